#pragma once

#include <pinocchio/autodiff/casadi.hpp>
#include <pinocchio/multibody.hpp>

namespace trajopt {

// Pinocchio's default collection without the unsupported kinds: fewer
// alternatives of the variant, so every algorithm is instantiated less often.
// The mimic joint stays because Pinocchio's Model and Data name it; no model
// that reaches this code contains one.
template <typename _Scalar, int _Options>
struct JointCollectionTpl : pinocchio::JointCollectionDefaultTpl<_Scalar, _Options> {
  using Default = pinocchio::JointCollectionDefaultTpl<_Scalar, _Options>;
  using JointModelMimic = pinocchio::JointModelMimicTpl<_Scalar, _Options, trajopt::JointCollectionTpl>;
  using JointDataMimic = pinocchio::JointDataMimicTpl<_Scalar, _Options, trajopt::JointCollectionTpl>;

  using JointModelVariant = boost::variant<
      typename Default::JointModelRX, typename Default::JointModelRY, typename Default::JointModelRZ,
      typename Default::JointModelFreeFlyer, typename Default::JointModelPlanar,
      typename Default::JointModelRevoluteUnaligned, typename Default::JointModelSpherical,
      typename Default::JointModelSphericalZYX, typename Default::JointModelPrismaticUnaligned, typename Default::JointModelTranslation,
      typename Default::JointModelRUBX, typename Default::JointModelRUBY, typename Default::JointModelRUBZ,
      typename Default::JointModelRevoluteUnboundedUnaligned,
      boost::recursive_wrapper<JointModelMimic>>;

  using JointDataVariant = boost::variant<
      typename Default::JointDataRX, typename Default::JointDataRY, typename Default::JointDataRZ,
      typename Default::JointDataFreeFlyer, typename Default::JointDataPlanar,
      typename Default::JointDataRevoluteUnaligned, typename Default::JointDataSpherical,
      typename Default::JointDataSphericalZYX, typename Default::JointDataPrismaticUnaligned,
      typename Default::JointDataTranslation, typename Default::JointDataRUBX,
      typename Default::JointDataRUBY, typename Default::JointDataRUBZ,
      typename Default::JointDataRevoluteUnboundedUnaligned,
      boost::recursive_wrapper<JointDataMimic>>;
};

using Scalar = casadi::SX;
using Model = pinocchio::ModelTpl<Scalar, 0, JointCollectionTpl>;
using Data = pinocchio::DataTpl<Scalar, 0, JointCollectionTpl>;
using JointModel = Model::JointModel;

}  // namespace trajopt
