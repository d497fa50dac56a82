// Height fields against planes, against the nearest of their triangles found by search, and against bad input.
#include <boost/test/unit_test.hpp>
#include <functional>
#include <string>

#include "shapes.hpp"
#include "signorini/errors.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

HeightGrid ground(int rows, int columns, double half_x, double half_y,
                  const std::function<double(double, double)>& height) {
  HeightGrid grid;
  grid.rows = rows, grid.columns = columns, grid.half_x = half_x, grid.half_y = half_y, grid.base = 2.0;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c)
      grid.heights.push_back(height(half_x * (2.0 * c / (columns - 1) - 1.0), half_y * (2.0 * r / (rows - 1) - 1.0)));
  return grid;
}

HeightGrid rough_ground(std::uint64_t seed, double roughness) {
  Dice dice(seed);
  return ground(17, 21, 0.5, 0.4, [&](double, double) { return dice.uniform(-roughness, roughness); });
}

using Flat = std::array<Vector3, 3>;

/// The surface, its walls and its bottom.
std::vector<Flat> all_sides(const HeightGrid& grid) {
  const int rows = grid.rows, columns = grid.columns;
  const auto at = [&](int r, int c) {
    return Vector3(grid.half_x * (2.0 * c / (columns - 1) - 1.0), grid.half_y * (2.0 * r / (rows - 1) - 1.0),
                   grid.heights[static_cast<std::size_t>(r * columns + c)]);
  };
  const auto below = [&](int r, int c) {
    Vector3 p = at(r, c);
    p[2] = -grid.base;
    return p;
  };
  std::vector<Flat> flats;
  for (int r = 0; r + 1 < rows; ++r)
    for (int c = 0; c + 1 < columns; ++c) {
      flats.push_back({at(r, c), at(r, c + 1), at(r + 1, c + 1)});
      flats.push_back({at(r, c), at(r + 1, c + 1), at(r + 1, c)});
    }
  const auto wall = [&](int r, int c, int r1, int c1) {
    flats.push_back({at(r, c), at(r1, c1), below(r1, c1)});
    flats.push_back({at(r, c), below(r, c), below(r1, c1)});
  };
  for (const int r : {0, rows - 1})
    for (int c = 0; c + 1 < columns; ++c) wall(r, c, r, c + 1);
  for (const int c : {0, columns - 1})
    for (int r = 0; r + 1 < rows; ++r) wall(r, c, r + 1, c);
  flats.push_back({below(0, 0), below(0, columns - 1), below(rows - 1, columns - 1)});
  flats.push_back({below(0, 0), below(rows - 1, 0), below(rows - 1, columns - 1)});
  return flats;
}

/// The least value of a convex function on [0, 1], by golden sections.
template <typename Function>
double least_value(const Function& function) {
  const double ratio = 0.5 * (std::sqrt(5.0) - 1.0);
  double lower = 0.0, upper = 1.0, x = 1.0 - ratio, y = ratio, at_x = function(x), at_y = function(y);
  for (int k = 0; k < 34; ++k) {
    if (at_x < at_y)
      upper = y, y = x, at_y = at_x, x = upper - ratio * (upper - lower), at_x = function(x);
    else
      lower = x, x = y, at_x = at_y, y = lower + ratio * (upper - lower), at_y = function(y);
  }
  return std::min({at_x, at_y, function(0.0), function(1.0)});
}

double distance_to_triangle(const Vector3& point, const Vector3& a, const Vector3& b, const Vector3& c) {
  const Vector3 normal = (b - a).cross(c - a);
  bool inside = true;
  double least = 1e300;
  for (const auto& [p, q] : {std::make_pair(a, b), std::make_pair(b, c), std::make_pair(c, a)}) {
    const Vector3 edge = q - p, offset = point - p;
    inside = inside && normal.cross(edge).dot(offset) >= 0.0;
    least = std::min(least, (offset - std::clamp(edge.dot(offset) / edge.squaredNorm(), 0.0, 1.0) * edge).norm());
  }
  return inside ? std::abs(normal.dot(point - a)) / normal.norm() : least;
}

