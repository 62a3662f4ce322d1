#include "motion.hpp"

#include <map>
#include <stdexcept>

namespace trajopt {

Motion::Motion(const Description& description, Level level)
    : model(make_model(description)),
      data(make_data(model)),
      q("q", model.nq),
      v("v", model.nv),
      a("a", model.nv) {
  if (level < velocity) v.vector.setZero();
  if (level < acceleration) a.vector.setZero();
  forward_pass(model, data, q.vector, v.vector, a.vector);
}

std::string function(const std::string& name, const Motion& motion, Motion::Level level,
                     const std::vector<casadi::SX>& outputs,
                     const std::vector<std::string>& output_names) {
  std::vector<casadi::SX> inputs = {motion.q.matrix, motion.v.matrix, motion.a.matrix};
  std::vector<std::string> input_names = {"q", "v", "a"};
  inputs.resize(level + 1);
  input_names.resize(level + 1);
  return casadi::Function(name, inputs, outputs, input_names, output_names).serialize();
}

pinocchio::ReferenceFrame reference_frame(const std::string& name) {
  static const std::map<std::string, pinocchio::ReferenceFrame> frames = {
      {"world_aligned", pinocchio::LOCAL_WORLD_ALIGNED},
      {"local", pinocchio::LOCAL},
      {"world", pinocchio::WORLD},
  };
  const auto frame = frames.find(name);
  if (frame == frames.end()) throw std::invalid_argument("reference '" + name + "'; allowed: world_aligned, local, world");
  return frame->second;
}

}  // namespace trajopt
