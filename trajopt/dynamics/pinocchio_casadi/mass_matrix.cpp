#include <pinocchio/autodiff/casadi.hpp>
#include <pinocchio/algorithm/crba.hpp>

#include "functions.hpp"
#include "motion.hpp"

namespace trajopt {

std::string mass_matrix(const Description& description) {
  const Model model = make_model(description);
  Data data = make_data(model);
  const Symbol q("q", model.nq);
  pinocchio::impl::crbaLocalConvention(model, data, q.vector);
  data.M.triangularView<Eigen::StrictlyLower>() = data.M.transpose();
  return casadi::Function("mass_matrix", {q.matrix}, {dense(data.M)}, {"q"}, {"M"}).serialize();
}

}  // namespace trajopt
