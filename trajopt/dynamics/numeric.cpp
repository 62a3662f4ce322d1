#include "numeric.hpp"

#include "held.hpp"

#include <pinocchio/multibody.hpp>

#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>

namespace {

constexpr auto kAligned = pinocchio::LOCAL_WORLD_ALIGNED;

// What the library has its algorithms of dynamics and kinematics for, beside plain vectors for those of configurations: with
// other types they would be compiled here.
using In = Eigen::Ref<const Vector>;

}  // namespace

// Data are Python's, too: no part of their templates is compiled here.
struct NumericModel::State {
  explicit State(const nb::object& object)
      : owner(object),
        model(held_by<pinocchio::Model>(object, "pinocchio.Model")),
        data_owner(object.attr("createData")()),
        data(held_by<pinocchio::Data>(data_owner, "pinocchio.Data")) {}

  nb::object owner;
  const pinocchio::Model& model;
  nb::object data_owner;
  pinocchio::Data& data;
};

NumericModel::NumericModel(const nb::object& model)
    : state_(std::make_unique<State>(model)), nq_(state_->model.nq), nv_(state_->model.nv), position_of_(nv_, -1) {
  const pinocchio::Model& known = state_->model;
  for (int joint = 1; joint < known.njoints; ++joint)
    if (known.nqs[joint] == 1 && known.nvs[joint] == 1) position_of_[known.idx_vs[joint]] = known.idx_qs[joint];
}

NumericModel::~NumericModel() = default;

int NumericModel::frame(int number) const {
  if (number < 0 || number >= state_->model.nframes) throw std::invalid_argument("a frame is not in the model");
  return number;
}

Vector NumericModel::integrate(const Vector& q, const Vector& change) const {
  Vector result(nq_);
  pinocchio::integrate(state_->model, q, change, result);
  return result;
}

Matrix NumericModel::integration_jacobian(const Vector& q, const Vector& change) const {
  Matrix result = Matrix::Zero(nv_, nv_);
  pinocchio::dIntegrate(state_->model, q, change, result, pinocchio::ARG1);
  return result;
}

Matrix NumericModel::mass_matrix(const Vector& q) { return pinocchio::crba(state_->model, state_->data, In(q)); }

Vector NumericModel::bias(const Vector& q, const Vector& v) {
  return pinocchio::nonLinearEffects(state_->model, state_->data, In(q), In(v));
}

Vector NumericModel::inverse_dynamics(const Vector& q, const Vector& v, const Vector& a) {
  return pinocchio::rnea(state_->model, state_->data, In(q), In(v), In(a));
}

void NumericModel::move(const Vector& q, const Vector& v) { move(q, v, Vector::Zero(nv_)); }

void NumericModel::move(const Vector& q, const Vector& v, const Vector& a) {
  pinocchio::forwardKinematics(state_->model, state_->data, In(q), In(v), In(a));
  pinocchio::computeJointJacobians(state_->model, state_->data);
}

void NumericModel::place(const Vector& q) { pinocchio::computeJointJacobians(state_->model, state_->data, In(q)); }

void NumericModel::place_frames(const Vector& q) { pinocchio::forwardKinematics(state_->model, state_->data, In(q)); }

Matrix NumericModel::frame_jacobian(int frame) {
  return pinocchio::getFrameJacobian(state_->model, state_->data, frame, kAligned);
}

Twist NumericModel::frame_velocity(int frame) {
  return pinocchio::getFrameVelocity(state_->model, state_->data, frame, kAligned).toVector();
}

Twist NumericModel::frame_acceleration(int frame) {
  return pinocchio::getFrameClassicalAcceleration(state_->model, state_->data, frame, kAligned).toVector();
}

Eigen::Vector3d NumericModel::frame_position(int frame) {
  return pinocchio::updateFramePlacement(state_->model, state_->data, frame).translation();
}

void NumericModel::frame_placement(int frame, Eigen::Matrix3d& rotation, Eigen::Vector3d& position) {
  const auto& place = pinocchio::updateFramePlacement(state_->model, state_->data, frame);
  rotation = place.rotation();
  position = place.translation();
}

Twist NumericModel::pose_error(int frame, const Eigen::Matrix3d& rotation, const Eigen::Vector3d& position) {
  const auto& place = pinocchio::updateFramePlacement(state_->model, state_->data, frame);
  return pinocchio::log6(pinocchio::SE3(rotation, position).actInv(place)).toVector();
}

Matrix NumericModel::pose_error_jacobian(int frame, const Eigen::Matrix3d& rotation, const Eigen::Vector3d& position) {
  const auto& place = pinocchio::updateFramePlacement(state_->model, state_->data, frame);
  Eigen::Matrix<double, 6, 6> turned;
  pinocchio::Jlog6(pinocchio::SE3(rotation, position).actInv(place), turned);
  return turned.lazyProduct(pinocchio::getFrameJacobian(state_->model, state_->data, frame, pinocchio::LOCAL));
}

std::pair<OutputTable, OutputTable> sampled(const nb::object& model, const std::vector<int>& frames, const Table& q,
                                            const Table& v, const Table& a, const Table& wrenches) {
  NumericModel numeric(model);
  const RowMajor places = read(q), rates = read(v), changes = read(a), pushes = read(wrenches);
  const auto rows = places.rows(), count = static_cast<Eigen::Index>(frames.size());
  if (places.cols() != numeric.nq() || rates.cols() != numeric.nv() || changes.cols() != numeric.nv() ||
      pushes.cols() != 6 * count || rates.rows() != rows || changes.rows() != rows || pushes.rows() != rows)
    throw std::invalid_argument("q, v, a or wrenches have a wrong shape");
  for (const int frame : frames) numeric.frame(frame);
  auto forces = std::make_unique<RowMajor>(rows, numeric.nv());
  auto moved = std::make_unique<RowMajor>(rows * count, 24);
  Eigen::Matrix3d rotation;
  Eigen::Vector3d position;
  for (Eigen::Index row = 0; row < rows; ++row) {
    const Vector at = places.row(row), rate = rates.row(row), change = changes.row(row);
    Vector force = numeric.inverse_dynamics(at, rate, change);
    numeric.move(at, rate, change);
    for (Eigen::Index i = 0; i < count; ++i) {
      const int frame = frames[static_cast<std::size_t>(i)];
      numeric.frame_placement(frame, rotation, position);
      force -= numeric.frame_jacobian(frame).transpose() * pushes.row(row).segment<6>(6 * i).transpose();
      auto values = moved->row(row * count + i);
      for (int axis = 0; axis < 3; ++axis) values.segment<3>(3 * axis) = rotation.row(axis);
      values.segment<3>(9) = position;
      values.segment<6>(12) = numeric.frame_velocity(frame);
      values.tail<6>() = numeric.frame_acceleration(frame);
    }
    forces->row(row) = force;
  }
  return {to_numpy(std::move(forces)), to_numpy(std::move(moved))};
}
