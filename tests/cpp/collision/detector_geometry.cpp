// Points, normals and gaps of single pairs against what they are by definition (shapes.hpp).
#include <boost/test/unit_test.hpp>
#include <string>

#include "shapes.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// b beside a: `gap` apart along a random direction; along the best one, the truth, more.
std::pair<Placement, Placement> beside(const Shape& a, const Shape& b, double gap, Dice& dice) {
  Placement place_a = dice.placement(), place_b = dice.placement();
  const Vector3 n = dice.direction();
  if (a.type == ShapeType::HalfSpace) {
    place_b.translation +=
        (gap - (place_a.rotation.col(2).dot(support(b, place_b, -place_a.rotation.col(2)) - place_a.translation))) *
        place_a.rotation.col(2);
  } else {
    place_b.translation = place_a.translation + dice.vector(0.01);
    place_b.translation += (gap - separation(a, place_a, b, place_b, n)) * n;
  }
  return {place_a, place_b};
}

std::string name(const Shape& a, const Shape& b) {
  static const char* kNames[] = {"sphere", "box", "capsule", "cylinder", "ellipsoid", "half space", "convex"};
  return std::string(kNames[static_cast<int>(a.type)]) + " - " + kNames[static_cast<int>(b.type)];
}

struct Worst {
  double value = 0.0;
  std::string where;
  void see(double candidate, const std::string& what) {
    if (!(candidate <= value)) value = candidate, where = what;
  }
};

}  // namespace

BOOST_AUTO_TEST_CASE(gaps_normals_and_points_are_exact) {
  Dice dice(11);
  const double margin = 0.02;
  Worst own, optimal, surface, alignment, missed;
  auto shapes = some_shapes();
  const std::size_t bounded = shapes.size();
  shapes.push_back(Shape::half_space());
  for (std::size_t i = 0; i < shapes.size(); ++i)
    for (std::size_t j = 0; j < bounded; ++j) {
      const Shape &a = shapes[i], &b = shapes[j];
      const bool plane = a.type == ShapeType::HalfSpace;
      const std::string what = name(a, b);
      Two two(a, b, margin);
      for (int k = 0; k < 8; ++k) {
        // From clearly apart to deep, and a few that about touch.
        const double gap = k % 4 == 0 ? dice.uniform(-1e-7, 1e-7) : dice.uniform(-0.03, margin);
        const auto [place_a, place_b] = beside(a, b, gap, dice);
        const auto& points = two.detect(place_a, place_b);
        double truth = plane ? gap : signed_distance(a, place_a, b, place_b);
        const std::string here = what + ", pose " + std::to_string(k);
        if (points.empty()) {
          missed.see(margin - truth, here);
          continue;
        }
        for (const ContactPoint& p : points) {
          BOOST_TEST(is_finite(p));
          BOOST_TEST(p.distance <= margin);
          surface.see(std::abs(off_surface(a, place_a, p.position - 0.5 * p.distance * p.normal)), here);
          surface.see(std::abs(off_surface(b, place_b, p.position + 0.5 * p.distance * p.normal)), here);
          alignment.see(std::abs(p.normal.norm() - 1.0), here);
        }
        const double least = least_distance(points);
        optimal.see(truth - least, here);
        const ContactPoint& deepest = *std::min_element(
            points.begin(), points.end(), [](const auto& p, const auto& q) { return p.distance < q.distance; });
        if (plane)
          own.see(std::abs(least - gap), here);
        else
          own.see(std::abs(separation(a, place_a, b, place_b, deepest.normal) - least), here);
      }
    }
  BOOST_TEST(own.value <= 1e-6, "gap is not that along its normal: " << own.value << " " << own.where);
  BOOST_TEST(optimal.value <= 2e-7, "a better normal exists: " << optimal.value << " " << optimal.where);
  BOOST_TEST(surface.value <= 2e-6, "a point is off its surface: " << surface.value << " " << surface.where);
  BOOST_TEST(alignment.value <= 1e-12, "a normal is not of unit length: " << alignment.where);
  BOOST_TEST(missed.value <= 1e-5, "not seen though nearer than the margin: " << missed.value << " " << missed.where);
}

