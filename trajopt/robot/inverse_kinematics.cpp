// Inverse kinematics by damped Gauss-Newton, see trajopt/robot/kinematics.py.
#include "../dynamics/numeric.hpp"

#include <Eigen/LU>

#include <algorithm>
#include <iterator>

namespace {

// The damping starts small against joint Jacobians of order one, shrinks on success, grows on failure.
constexpr double kFirstDamping = 1e-6, kDampingGrowth = 10.0;
// Keeps the normal equations of a redundant arm regular, four digits above rounding.
constexpr double kLeastDamping = 1e-12;
constexpr int kMostIterations = 60;

class InverseKinematics {
 public:
  InverseKinematics(const nb::object& model, const Numbers& lower, const Numbers& upper, const Table& projection,
                    const Table& followers)
      : model_(model),
        lower_(read(lower, model_.nq(), "lower")),
        upper_(read(upper, model_.nq(), "upper")),
        projection_(read(projection)),
        followers_(read(followers)) {}
  InverseKinematics(const InverseKinematics&) = delete;

  // The posture near q, and the norm of what is left of the errors.
  std::pair<Output, double> search(const Numbers& start, const std::vector<int>& frames, const Table& poses,
                                   const std::vector<int>& sizes, const std::vector<int>& movable, double tolerance) {
    Vector q = read(start, model_.nq(), "q");
    if (poses.shape(0) != frames.size() || poses.shape(1) != 12 || sizes.size() != frames.size())
      throw std::invalid_argument("poses or sizes have a wrong shape");
    const Matrix table = read(poses);
    goals_.clear();
    rows_ = 0;
    for (std::size_t k = 0; k < frames.size(); ++k) {
      const Vector row = table.row(static_cast<Eigen::Index>(k));
      goals_.push_back({model_.frame(frames[k]), sizes[k] == 6, Eigen::Map<const Eigen::Matrix3d>(row.data()).transpose(),
                        row.tail<3>()});
      rows_ += sizes[k];
    }
    double damping = kFirstDamping;
    Vector error = errors(q);
    for (int k = 0; k < kMostIterations && !(error.norm() < tolerance || damping > 1 / kFirstDamping); ++k) {
      Matrix whole = jacobian(q);
      if (projection_.size() > 0) whole = whole * projection_;
      const Vector slope = whole.transpose() * error;
      std::vector<int> moving;
      std::copy_if(movable.begin(), movable.end(), std::back_inserter(moving),
                   [&](int row) { return !held_by_limit(q, slope, row); });
      Matrix reduced(rows_, static_cast<Eigen::Index>(moving.size()));
      for (std::size_t column = 0; column < moving.size(); ++column)
        reduced.col(static_cast<Eigen::Index>(column)) = whole.col(moving[column]);
      Matrix normal = reduced.transpose() * reduced;
      normal.diagonal().array() += damping;
      const Vector taken = normal.partialPivLu().solve(reduced.transpose() * error);
      Vector step = Vector::Zero(model_.nv());
      for (std::size_t row = 0; row < moving.size(); ++row) step[moving[row]] = -taken[static_cast<Eigen::Index>(row)];
      Vector trial = model_.integrate(q, step).cwiseMax(lower_).cwiseMin(upper_);
      for (Eigen::Index row = 0; row < followers_.rows(); ++row)
        trial[static_cast<int>(followers_(row, 0))] =
            followers_(row, 2) * trial[static_cast<int>(followers_(row, 1))] + followers_(row, 3);
      const Vector trial_error = errors(trial);
      if (trial_error.norm() < error.norm()) {
        q = trial;
        error = trial_error;
        damping = std::max(damping / kDampingGrowth, kLeastDamping);
      } else {
        damping *= kDampingGrowth;
      }
    }
    return {to_numpy(q), error.norm()};
  }

 private:
  struct Goal {
    int frame;
    bool is_pose;
    Eigen::Matrix3d rotation;
    Eigen::Vector3d position;
  };

  Vector errors(const Vector& q) {
    model_.place(q);
    Vector result(rows_);
    Eigen::Index first = 0;
    for (const auto& goal : goals_) {
      if (goal.is_pose)
        result.segment<6>(first) = model_.pose_error(goal.frame, goal.rotation, goal.position);
      else
        result.segment<3>(first) = model_.frame_position(goal.frame) - goal.position;
      first += goal.is_pose ? 6 : 3;
    }
    return result;
  }

  Matrix jacobian(const Vector& q) {
    model_.place(q);
    Matrix result(rows_, model_.nv());
    Eigen::Index first = 0;
    for (const auto& goal : goals_) {
      if (goal.is_pose)
        result.middleRows(first, 6) = model_.pose_error_jacobian(goal.frame, goal.rotation, goal.position);
      else
        result.middleRows(first, 3) = model_.frame_jacobian(goal.frame).topRows(3);
      first += goal.is_pose ? 6 : 3;
    }
    return result;
  }

  // Whether descent would leave the position limits there: a joint at a limit, pushed outwards. Without such a row a
  // step minimises over the others, and the search ends where no allowed direction descends (projected Newton:
  // Bertsekas, SIAM J. Control and Optimization 20, 1982).
  bool held_by_limit(const Vector& q, const Vector& slope, int row) const {
    const int at = model_.position_of()[static_cast<std::size_t>(row)];
    return at >= 0 && ((q[at] <= lower_[at] && slope[row] > 0) || (q[at] >= upper_[at] && slope[row] < 0));
  }

  NumericModel model_;
  Vector lower_, upper_;
  Matrix projection_, followers_;
  std::vector<Goal> goals_;
  Eigen::Index rows_ = 0;
};

}  // namespace

void define_inverse_kinematics(nb::module_& module) {
  nb::class_<InverseKinematics>(module, "InverseKinematics")
      .def(nb::init<const nb::object&, const Numbers&, const Numbers&, const Table&, const Table&>(), "model"_a, "lower"_a,
           "upper"_a, "projection"_a, "followers"_a)
      .def("search", &InverseKinematics::search, "q"_a, "frames"_a, "poses"_a, "sizes"_a, "movable"_a, "tolerance"_a);
}
