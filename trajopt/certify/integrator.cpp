// Forward dynamics with points and soles in contact, and their integration: numeric Pinocchio on the model that Python has.
#include "../dynamics/numeric.hpp"

#include <algorithm>
#include <map>

#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea.hpp>

namespace {

// A surface on which a contact slides.
struct Sliding {
  Vector normal;
  double friction, slip;
};

// Why an integration ends early: too many evaluations or no finite state; constraints whose algorithm does not converge.
struct Diverged {};
struct NotConverged {};

// Coefficients of an explicit Runge-Kutta method of order 8 with error estimates of order 5 and 3.
struct Method {
  Vector nodes, weights, error_5, error_3;
  Matrix matrix;
};

// Of steps: how much smaller than the one that would be just accurate enough, and bounds on their change.
// As WELL_CONDITIONED of contact_response.py.
constexpr double kConditioned = 1e-8;
constexpr double kSafety = 0.9, kLeast = 0.2, kMost = 10.0, kExponent = 1.0 / 8.0;

class Dynamics {
 public:
  // Contacts at `frames` with 3 rows, or 6 of which the angular ones are taken times `arm` m.
  Dynamics(nb::object model, const std::vector<int>& frames, const std::vector<int>& dimensions, double arm,
           double accuracy, double softness, int most)
      : owner_(std::move(model)),
        model_(model_of(owner_)),
        data_(model_),
        dimensions_(dimensions),
        arm_(arm),
        accuracy_(accuracy),
        softness_(softness),
        most_(most) {
    for (int number : frames) {
      frames_.push_back(frame_of(model_, number));
      const auto& frame = model_.frames[frames_.back()];
      points_.emplace_back(pinocchio::CONTACT_3D, model_, frame.parentJoint, frame.placement,
                           pinocchio::LOCAL_WORLD_ALIGNED);
    }
    if (dimensions_.size() != frames_.size()) throw std::invalid_argument("dimensions have a wrong size");
    for (int size : dimensions_) rows_ += size;
    projected_ = rows_ != 3 * static_cast<Eigen::Index>(frames_.size());
    for (const auto& point : points_) states_.emplace_back(point);
    pinocchio::initConstraintDynamics(model_, data_, points_, states_);
    for (std::size_t joint = 1; joint < model_.joints.size(); ++joint)
      additive_ = additive_ && model_.joints[joint].nq() == 1 && model_.joints[joint].nv() == 1;
  }

  // Without contacts by the mass matrix: it is exact for inertias that differ by many orders. So are soles, of which
  // the proximal algorithm would hold the spatial, not the classical acceleration, and contacts that slide or roll.
  const Vector& acceleration(const Vector& q, const Vector& v, const Vector& force) {
    if (points_.empty() || projected_) {
      pinocchio::crba(model_, data_, q);
      const Eigen::LLT<Matrix, Eigen::Lower> factor(data_.M.transpose());
      if (factor.info() != Eigen::Success) throw NotConverged();
      free_ = factor.solve(force - pinocchio::nonLinearEffects(model_, data_, q, v));
      if (projected_) free_ += response(factor, q, v);
      if (!free_.allFinite()) throw NotConverged();
      return free_;
    }
    pinocchio::ProximalSettings settings(accuracy_, softness_, most_);
    pinocchio::constraintDynamics(model_, data_, q, v, force, points_, states_, settings);
    if (settings.iter >= most_ || !data_.ddq.allFinite()) throw NotConverged();
    return data_.ddq;
  }

  // Contact `number`, a point, slides on a surface with that normal, with friction times its normal force against its
  // velocity within the surface, over the root of its square and that of the slip speed.
  void slide(int number, const Numbers& normal, double friction, double slip) {
    sliding_[held_point(number)] = {read(normal, 3, "normal"), friction, slip};
    rows_ -= 2;
    projected_ = true;
  }

  // Contact `number`, a point, is the centre of a ball that rolls, at `lever` from where it touches: see contact_set.py.
  void roll(int number, const Numbers& lever) {
    rolling_[held_point(number)] = pinocchio::skew(Eigen::Vector3d(read(lever, 3, "lever")));
    projected_ = true;
  }

  // Accelerations (n, nv) at n states; NaN where the constraints' algorithm does not converge.
  OutputTable accelerations(const Table& q, const Table& v, const Table& force) {
    const auto count = static_cast<Eigen::Index>(q.shape(0));
    if (static_cast<int>(q.shape(1)) != model_.nq || static_cast<int>(v.shape(1)) != model_.nv ||
        static_cast<int>(force.shape(1)) != model_.nv || v.shape(0) != q.shape(0) || force.shape(0) != q.shape(0))
      throw std::invalid_argument("q, v or force have a wrong shape");
    const RowMajor places = read(q), rates = read(v), forces = read(force);
    auto* kept = new RowMajor(RowMajor::Constant(count, model_.nv, std::nan("")));
    nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<RowMajor*>(p); });
    {
      nb::gil_scoped_release unlocked;
      for (Eigen::Index row = 0; row < count; ++row) try {
          kept->row(row) = acceleration(places.row(row), rates.row(row), forces.row(row));
        } catch (const NotConverged&) {
        }
    }
    return OutputTable(kept->data(), {static_cast<std::size_t>(count), static_cast<std::size_t>(model_.nv)}, owner);
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
  // The contact of that number, a point that neither slides nor rolls.
  std::size_t held_point(int number) const {
    const auto index = static_cast<std::size_t>(number);
    if (number < 0 || index >= frames_.size() || dimensions_[index] != 3 || sliding_.count(index) > 0 ||
        rolling_.count(index) > 0)
      throw std::invalid_argument("no point of that number holds its place");
    return index;
  }