BOOST_AUTO_TEST_CASE(swapping_the_shapes_or_moving_both_changes_nothing) {
  Dice dice(12);
  const auto shapes = some_shapes();
  Worst swapped, moved;
  for (const Shape& a : shapes)
    for (const Shape& b : shapes) {
      Two forth(a, b, 0.01), back(b, a, 0.01), elsewhere(a, b, 0.01);
      for (int k = 0; k < 8; ++k) {
        const auto [place_a, place_b] = beside(a, b, dice.uniform(-0.01, 0.01), dice);
        const Placement motion = dice.placement(3.0);
        const auto& points = forth.detect(place_a, place_b);
        const auto& mirrored = back.detect(place_b, place_a);
        const auto& carried = elsewhere.detect(motion * place_a, motion * place_b);
        const std::string here = name(a, b) + ", pose " + std::to_string(k);
        if (points.empty() || mirrored.empty() || carried.empty()) {
          swapped.see(points.empty() == mirrored.empty() ? 0.0 : 1.0, here);
          moved.see(points.empty() == carried.empty() ? 0.0 : 1.0, here);
          continue;
        }
        swapped.see(std::abs(least_distance(points) - least_distance(mirrored)), here);
        moved.see(std::abs(least_distance(points) - least_distance(carried)), here);
      }
    }
  BOOST_TEST(swapped.value <= 1e-7, swapped.value << " " << swapped.where);
  BOOST_TEST(moved.value <= 1e-7, moved.value << " " << moved.where);
}

BOOST_AUTO_TEST_CASE(distance_is_continuous_through_touching) {
  Dice dice(13);
  const auto shapes = some_shapes();
  Worst jump;
  const double step = 2e-6;
  for (const Shape& a : shapes)
    for (const Shape& b : shapes) {
      Two two(a, b, 0.1);
      auto [place_a, start] = beside(a, b, 2e-4, dice);
      // Downwards along the normal there, once near.
      for (int k = 0; k < 20; ++k) {
        const auto& points = two.detect(place_a, start);
        BOOST_REQUIRE_MESSAGE(!points.empty(), name(a, b));
        start.translation -= (least_distance(points) - 2e-4) * points[0].normal;
      }
      const auto& first = two.detect(place_a, start);
      const Vector3 n = first[0].normal;
      double last = least_distance(first);
      for (int k = 1; k <= 250; ++k) {
        const auto& points = two.detect(place_a, {start.rotation, start.translation - k * step * n});
        BOOST_REQUIRE(!points.empty());
        const double now = least_distance(points);
        jump.see(std::abs(now - last) - step, name(a, b) + ", step " + std::to_string(k));
        last = now;
      }
      BOOST_TEST(last < 0.0);
    }
  BOOST_TEST(jump.value <= 2e-8, jump.value << " " << jump.where);
}

