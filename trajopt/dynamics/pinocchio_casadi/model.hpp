#pragma once

#include "description.hpp"
#include "joint_collection.hpp"

namespace trajopt {

// Throws std::invalid_argument (Python's ValueError) for what no model has: a kind of joint that is not supported,
// whose message is its name alone, a parent that does not come before its joint, a wrong number of armatures.
Model make_model(const Description& description);
// Throws std::invalid_argument for a joint that the model does not have, or another wrench size than 0, 3, 6.
void check(const Model& model, const Frame& frame);
// The frame's placement in its joint's frame, once it is checked.
Model::SE3 placement(const Model& model, const Frame& frame);
Data make_data(const Model& model);

using Vector = Eigen::Matrix<Scalar, Eigen::Dynamic, 1>;

// A column of fresh symbols and the same symbols as Eigen sees them.
struct Symbol {
  Symbol(const std::string& name, int size);
  casadi::SX matrix;
  Vector vector;
};

template <typename Derived>
casadi::SX dense(const Eigen::MatrixBase<Derived>& source) {
  casadi::SX result = casadi::SX::zeros(source.rows(), source.cols());
  for (Eigen::Index j = 0; j < source.cols(); ++j)
    for (Eigen::Index i = 0; i < source.rows(); ++i) result(i, j) = source(i, j);
  return result;
}

inline Eigen::Matrix3d matrix3(const std::array<double, 9>& rows) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rows.data());
}

inline Eigen::Vector3d vector3(const std::array<double, 3>& values) {
  return Eigen::Map<const Eigen::Vector3d>(values.data());
}

}  // namespace trajopt
