#include "dynamics.hpp"

#include <pinocchio/algorithm/rnea.hpp>

namespace trajopt {

void forward_pass(const Model& model, Data& data, const Vector& q, const Vector& v,
                  const Vector& a) {
  using Step = pinocchio::impl::RneaForwardStep<Scalar, 0, JointCollectionTpl, Vector, Vector, Vector>;
  const Model::SE3::Vector3 gravity = model.gravity.linear();
  data.tau.setZero();
  data.v[0].setZero();
  data.a[0].setZero();
  data.a_gf[0] = -model.gravity;
  data.oMi[0].setIdentity();
  for (int i = 1; i < model.njoints; ++i) {
    Step::run(model.joints[i], data.joints[i], typename Step::ArgsType(model, data, q, v, a));
    data.oMi[i] = data.oMi[model.parents[i]] * data.liMi[i];
    data.a[i] = data.a_gf[i];
    data.a[i].linear() += data.oMi[i].rotation().transpose() * gravity;
  }
}

Vector backward_pass(const Model& model, Data& data, const Vector& a, const Forces& external) {
  using Step = pinocchio::impl::RneaBackwardStep<Scalar, 0, JointCollectionTpl>;
  for (int i = model.njoints - 1; i > 0; --i) {
    data.f[i] -= external[i];
    Step::run(model.joints[i], data.joints[i], typename Step::ArgsType(model, data));
  }
  for (int i = 0; i < model.nv; ++i) data.tau[i] += model.armature[i] * a[i];
  return data.tau;
}

}  // namespace trajopt
