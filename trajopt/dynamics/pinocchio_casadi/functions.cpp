#include "functions.hpp"

#include "model.hpp"

#include <map>
#include <stdexcept>

#include <pinocchio/algorithm/rnea.hpp>

namespace trajopt {
namespace {

using Forces = std::vector<Model::Force>;
using Vector3 = Model::SE3::Vector3;
using Matrix3 = Model::SE3::Matrix3;

// Pinocchio's Newton-Euler algorithm in its two halves, so that the wrenches given in world axes can use the placements of the
// forward half.

using ForwardStep = pinocchio::impl::RneaForwardStep<Scalar, 0, JointCollectionTpl, Vector, Vector, Vector>;
using BackwardStep = pinocchio::impl::RneaBackwardStep<Scalar, 0, JointCollectionTpl>;

void forward_step(const Model& model, Data& data, int joint, const Vector& q, const Vector& v, const Vector& a) {
  ForwardStep::run(model.joints[joint], data.joints[joint], typename ForwardStep::ArgsType(model, data, q, v, a));
}

// The joint's generalised forces are added to tau, its force to that of its parent.
void backward_step(const Model& model, Data& data, int joint) {
  BackwardStep::run(model.joints[joint], data.joints[joint], typename BackwardStep::ArgsType(model, data));
}

// Fills liMi, oMi, v, a_gf (gravity included), a (gravity excluded), h, f.
void forward_pass(const Model& model, Data& data, const Vector& q, const Vector& v, const Vector& a) {
  const Model::SE3::Vector3 gravity = model.gravity.linear();
  data.tau.setZero();
  data.v[0].setZero();
  data.a[0].setZero();
  data.a_gf[0] = -model.gravity;
  data.oMi[0].setIdentity();
  for (int i = 1; i < model.njoints; ++i) {
    forward_step(model, data, i, q, v, a);
    data.oMi[i] = data.oMi[model.parents[i]] * data.liMi[i];
    data.a[i] = data.a_gf[i];
    data.a[i].linear() += data.oMi[i].rotation().transpose() * gravity;
  }
}

// Generalised forces (nv), with `external` subtracted: one force per joint, in its frame.
Vector backward_pass(const Model& model, Data& data, const Vector& a, const Forces& external) {
  for (int i = model.njoints - 1; i > 0; --i) {
    data.f[i] -= external[i];
    backward_step(model, data, i);
  }
  for (int i = 0; i < model.nv; ++i) data.tau[i] += model.armature[i] * a[i];
  return data.tau;
}

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


// A model, its data after the forward pass, and the symbols they depend on. A level that is left out is zero, so its symbols
// do not appear in the graph.
enum Level { position, velocity, acceleration };
struct Motion {
  Motion(const Description& description, Level level)
      : level(level),
        model(make_model(description)),
        data(make_data(model)),
        q("q", model.nq),
        v("v", model.nv),
        a("a", model.nv) {
    if (level < velocity) v.vector.setZero();
    if (level < acceleration) a.vector.setZero();
    forward_pass(model, data, q.vector, v.vector, a.vector);
  }

  // Serialised function of the symbols up to the level.
  std::string function(const std::string& name, const std::vector<casadi::SX>& outputs,
                       const std::vector<std::string>& output_names) const {
    std::vector<casadi::SX> inputs = {q.matrix, v.matrix, a.matrix};
    std::vector<std::string> input_names = {"q", "v", "a"};
    inputs.resize(level + 1);
    input_names.resize(level + 1);
    return casadi::Function(name, inputs, outputs, input_names, output_names).serialize();
  }

  Level level;
  Model model;
  Data data;
  Symbol q, v, a;
};

std::string generalised_forces(const std::string& name, const std::string& output, const Description& description,
                               Level level) {
  Motion motion(description, level);
  const Forces none(motion.model.njoints, Model::Force::Zero());
  const Vector tau = backward_pass(motion.model, motion.data, motion.a.vector, none);
  return motion.function(name, {dense(tau)}, {output});
}

// A motion of a joint as that of a frame on it, in the axes and at the origin that `reference` names.
Model::Motion seen_from(const std::string& reference, const Motion& motion, const Frame& frame, const Model::Motion& of_joint) {
  const Model::SE3 in_joint = placement(motion.model, frame);
  if (reference == "local") return in_joint.actInv(of_joint);
  if (reference == "world") return motion.data.oMi[frame.joint].act(of_joint);
  if (reference != "world_aligned")
    throw std::invalid_argument("reference '" + reference + "'; allowed: world_aligned, local, world");
  const Matrix3 rotation = motion.data.oMi[frame.joint].rotation() * in_joint.rotation();
  return Model::SE3(rotation, Vector3::Zero()).act(in_joint.actInv(of_joint));
}

// Sums over the bodies after a forward pass, from the tips to the world.
struct Bodies {
  explicit Bodies(const Motion& motion) {
    const Model& model = motion.model;
    std::vector<Vector3> moments(model.njoints, Vector3::Zero());
    std::vector<Scalar> masses(model.njoints, 0);
    auto momenta = motion.data.h, forces = motion.data.f;
    momenta[0].setZero();
    forces[0].setZero();
    for (int i = model.njoints - 1; i > 0; --i) {
      const int parent = model.parents[i];
      const Model::SE3& place = motion.data.liMi[i];
      masses[i] += model.inertias[i].mass();
      masses[parent] += masses[i];
      moments[i] += model.inertias[i].mass() * model.inertias[i].lever();
      moments[parent] += place.rotation() * moments[i] + masses[i] * place.translation();
      momenta[parent] += place.act(momenta[i]);
      forces[parent] += place.act(forces[i]);
      if (motion.level > position) kinetic += motion.data.v[i].dot(motion.data.h[i]) / 2;
    }
    mass = masses[0];
    const Vector3& moment = moments[0];
    const Model::Force &total_momentum = momenta[0], &total_force = forces[0];
    centre = moment / mass;
    potential = -moment.dot(Vector3(model.gravity.linear()));
    momentum << total_momentum.linear(), total_momentum.angular() - centre.cross(total_momentum.linear());
    // The forces hold against gravity, too, which has no moment about the centre of mass.
    rate << total_force.linear() + mass * model.gravity.linear(),
        total_force.angular() - centre.cross(total_force.linear());
  }

