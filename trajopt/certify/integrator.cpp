// Forward dynamics with contacts, and their integration, by numeric Pinocchio on the model that Python has.
#include "../dynamics/numeric.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include <algorithm>
#include <cmath>
#include <map>

namespace {

// A surface on which a contact slides.
struct Sliding {
  Vector normal;
  double friction, slip;
};

// A wrench at a point of a frame, in axes of the world: linear between fractions of the integration, then constant.
struct Load {
  int frame;
  Eigen::Vector3d point;
  Vector fractions;
  Matrix wrenches;

  Twist at(double time) const {
    const double* first = fractions.data();
    const Eigen::Index after = std::upper_bound(first, first + fractions.size(), time) - first;
    const Eigen::Index before = std::max<Eigen::Index>(after - 1, 0);
    Twist wrench = wrenches.row(before);
    if (after > 0 && after < fractions.size())
      wrench += (time - first[before]) / (first[after] - first[before]) * (wrenches.row(after) - wrenches.row(before)).transpose();
    return wrench;
  }
};

// An integration ends early: too many evaluations, no finite state, or a mass matrix that is not positive definite.
struct Diverged {};

// Coefficients of an explicit Runge-Kutta method of order 8 with error estimates of order 5 and 3.
struct Method {
  Vector nodes, weights, error_5, error_3;
  Matrix matrix;
};

// As RANK_TOLERANCE and WELL_CONDITIONED of contact_response.py.
constexpr double kRank = 1e-8, kConditioned = 1e-8;
constexpr int kRefinements = 3;  // of least squares by normal equations
// Of steps: how much smaller than the one that would be just accurate enough, and bounds on their change.
constexpr double kSafety = 0.9, kLeast = 0.2, kMost = 10.0, kExponent = 1.0 / 8.0;

class Dynamics {
 public:
  // Contacts at `frames` with 3 rows, or 6 of which the angular ones are taken times `arm` m.
  Dynamics(const nb::object& model, const std::vector<int>& frames, const std::vector<int>& dimensions, double arm)
      : model_(model), dimensions_(dimensions), arm_(arm) {
    for (int number : frames) frames_.push_back(model_.frame(number));
    if (dimensions_.size() != frames_.size()) throw std::invalid_argument("dimensions have a wrong size");
    for (int size : dimensions_) rows_ += size;
    const std::vector<int>& position = model_.position_of();
    additive_ = std::none_of(position.begin(), position.end(), [](int at) { return at < 0; });
  }
  Dynamics(const Dynamics&) = delete;

  // By the mass matrix M = L L^T: it is exact for inertias that differ by many orders.
  const Vector& acceleration(const Vector& q, const Vector& v, const Vector& force) {
    const Matrix mass = model_.mass_matrix(q).transpose();
    const Eigen::LLT<Matrix> factor(mass);
    if (factor.info() != Eigen::Success) throw Diverged();
    free_ = factor.solve(force - model_.bias(q, v));
    redundant_.clear();
    if (!frames_.empty()) free_ += response(factor, q, v);
    if (!free_.allFinite()) throw Diverged();
    return free_;
  }

  // Rows of the contacts, in the order of their frames, that depend on others at the last state.
  const std::vector<int>& redundant() const { return redundant_; }

  // Contact `number`, a point, slides on a surface with that normal, with friction times its normal force against its
  // velocity within the surface, over the root of its square and that of the slip speed.
  void slide(int number, const Numbers& normal, double friction, double slip) {
    sliding_[held_point(number)] = {read(normal, 3, "normal"), friction, slip};
    rows_ -= 2;
  }

  // Contact `number`, a point, is the centre of a ball that rolls, at `lever` from where it touches: see contact_set.py.
  void roll(int number, const Numbers& lever) {
    rolling_[held_point(number)] = read(lever, 3, "lever");
  }

  // Wrench `number` of later integrations: see Load; values (n, 6) at n fractions.
  void load(int number, int frame, const Numbers& point, const Numbers& fractions, const Table& wrenches) {
    const auto count = static_cast<Eigen::Index>(fractions.size());
    if (count == 0 || static_cast<Eigen::Index>(wrenches.shape(0)) != count || wrenches.shape(1) != 6)
      throw std::invalid_argument("wrenches have a wrong shape");
    loads_[number] = {model_.frame(frame), read(point, 3, "point"), read(fractions, count, "fractions"), read(wrenches)};
  }

  // Accelerations (n, nv) at n states; NaN where the mass matrix is not positive definite.
  OutputTable accelerations(const Table& q, const Table& v, const Table& force) {
    const auto count = static_cast<Eigen::Index>(q.shape(0));
    if (static_cast<int>(q.shape(1)) != model_.nq() || static_cast<int>(v.shape(1)) != model_.nv() ||
        static_cast<int>(force.shape(1)) != model_.nv() || v.shape(0) != q.shape(0) || force.shape(0) != q.shape(0))
      throw std::invalid_argument("q, v or force have a wrong shape");
    const RowMajor places = read(q), rates = read(v), forces = read(force);
    auto result = std::make_unique<RowMajor>(RowMajor::Constant(count, model_.nv(), std::nan("")));
    {
      nb::gil_scoped_release unlocked;
      for (Eigen::Index row = 0; row < count; ++row) try {
          result->row(row) = acceleration(places.row(row), rates.row(row), forces.row(row));
        } catch (const Diverged&) {
        }
    }
    return to_numpy(std::move(result));
  }