/// From a point outside; 0 inside.
double outside(const Shape& shape, const Placement& place, const Vector3& point) {
  const Vector3 p = place.inverse() * point;
  const Vector3& s = shape.size;
  switch (shape.type) {
    case ShapeType::Cylinder:
      return std::hypot(std::max(std::hypot(p[0], p[1]) - s[0], 0.0), std::max(std::abs(p[2]) - s[1], 0.0));
    case ShapeType::Ellipsoid: {
      // The closest point is p_k s_k^2 / (s_k^2 + t), with t such that it lies on the surface.
      const auto closest = [&](double t) -> Vector3 {
        return p.cwiseProduct(s.cwiseAbs2()).cwiseQuotient(Vector3(s.cwiseAbs2().array() + t));
      };
      if (p.cwiseQuotient(s).norm() <= 1.0) return 0.0;
      double lower = 0.0, upper = s.maxCoeff() * p.norm();
      for (int k = 0; k < 100; ++k) {
        const double t = 0.5 * (lower + upper);
        (closest(t).cwiseQuotient(s).norm() > 1.0 ? lower : upper) = t;
      }
      return (p - closest(upper)).norm();
    }
    case ShapeType::Convex: {
      if (off_surface(shape, place, point) <= 0.0) return 0.0;
      double least = 1e300;
      for (const auto& t : shape.mesh->triangles) {
        const auto& v = shape.mesh->vertices;
        least = std::min(least, distance_to_triangle(p, v[t[0]], v[t[1]], v[t[2]]));
      }
      return least;
    }
    default:
      return std::max(off_surface(shape, place, point), 0.0);
  }
}

double apart(const Flat& flat, const Shape& b, const Placement& place) {
  return least_value([&](double u) {
    const Vector3 p = flat[0] + u * (flat[1] - flat[0]), q = flat[0] + u * (flat[2] - flat[0]);
    return least_value([&](double v) { return outside(b, place, p + v * (q - p)); });
  });
}

double apart(const std::vector<Flat>& flats, const Shape& b, const Placement& place) {
  // Those nearest to the ball around b first.
  std::vector<std::pair<double, const Flat*>> order;
  for (const Flat& flat : flats)
    order.emplace_back(distance_to_triangle(place.translation, flat[0], flat[1], flat[2]) - b.bounding_radius(), &flat);
  std::sort(order.begin(), order.end());
  double least = 1e300;
  for (const auto& [at_least, flat] : order) {
    if (at_least >= least) break;
    least = std::min(least, apart(*flat, b, place));
  }
  return least;
}

struct Ground : Two {
  Ground(const HeightGrid& grid, const Shape& body, double margin = 0.02)
      : Two(Shape::height_field(grid), body, margin) {}
};

/// The largest difference from each point of one list to the nearest of the other, in place, normal and gap.
double difference(const std::vector<ContactPoint>& points, const std::vector<ContactPoint>& others) {
  double most = points.size() == others.size() ? 0.0 : 1.0;
  for (const ContactPoint& p : points) {
    double least = 1e300;
    for (const ContactPoint& q : others)
      least = std::min(
          least, (p.position - q.position).norm() + (p.normal - q.normal).norm() + std::abs(p.distance - q.distance));
    most = std::max(most, least);
  }
  return most;
}