BOOST_AUTO_TEST_CASE(how_many_points) {
  const double margin = 1e-3;
  const Placement ground;
  const auto at = [](double height, const Matrix3& rotation = Matrix3::Identity()) {
    return Placement{rotation, Vector3(0.01, 0.02, height)};
  };
  const Matrix3 lying = turn(kPi / 2, Vector3::UnitX());
  const Shape box = Shape::box({0.05, 0.04, 0.03}), capsule = Shape::capsule(0.02, 0.05);
  const Shape cylinder = Shape::cylinder(0.03, 0.06), slab = Shape::box({1.0, 1.0, 0.5});
  const Shape slab_mesh = Shape::convex(cube_mesh({1.0, 1.0, 0.5}));
  struct Case {
    Shape shape;
    Matrix3 rotation;
    double height;
    std::size_t count;
    const char* what;
  };
  const double edge = std::sqrt(0.5) * (0.05 + 0.03);
  const Matrix3 on_corner = Eigen::Quaterniond::FromTwoVectors(Vector3(1, 1, 1), Vector3::UnitZ()).toRotationMatrix();
  const std::vector<Case> cases = {
      {Shape::sphere(0.05), Matrix3::Identity(), 0.05, 1, "sphere"},
      {box, Matrix3::Identity(), 0.03, 4, "box on a face"},
      {box, turn(kPi / 4, Vector3::UnitY()), edge, 2, "box on an edge"},
      {Shape::box({0.05, 0.05, 0.05}), on_corner, 0.05 * std::sqrt(3.0), 1, "box on a corner"},
      {capsule, Matrix3::Identity(), 0.07, 1, "capsule upright"},
      {capsule, lying, 0.02, 2, "capsule lying"},
      {cylinder, Matrix3::Identity(), 0.06, 4, "cylinder standing"},
      {cylinder, lying, 0.03, 2, "cylinder lying"},
      {Shape::ellipsoid({0.05, 0.04, 0.03}), Matrix3::Identity(), 0.03, 1, "ellipsoid"},
      {Shape::convex(cube_mesh({0.05, 0.04, 0.03})), Matrix3::Identity(), 0.03, 4, "mesh of a box on a face"},
      {Shape::convex(cube_mesh({0.05, 0.04, 0.03})), turn(kPi / 4, Vector3::UnitY()), edge, 2, "mesh on an edge"}};
  for (const Case& c : cases)
    for (const double gap : {5e-4, 0.0, -1e-4, -3e-3})
      for (const Shape& floor : {Shape::half_space(), slab, slab_mesh}) {
        Two two(floor, c.shape, margin);
        const double top = floor.type == ShapeType::HalfSpace ? 0.0 : 0.5;
        const auto& points = two.detect(ground, at(top + c.height + gap, c.rotation));
        BOOST_TEST(held(points) == c.count,
                   c.what << " at gap " << gap << " on floor " << static_cast<int>(floor.type) << ": " << held(points));
        for (const ContactPoint& p : points) {
          BOOST_TEST(p.patch_size == static_cast<int>(c.count));
          BOOST_TEST((p.normal - Vector3::UnitZ()).norm() <= 1e-9, c.what);
          BOOST_TEST(std::abs(p.distance - gap) <= 1e-9, c.what << " " << p.distance << " is not " << gap);
        }
      }
  Two parallel(capsule, capsule, margin);
  BOOST_TEST(parallel.detect({lying, Vector3::Zero()}, {lying, {0.0, 0.01, 0.04}}).size() == 2u);
  BOOST_TEST(parallel.detect({lying, Vector3::Zero()}, {turn(kPi / 2, Vector3::UnitY()), {0.0, 0.0, 0.04}}).size() ==
             1u);
  Two rollers(cylinder, cylinder, margin);
  BOOST_TEST(rollers.detect({lying, Vector3::Zero()}, {lying, {0.0, 0.01, 0.06}}).size() == 2u);
  Two stack(box, box, margin);
  for (const ContactPoint& p : stack.detect({}, {turn(0.3, Vector3::UnitZ()), {0.01, 0.01, 0.06 - 1e-5}}))
    BOOST_TEST(std::abs(p.distance + 1e-5) <= 1e-12);
  BOOST_TEST(held(stack.detector.points()) == 4u);
}

BOOST_AUTO_TEST_CASE(the_mesh_of_a_box_touches_where_the_box_does) {
  Dice dice(14);
  const Vector3 half(0.05, 0.05, 0.05);
  const Shape box = Shape::box(half), mesh = Shape::convex(cube_mesh(half));
  for (const Shape& floor :
       {Shape::half_space(), Shape::box({0.3, 0.3, 0.1}), Shape::convex(cube_mesh({0.3, 0.3, 0.1}))})
    for (int k = 0; k < 40; ++k) {
      Two with_box(floor, box), with_mesh(floor, mesh);
      const double top = floor.type == ShapeType::HalfSpace ? 0.0 : 0.1;
      const Matrix3 rotation = turn(dice.uniform(-1.0, 1.0), Vector3::UnitZ()) * turn(1e-3 * (k % 4), dice.direction());
      const Placement place{rotation, Vector3(0.1, 0.05, top + 0.05 + dice.uniform(-1e-3, 1e-3))};
      const auto expected = with_box.detect({}, place);
      const auto& found = with_mesh.detect({}, place);
      BOOST_TEST(found.size() == expected.size());
      for (const ContactPoint& p : expected) {
        double nearest = 1.0;
        for (const ContactPoint& q : found)
          nearest = std::min(nearest, (p.position - q.position).norm() + std::abs(p.distance - q.distance));
        BOOST_TEST(nearest <= 1e-9);
      }
    }
}