  // Whether it is finite, and the state after `duration` from q, v under actuation * coefficients^T (1, t, t^2, ...).
  std::pair<bool, std::pair<Output, Output>> integrate(const Method& method, const Numbers& q, const Numbers& v,
                                                       const Table& coefficients, const Table& actuation,
                                                       double duration, double relative, double absolute,
                                                       int evaluations) {
    start_ = read(q, model_.nq(), "q");
    Vector state(2 * model_.nv());
    state << Vector::Zero(model_.nv()), read(v, model_.nv(), "v");
    if (static_cast<int>(actuation.shape(0)) != model_.nv() || actuation.shape(1) != coefficients.shape(1))
      throw std::invalid_argument("actuation has a wrong shape");
    powers_ = read(actuation) * read(coefficients).transpose();
    duration_ = duration;
    left_ = evaluations;
    bool finite = true;
    {
      nb::gil_scoped_release unlocked;
      try {
        state = steps(method, state, relative, absolute);
      } catch (const Diverged&) {
        finite = false;
      }
    }
    const Vector end = model_.integrate(start_, state.head(model_.nv()));
    return {finite, {to_numpy(end), to_numpy(state.tail(model_.nv()))}};
  }

 private:
  // The contact of that number, a point that neither slides nor rolls.
  std::size_t held_point(int number) const {
    const auto index = static_cast<std::size_t>(number);
    if (number < 0 || index >= frames_.size() || dimensions_[index] != 3 || sliding_.count(index) > 0 ||
        rolling_.count(index) > 0)
      throw std::invalid_argument("no point of that number holds its place");
    return index;
  }

  // What contacts add to the free acceleration `free_`: see contact_response.py, and sliding.py for the force that a sliding
  // contact has with its normal force.
  Vector response(const Eigen::LLT<Matrix>& factor, const Vector& q, const Vector& v) {
    model_.move(q, v);
    Matrix held(model_.nv(), rows_), pushed;
    if (!sliding_.empty()) pushed.resize(model_.nv(), rows_);
    Vector wanted(rows_);
    Eigen::Index first = 0;
    for (std::size_t k = 0; k < frames_.size(); ++k) {
      const Matrix whole = model_.frame_jacobian(frames_[k]);
      const Twist moved = model_.frame_acceleration(frames_[k]);
      Matrix rows = whole.topRows(dimensions_[k]);
      Vector drift = moved.head(dimensions_[k]);
      if (dimensions_[k] == 6) {
        rows.bottomRows(3) *= arm_;
        drift.tail(3) *= arm_;
      }
      if (const auto ball = rolling_.find(k); ball != rolling_.end()) {
        for (Eigen::Index column = 0; column < rows.cols(); ++column)
          rows.col(column) += ball->second.cross(Eigen::Vector3d(whole.col(column).tail(3)));
        drift += ball->second.cross(Eigen::Vector3d(moved.tail(3)));
      }
      Matrix push = rows;
      if (const auto surface = sliding_.find(k); surface != sliding_.end()) {
        const auto& [normal, friction, slip] = surface->second;
        const Vector velocity = rows * v, along = velocity - normal.dot(velocity) * normal;
        push = (normal - friction / std::sqrt(along.squaredNorm() + slip * slip) * along).transpose() * rows;
        drift = normal.transpose() * drift;
        rows = normal.transpose() * rows.eval();
      }
      wanted.segment(first, rows.rows()) = -drift - rows * free_;
      held.middleCols(first, rows.rows()) = rows.transpose();
      if (!sliding_.empty()) pushed.middleCols(first, rows.rows()) = push.transpose();
      first += rows.rows();
    }
    factor.matrixL().solveInPlace(held);
    if (sliding_.empty()) return factor.matrixU().solve(impulse(factor, held, held, wanted));
    factor.matrixL().solveInPlace(pushed);
    return factor.matrixU().solve(impulse(factor, held, pushed, wanted));
  }

