// Numeric Pinocchio on the model that Python has: what the parts of the extension _numeric share.
#pragma once

#include <boost/python.hpp>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <pinocchio/multibody.hpp>

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/kinematics.hpp>

namespace nb = nanobind;
using namespace nb::literals;

using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Numbers = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;
using OutputTable = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

inline Vector read(const Numbers& numbers, Eigen::Index size, const char* name) {
  if (static_cast<Eigen::Index>(numbers.size()) != size) throw std::invalid_argument(name + std::string(" has a wrong size"));
  return Eigen::Map<const Vector>(numbers.data(), size);
}

inline Matrix read(const Table& table) {
  return Eigen::Map<const RowMajor>(table.data(), static_cast<Eigen::Index>(table.shape(0)),
                                    static_cast<Eigen::Index>(table.shape(1)));
}

inline Output to_numpy(const Vector& values) {
  auto* kept = new Vector(values);
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<Vector*>(p); });
  return Output(kept->data(), {static_cast<std::size_t>(kept->size())}, owner);
}

// The model within a pinocchio.Model of Python, which must outlive its use.
inline const pinocchio::Model& model_of(nb::handle object) {
  namespace converter = boost::python::converter;
  void* held = converter::get_lvalue_from_python(object.ptr(), converter::registered<pinocchio::Model>::converters);
  if (held == nullptr) throw nb::type_error("a pinocchio.Model is needed");
  return *static_cast<const pinocchio::Model*>(held);
}

inline pinocchio::FrameIndex frame_of(const pinocchio::Model& model, int number) {
  if (number < 0 || number >= model.nframes) throw std::invalid_argument("a frame is not in the model");
  return static_cast<pinocchio::FrameIndex>(number);
}

void define_inverse_kinematics(nb::module_& module);
