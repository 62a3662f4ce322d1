#include "functions.hpp"

#include "dynamics.hpp"

namespace trajopt {
namespace {

using Vector3 = Model::SE3::Vector3;
using Matrix3 = Model::SE3::Matrix3;

int stacked_wrench_size(const std::vector<Frame>& frames) {
  int size = 0;
  for (const Frame& frame : frames) size += frame.wrench_size;
  return size;
}

// The wrenches at the frames' origins, transformed to their joints' frames and summed.
Forces joint_forces(const Model& model, const Data& data, const std::vector<Frame>& frames,
                    const Vector& wrenches) {
  Forces forces(model.njoints, Model::Force::Zero());
  int offset = 0;
  for (const Frame& frame : frames) {
    if (frame.wrench_size == 0) continue;
    const Matrix3 to_joint = data.oMi[frame.joint].rotation().transpose();
    const Vector3 origin = vector3(frame.translation).cast<Scalar>();
    const Vector3 force = to_joint * wrenches.segment<3>(offset);
    Vector3 moment = origin.cross(force);
    if (frame.wrench_size == 6) moment += to_joint * wrenches.segment<3>(offset + 3);
    forces[frame.joint] += Model::Force(force, moment);
    offset += frame.wrench_size;
  }
  return forces;
}

struct FrameColumns {
  explicit FrameColumns(int count)
      : rotation(casadi::SX::zeros(9, count)),
        position(casadi::SX::zeros(3, count)),
        velocity(casadi::SX::zeros(6, count)),
        acceleration(casadi::SX::zeros(6, count)) {}
  casadi::SX rotation, position, velocity, acceleration;
};

void fill(casadi::SX& matrix, int row, int column, const Vector3& values) {
  for (int i = 0; i < 3; ++i) matrix(row + i, column) = values[i];
}

// Motion of the frame's origin in world-aligned axes; the linear acceleration is classical.
// The forward pass accelerates everything by -gravity: that is undone in the world, where it
// is a constant.
void fill_motion(FrameColumns& columns, int column, const Model& model, const Data& data,
                 const Frame& frame) {
  const Model::SE3& joint = data.oMi[frame.joint];
  const Vector3 origin = vector3(frame.translation).cast<Scalar>();
  const Vector3 omega = data.v[frame.joint].angular();
  const Vector3 alpha = data.a_gf[frame.joint].angular();
  const Vector3 velocity = data.v[frame.joint].linear() + omega.cross(origin);
  const Vector3 acceleration =
      data.a_gf[frame.joint].linear() + alpha.cross(origin) + omega.cross(velocity);
  fill(columns.velocity, 0, column, joint.rotation() * velocity);
  fill(columns.velocity, 3, column, joint.rotation() * omega);
  fill(columns.acceleration, 0, column,
       joint.rotation() * acceleration + Vector3(model.gravity.linear()));
  fill(columns.acceleration, 3, column, joint.rotation() * alpha);
}

void fill_placement(FrameColumns& columns, int column, const Data& data, const Frame& frame) {
  const Model::SE3& joint = data.oMi[frame.joint];
  const Matrix3 rotation = joint.rotation() * matrix3(frame.rotation).cast<Scalar>();
  for (int j = 0; j < 3; ++j) fill(columns.rotation, 3 * j, column, rotation.col(j));
  fill(columns.position, 0, column, joint.act(vector3(frame.translation).cast<Scalar>().eval()));
}

}  // namespace

std::string fused(const Description& description, const std::vector<Frame>& frames) {
  const Model model = make_model(description);
  for (const Frame& frame : frames) check(model, frame);
  Data data = make_data(model);
  const Symbol q("q", model.nq), v("v", model.nv), a("a", model.nv);
  const Symbol w("w", stacked_wrench_size(frames));

  forward_pass(model, data, q.vector, v.vector, a.vector);
  const Forces forces = joint_forces(model, data, frames, w.vector);
  const Vector tau = backward_pass(model, data, a.vector, forces);
  FrameColumns columns(frames.size());
  for (std::size_t k = 0; k < frames.size(); ++k) {
    fill_placement(columns, k, data, frames[k]);
    fill_motion(columns, k, model, data, frames[k]);
  }
  return casadi::Function("fused", {q.matrix, v.matrix, a.matrix, w.matrix},
                          {dense(tau), columns.rotation, columns.position, columns.velocity,
                           columns.acceleration},
                          {"q", "v", "a", "w"},
                          {"tau", "rotation", "position", "velocity", "acceleration"})
      .serialize();
}

}  // namespace trajopt
