// Numeric Pinocchio on a model that Python has. Its headers, which take longest to compile, are read by numeric.cpp alone.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <Eigen/Core>

#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using Twist = Eigen::Matrix<double, 6, 1>;
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

inline OutputTable to_numpy(std::unique_ptr<RowMajor> values) {
  RowMajor* kept = values.release();
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<RowMajor*>(p); });
  return OutputTable(kept->data(), {static_cast<std::size_t>(kept->rows()), static_cast<std::size_t>(kept->cols())}, owner);
}

// Pinocchio's algorithms in double precision; frames by their index, axes of the world at a frame's origin.
class NumericModel {
 public:
  // Throws nb::type_error where it is no pinocchio.Model.
  explicit NumericModel(const nb::object& model);
  ~NumericModel();

  int nq() const { return nq_; }
  int nv() const { return nv_; }
  // Row of q of each row of v that is a joint with one coordinate; else -1.
  const std::vector<int>& position_of() const { return position_of_; }
  int frame(int number) const;  // throws std::invalid_argument where the model has no frame of that number

  Vector integrate(const Vector& q, const Vector& change) const;
  Matrix integration_jacobian(const Vector& q, const Vector& change) const;  // by the change

  Matrix mass_matrix(const Vector& q);  // its upper triangle
  Vector bias(const Vector& q, const Vector& v);
  Vector inverse_dynamics(const Vector& q, const Vector& v, const Vector& a);
  // For what follows.
  void move(const Vector& q, const Vector& v);
  void move(const Vector& q, const Vector& v, const Vector& a);
  void place(const Vector& q);
  void place_frames(const Vector& q);     // for placements alone
  Matrix frame_jacobian(int frame);       // (6, nv)
  Twist frame_velocity(int frame);
  Twist frame_acceleration(int frame);  // classical
  Eigen::Vector3d frame_position(int frame);
  void frame_placement(int frame, Eigen::Matrix3d& rotation, Eigen::Vector3d& position);
  // log6 of the frame's placement as seen from the target, rotation and position, and its Jacobian (6, nv).
  Twist pose_error(int frame, const Eigen::Matrix3d& rotation, const Eigen::Vector3d& position);
  Matrix pose_error_jacobian(int frame, const Eigen::Matrix3d& rotation, const Eigen::Vector3d& position);

 private:
  struct State;
  std::unique_ptr<State> state_;
  int nq_, nv_;
  std::vector<int> position_of_;
};

// Generalised forces (K, nv), RNEA(q, v, a) - sum J^T f, and the motion of frames (K n, 24) at K states: rotation, place,
// velocity and classical acceleration, in axes of the world, as the wrenches (K, 6 n).
std::pair<OutputTable, OutputTable> sampled(const nb::object& model, const std::vector<int>& frames, const Table& q,
                                            const Table& v, const Table& a, const Table& wrenches);

void define_bodies(nb::module_& module);
void define_inverse_kinematics(nb::module_& module);
