// Forward dynamics with points in contact, and their integration: numeric Pinocchio on the model that Python has.
#include <boost/python.hpp>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <pinocchio/multibody.hpp>

#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/rnea.hpp>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using Numbers = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Vector read(const Numbers& numbers, Eigen::Index size, const char* name) {
  if (static_cast<Eigen::Index>(numbers.size()) != size) throw std::invalid_argument(name + std::string(" has a wrong size"));
  return Eigen::Map<const Vector>(numbers.data(), size);
}

Matrix read(const Table& table) {
  return Eigen::Map<const RowMajor>(table.data(), static_cast<Eigen::Index>(table.shape(0)),
                                    static_cast<Eigen::Index>(table.shape(1)));
}

Output to_numpy(const Vector& values) {
  auto* kept = new Vector(values);
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<Vector*>(p); });
  return Output(kept->data(), {static_cast<std::size_t>(kept->size())}, owner);
}

// The model within a pinocchio.Model of Python, which must outlive its use.
const pinocchio::Model& model_of(nb::handle object) {
  namespace converter = boost::python::converter;
  void* held = converter::get_lvalue_from_python(object.ptr(), converter::registered<pinocchio::Model>::converters);
  if (held == nullptr) throw nb::type_error("a pinocchio.Model is needed");
  return *static_cast<const pinocchio::Model*>(held);
}

// Why an integration ends early: too many evaluations or no finite state; constraints whose algorithm does not converge.
struct Diverged {};
struct NotConverged {};

// Coefficients of an explicit Runge-Kutta method of order 8 with error estimates of order 5 and 3.
struct Method {
  Vector nodes, weights, error_5, error_3;
  Matrix matrix;
};

// Of steps: how much smaller than the one that would be just accurate enough, and bounds on their change.
constexpr double kSafety = 0.9, kLeast = 0.2, kMost = 10.0, kExponent = 1.0 / 8.0;

class Dynamics {
 public:
  Dynamics(nb::object model, const std::vector<int>& frames, double accuracy, double softness, int most)
      : owner_(std::move(model)),
        model_(model_of(owner_)),
        data_(model_),
        accuracy_(accuracy),
        softness_(softness),
        most_(most) {
    for (int number : frames) {
      if (number < 0 || number >= model_.nframes) throw std::invalid_argument("a frame is not in the model");
      const auto& frame = model_.frames[static_cast<std::size_t>(number)];
      points_.emplace_back(pinocchio::CONTACT_3D, model_, frame.parentJoint, frame.placement,
                           pinocchio::LOCAL_WORLD_ALIGNED);
    }
    for (const auto& point : points_) states_.emplace_back(point);
    pinocchio::initConstraintDynamics(model_, data_, points_, states_);
    for (std::size_t joint = 1; joint < model_.joints.size(); ++joint)
      additive_ = additive_ && model_.joints[joint].nq() == 1 && model_.joints[joint].nv() == 1;
  }

  // Without contacts by the mass matrix: it is exact for inertias that differ by many orders.
  const Vector& acceleration(const Vector& q, const Vector& v, const Vector& force) {
    if (points_.empty()) {
      pinocchio::crba(model_, data_, q);
      const Eigen::LLT<Matrix, Eigen::Upper> factor(data_.M);
      if (factor.info() != Eigen::Success) throw NotConverged();
      free_ = factor.solve(force - pinocchio::nonLinearEffects(model_, data_, q, v));
      if (!free_.allFinite()) throw NotConverged();
      return free_;
    }
    pinocchio::ProximalSettings settings(accuracy_, softness_, most_);
    pinocchio::constraintDynamics(model_, data_, q, v, force, points_, states_, settings);
    if (settings.iter >= most_ || !data_.ddq.allFinite()) throw NotConverged();
    return data_.ddq;
  }

  // The state after `duration` from q, v under the generalised force actuation * coefficients^T (1, t, t^2, ...).
  std::pair<std::string, std::pair<Output, Output>> integrate(const Method& method, const Numbers& q, const Numbers& v,
                                                              const Table& coefficients, const Table& actuation,
                                                              double duration, double relative, double absolute,
                                                              int evaluations) {
    start_ = read(q, model_.nq, "q");
    Vector state(2 * model_.nv);
    state << Vector::Zero(model_.nv), read(v, model_.nv, "v");
    if (static_cast<int>(actuation.shape(0)) != model_.nv || actuation.shape(1) != coefficients.shape(1))
      throw std::invalid_argument("actuation has a wrong shape");
    powers_ = read(actuation) * read(coefficients).transpose();
    duration_ = duration;
    left_ = evaluations;
    std::string status = "solved";
    {
      nb::gil_scoped_release unlocked;
      try {
        state = steps(method, state, relative, absolute);
      } catch (const Diverged&) {
        status = "diverged";
      } catch (const NotConverged&) {
        status = "not converged";
      }
    }
    const Vector end = pinocchio::integrate(model_, start_, Vector(state.head(model_.nv)));
    return {status, {to_numpy(end), to_numpy(state.tail(model_.nv))}};
  }

