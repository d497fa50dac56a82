// Many geometries over many steps: who meets whom, which point is which, what is remembered.
#include "signorini/collision/detector.hpp"

#include <algorithm>
#include <boost/test/unit_test.hpp>
#include <cmath>
#include <cstdlib>
#include <map>
#include <set>
#include <string>

#include "../count_allocations.hpp"
#include "shapes.hpp"
#include "signorini/errors.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

bool identical(const ContactPoint& p, const ContactPoint& q) {
  return p.geometry_a == q.geometry_a && p.geometry_b == q.geometry_b && p.position == q.position &&
         p.normal == q.normal && p.distance == q.distance && p.spare == q.spare && p.patch_size == q.patch_size &&
         p.previous == q.previous && p.id == q.id && p.swept == q.swept && p.way_a == q.way_a && p.way_b == q.way_b;
}

bool identical(const std::vector<ContactPoint>& p, const std::vector<ContactPoint>& q) {
  if (p.size() != q.size()) return false;
  for (std::size_t k = 0; k < p.size(); ++k)
    if (!identical(p[k], q[k])) return false;
  return true;
}

/// A heap of all kinds of shapes on a half space, and how its bodies drift.
struct Heap {
  std::vector<CollisionGeometry> geometries{{Shape::half_space(), 0, {}}};
  std::vector<Placement> frames{Placement()};
  std::vector<Vector3> velocities{Vector3::Zero()};

  explicit Heap(int count, double room = 0.25) {
    Dice dice(21);
    const auto shapes = some_shapes();
    for (int k = 0; k < count; ++k) {
      geometries.push_back({shapes[k % shapes.size()], k + 1, {}});
      frames.push_back(dice.placement(room));
      velocities.push_back(dice.vector(1e-3));
    }
  }
  void step() {
    for (std::size_t k = 1; k < frames.size(); ++k) {
      frames[k].translation += velocities[k];
      frames[k].rotation = frames[k].rotation * turn(2e-3, velocities[k]);
    }
  }
  Detector detector(int tree_from) const {
    DetectorSettings settings;
    settings.tree_from = tree_from;
    return Detector(geometries, all_pairs(static_cast<int>(geometries.size())), settings);
  }
};

