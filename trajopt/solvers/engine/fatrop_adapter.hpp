// The sparse NLP as FATROP's: whole vectors in, blocks of stages out.
#pragma once

#include "fatrop_stages.hpp"

// FATROP's print level and banner are inline variables: they must be the library's own.
#pragma GCC visibility push(default)
#include <fatrop/fatrop.hpp>
#pragma GCC visibility pop

namespace trajopt {

class FatropAdapter : public fatrop::Nlp<fatrop::OcpType> {
 public:
  using Index = fatrop::Index;
  using Scalar = fatrop::Scalar;
  using Vector = fatrop::VecRealView;
  using Data = fatrop::IpData<fatrop::OcpType>;

  FatropAdapter(trajopt::Nlp& nlp, const StageMap& map, const Reals& x0);

  std::function<void(bool restoration)> tick;  // at every iteration
  std::function<void()> look;                  // before every evaluation and factorisation
  double objective_scale = 1.0;                // FATROP minimises the objective times this
  bool finite_derivatives = true;              // none was NaN or infinite so far

  // FATROP's vector in the NLP's order.
  const double* unknowns(const Vector& x);

  const fatrop::NlpDims& nlp_dims() const override { return totals_; }
  const StageDims& problem_dims() const override { return map_.dims; }
  Index eval_lag_hess(const StageInfo&, const Scalar scale, const Vector& x, const Vector&, const Vector& lambda,
                      fatrop::Hessian<fatrop::OcpType>& hessian) override;
  Index eval_constr_jac(const StageInfo&, const Vector& x, const Vector&,
                        fatrop::Jacobian<fatrop::OcpType>& jacobian) override;
  Index eval_constraint_violation(const StageInfo& info, const Vector& x, const Vector& slack,
                                  Vector& result) override;
  Index eval_objective_gradient(const StageInfo&, const Scalar scale, const Vector& x, const Vector&,
                                Vector& gradient_x, Vector& gradient_s) override;
  Index eval_objective(const StageInfo&, const Scalar scale, const Vector& x, const Vector&, Scalar& result) override;
  Index get_bounds(const StageInfo&, Vector& lower, Vector& upper) override;
  Index get_initial_primal(const StageInfo&, Vector& x) override;
  void get_primal_damping(const StageInfo&, Vector& damping) override { damping = 0.0; }
  void apply_jacobian_s_transpose(const StageInfo& info, const Vector& lambda, const Scalar alpha, const Vector& y,
                                  Vector& out) override;
  void callback(const Data&) override;

 private:
  const double* point(const Vector& x);
  const Reals& watch(const Reals& values);

  trajopt::Nlp& nlp_;
  const StageMap& map_;
  const Reals& x0_;
  fatrop::NlpDims totals_;
  Reals x_, lambda_;
  bool called_back_ = false;
};

}  // namespace trajopt
