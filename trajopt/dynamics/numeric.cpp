#include "numeric.hpp"

#include <boost/python/converter/from_python.hpp>
#include <boost/python/converter/registry.hpp>
#include <boost/python/type_id.hpp>

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

// What an object of Python's wrapper holds.
template <class Held>
Held& held_by(const nb::object& object) {
  namespace converter = boost::python::converter;
  const auto* registration = converter::registry::query(boost::python::type_id<Held>());
  void* held = registration ? converter::get_lvalue_from_python(object.ptr(), *registration) : nullptr;
  if (held == nullptr) throw nb::type_error("a pinocchio.Model is needed");
  return *static_cast<Held*>(held);
}

}  // namespace

// Data are Python's, too: no part of their templates is compiled here.
struct NumericModel::State {
  explicit State(const nb::object& object)
      : owner(object),
        model(held_by<pinocchio::Model>(object)),
        data_owner(object.attr("createData")()),
        data(held_by<pinocchio::Data>(data_owner)) {}

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

void NumericModel::move(const Vector& q, const Vector& v) {
  const Vector still = Vector::Zero(nv_);
  pinocchio::forwardKinematics(state_->model, state_->data, In(q), In(v), In(still));
  pinocchio::computeJointJacobians(state_->model, state_->data);
}

void NumericModel::place(const Vector& q) { pinocchio::computeJointJacobians(state_->model, state_->data, In(q)); }

Matrix NumericModel::frame_jacobian(int frame) {
  return pinocchio::getFrameJacobian(state_->model, state_->data, frame, kAligned);
}

Twist NumericModel::frame_acceleration(int frame) {
  return pinocchio::getFrameClassicalAcceleration(state_->model, state_->data, frame, kAligned).toVector();
}

Eigen::Vector3d NumericModel::frame_position(int frame) {
  return pinocchio::updateFramePlacement(state_->model, state_->data, frame).translation();
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