BOOST_AUTO_TEST_CASE(rounding_does_not_turn_the_normal_of_faces) {
  Dice dice(15);
  const Shape box = Shape::box({0.05, 0.05, 0.05}), mesh = Shape::convex(cube_mesh({0.05, 0.05, 0.05}));
  for (const auto& [lower, upper, rest] :
       {std::make_tuple(box, box, 0.1), std::make_tuple(mesh, mesh, 0.1),
        std::make_tuple(box, Shape::cylinder(0.03, 0.05), 0.1), std::make_tuple(mesh, Shape::cylinder(0.03, 0.05), 0.1),
        std::make_tuple(box, mesh, 0.1)})
    for (const double offset : {0.0, 0.02}) {
      Two two(lower, upper);
      for (int k = 0; k < 200; ++k) {
        const Placement place{turn(1e-9, dice.direction()), Vector3(offset, 0.5 * offset, rest) + dice.vector(1e-9)};
        const auto& points = two.detect({}, place);
        BOOST_TEST(held(points) == 4u, name(lower, upper));
        for (const ContactPoint& p : points) {
          BOOST_TEST((p.normal - Vector3::UnitZ()).norm() <= 1e-8, name(lower, upper));
          BOOST_TEST(std::abs(p.distance) <= 1e-8, name(lower, upper));
          if (k > 0) BOOST_TEST(p.previous >= 0, name(lower, upper) << " lost a point in step " << k);
        }
      }
    }
}

BOOST_AUTO_TEST_CASE(boxes_in_a_hundred_thousand_poses) {
  // The depth of an overlap is the least over 15 axes, by their definition.
  Dice dice(16);
  const Shape a = Shape::box({0.05, 0.04, 0.03}), b = Shape::box({0.02, 0.06, 0.05});
  Two two(a, b, 0.01);
  int overlaps = 0, apart = 0;
  Worst wrong;
  for (int k = 0; k < 100000; ++k) {
    const Placement place_a = dice.placement(0.05);
    Placement place_b = dice.placement(0.05);
    // Now and then with parallel edges or faces, as boxes lie in piles.
    if (k % 5 == 0) place_b.rotation = place_a.rotation * turn(kPi / 2 * (k % 4), Vector3::UnitZ());
    if (k % 5 == 1) place_b.rotation = place_a.rotation * turn(1e-7, dice.direction());
    double best = -1.0;
    const auto look = [&](const Vector3& axis) {
      if (axis.norm() < 1e-6) return;
      const Vector3 n = axis.normalized();
      for (const Vector3& side : {n, Vector3(-n)}) best = std::max(best, separation(a, place_a, b, place_b, side));
    };
    for (int i = 0; i < 3; ++i) {
      look(place_a.rotation.col(i)), look(place_b.rotation.col(i));
      for (int j = 0; j < 3; ++j) look(place_a.rotation.col(i).cross(place_b.rotation.col(j)));
    }
    const auto& points = two.detect(place_a, place_b);
    bool good = held(points) <= 4 && points.size() <= 8 && (best > 0.0 || !points.empty());
    for (const ContactPoint& p : points) good = good && is_finite(p);
    BOOST_TEST(good);
    if (points.empty()) continue;
    if (best <= 0.0) {
      ++overlaps;
      wrong.see(std::abs(least_distance(points) - best), "pose " + std::to_string(k));
    } else {
      // Apart, corners may be farther than any of these axes says.
      ++apart;
      wrong.see(best - least_distance(points), "pose " + std::to_string(k));
    }
  }
  BOOST_TEST(wrong.value <= 2e-8, wrong.value << " " << wrong.where);
  BOOST_TEST(overlaps > 20000);
  BOOST_TEST(apart > 2000);
}