  Scalar mass = 0, kinetic = 0, potential = 0;
  Vector3 centre;
  Eigen::Matrix<Scalar, 6, 1> momentum, rate;  // about the centre of mass
};

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

std::string rnea(const Description& description) {
  return generalised_forces("rnea", "tau", description, acceleration);
}

std::string bias_forces(const Description& description) {
  return generalised_forces("bias_forces", "h", description, velocity);
}

// Composite rigid bodies, by the steps of the Newton-Euler algorithm: a column is the generalised forces of the bodies
// that one unit of acceleration moves.
std::string mass_matrix(const Description& description) {
  Motion motion(description, position);
  const Model& model = motion.model;
  Data& data = motion.data;
  auto composite = model.inertias;
  for (int i = model.njoints - 1; i > 0; --i)
    if (model.parents[i] > 0) composite[model.parents[i]] += data.liMi[i].act(composite[i]);
  Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic> mass(model.nv, model.nv);
  mass.setZero();
  for (int joint = 1; joint < model.njoints; ++joint)
    for (int column = model.idx_vs[joint]; column < model.idx_vs[joint] + model.nvs[joint]; ++column) {
      Vector unit = Vector::Zero(model.nv);
      unit[column] = 1;
      data.a_gf[model.parents[joint]].setZero();
      data.tau.setZero();
      forward_step(model, data, joint, motion.q.vector, motion.v.vector, unit);
      data.f[joint] = composite[joint] * data.a_gf[joint];
      for (int i = joint; i > 0; i = model.parents[i]) {
        data.f[model.parents[i]].setZero();
        backward_step(model, data, i);
        for (int row = model.idx_vs[i]; row < model.idx_vs[i] + model.nvs[i]; ++row)
          mass(row, column) = mass(column, row) = data.tau[row];
      }
      mass(column, column) += model.armature[column];
    }
  return motion.function("mass_matrix", {dense(mass)}, {"M"});
}

std::string frame_placement(const Description& description, const Frame& frame) {
  const Motion motion(description, position);
  const Model::SE3 in_joint = placement(motion.model, frame);
  const Model::SE3 world = motion.data.oMi[frame.joint] * in_joint;
  return motion.function("frame_placement", {dense(world.rotation()), dense(world.translation())},
                         {"rotation", "position"});
}

std::string frame_velocity(const Description& description, const Frame& frame, const std::string& reference) {
  const Motion motion(description, velocity);
  check(motion.model, frame);
  const Model::Motion moved = seen_from(reference, motion, frame, motion.data.v[frame.joint]);
  return motion.function("frame_velocity", {dense(moved.toVector())}, {"velocity"});
}

std::string frame_acceleration(const Description& description, const Frame& frame, const std::string& reference) {
  const Motion motion(description, acceleration);
  check(motion.model, frame);
  const Model::Motion rate = seen_from(reference, motion, frame, motion.data.v[frame.joint]);
  Model::Motion moved = seen_from(reference, motion, frame, motion.data.a[frame.joint]);
  moved.linear() += rate.angular().cross(rate.linear());
  return motion.function("frame_acceleration", {dense(moved.toVector())}, {"acceleration"});
}

std::string centre_of_mass(const Description& description) {
  const Motion motion(description, velocity);
  const Bodies bodies(motion);
  return motion.function("centre_of_mass", {dense(bodies.centre), dense(bodies.momentum.head<3>() / bodies.mass)},
                         {"c", "dc"});
}

std::string centroidal_momentum(const Description& description) {
  const Motion motion(description, velocity);
  return motion.function("centroidal_momentum", {dense(Bodies(motion).momentum)}, {"h"});
}

std::string centroidal_momentum_rate(const Description& description) {
  const Motion motion(description, acceleration);
  const Bodies bodies(motion);
  return motion.function("centroidal_momentum_rate", {dense(bodies.momentum), dense(bodies.rate)}, {"h", "dh"});
}

std::string kinetic_energy(const Description& description) {
  const Motion motion(description, velocity);
  return motion.function("kinetic_energy", {Bodies(motion).kinetic}, {"energy"});
}

std::string potential_energy(const Description& description) {
  const Motion motion(description, position);
  return motion.function("potential_energy", {Bodies(motion).potential}, {"energy"});
}

}  // namespace trajopt
