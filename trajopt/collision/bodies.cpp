// Signed distances of convex bodies on a model's frames, of many pairs at many configurations: Coal's, and exact ones from planes.
#include "../dynamics/held.hpp"
#include "../dynamics/numeric.hpp"

#include <Eigen/Geometry>

#include <coal/distance.h>

#include <limits>
#include <map>

namespace {

using Points = Eigen::Matrix3Xd;
using Pair = std::pair<int, int>;

// A point whose foot is this far outside of a face, m, still projects onto it: rounding.
constexpr double kOnFace = 1e-9;

// All within `radius` of the hull of `points` (3, n) on a frame, Coal's body and its place there; or what lies below planes,
// which are those of the hull's faces, in the world, where there are points, too.
struct Body {
  nb::object owner;
  const coal::CollisionGeometry* solid;  // null: a half-space
  int frame;                             // -1: the world
  Eigen::Matrix3d turn;
  Eigen::Vector3d place;
  Points points;
  double radius;
  Points normals;
  Vector offsets;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of a ball around it, of radius `reach`
  double reach = 0.0;
};

struct Placement {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
};

struct Witness {
  double distance;
  Eigen::Vector3d normal, first, second;
};

class Bodies {
 public:
  explicit Bodies(const nb::object& model) : model_(model) {}

  int add(const nb::object& solid, int frame, const Table& place, const Table& points, double radius, const Table& planes) {
    const Matrix placed = read(place), cloud = read(points), faces = read(planes);
    if (placed.rows() != 3 || placed.cols() != 4 || cloud.cols() != 3 || faces.cols() != 4)
      throw std::invalid_argument("place, points or planes have a wrong shape");
    if (solid.is_none() && (cloud.rows() > 0 || faces.rows() != 1))
      throw std::invalid_argument("a half-space has one plane and no points");
    Body body{solid,
              solid.is_none() ? nullptr : &held_by<coal::CollisionGeometry>(solid, "coal.CollisionGeometry"),
              frame < 0 ? -1 : model_.frame(frame),
              placed.leftCols<3>(),
              placed.col(3),
              cloud.transpose(),
              radius,
              faces.leftCols<3>().transpose(),
              faces.col(3)};
    if (cloud.rows() > 0) {
      body.centre = (body.points.rowwise().minCoeff() + body.points.rowwise().maxCoeff()) / 2;
      body.reach = (body.points.colwise() - body.centre).colwise().norm().maxCoeff() + radius;
    }
    bodies_.push_back(std::move(body));
    return static_cast<int>(bodies_.size()) - 1;
  }

  OutputTable placements(const Table& q) {
    const Matrix configurations = read(q);
    auto result = std::make_unique<RowMajor>(configurations.rows() * size(), 12);
    for (Eigen::Index k = 0; k < configurations.rows(); ++k) {
      move(configurations.row(k));
      for (std::size_t i = 0; i < bodies_.size(); ++i) {
        auto row = result->row(k * size() + static_cast<Eigen::Index>(i));
        for (int axis = 0; axis < 3; ++axis) row.segment<3>(3 * axis) = places_[i].rotation.row(axis);
        row.tail<3>() = places_[i].origin;
      }
    }
    return to_numpy(std::move(result));
  }

  OutputTable distances(const Table& q, const std::vector<Pair>& pairs, const Numbers& within) {
    const Matrix configurations = read(q);
    const Vector limits = read(within, static_cast<Eigen::Index>(pairs.size()), "within");
    for (const auto& pair : pairs) require(pair);
    auto result = std::make_unique<RowMajor>(configurations.rows(), static_cast<Eigen::Index>(pairs.size()));
    std::vector<Eigen::Vector3d> hints(pairs.size(), Eigen::Vector3d::Zero());
    for (Eigen::Index k = 0; k < configurations.rows(); ++k) {
      move(configurations.row(k));
      for (std::size_t i = 0; i < pairs.size(); ++i) {
        const auto column = static_cast<Eigen::Index>(i);
        (*result)(k, column) = distance(pairs[i], limits[column], hints[i]);
      }
    }
    return to_numpy(std::move(result));
  }

  OutputTable witnesses(const Table& q, const std::vector<int>& rows, const std::vector<Pair>& pairs) {
    const Matrix configurations = read(q);
    if (rows.size() != pairs.size()) throw std::invalid_argument("rows and pairs differ in number");
    auto result = std::make_unique<RowMajor>(static_cast<Eigen::Index>(rows.size()), 10);
    int moved = -1;
    for (std::size_t i = 0; i < rows.size(); ++i) {
      require(pairs[i]);
      if (rows[i] < 0 || rows[i] >= configurations.rows()) throw std::invalid_argument("a row is not in q");
      if (rows[i] != moved) move(configurations.row(moved = rows[i]));
      const Witness found = witness(pairs[i]);
      result->row(static_cast<Eigen::Index>(i)) << found.distance, found.normal.transpose(), found.first.transpose(),
          found.second.transpose();
    }
    return to_numpy(std::move(result));
  }

 private:
  Eigen::Index size() const { return static_cast<Eigen::Index>(bodies_.size()); }

  void require(const Pair& pair) const {
    for (int number : {pair.first, pair.second})
      if (number < 0 || number >= size()) throw std::invalid_argument("a pair has a body that is not there");
    if (bodies_[static_cast<std::size_t>(pair.first)].solid == nullptr)
      throw std::invalid_argument("the first of a pair is a half-space");
  }