 private:
  Vector rate(double time, const Vector& state) {
    if (left_-- <= 0) throw Diverged();
    const Vector delta = state.head(model_.nv), velocity = state.tail(model_.nv);
    const Vector moved = pinocchio::integrate(model_, start_, delta);
    Vector force = Vector::Zero(model_.nv);
    for (Eigen::Index k = powers_.cols(); k-- > 0;) force = force * time + powers_.col(k);
    Vector result(2 * model_.nv);
    result.tail(model_.nv) = acceleration(moved, velocity, force);
    if (additive_) {  // q + delta
      result.head(model_.nv) = velocity;
    } else {
      Matrix jacobian = Matrix::Zero(model_.nv, model_.nv);
      pinocchio::dIntegrate(model_, start_, delta, jacobian, pinocchio::ARG1);
      result.head(model_.nv) = jacobian.partialPivLu().solve(velocity);
    }
    return duration_ * result;
  }

  static double norm(const Vector& values) { return values.norm() / std::sqrt(static_cast<double>(values.size())); }

  double first_step(const Vector& state, const Vector& slope, double relative, double absolute) {
    const Vector scale = (absolute + state.array().abs() * relative).matrix();
    const double size = norm(state.cwiseQuotient(scale)), first = norm(slope.cwiseQuotient(scale));
    const double trial = size < 1e-5 || first < 1e-5 ? 1e-6 : std::min(0.01 * size / first, 1.0);
    const Vector change = rate(trial, state + trial * slope) - slope;
    const double second = norm(change.cwiseQuotient(scale)) / trial, largest = std::max(first, second);
    const double guess = largest <= 1e-15 ? std::max(1e-6, 1e-3 * trial) : std::pow(0.01 / largest, kExponent);
    return std::min({100 * trial, guess, 1.0});
  }

  // As trajopt/certify/runge_kutta.py, over the fraction of the duration.
  Vector steps(const Method& method, Vector state, double relative, double absolute) {
    const Eigen::Index count = method.nodes.size();
    Matrix stages(state.size(), count);
    double time = 0.0;
    Vector slope = rate(0.0, state);
    double step = first_step(state, slope, relative, absolute);
    while (time < 1.0) {
      for (bool rejected = false;; rejected = true) {
        if (!(step >= 10 * (std::nextafter(time, 2.0) - time))) throw Diverged();
        const double end = std::min(time + step, 1.0), taken = end - time;
        stages.col(0) = slope;
        for (Eigen::Index k = 1; k < count; ++k)
          stages.col(k) = rate(time + method.nodes[k] * taken,
                               state + taken * (stages.leftCols(k) * method.matrix.row(k).head(k).transpose()));
        const Vector following = state + taken * (stages * method.weights);
        const Vector last = rate(end, following);
        const Vector scale = (absolute + state.cwiseAbs().cwiseMax(following.cwiseAbs()).array() * relative).matrix();
        const double large = (stages * method.error_5).cwiseQuotient(scale).squaredNorm();
        const double small = (stages * method.error_3).cwiseQuotient(scale).squaredNorm();
        const double error = large == 0 && small == 0
                                 ? 0.0
                                 : taken * large / std::sqrt((large + 0.01 * small) * static_cast<double>(state.size()));
        const double factor = error == 0 ? kMost : kSafety * std::pow(error, -kExponent);
        if (error < 1) {
          step = taken * std::min(factor, rejected ? 1.0 : kMost);
          time = end;
          state = following;
          slope = last;
          break;
        }
        step = taken * std::max(kLeast, factor);
      }
    }
    if (!state.allFinite()) throw Diverged();
    return state;
  }

  nb::object owner_;
  const pinocchio::Model& model_;
  pinocchio::Data data_;
  std::vector<pinocchio::RigidConstraintModel> points_;
  std::vector<pinocchio::RigidConstraintData> states_;
  double accuracy_, softness_;
  int most_;
  bool additive_ = true;
  Vector start_, free_;
  Matrix powers_;
  double duration_ = 0.0;
  int left_ = 0;
};

}  // namespace

NB_MODULE(_integrator, module) {
  nb::class_<Method>(module, "Method")
      .def(
          "__init__",
          [](Method* self, const Numbers& nodes, const Table& matrix, const Numbers& weights, const Numbers& error_5,
             const Numbers& error_3) {
            const auto count = static_cast<Eigen::Index>(nodes.size());
            new (self) Method{read(nodes, count, "nodes"), read(weights, count, "weights"),
                              read(error_5, count, "error_5"), read(error_3, count, "error_3"), read(matrix)};
            if (self->matrix.rows() != count || self->matrix.cols() != count)
              throw std::invalid_argument("matrix has a wrong shape");
          },
          "nodes"_a, "matrix"_a, "weights"_a, "error_5"_a, "error_3"_a);
  nb::class_<Dynamics>(module, "Dynamics")
      .def(nb::init<nb::object, const std::vector<int>&, double, double, int>(), "model"_a, "frames"_a, "accuracy"_a,
           "softness"_a, "most"_a)
      .def("integrate", &Dynamics::integrate, "method"_a, "q"_a, "v"_a, "coefficients"_a, "actuation"_a, "duration"_a,
           "relative"_a, "absolute"_a, "evaluations"_a);
}
