#include "functions.hpp"
#include "motion.hpp"

namespace trajopt {
namespace {

std::string generalised_forces(const std::string& name, const std::string& output,
                               const Description& description, Motion::Level level) {
  Motion motion(description, level);
  const Forces none(motion.model.njoints, Model::Force::Zero());
  const Vector tau = backward_pass(motion.model, motion.data, motion.a.vector, none);
  return function(name, motion, level, {dense(tau)}, {output});
}

}  // namespace

std::string rnea(const Description& description) {
  return generalised_forces("rnea", "tau", description, Motion::acceleration);
}

std::string bias_forces(const Description& description) {
  return generalised_forces("bias_forces", "h", description, Motion::velocity);
}

}  // namespace trajopt