  void move(const Vector& q) {
    if (q.size() != model_.nq()) throw std::invalid_argument("q has a wrong size");
    model_.place_frames(q);
    places_.resize(bodies_.size());
    for (std::size_t i = 0; i < bodies_.size(); ++i)
      if (bodies_[i].frame >= 0) model_.frame_placement(bodies_[i].frame, places_[i].rotation, places_[i].origin);
  }

  // Lower bounds of those > within; the hint is a normal in the axes of the first body along which they were apart before, or 0.
  double distance(const Pair& pair, double within, Eigen::Vector3d& hint) {
    const Body &first = body(pair.first), &second = body(pair.second);
    const Placement& place = at(pair.first);
    const Eigen::Vector3d centre = place.origin + place.rotation * first.centre;
    if (second.offsets.size() > 0) {
      const double bound = (second.normals.transpose() * centre - second.offsets).maxCoeff() - first.reach;
      if (bound > within) return bound;
      const auto [gap, exact] = beyond_planes(pair);
      if (exact || gap > within) return gap;
    } else {
      const Placement& other = at(pair.second);
      const double bound = (centre - other.origin - other.rotation * second.centre).norm() - first.reach - second.reach;
      if (bound > within) return bound;
    }
    if (!hint.isZero()) {
      const double bound = apart(pair, place.rotation * hint);
      if (bound > within) return bound;
    }
    const double found = measured(pair);
    hint = place.rotation.transpose() * -result_.normal;
    return found;
  }

  // By the plane that lies farthest from the body: exact where its nearest point is over that face.
  std::pair<double, bool> beyond_planes(const Pair& pair) const {
    const Body &first = body(pair.first), &second = body(pair.second);
    const Placement& place = at(pair.first);
    double gap = -std::numeric_limits<double>::infinity();
    Eigen::Index face = 0, lowest = 0;
    for (Eigen::Index i = 0; i < second.offsets.size(); ++i) {
      const Eigen::Vector3d normal = second.normals.col(i);
      Eigen::Index nearest;
      const double height = (first.points.transpose() * (place.rotation.transpose() * normal)).minCoeff(&nearest) +
                            normal.dot(place.origin) - second.offsets[i];
      if (!(height <= gap)) gap = height, face = i, lowest = nearest;
    }
    if (second.solid == nullptr) return {gap - first.radius, true};
    const Eigen::Vector3d foot = place.origin + place.rotation * first.points.col(lowest) - gap * second.normals.col(face);
    const bool over = gap > 0 && (second.normals.transpose() * foot - second.offsets).maxCoeff() <= kOnFace;
    return {gap - first.radius, over};
  }

  // How far apart bodies are along a normal, from the second to the first, world.
  double apart(const Pair& pair, const Eigen::Vector3d& normal) const {
    double sum = normal.dot(at(pair.first).origin - at(pair.second).origin);
    sum += (body(pair.first).points.transpose() * (at(pair.first).rotation.transpose() * normal)).minCoeff();
    sum -= (body(pair.second).points.transpose() * (at(pair.second).rotation.transpose() * normal)).maxCoeff();
    return sum - body(pair.first).radius - body(pair.second).radius;
  }

  double measured(const Pair& pair) {
    auto known = functions_.find(pair);
    if (known == functions_.end())
      known = functions_.emplace(pair, coal::ComputeDistance(body(pair.first).solid, body(pair.second).solid)).first;
    result_.clear();
    return known->second(transform(pair.first), transform(pair.second), request_, result_);
  }

  Witness witness(const Pair& pair) {
    const Body &first = body(pair.first), &second = body(pair.second);
    if (second.solid == nullptr) {
      const Placement& place = at(pair.first);
      const Eigen::Vector3d normal = second.normals.col(0);
      const Points points = (place.rotation * first.points).colwise() + place.origin;
      const Vector heights = points.transpose() * normal;
      const Vector low = (heights.array() <= heights.minCoeff() + kOnFace).cast<double>().matrix();
      const Eigen::Vector3d lowest = points * low / low.sum() - first.radius * normal;
      const double distance = normal.dot(lowest) - second.offsets[0];
      return {distance, normal, lowest, lowest - distance * normal};
    }
    measured(pair);
    const Eigen::Vector3d normal = -result_.normal;
    return {apart(pair, normal), normal, result_.nearest_points[0], result_.nearest_points[1]};
  }

  const Body& body(int number) const { return bodies_[static_cast<std::size_t>(number)]; }
  const Placement& at(int number) const { return places_[static_cast<std::size_t>(number)]; }
  coal::Transform3s transform(int number) const {
    const Placement& frame = at(number);
    return {frame.rotation * body(number).turn, frame.rotation * body(number).place + frame.origin};
  }

  NumericModel model_;
  std::vector<Body> bodies_;
  std::vector<Placement> places_;
  std::map<Pair, coal::ComputeDistance> functions_;
  coal::DistanceRequest request_;
  coal::DistanceResult result_;
};

}  // namespace

void define_bodies(nb::module_& module) {
  nb::class_<Bodies>(module, "Bodies")
      .def(nb::init<const nb::object&>(), "model"_a)
      .def("add", &Bodies::add, "solid"_a.none(), "frame"_a, "place"_a, "points"_a, "radius"_a, "planes"_a)
      .def("placements", &Bodies::placements, "q"_a)
      .def("distances", &Bodies::distances, "q"_a, "pairs"_a, "within"_a)
      .def("witnesses", &Bodies::witnesses, "q"_a, "rows"_a, "pairs"_a);
}