BOOST_AUTO_TEST_CASE(no_corner_of_a_plate_is_left_out) {
  const int corners = 12;
  ConvexMesh plate;
  for (int k = 0; k < corners; ++k)
    plate.vertices.push_back({0.1 * std::cos(2.0 * kPi * k / corners), 0.1 * std::sin(2.0 * kPi * k / corners), 0.0});
  plate.vertices.push_back({0.0, 0.0, 0.02});
  for (int k = 0; k < corners; ++k) plate.triangles.push_back({{k, (k + 1) % corners, corners}});
  for (int k = 2; k < corners; ++k) plate.triangles.push_back({{0, k, k - 1}});
  Dice dice(18);
  const double margin = 0.004;
  for (const Shape& floor : {Shape::half_space(), Shape::box({0.5, 0.5, 0.5})}) {
    Two two(floor, Shape::convex(plate), margin);
    const double top = floor.type == ShapeType::HalfSpace ? 0.0 : 0.5;
    for (int k = 0; k < 500; ++k) {
      // Tilts up to 2 degrees, and none.
      const Placement place{turn(k % 10 == 0 ? 0.0 : dice.uniform(0.0, 0.035), dice.direction()),
                            Vector3(0.1, 0.05, top + dice.uniform(-5e-4, 4e-3))};
      const auto& points = two.detect({}, place);
      BOOST_TEST(held(points) <= 4u);
      for (int c = 0; c < corners; ++c) {
        const Vector3 corner = place * plate.vertices[static_cast<std::size_t>(c)];
        const double gap = corner[2] - top;
        if (gap > margin - 1e-4) continue;  // on a box gaps are along the normal, which may be that of the plate
        const bool found = std::any_of(points.begin(), points.end(), [&](const ContactPoint& p) {
          return (p.position - corner).norm() < 1e-5 + std::abs(gap) && std::abs(p.distance - gap) < 1e-5;
        });
        BOOST_TEST(found, "pose " << k << " has no point at corner " << c << ", " << gap << " m above the floor");
      }
      double least = std::numeric_limits<double>::infinity();
      for (const ContactPoint& p : points)
        if (!p.spare) least = std::min(least, p.distance);
      BOOST_TEST((points.empty() || least <= least_distance(points) + 1e-6));
    }
  }
  // One that gives way would have a spring more at each.
  Detector soft({{Shape::half_space(), 0, {}}, {Shape::convex(plate), 1, {}, true}}, {{0, 1}});
  BOOST_TEST(soft.detect({Placement(), Placement()}).size() == 4u);
}

BOOST_AUTO_TEST_CASE(deep_overlaps) {
  Dice dice(17);
  auto shapes = some_shapes();
  shapes.push_back(Shape::box({0.5, 0.5, 0.5}));
  shapes.push_back(Shape::convex(cube_mesh({0.5, 0.5, 0.5})));
  for (const Shape& a : shapes)
    for (const Shape& b : shapes)
      for (int k = 0; k < 8; ++k) {
        Placement place_a, place_b;
        if (k >= 2) place_a = dice.placement();
        place_b = place_a;
        if (k == 1 || k >= 4) place_b.rotation = dice.rotation();
        if (k >= 6) place_b.translation += dice.vector(0.01);
        Two two(a, b), again(a, b);
        const auto& points = two.detect(place_a, place_b);
        const auto& same = again.detect(place_a, place_b);
        BOOST_REQUIRE(!points.empty());
        BOOST_TEST(points.size() == same.size());
        for (std::size_t i = 0; i < points.size(); ++i) {
          BOOST_TEST(is_finite(points[i]));
          BOOST_TEST(points[i].distance == same[i].distance);
          BOOST_TEST(points[i].position == same[i].position);
        }
        BOOST_TEST(least_distance(points) < 0.0, name(a, b) << " " << k << " " << least_distance(points));
        BOOST_TEST(std::abs(separation(a, place_a, b, place_b, points[0].normal) - least_distance(points)) <= 1e-6,
                   name(a, b) << " " << k << " " << separation(a, place_a, b, place_b, points[0].normal) << " "
                              << least_distance(points));
      }
}
