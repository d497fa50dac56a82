// Nanoseconds a call of Detector::detect(), for single pairs and for whole scenes. Best of several rounds, since others
// may use the machine. Shapes move a little each step, as they do in a simulation.
#include "signorini/collision/detector.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include "collision/shapes.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

double best_nanoseconds(int calls, const std::function<void(int)>& call) {
  double best = std::numeric_limits<double>::infinity();
  for (int round = 0; round < 15; ++round) {
    const auto start = std::chrono::steady_clock::now();
    for (int k = 0; k < calls; ++k) call(k);
    const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - start;
    best = std::min(best, spent.count() / calls);
  }
  return best;
}

/// b on top of a, overlapping a little, swaying by 1e-4.
void pair(const char* name, const Shape& a, const Shape& b, const Placement& place_a, Placement place_b) {
  Two two(a, b);
  const double gap = a.type == ShapeType::HalfSpace ? support(b, place_b, -Vector3::UnitZ())[2]
                                                    : separation(a, place_a, b, place_b, Vector3::UnitZ());
  place_b.translation[2] -= gap + 1e-4;
  std::vector<Placement> places(64, place_b);
  Dice dice(5);
  for (Placement& p : places) p.rotation *= turn(1e-4, dice.direction()), p.translation += dice.vector(1e-4);
  std::size_t points = 0;
  const double time = best_nanoseconds(2000, [&](int k) { points = two.detect(place_a, places[k % 64]).size(); });
  std::printf("%-44s %8.0f ns   %zu points\n", name, time, points);
}

/// On a height field of 200 x 200 cells of 5 cm, at the place where `pair` would put it on a half space of the height
/// there; deep enough to touch.
void on_field(const char* name, double roughness, const Shape& b, const Placement& place_b) {
  HeightGrid grid;
  grid.rows = grid.columns = 201;
  grid.half_x = grid.half_y = 5.0;
  Dice dice(9);
  for (int k = 0; k < 201 * 201; ++k)
    grid.heights.push_back(roughness > 0.0 ? dice.uniform(-roughness, roughness) : 0.0);
  Two two(Shape::height_field(grid), b);
  Placement place = place_b;
  place.translation += Vector3(0.013, 0.021, 0.2);
  while (two.detect({}, place).empty() || least_distance(two.detector.points()) > -1e-4) place.translation[2] -= 5e-5;
  std::vector<Placement> places(64, place);
  for (Placement& p : places) p.rotation *= turn(1e-4, dice.direction()), p.translation += dice.vector(1e-4);
  std::size_t points = 0;
  const double time = best_nanoseconds(500, [&](int k) { points = two.detect({}, places[k % 64]).size(); });
  std::printf("%-44s %8.0f ns   %zu points\n", name, time, points);
}

void scene(const char* name, int count, double spacing, bool by_filter, int tree_from) {
  std::vector<CollisionGeometry> geometries{{Shape::half_space(), 0, {}}};
  std::vector<Placement> frames(1);
  Dice dice(7);
  const int side = static_cast<int>(std::ceil(std::cbrt(count)));
  for (int k = 0; k < count; ++k) {
    geometries.push_back({Shape::sphere(0.05), k + 1, {}});
    const Vector3 place(k % side, k / side % side, k / (side * side) + 0.5);
    frames.push_back({Matrix3::Identity(), spacing * place + dice.vector(0.002)});
  }
  DetectorSettings settings;
  settings.tree_from = tree_from;
  Detector detector = by_filter ? Detector(geometries, CollisionFilter(), settings)
                                : Detector(geometries, all_pairs(count + 1), settings);
  std::size_t points = 0;
  const double time = best_nanoseconds(std::max(3, 20000 / count), [&](int) {
    for (int k = 1; k <= count; ++k) frames[k].translation += dice.vector(1e-5);
    points = detector.detect(frames).size();
  });
  std::printf("%-44s %8.1f us   %zu points\n", name, 1e-3 * time, points);
}

}  // namespace

