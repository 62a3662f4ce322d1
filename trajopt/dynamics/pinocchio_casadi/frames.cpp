#include <pinocchio/autodiff/casadi.hpp>
#include <pinocchio/algorithm/frames.hpp>

#include "functions.hpp"
#include "motion.hpp"

namespace trajopt {

std::string frame_placement(const Description& description, const Frame& frame) {
  const Motion motion(description, Motion::position);
  const Model::SE3 in_joint = placement(motion.model, frame);
  const Model::SE3 world = motion.data.oMi[frame.joint] * in_joint;
  return function("frame_placement", motion, Motion::position,
                  {dense(world.rotation()), dense(world.translation())}, {"rotation", "position"});
}

std::string frame_velocity(const Description& description, const Frame& frame,
                           const std::string& reference) {
  const Motion motion(description, Motion::velocity);
  const auto velocity = pinocchio::getFrameVelocity(motion.model, motion.data, frame.joint,
                                                    placement(motion.model, frame), reference_frame(reference));
  return function("frame_velocity", motion, Motion::velocity, {dense(velocity.toVector())},
                  {"velocity"});
}

std::string frame_acceleration(const Description& description, const Frame& frame,
                               const std::string& reference) {
  const Motion motion(description, Motion::acceleration);
  const auto acceleration = pinocchio::getFrameClassicalAcceleration(
      motion.model, motion.data, frame.joint, placement(motion.model, frame), reference_frame(reference));
  return function("frame_acceleration", motion, Motion::acceleration,
                  {dense(acceleration.toVector())}, {"acceleration"});
}

std::string frame_jacobian(const Description& description, const Frame& frame,
                           const std::string& reference) {
  const Model model = make_model(description);
  Data data = make_data(model);
  const Symbol q("q", model.nq);
  pinocchio::computeJointJacobians(model, data, q.vector);
  const auto jacobian = pinocchio::getFrameJacobian(model, data, frame.joint, placement(model, frame),
                                                    reference_frame(reference));
  return casadi::Function("frame_jacobian", {q.matrix}, {dense(jacobian)}, {"q"}, {"J"})
      .serialize();
}

}  // namespace trajopt