template <typename Make>
std::string refusal(const Make& make) {
  try {
    make();
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

}  // namespace

BOOST_AUTO_TEST_CASE(a_resting_box_keeps_its_points) {
  Dice dice(22);
  for (const Shape& floor : {Shape::half_space(), Shape::box({1.0, 1.0, 0.5})}) {
    Two two(floor, Shape::box({0.05, 0.04, 0.03}));
    const double top = floor.type == ShapeType::HalfSpace ? 0.0 : 0.5;
    std::vector<std::uint64_t> ids;
    for (int k = 0; k < 300; ++k) {
      const auto& points =
          two.detect({}, {turn(1e-6, dice.direction()), Vector3(0.0, 0.0, top + 0.03) + dice.vector(1e-6)});
      BOOST_REQUIRE(points.size() == 4u);
      for (int i = 0; i < 4; ++i) {
        if (k == 0) {
          BOOST_TEST(points[i].previous == -1);
          ids.push_back(points[i].id);
        } else {
          BOOST_TEST(points[i].previous == i);
          BOOST_TEST(points[i].id == ids[i]);
        }
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(a_sliding_box_and_a_rolling_ball_keep_theirs) {
  Two slide(Shape::half_space(), Shape::box({0.05, 0.04, 0.03}));
  for (int k = 0; k < 100; ++k) {
    // Farther a step than the match distance: what stays is the place on the box.
    const auto& points = slide.detect({}, {Matrix3::Identity(), {0.05 * k, 0.0, 0.03}});
    BOOST_REQUIRE(points.size() == 4u);
    for (const ContactPoint& p : points) BOOST_TEST(p.previous == (k == 0 ? -1 : static_cast<int>(p.id)));
  }
  Two roll(Shape::half_space(), Shape::sphere(0.05));
  for (int k = 0; k < 100; ++k) {
    const auto& points = roll.detect({}, {turn(0.1 * k, Vector3::UnitY()), {0.005 * k, 0.0, 0.05}});
    BOOST_REQUIRE(points.size() == 1u);
    BOOST_TEST(points[0].previous == (k == 0 ? -1 : 0));
    BOOST_TEST(points[0].id == 0u);
  }
  // A jump is a new point.
  const auto& points = roll.detect({}, {turn(2.0, Vector3::UnitX()), {9.0, 0.0, 0.05}});
  BOOST_REQUIRE(points.size() == 1u);
  BOOST_TEST(points[0].previous == -1);
  BOOST_TEST(points[0].id == 1u);
}

BOOST_AUTO_TEST_CASE(each_old_point_has_one_heir_and_no_number_comes_back) {
  Heap heap(24);
  Detector detector = heap.detector(40);
  std::vector<ContactPoint> last;
  std::set<std::uint64_t> seen;
  std::size_t matched = 0, total = 0;
  for (int k = 0; k < 60; ++k, heap.step()) {
    const auto points = detector.detect(heap.frames);
    std::set<int> used;
    std::set<std::uint64_t> ids;
    std::map<std::pair<int, int>, int> patch;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const ContactPoint& p = points[i];
      BOOST_TEST(ids.insert(p.id).second);
      ++total, patch[{p.geometry_a, p.geometry_b}] += p.spare ? 0 : 1;
      if (i > 0)
        BOOST_TEST((std::make_pair(points[i - 1].geometry_a, points[i - 1].geometry_b) <=
                    std::make_pair(p.geometry_a, p.geometry_b)));
      if (p.previous >= 0) {
        ++matched;
        BOOST_REQUIRE(p.previous < static_cast<int>(last.size()));
        const ContactPoint& old = last[p.previous];
        BOOST_TEST(used.insert(p.previous).second);
        BOOST_TEST(old.id == p.id);
        BOOST_TEST((old.geometry_a == p.geometry_a && old.geometry_b == p.geometry_b));
      } else {
        BOOST_TEST(seen.count(p.id) == 0u);
      }
    }
    for (const ContactPoint& p : points) {
      BOOST_TEST((p.patch_size == patch[{p.geometry_a, p.geometry_b}]));
      BOOST_TEST(p.patch_size <= 4);
    }
    seen.insert(ids.begin(), ids.end());
    last = points;
  }
  BOOST_TEST(total > 2000u);
  BOOST_TEST(matched > total * 8 / 10);
}

BOOST_AUTO_TEST_CASE(hulls_followed_from_step_to_step_are_as_far_apart_as_hulls_seen_for_the_first_time) {
  const Shape shapes[] = {Shape::convex(cube_mesh({0.05, 0.04, 0.03})),
                          Shape::convex(globe_mesh({0.05, 0.04, 0.06}, 7, 9)), Shape::convex(random_mesh(3, 40, 0.05))};
  Dice dice(5);
  int near = 0, overlapping = 0;
  for (const Shape& a : shapes)
    for (const Shape& b : shapes) {
      const std::vector<CollisionGeometry> geometries{{a, 1, {}}, {b, 2, {}}};
      Detector warm(geometries, {{0, 1}});
      std::vector<Placement> frames{{}, {}, dice.placement(0.0)};
      const Vector3 axis = dice.vector(1.0);
      frames[2].translation = {0.0, 0.0, 0.14};
      for (int k = 0; k < 1000; ++k) {  // comes down until it touches, then rolls over the other one, up and down
        frames[2].rotation = turn(2e-3, axis) * frames[2].rotation;
        frames[2].translation += Vector3(2e-5 * std::sin(0.01 * k), 2e-5 * std::cos(0.013 * k), 0.0);
        Detector cold(geometries, {{0, 1}});
        const std::vector<ContactPoint>& points = warm.detect(frames);
        const double distance = least_distance(cold.detect(frames));
        BOOST_TEST_REQUIRE(points.empty() == cold.points().empty());
        if (points.empty()) {
          frames[2].translation[2] -= 2e-4;
          continue;
        }
        ++near, overlapping += distance < 0.0;
        BOOST_TEST_REQUIRE(std::abs(least_distance(points) - distance) < 1e-9);
        frames[2].translation[2] += std::clamp(3e-5 * std::sin(0.05 * k) - 0.2 * distance, -1e-3, 1e-3);
      }
    }
  BOOST_TEST(near > 3000);
  BOOST_TEST(overlapping > 1000);
}

BOOST_AUTO_TEST_CASE(reset_forgets) {
  Two two(Shape::half_space(), Shape::sphere(0.05));
  const Placement place{Matrix3::Identity(), {0.0, 0.0, 0.05}};
  const std::uint64_t first = two.detect({}, place)[0].id;
  two.detector.reset();
  BOOST_TEST(two.detector.points().empty());
  const auto& points = two.detect({}, place);
  BOOST_TEST(points[0].previous == -1);
  BOOST_TEST(points[0].id != first);
}

BOOST_AUTO_TEST_CASE(a_restored_copy_goes_on_bit_for_bit) {
  Heap heap(30);
  Detector original = heap.detector(10), copy = heap.detector(10);
  for (int k = 0; k < 20; ++k, heap.step()) original.detect(heap.frames);
  const std::string bytes = original.save();
  copy.load(bytes);
  BOOST_TEST(copy.save() == bytes);
  BOOST_TEST(identical(copy.points(), original.points()));
  for (int k = 0; k < 20; ++k, heap.step()) {
    const auto points = original.detect(heap.frames);
    BOOST_REQUIRE(points.size() > 10u);
    BOOST_TEST(identical(points, copy.detect(heap.frames)));
  }
  // Not of this detector.
  const auto refused = [&](const std::string& other) {
    return refusal([&] { copy.load(other); }).find("detector") == 0;
  };
  const auto before = copy.points();
  BOOST_TEST(refused(""));
  BOOST_TEST(refused("nonsense"));
  BOOST_TEST(refused(bytes + "x"));
  for (std::size_t cut = 0; cut < bytes.size(); cut += 97) BOOST_TEST(refused(bytes.substr(0, cut)));
  BOOST_TEST(refused(Heap(31).detector(10).save()));
  BOOST_TEST(identical(before, copy.points()));
}

BOOST_AUTO_TEST_CASE(a_restored_copy_has_the_points_of_sweeps) {
  const std::vector<CollisionGeometry> geometries{{Shape::half_space(), 0, {}}, {Shape::sphere(0.1), 1, {}}};
  Detector original(geometries, CollisionFilter()), copy(geometries, CollisionFilter());
  std::vector<Placement> frames(2);
  frames[1].translation = Vector3(0.0, 0.0, 0.15);
  std::vector<FrameMotion> motions(2);
  motions[1].velocity = Vector3(30.0, 0.0, -100.0);
  const auto& points = original.detect(frames, motions, 1e-3);
  BOOST_REQUIRE(points.size() == 1u);
  BOOST_TEST(points[0].swept);
  BOOST_TEST(std::abs(points[0].way_b[0] - 0.015) < 1e-9);  // it meets after half the step
  copy.load(original.save());
  BOOST_TEST(identical(copy.points(), points));
}

BOOST_AUTO_TEST_CASE(the_tree_finds_what_the_loop_finds) {
  Heap heap(120, 0.5);
  Detector loop = heap.detector(1000), tree = heap.detector(0);
  // A filter says the same as a list of all pairs.
  DetectorSettings settings;
  settings.tree_from = 0;
  Detector filtered(heap.geometries, CollisionFilter(), settings);
  std::size_t total = 0;
  for (int k = 0; k < 100; ++k, heap.step()) {
    const auto& expected = loop.detect(heap.frames);
    total += expected.size();
    BOOST_TEST(identical(expected, tree.detect(heap.frames)));
    BOOST_TEST(identical(expected, filtered.detect(heap.frames)));
  }
  BOOST_TEST(total > 5000u);
}

BOOST_AUTO_TEST_CASE(the_tree_finds_what_the_loop_finds_of_fast_bodies) {
  Heap heap(120, 0.7);
  Detector loop = heap.detector(1000), tree = heap.detector(0);
  std::vector<FrameMotion> motions(heap.frames.size());
  std::size_t swept = 0, fast_steps = 0;
  for (int k = 0; k < 100; ++k) {
    // Bodies in turn are fast, now and then none is: the list of candidates serves both kinds of steps.
    for (std::size_t f = 1; f < motions.size(); ++f) {
      const bool fast = k % 10 < 7 && static_cast<int>(f) % 9 == k / 10 % 9;
      motions[f].centre = heap.frames[f].translation;
      motions[f].velocity = (fast ? 300.0 : 1.0) * heap.velocities[f] / 1e-3;
    }
    const auto expected = loop.detect(heap.frames, motions, 1e-3);
    BOOST_TEST(identical(expected, tree.detect(heap.frames, motions, 1e-3)));
    const auto count = std::count_if(expected.begin(), expected.end(), [](const ContactPoint& p) { return p.swept; });
    swept += static_cast<std::size_t>(count), fast_steps += count > 0 ? 1 : 0;
    for (std::size_t f = 1; f < motions.size(); ++f) heap.frames[f].translation += 1e-3 * motions[f].velocity;
  }
  BOOST_TEST(swept > 50u);
  BOOST_TEST(fast_steps > 20u);
}

BOOST_AUTO_TEST_CASE(a_filter_lets_through_what_it_says) {
  const Heap heap(60);
  const int count = static_cast<int>(heap.geometries.size());
  auto geometries = heap.geometries;
  for (int k = 1; k < count; ++k) geometries[k].frame = (k + 1) / 2;  // two on each frame
  CollisionFilter filter;
  for (int k = 0; k < count; ++k) {
    filter.group.push_back(1u << (k % 3));
    filter.mask.push_back(k % 5 == 0 ? 0u : 3u);
  }
  filter.excluded = {{7, 3}, {1, 9}};
  filter.excluded_frames = {{4, 5}, {20, 11}};
  std::vector<std::pair<int, int>> expected;
  for (const auto& [a, b] : all_pairs(count)) {
    const int f = geometries[a].frame, g = geometries[b].frame;
    const bool meet = (filter.group[a] & filter.mask[b]) != 0 || (filter.group[b] & filter.mask[a]) != 0;
    const bool excluded = (a == 3 && b == 7) || (a == 1 && b == 9) || (f == 4 && g == 5) || (f == 11 && g == 20);
    if (f != g && meet && !excluded) expected.emplace_back(a, b);
  }
  for (const int tree_from : {0, 1000}) {
    DetectorSettings settings;
    settings.tree_from = tree_from;
    settings.margin = 0.1;
    Detector by_list(geometries, expected, settings), by_filter(geometries, filter, settings);
    const auto& points = by_list.detect(heap.frames);
    BOOST_TEST(points.size() > 100u);
    BOOST_TEST(identical(points, by_filter.detect(heap.frames)));
  }
}

BOOST_AUTO_TEST_CASE(placements_that_are_not_finite_give_no_points) {
  Heap heap(50);
  for (const int tree_from : {0, 1000}) {
    Detector detector = heap.detector(tree_from);
    BOOST_TEST(!detector.detect(heap.frames).empty());
    for (const double bad : {kNan, std::numeric_limits<double>::infinity(), 1e300, -1e200}) {
      auto frames = heap.frames;
      frames[3].translation[1] = bad;
      frames[5].rotation(0, 2) = bad;
      std::size_t others = 0;
      for (const ContactPoint& p : detector.detect(frames)) {
        BOOST_TEST(is_finite(p));
        const bool touched = p.geometry_a == 3 || p.geometry_b == 3 || p.geometry_a == 5 || p.geometry_b == 5;
        if (!std::isfinite(bad)) BOOST_TEST(!touched);
        if (!touched) ++others;
      }
      BOOST_TEST(others > 20u);
    }
    BOOST_TEST(detector.detect(std::vector<Placement>(2)).size() < 100u);  // frames missing
    auto frames = heap.frames;
    for (auto& f : frames) f.translation.setConstant(kNan);
    BOOST_TEST(detector.detect(frames).empty());
    BOOST_TEST(!detector.detect(heap.frames).empty());
  }
}

BOOST_AUTO_TEST_CASE(once_warm_nothing_is_allocated) {
#if SIGNORINI_COUNTS_ALLOCATIONS
  for (const int tree_from : {0, 1000}) {
    Heap heap(60);
    Detector detector = heap.detector(tree_from);
    const auto start = heap.frames;
    for (int round = 0; round < 2; ++round) {
      heap.frames = start;
      for (int k = 0; k < 50; ++k, heap.step()) {
        const long before = allocations;
        const std::size_t count = detector.detect(heap.frames).size();
        if (round == 1) BOOST_TEST(allocations == before);
        BOOST_TEST(count > 0u);
      }
    }
  }
  // On rough ground, where pieces of many cells are gathered.
  HeightGrid grid;
  grid.rows = grid.columns = 41;
  Dice dice(21);
  for (int k = 0; k < 41 * 41; ++k) grid.heights.push_back(dice.uniform(-0.03, 0.03));
  for (const Shape& shape : some_shapes()) {
    Two two(Shape::height_field(grid), shape);
    for (int round = 0; round < 2; ++round)
      for (int k = 0; k < 50; ++k) {
        const Placement place{turn(0.1 * k, {1.0, 0.3, 0.2}), {0.01 * k - 0.3, 0.2, 0.03 - 5e-4 * k}};
        const long before = allocations;
        two.detect({}, place);
        if (round == 1) BOOST_TEST(allocations == before);
      }
  }
  const long before = allocations;
  std::vector<double> counted(100);
  BOOST_TEST(allocations > before);
#endif
}

BOOST_AUTO_TEST_CASE(bad_input_is_refused_by_name_value_and_range) {
  DetectorSettings settings;
  settings.margin = -1.0;
  BOOST_TEST(refusal([&] { settings.validate(); }) == "margin: is -1, must be in [0, 1e3] m");
  settings.margin = kNan;
  BOOST_TEST(refusal([&] { settings.validate(); }).find("margin") == 0u);
  settings = {};
  settings.match_distance = -0.5;
  BOOST_TEST(refusal([&] { settings.validate(); }) == "match_distance: is -0.5, must be in [0, 1e3] m");
  settings = {};
  settings.tree_from = -3;
  BOOST_TEST(refusal([&] { settings.validate(); }) == "tree_from: is -3, must be at least 0");

  const Shape ball = Shape::sphere(0.1), plane = Shape::half_space();
  const std::vector<CollisionGeometry> geometries = {{plane, 0, {}}, {plane, 0, {}}, {ball, 1, {}}};
  using Pairs = std::vector<std::pair<int, int>>;
  const auto with = [&](const Pairs& pairs) { return refusal([&] { Detector(geometries, pairs); }); };
  BOOST_TEST(with({{0, 2}, {1, 3}}).find("pairs[1]: is (1, 3)") == 0u);
  BOOST_TEST(with({{2, 1}}).find("pairs[0]: is (2, 1)") == 0u);
  BOOST_TEST(with({{2, 2}}).find("pairs[0]: is (2, 2)") == 0u);
  BOOST_TEST(with({{-1, 2}}).find("pairs[0]: is (-1, 2)") == 0u);
  BOOST_TEST(with({{0, 1}}).find("half spaces") != std::string::npos);
  BOOST_TEST(with({{0, 2}}).empty());
  CollisionFilter filter;
  filter.group = {1, 2};
  BOOST_TEST(refusal([&] { Detector(geometries, filter); }).find("filter.group: has 2 entries") == 0u);
  filter = {};
  filter.excluded = {{0, 5}};
  BOOST_TEST(refusal([&] { Detector(geometries, filter); }).find("filter.excluded[0]") == 0u);
  BOOST_TEST(refusal([&] { Detector({{ball, -1, {}}}, Pairs{}); }).find("geometries[0].frame") == 0u);
  BOOST_TEST(refusal([&] { Detector({{Shape::sphere(-1.0), 1, {}}}, Pairs{}); }).find("geometries[0].shape") == 0u);

  // Meshes: open, inside out, dented.
  ConvexMesh open = cube_mesh({1, 1, 1}), reversed = open, dented = open;
  open.triangles.pop_back();
  for (auto& t : reversed.triangles) std::swap(t[0], t[1]);
  dented.vertices.push_back({0.0, 0.0, 0.5});
  dented.triangles.erase(dented.triangles.begin() + 2, dented.triangles.begin() + 4);
  dented.triangles.insert(dented.triangles.end(), {{{4, 5, 8}}, {{5, 7, 8}}, {{7, 6, 8}}, {{6, 4, 8}}});
  for (const ConvexMesh& mesh : {open, reversed, dented})
    BOOST_TEST(refusal([&] { Detector({{Shape::convex(mesh), 1, {}}}, Pairs{}); }).find("geometries[0].shape.mesh") ==
               0u);
}