int main() {
  const Placement at_origin;
  const Placement tilted{turn(0.4, Vector3(1.0, 2.0, 0.5)), Vector3::Zero()};
  const Placement lying{turn(kPi / 2, Vector3::UnitX()), Vector3::Zero()};
  const Placement crossed{turn(kPi / 2, Vector3::UnitY()), Vector3::Zero()};
  const Shape plane = Shape::half_space(), ball = Shape::sphere(0.05), box = Shape::box({0.05, 0.05, 0.05});
  const Shape capsule = Shape::capsule(0.03, 0.06), cylinder = Shape::cylinder(0.04, 0.05);
  const Shape egg = Shape::ellipsoid({0.05, 0.04, 0.06}), cube = Shape::convex(cube_mesh({0.05, 0.05, 0.05}));
  const Shape hull = Shape::convex(globe_mesh({0.06, 0.05, 0.05}, 22, 45));
  pair("half space - sphere", plane, ball, at_origin, at_origin);
  pair("half space - box on a face", plane, box, at_origin, at_origin);
  pair("half space - box on a corner", plane, box, at_origin, tilted);
  pair("half space - capsule", plane, capsule, at_origin, lying);
  pair("half space - cylinder standing", plane, cylinder, at_origin, at_origin);
  pair("half space - ellipsoid", plane, egg, at_origin, tilted);
  pair("half space - mesh of a cube", plane, cube, at_origin, at_origin);
  pair("half space - hull of 992 vertices", plane, hull, at_origin, tilted);
  pair("sphere - sphere", ball, ball, at_origin, at_origin);
  pair("sphere - box", ball, box, at_origin, tilted);
  pair("sphere - hull of 992", ball, hull, at_origin, tilted);
  pair("sphere - ellipsoid", ball, egg, at_origin, tilted);
  pair("capsule - capsule, parallel", capsule, capsule, lying, lying);
  pair("capsule - capsule, crossed", capsule, capsule, lying, crossed);
  pair("capsule - box, lying", box, capsule, at_origin, lying);
  pair("box - box, face on face", box, box, at_origin, at_origin);
  pair("box - box, corner on face", box, box, at_origin, tilted);
  pair("box - box, edges", box, box, {turn(kPi / 4, Vector3::UnitX()), Vector3::Zero()},
       {turn(kPi / 4, Vector3::UnitY()), Vector3::Zero()});
  pair("box - mesh of a cube, face on face", box, cube, at_origin, at_origin);
  pair("cylinder - box, standing", box, cylinder, at_origin, at_origin);
  pair("cylinder - cylinder, crossed", cylinder, cylinder, lying, crossed);
  pair("ellipsoid - ellipsoid", egg, egg, at_origin, tilted);
  pair("hull of 992 - hull of 992", hull, hull, at_origin, tilted);
  on_field("flat height field - sphere", 0.0, ball, at_origin);
  on_field("flat height field - box on a face", 0.0, box, at_origin);
  on_field("flat height field - cylinder standing", 0.0, cylinder, at_origin);
  on_field("flat height field - hull of 992 vertices", 0.0, hull, tilted);
  on_field("rough height field - sphere", 0.01, ball, at_origin);
  on_field("rough height field - box on a face", 0.01, box, at_origin);
  on_field("rough height field - capsule", 0.01, capsule, lying);
  on_field("rough height field - cylinder standing", 0.01, cylinder, at_origin);
  on_field("rough height field - ellipsoid", 0.01, egg, tilted);
  on_field("rough height field - hull of 992 vertices", 0.01, hull, tilted);
  scene("20 balls apart, list of all pairs", 20, 0.3, false, 40);
  scene("20 balls apart, tree", 20, 0.3, true, 0);
  scene("40 balls apart, list of all pairs", 40, 0.3, false, 1000);
  scene("40 balls apart, tree", 40, 0.3, true, 0);
  scene("100 balls apart, list of all pairs", 100, 0.3, false, 1000);
  scene("100 balls apart, tree", 100, 0.3, true, 0);
  scene("1000 balls touching, tree", 1000, 0.1, true, 0);
  scene("10000 balls touching, tree", 10000, 0.1, true, 0);
}
