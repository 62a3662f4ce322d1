#include "model.hpp"

#include <map>
#include <stdexcept>

namespace trajopt {
namespace {

void require(bool condition, const std::string& message) {
  if (!condition) throw std::invalid_argument(message);
}

using Collection = JointCollectionTpl<Scalar, 0>;
using Maker = JointModel (*)(const Model::Vector3& axis);

template <typename Kind>
JointModel aligned(const Model::Vector3&) { return Kind(); }

template <typename Kind>
JointModel unaligned(const Model::Vector3& axis) { return Kind(axis[0], axis[1], axis[2]); }

// Along an axis of its frame: products with its zeros and ones are none in the graph.
template <int axis>
JointModel along(const Model::Vector3&) {
  return Collection::JointModelPrismaticUnaligned(Model::Vector3::Unit(axis));
}

JointModel make_joint(const Joint& joint) {
  static const std::map<std::string, Maker> makers = {
      {"RX", aligned<Collection::JointModelRX>},
      {"RY", aligned<Collection::JointModelRY>},
      {"RZ", aligned<Collection::JointModelRZ>},
      {"RUBX", aligned<Collection::JointModelRUBX>},
      {"RUBY", aligned<Collection::JointModelRUBY>},
      {"RUBZ", aligned<Collection::JointModelRUBZ>},
      {"RevoluteUnaligned", unaligned<Collection::JointModelRevoluteUnaligned>},
      {"RevoluteUnboundedUnaligned", unaligned<Collection::JointModelRevoluteUnboundedUnaligned>},
      {"PX", along<0>},
      {"PY", along<1>},
      {"PZ", along<2>},
      {"PrismaticUnaligned", unaligned<Collection::JointModelPrismaticUnaligned>},
      {"Spherical", aligned<Collection::JointModelSpherical>},
      {"SphericalZYX", aligned<Collection::JointModelSphericalZYX>},
      {"Translation", aligned<Collection::JointModelTranslation>},
      {"FreeFlyer", aligned<Collection::JointModelFreeFlyer>},
      {"Planar", aligned<Collection::JointModelPlanar>},
  };
  const auto maker = makers.find(joint.kind);
  if (maker == makers.end()) throw std::invalid_argument(joint.kind);
  return maker->second(vector3(joint.axis).cast<Scalar>());
}

}  // namespace

Model make_model(const Description& description) {
  Model model;
  for (const Joint& joint : description.joints) {
    require(0 <= joint.parent && joint.parent < model.njoints,
            "the parent of joint '" + joint.name + "' is " + std::to_string(joint.parent) + "; allowed: 0 to " +
                std::to_string(model.njoints - 1));
    const Model::SE3 placement(matrix3(joint.rotation).cast<Scalar>(),
                               vector3(joint.translation).cast<Scalar>());
    const auto index = model.addJoint(joint.parent, make_joint(joint), placement, joint.name);
    model.inertias[index] = Model::Inertia(
        joint.mass, vector3(joint.lever).cast<Scalar>(),
        pinocchio::Symmetric3Tpl<Scalar, 0>(matrix3(joint.inertia).cast<Scalar>().eval()));
  }
  require(description.armature.size() == static_cast<std::size_t>(model.nv),
          "armature has " + std::to_string(description.armature.size()) + " entries; allowed: " +
              std::to_string(model.nv));
  for (int i = 0; i < model.nv; ++i) model.armature[i] = description.armature[i];
  model.gravity.linear(vector3(description.gravity).cast<Scalar>());
  return model;
}

void check(const Model& model, const Frame& frame) {
  require(0 <= frame.joint && frame.joint < model.njoints,
          "the joint of a frame is " + std::to_string(frame.joint) + "; allowed: 0 to " +
              std::to_string(model.njoints - 1));
  require(frame.wrench_size == 0 || frame.wrench_size == 3 || frame.wrench_size == 6,
          "a wrench size is " + std::to_string(frame.wrench_size) + "; allowed: 0, 3, 6");
}

Model::SE3 placement(const Model& model, const Frame& frame) {
  check(model, frame);
  return Model::SE3(matrix3(frame.rotation).cast<Scalar>(), vector3(frame.translation).cast<Scalar>());
}

Data make_data(const Model& model) { return Data(model); }

Symbol::Symbol(const std::string& name, int size)
    : matrix(casadi::SX::sym(name, size)), vector(size) {
  for (int i = 0; i < size; ++i) vector[i] = matrix(i);
}

}  // namespace trajopt