std::string refused_grid(const std::function<void(HeightGrid&)>& change) {
  HeightGrid grid = rough_ground(1, 0.1);
  change(grid);
  try {
    Shape::height_field(grid).validate("ground");
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

}  // namespace

BOOST_AUTO_TEST_CASE(a_plane_of_triangles_is_a_half_space) {
  Dice dice(41);
  for (const double slope_x : {0.0, 0.3})
    for (const double slope_y : {0.0, -0.7}) {
      const HeightGrid grid = ground(31, 41, 1.0, 0.8, [&](double x, double y) { return slope_x * x + slope_y * y; });
      Placement plane;
      plane.rotation =
          Eigen::Quaterniond::FromTwoVectors(Vector3::UnitZ(), Vector3(-slope_x, -slope_y, 1.0)).toRotationMatrix();
      for (const Shape& shape : some_shapes()) {
        // Of the globe's level rings rounding may choose other four points, as good.
        if (shape.mesh && shape.mesh->triangles.size() > 50) continue;
        Ground field(grid, shape);
        Two half_space(Shape::half_space(), shape, 0.02);
        for (int k = 0; k < 40; ++k) {
          // Lying, a little tilted, or anyhow; next to the plane on either side.
          Placement place{k % 3 == 0   ? Matrix3(plane.rotation)
                          : k % 3 == 1 ? Matrix3(plane.rotation * turn(dice.uniform(0.0, 0.05), dice.direction()))
                                       : dice.rotation(),
                          dice.vector(0.4)};
          const Vector3 n = plane.rotation.col(2);
          place.translation += (dice.uniform(-5e-3, 0.019) - n.dot(support(shape, place, -n))) * n;
          const Placement motion = dice.placement(3.0);
          const auto& points = field.detect(motion, motion * place);
          const auto& others = half_space.detect(motion * plane, motion * place);
          BOOST_TEST(!points.empty());
          BOOST_TEST(difference(points, others) < 1e-9);
          BOOST_TEST(difference(others, points) < 1e-9);
        }
      }
    }
}

BOOST_AUTO_TEST_CASE(gaps_on_rough_ground_are_those_to_its_nearest_triangle) {
  Dice dice(42);
  for (const double roughness : {0.002, 0.03})
    for (const Shape& shape : some_shapes()) {
      if (shape.mesh && shape.mesh->triangles.size() > 50) continue;  // a search too long
      const HeightGrid grid = rough_ground(7, roughness);
      const std::vector<Flat> flats = all_sides(grid);
      Ground field(grid, shape);
      double worst = 0.0;
      for (int k = 0; k < 6; ++k) {
        // From above, and, every third time, from beside the border or its corners.
        Placement place{dice.rotation(), Vector3(dice.uniform(-0.45, 0.45), dice.uniform(-0.35, 0.35), 0.3)};
        Vector3 toward = -Vector3::UnitZ();
        if (k % 3 == 2) {
          place.translation = {dice.uniform(0.45, 0.7), k == 5 ? 0.5 : dice.uniform(-0.3, 0.6),
                               dice.uniform(-0.2, 0.2)};
          toward = (Vector3(0.3, 0.2, -0.4) - place.translation).normalized();
        }
        const double wanted = dice.uniform(1e-4, 0.018);
        double gap = apart(flats, shape, place);
        for (int step = 0; step < 40 && gap > 0.018; ++step) {
          place.translation += (gap - wanted) * toward;
          gap = apart(flats, shape, place);
        }
        if (!(gap > 1e-6 && gap < 0.0199)) continue;
        const auto& points = field.detect({}, place);
        BOOST_TEST(!points.empty());
        worst = std::max(worst, std::abs(least_distance(points) - gap));
        for (const ContactPoint& p : points) {
          BOOST_TEST(is_finite(p));
          BOOST_TEST(std::abs(p.normal.norm() - 1.0) < 1e-12);
          BOOST_TEST(std::abs(off_surface(shape, place, p.position + 0.5 * p.distance * p.normal)) < 2e-6);
        }
      }
      BOOST_TEST(worst < 1e-6,
                 "shape " << static_cast<int>(shape.type) << ", roughness " << roughness << ": " << worst);
    }
}

BOOST_AUTO_TEST_CASE(what_is_deep_below_the_surface_is_pushed_up) {
  Dice dice(43);
  for (const double roughness : {0.0, 0.01, 0.03, 0.1})
    for (const Shape& shape : some_shapes()) {
      Ground field(rough_ground(8, roughness), shape, 0.005);
      for (int k = 0; k < 60; ++k) {
        const Placement place{dice.rotation(), Vector3(dice.uniform(-0.4, 0.4), dice.uniform(-0.3, 0.3),
                                                       dice.uniform(-0.08 - 3.0 * roughness, -roughness))};
        const auto& points = field.detect({}, place);
        BOOST_TEST(least_distance(points) < 0.0);
        for (const ContactPoint& p : points) BOOST_TEST(p.normal[2] > 0.0);
      }
    }
}

BOOST_AUTO_TEST_CASE(a_sphere_in_a_valley_touches_both_sides_and_on_a_ridge_its_edge) {
  // Slopes of 45 degrees along x, with their line at x = 0, which is a column of samples.
  const double r = 0.05, half = std::sqrt(0.5);
  Ground valley(ground(5, 21, 1.0, 1.0, [](double x, double) { return std::abs(x); }), Shape::sphere(r));
  const auto& sides = valley.detect({}, {Matrix3::Identity(), {0.0, 0.13, r / half - 1e-3}});
  BOOST_TEST(sides.size() == 2u);
  for (const ContactPoint& p : sides) {
    BOOST_TEST(std::abs(p.distance + 1e-3 * half) < 1e-12);
    BOOST_TEST(std::abs(std::abs(p.normal[0]) - half) < 1e-12);
  }
  Ground hill(ground(5, 21, 1.0, 1.0, [](double x, double) { return -std::abs(x); }), Shape::sphere(r));
  for (const double angle : {-0.7, 0.0, 0.4}) {
    const Vector3 n(std::sin(angle), 0.0, std::cos(angle));
    const auto& edge = hill.detect({}, {Matrix3::Identity(), (r + 0.002) * n + Vector3(0.0, 0.13, 0.0)});
    BOOST_TEST(edge.size() == 1u);
    BOOST_TEST(std::abs(edge[0].distance - 0.002) < 1e-12);
    BOOST_TEST((edge[0].normal - n).norm() < 1e-12);
  }
}

BOOST_AUTO_TEST_CASE(a_box_over_the_end_of_a_plateau_rests_on_it) {
  // Flat for x <= 0, falling at 30 degrees beyond. The box hangs over by 4 cm.
  Ground field(ground(9, 41, 1.0, 1.0, [](double x, double) { return -std::max(x, 0.0) * std::tan(kPi / 6.0); }),
               Shape::box({0.08, 0.05, 0.03}));
  const auto& points = field.detect({}, {Matrix3::Identity(), {-0.04, 0.011, 0.03 - 1e-5}});
  double lowest = 1.0, highest = -1.0;
  for (const ContactPoint& p : points) {
    BOOST_TEST((p.normal - Vector3::UnitZ()).norm() < 1e-9);
    BOOST_TEST(std::abs(p.distance + 1e-5) < 1e-9);
    lowest = std::min(lowest, p.position[0]), highest = std::max(highest, p.position[0]);
  }
  BOOST_TEST(points.size() >= 4u);
  BOOST_TEST(std::abs(lowest + 0.12) < 1e-9);
  BOOST_TEST(std::abs(highest) < 1e-9);
}

BOOST_AUTO_TEST_CASE(points_keep_their_names_from_cell_to_cell) {
  Ground field(ground(21, 21, 1.0, 1.0, [](double, double) { return 0.0; }), Shape::box({0.05, 0.04, 0.03}));
  std::vector<std::uint64_t> ids;
  for (int k = 0; k < 60; ++k) {
    const auto& points = field.detect({}, {Matrix3::Identity(), {-0.4 + 0.01 * k, 0.003 * k, 0.03 - 1e-4}});
    std::vector<std::uint64_t> now;
    for (const ContactPoint& p : points) now.push_back(p.id);
    BOOST_TEST(now.size() == 4u);
    if (k > 0) BOOST_TEST(now == ids);
    ids = now;
  }
}

BOOST_AUTO_TEST_CASE(bad_height_fields_are_refused_by_name) {
  BOOST_TEST(refused_grid([](HeightGrid&) {}) == "");
  const auto names = [](const std::string& field, const std::function<void(HeightGrid&)>& change) {
    const std::string message = refused_grid(change);
    BOOST_TEST(message.find("ground." + field) != std::string::npos, field << ": " << message);
  };
  names("rows", [](HeightGrid& g) { g.rows = 1; });
  names("columns", [](HeightGrid& g) { g.columns = 4097; });
  names("half_x", [](HeightGrid& g) { g.half_x = 0.0; });
  names("half_y", [](HeightGrid& g) { g.half_y = kNan; });
  names("base", [](HeightGrid& g) { g.base = -1.0; });
  names("heights", [](HeightGrid& g) { g.heights.pop_back(); });
  names("heights[5]", [](HeightGrid& g) { g.heights[5] = kNan; });
  names("heights[6]", [](HeightGrid& g) { g.heights[6] = -3.0; });
  Shape empty;
  empty.type = ShapeType::HeightField;
  BOOST_CHECK_THROW(empty.validate("ground"), InvalidInput);
  const Shape field = Shape::height_field(rough_ground(1, 0.1)), plane = Shape::half_space();
  BOOST_CHECK_THROW(Two(field, plane), InvalidInput);
  BOOST_CHECK_THROW(Two(field, field), InvalidInput);
}
