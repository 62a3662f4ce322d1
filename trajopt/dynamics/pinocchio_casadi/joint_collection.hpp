#pragma once

#include <pinocchio/autodiff/casadi.hpp>
#include <pinocchio/multibody.hpp>

namespace trajopt {

// Pinocchio's default collection without the unsupported kinds: fewer
// alternatives of the variant, so every algorithm is instantiated less often.
// The mimic joint stays because Pinocchio's Model and Data name it; no model
// that reaches this code contains one.
template <typename _Scalar, int _Options>
struct JointCollectionTpl {
  using Scalar = _Scalar;
  static constexpr int Options = _Options;

  using JointModelRX = pinocchio::JointModelRevoluteTpl<Scalar, Options, 0>;
  using JointModelRY = pinocchio::JointModelRevoluteTpl<Scalar, Options, 1>;
  using JointModelRZ = pinocchio::JointModelRevoluteTpl<Scalar, Options, 2>;
  using JointModelRUBX = pinocchio::JointModelRevoluteUnboundedTpl<Scalar, Options, 0>;
  using JointModelRUBY = pinocchio::JointModelRevoluteUnboundedTpl<Scalar, Options, 1>;
  using JointModelRUBZ = pinocchio::JointModelRevoluteUnboundedTpl<Scalar, Options, 2>;
  using JointModelRevoluteUnaligned = pinocchio::JointModelRevoluteUnalignedTpl<Scalar, Options>;
  using JointModelRevoluteUnboundedUnaligned =
      pinocchio::JointModelRevoluteUnboundedUnalignedTpl<Scalar, Options>;
  using JointModelPX = pinocchio::JointModelPrismaticTpl<Scalar, Options, 0>;
  using JointModelPY = pinocchio::JointModelPrismaticTpl<Scalar, Options, 1>;
  using JointModelPZ = pinocchio::JointModelPrismaticTpl<Scalar, Options, 2>;
  using JointModelPrismaticUnaligned = pinocchio::JointModelPrismaticUnalignedTpl<Scalar, Options>;
  using JointModelSpherical = pinocchio::JointModelSphericalTpl<Scalar, Options>;
  using JointModelSphericalZYX = pinocchio::JointModelSphericalZYXTpl<Scalar, Options>;
  using JointModelTranslation = pinocchio::JointModelTranslationTpl<Scalar, Options>;
  using JointModelFreeFlyer = pinocchio::JointModelFreeFlyerTpl<Scalar, Options>;
  using JointModelPlanar = pinocchio::JointModelPlanarTpl<Scalar, Options>;
  using JointModelMimic = pinocchio::JointModelMimicTpl<Scalar, Options, trajopt::JointCollectionTpl>;

  using JointModelVariant = boost::variant<
      JointModelRX, JointModelRY, JointModelRZ, JointModelFreeFlyer, JointModelPlanar,
      JointModelRevoluteUnaligned, JointModelSpherical, JointModelSphericalZYX, JointModelPX,
      JointModelPY, JointModelPZ, JointModelPrismaticUnaligned, JointModelTranslation,
      JointModelRUBX, JointModelRUBY, JointModelRUBZ, JointModelRevoluteUnboundedUnaligned,
      boost::recursive_wrapper<JointModelMimic>>;

  using JointDataRX = pinocchio::JointDataRevoluteTpl<Scalar, Options, 0>;
  using JointDataRY = pinocchio::JointDataRevoluteTpl<Scalar, Options, 1>;
  using JointDataRZ = pinocchio::JointDataRevoluteTpl<Scalar, Options, 2>;
  using JointDataRUBX = pinocchio::JointDataRevoluteUnboundedTpl<Scalar, Options, 0>;
  using JointDataRUBY = pinocchio::JointDataRevoluteUnboundedTpl<Scalar, Options, 1>;
  using JointDataRUBZ = pinocchio::JointDataRevoluteUnboundedTpl<Scalar, Options, 2>;
  using JointDataRevoluteUnaligned = pinocchio::JointDataRevoluteUnalignedTpl<Scalar, Options>;
  using JointDataRevoluteUnboundedUnaligned =
      pinocchio::JointDataRevoluteUnboundedUnalignedTpl<Scalar, Options>;
  using JointDataPX = pinocchio::JointDataPrismaticTpl<Scalar, Options, 0>;
  using JointDataPY = pinocchio::JointDataPrismaticTpl<Scalar, Options, 1>;
  using JointDataPZ = pinocchio::JointDataPrismaticTpl<Scalar, Options, 2>;
  using JointDataPrismaticUnaligned = pinocchio::JointDataPrismaticUnalignedTpl<Scalar, Options>;
  using JointDataSpherical = pinocchio::JointDataSphericalTpl<Scalar, Options>;
  using JointDataSphericalZYX = pinocchio::JointDataSphericalZYXTpl<Scalar, Options>;
  using JointDataTranslation = pinocchio::JointDataTranslationTpl<Scalar, Options>;
  using JointDataFreeFlyer = pinocchio::JointDataFreeFlyerTpl<Scalar, Options>;
  using JointDataPlanar = pinocchio::JointDataPlanarTpl<Scalar, Options>;
  using JointDataMimic = pinocchio::JointDataMimicTpl<Scalar, Options, trajopt::JointCollectionTpl>;

  using JointDataVariant = boost::variant<
      JointDataRX, JointDataRY, JointDataRZ, JointDataFreeFlyer, JointDataPlanar,
      JointDataRevoluteUnaligned, JointDataSpherical, JointDataSphericalZYX, JointDataPX,
      JointDataPY, JointDataPZ, JointDataPrismaticUnaligned, JointDataTranslation, JointDataRUBX,
      JointDataRUBY, JointDataRUBZ, JointDataRevoluteUnboundedUnaligned,
      boost::recursive_wrapper<JointDataMimic>>;
};

using Scalar = casadi::SX;
using Model = pinocchio::ModelTpl<Scalar, 0, JointCollectionTpl>;
using Data = pinocchio::DataTpl<Scalar, 0, JointCollectionTpl>;
using JointModel = Model::JointModel;

}  // namespace trajopt