  // What contacts add to the free acceleration `free_`, where the mass matrix has that factor: see contact_response.py,
  // and sliding.py for the force that a sliding contact has with its normal force.
  Vector response(const Eigen::LLT<Matrix, Eigen::Lower>& factor, const Vector& q, const Vector& v) {
    pinocchio::forwardKinematics(model_, data_, q, v, Vector::Zero(model_.nv));
    pinocchio::computeJointJacobians(model_, data_);
    Matrix held(model_.nv, rows_), pushed, jacobian = Matrix::Zero(6, model_.nv);
    if (!sliding_.empty()) pushed.resize(model_.nv, rows_);
    Vector wanted(rows_), scale(6);
    scale << 1.0, 1.0, 1.0, arm_, arm_, arm_;
    Eigen::Index first = 0;
    for (std::size_t k = 0; k < frames_.size(); ++k) {
      const auto axes = pinocchio::LOCAL_WORLD_ALIGNED;
      const Eigen::Index size = dimensions_[k];
      pinocchio::getFrameJacobian(model_, data_, frames_[k], axes, jacobian.setZero());
      Vector drift = pinocchio::getFrameClassicalAcceleration(model_, data_, frames_[k], axes).toVector();
      if (const auto ball = rolling_.find(k); ball != rolling_.end()) {
        jacobian.topRows(3) += ball->second * jacobian.bottomRows(3);
        drift.head(3) += ball->second * drift.tail(3);
      }
      const auto surface = sliding_.find(k);
      const bool slides = surface != sliding_.end();
      Matrix rows = scale.head(size).asDiagonal() * jacobian.topRows(size), push = rows;
      Vector moved = scale.head(size).cwiseProduct(drift.head(size));
      if (slides) {
        const auto& [normal, friction, slip] = surface->second;
        const Vector velocity = rows * v, along = velocity - normal.dot(velocity) * normal;
        push = (normal - friction / std::sqrt(along.squaredNorm() + slip * slip) * along).transpose() * rows;
        moved = normal.transpose() * moved;
        rows = normal.transpose() * rows.eval();
      }
      wanted.segment(first, rows.rows()) = -moved - rows * free_;
      held.middleCols(first, rows.rows()) = rows.transpose();
      if (!sliding_.empty()) pushed.middleCols(first, rows.rows()) = push.transpose();
      first += rows.rows();
    }
    factor.matrixL().solveInPlace(held);
    if (!sliding_.empty()) factor.matrixL().solveInPlace(pushed);
    const Matrix& force = sliding_.empty() ? held : pushed;
    const Matrix gram = held.transpose() * force;
    const double largest = arm_ * arm_ / Matrix(factor.matrixL()).rowwise().squaredNorm().maxCoeff();
    const double norm = gram.cwiseAbs().colwise().sum().maxCoeff(), least = kConditioned * std::max(norm, largest);
    Vector forces;
    if (sliding_.empty()) {
      const Eigen::LLT<Matrix> solver(gram);
      if (solver.info() != Eigen::Success || !(norm * solver.rcond() > least)) throw NotConverged();
      forces = solver.solve(wanted);
    } else {
      const Eigen::PartialPivLU<Matrix> solver(gram);
      if (!(norm * solver.rcond() > least)) throw NotConverged();
      forces = solver.solve(wanted);
    }
    return factor.matrixU().solve(force * forces);
  }

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
  std::vector<pinocchio::FrameIndex> frames_;
  std::vector<int> dimensions_;
  std::map<std::size_t, Sliding> sliding_;
  std::map<std::size_t, Eigen::Matrix3d> rolling_;
  Eigen::Index rows_ = 0;
  bool projected_ = false;
  double arm_, accuracy_, softness_;
  int most_;
  bool additive_ = true;
  Vector start_, free_;
  Matrix powers_;
  double duration_ = 0.0;
  int left_ = 0;
};

}  // namespace

NB_MODULE(_numeric, module) {
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
      .def(nb::init<nb::object, const std::vector<int>&, const std::vector<int>&, double, double, double, int>(),
           "model"_a, "frames"_a, "dimensions"_a, "arm"_a, "accuracy"_a, "softness"_a, "most"_a)
      .def("slide", &Dynamics::slide, "number"_a, "normal"_a, "friction"_a, "slip"_a)
      .def("roll", &Dynamics::roll, "number"_a, "lever"_a)
      .def("accelerations", &Dynamics::accelerations, "q"_a, "v"_a, "force"_a)
      .def("integrate", &Dynamics::integrate, "method"_a, "q"_a, "v"_a, "coefficients"_a, "actuation"_a, "duration"_a,
           "relative"_a, "absolute"_a, "evaluations"_a);
}