  // force * forces with held^T force forces = wanted; the least squares where rows depend on each other.
  Vector impulse(const Eigen::LLT<Matrix>& factor, const Matrix& held, const Matrix& force, const Vector& wanted) {
    const Matrix gram = held.transpose() * force;
    const double unit = arm_ / std::sqrt(Matrix(factor.matrixL()).rowwise().squaredNorm().maxCoeff());
    const double norm = gram.cwiseAbs().colwise().sum().maxCoeff();
    if (!std::isfinite(norm)) throw Diverged();
    const double least = kConditioned * std::max(norm, unit * unit);
    if (sliding_.empty()) {
      const Eigen::LLT<Matrix> solver(gram);
      if (solver.info() == Eigen::Success && norm * solver.rcond() > least) return force * solver.solve(wanted);
    } else {
      const Eigen::PartialPivLU<Matrix> solver(gram);
      if (solver.matrixLU().diagonal().cwiseAbs().minCoeff() > 0 && norm * solver.rcond() > least)
        return force * solver.solve(wanted);
    }
    Matrix span = independent(held, unit);
    if (!sliding_.empty())
      for (std::size_t k = 0; k < chosen_.size(); ++k) span.col(static_cast<Eigen::Index>(k)) = force.col(chosen_[k]);
    const Matrix rows = held.transpose() * span;
    const Eigen::LLT<Matrix> squares(rows.transpose() * rows);
    Vector part = Vector::Zero(rows.cols());
    for (int k = 0; k < kRefinements; ++k) part += squares.solve(rows.transpose() * (wanted - rows * part));
    return span * part;
  }

  // An orthonormal basis of the columns, by Gram and Schmidt with the largest first; fills chosen_ and redundant_.
  Matrix independent(const Matrix& columns, double unit) {
    Matrix left = columns, basis(columns.rows(), std::min(columns.rows(), columns.cols()));
    chosen_.clear();
    double least = kRank * unit;
    for (Eigen::Index rank = 0; rank < basis.cols(); ++rank) {
      Eigen::Index largest;
      const double norm = std::sqrt(left.colwise().squaredNorm().maxCoeff(&largest));
      if (rank == 0) least = std::max(least, kRank * norm);
      if (!(norm > least)) break;
      Vector direction = left.col(largest);
      for (Eigen::Index k = 0; k < rank; ++k) direction -= basis.col(k).dot(direction) * basis.col(k);
      direction /= direction.norm();
      for (Eigen::Index k = 0; k < left.cols(); ++k) left.col(k) -= direction.dot(left.col(k)) * direction;
      basis.col(rank) = direction;
      chosen_.push_back(static_cast<int>(largest));
    }
    for (int column = 0; column < columns.cols(); ++column)
      if (std::find(chosen_.begin(), chosen_.end(), column) == chosen_.end()) redundant_.push_back(column);
    return basis.leftCols(static_cast<Eigen::Index>(chosen_.size()));
  }

  Vector rate(double time, const Vector& state) {
    if (left_-- <= 0) throw Diverged();
    const Vector delta = state.head(model_.nv()), velocity = state.tail(model_.nv());
    const Vector moved = model_.integrate(start_, delta);
    Vector force = Vector::Zero(model_.nv());
    for (Eigen::Index k = powers_.cols(); k-- > 0;) force = force * time + powers_.col(k);
    if (!loads_.empty()) model_.place(moved);
    for (const auto& [number, load] : loads_) {
      Eigen::Matrix3d rotation;
      Eigen::Vector3d position;
      model_.frame_placement(load.frame, rotation, position);
      Twist wrench = load.at(time);
      wrench.tail<3>() += (rotation * load.point).cross(wrench.head<3>());
      force += model_.frame_jacobian(load.frame).transpose() * wrench;
    }
    Vector result(2 * model_.nv());
    result.tail(model_.nv()) = acceleration(moved, velocity, force);
    if (additive_) {  // q + delta
      result.head(model_.nv()) = velocity;
    } else {
      result.head(model_.nv()) = model_.integration_jacobian(start_, delta).partialPivLu().solve(velocity);
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

  NumericModel model_;
  std::vector<int> frames_, dimensions_, chosen_, redundant_;
  std::map<std::size_t, Sliding> sliding_;
  std::map<std::size_t, Eigen::Vector3d> rolling_;  // levers
  std::map<int, Load> loads_;
  Eigen::Index rows_ = 0;
  double arm_;
  bool additive_ = true;
  Vector start_, free_;
  Matrix powers_;
  double duration_ = 0.0;
  int left_ = 0;
};

}  // namespace

NB_MODULE(_numeric, module) {
  module.def("sampled", &sampled, "model"_a, "frames"_a, "q"_a, "v"_a, "a"_a, "wrenches"_a);
  define_bodies(module);
  define_inverse_kinematics(module);
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
      .def(nb::init<const nb::object&, const std::vector<int>&, const std::vector<int>&, double>(), "model"_a, "frames"_a,
           "dimensions"_a, "arm"_a)
      .def_prop_ro("redundant", &Dynamics::redundant)
      .def("slide", &Dynamics::slide, "number"_a, "normal"_a, "friction"_a, "slip"_a)
      .def("roll", &Dynamics::roll, "number"_a, "lever"_a)
      .def("load", &Dynamics::load, "number"_a, "frame"_a, "point"_a, "fractions"_a, "wrenches"_a)
      .def("accelerations", &Dynamics::accelerations, "q"_a, "v"_a, "force"_a)
      .def("integrate", &Dynamics::integrate, "method"_a, "q"_a, "v"_a, "coefficients"_a, "actuation"_a, "duration"_a,
           "relative"_a, "absolute"_a, "evaluations"_a);
}
