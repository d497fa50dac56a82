#include "manifold.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace signorini {
namespace {

// Relative to the smaller shape.
constexpr double kSamePoint = 1e-5;    // corners closer than this are one
constexpr double kOnEdge = 1e-7;       // and a corner this little outside of an edge is on it
constexpr double kAsDeep = 1e-6;       // differences in depth below this do not choose a point
constexpr double kOffLine = 1e-3;      // segments that far apart sideways do not touch along their length
constexpr double kParallelSine = 0.1;  // nor do those at a larger angle

using Vector2 = Eigen::Vector2d;

double cross(const Vector2& a, const Vector2& b) { return a[0] * b[1] - a[1] * b[0]; }

/// A feature seen along the normal.
struct Flat {
  static constexpr int kMost = 2 * Feature::kMost + 2;
  int count = 0;
  std::array<Vector2, kMost> points;
};

/// The frame in which features are flat: origin at the deepest point.
struct View {
  Vector3 origin, x, y, normal;

  Vector2 project(const Vector3& point) const {
    const Vector3 offset = point - origin;
    return {x.dot(offset), y.dot(offset)};
  }
  Vector3 lift(const Vector2& point, double height) const {
    return origin + point[0] * x + point[1] * y + height * normal;
  }
};

/// Height of a feature above the view's plane, as a function of the place.
struct Height {
  const Feature& feature;
  double side;                                                   // 1 for a, which looks up along the normal, -1 for b
  Vector3 slope = Vector3::Zero();                               // polygon: height = slope . (x, y, 1)
  Vector2 start = Vector2::Zero(), direction = Vector2::Zero();  // segment
  double start_height = 0.0, end_height = 0.0, length = 0.0, tilt = 0.0;

  Height(const Feature& f, const View& view, double its_side) : feature(f), side(its_side) {
    if (f.count == 2) {
      start = view.project(f.points[0]);
      direction = view.project(f.points[1]) - start;
      start_height = view.normal.dot(f.points[0] - view.origin);
      end_height = view.normal.dot(f.points[1] - view.origin);
      length = (f.points[1] - f.points[0]).norm();
      tilt = length > 0.0 ? side * (end_height - start_height) / length : 0.0;
    } else {
      const double steepness = f.normal.dot(view.normal);
      slope << -f.normal.dot(view.x) / steepness, -f.normal.dot(view.y) / steepness,
          f.normal.dot(f.points[0] - view.origin) / steepness;
    }
  }
  double operator()(const Vector2& place) const {
    if (feature.count > 2) return slope[0] * place[0] + slope[1] * place[1] + slope[2];
    const double squared = direction.squaredNorm();
    const double share = squared > 0.0 ? std::clamp(direction.dot(place - start) / squared, 0.0, 1.0) : 0.0;
    const double core = start_height + share * (end_height - start_height);
    return feature.rounding > 0.0 ? core + side * above_axis(share * length) : core;
  }
  /// From a point of a capsule's axis outward along the normal to the surface: its straight side, or the cap of the end
  /// past which that would be.
  double above_axis(double along) const {
    const double radius = feature.rounding, straight = radius / std::sqrt(1.0 - tilt * tilt);
    const double hit = along + straight * tilt;
    if (hit >= 0.0 && hit <= length) return straight;
    const double to_end = (hit < 0.0 ? 0.0 : length) - along;
    return to_end * tilt + std::sqrt(std::max(0.0, radius * radius - to_end * to_end * (1.0 - tilt * tilt)));
  }
};

/// The part of a segment, or of a convex polygon, inside a convex polygon. Edges that coincide but for `slack` do not
/// cross: they would anywhere along their length.
void clip(Flat& subject, const Flat& window, double slack) {
  double area = 0.0;
  for (int k = 0; k < window.count; ++k) area += cross(window.points[k], window.points[(k + 1) % window.count]);
  const double turn = area < 0.0 ? -1.0 : 1.0;
  Flat next;
  for (int k = 0; k < window.count && subject.count > 0; ++k) {
    const Vector2 &from = window.points[k], edge = window.points[(k + 1) % window.count] - from;
    const double allowance = slack * edge.norm();
    const auto inside = [&](const Vector2& p) { return turn * cross(edge, p - from) + allowance; };
    next.count = 0;
    const bool closed = subject.count > 2;
    Vector2 before = subject.points[closed ? subject.count - 1 : 0];
    double before_inside = inside(before);
    if (!closed && before_inside >= 0.0) next.points[next.count++] = before;
    for (int i = closed ? 0 : 1; i < subject.count; ++i) {
      const Vector2 point = subject.points[i];
      const double point_inside = inside(point);
      if (next.count + 2 > Flat::kMost) break;
      if ((before_inside < 0.0) != (point_inside < 0.0)) {
        const double share = before_inside / (before_inside - point_inside);
        next.points[next.count++] = before + share * (point - before);
      }
      if (point_inside >= 0.0) next.points[next.count++] = point;
      before = point, before_inside = point_inside;
    }
    subject = next;
  }
}

/// The part of segment a that runs along segment b.
bool overlap(Flat& a, const Flat& b, double scale) {
  const Vector2 along = a.points[1] - a.points[0], other = b.points[1] - b.points[0];
  const double length = along.norm(), other_length = other.norm();
  if (!(length > 0.0 && other_length > 0.0)) return false;
  if (std::abs(cross(along, other)) > kParallelSine * length * other_length) return false;
  const Vector2 unit = along / length;
  const double first = unit.dot(b.points[0] - a.points[0]), second = unit.dot(b.points[1] - a.points[0]);
  const double lower = std::max(0.0, std::min(first, second)), upper = std::min(length, std::max(first, second));
  if (!(upper > lower)) return false;
  const Vector2 start = a.points[0];
  a.points[0] = start + lower * unit, a.points[1] = start + upper * unit;
  for (int k = 0; k < 2; ++k)
    if (std::abs(cross(other, a.points[k] - b.points[0])) > kOffLine * scale * other_length) return false;
  return true;
}

Flat flatten(const Feature& feature, const View& view) {
  Flat flat;
  flat.count = feature.count;
  for (int k = 0; k < feature.count; ++k) flat.points[k] = view.project(feature.points[k]);
  return flat;
}

}  // namespace

void complete_frame(const Vector3& normal, Vector3& first, Vector3& second) {
  // Across the axis that the normal is farthest from.
  int axis = 0;
  normal.cwiseAbs().minCoeff(&axis);
  first = normal.cross(Vector3::Unit(axis)).normalized();
  second = normal.cross(first);
}

void reduce(const Candidates& candidates, double tolerance, Manifold& out) {
  out.count = 0;
  const int count = candidates.count;
  if (count <= Manifold::kPatch) {
    for (int k = 0; k < count; ++k) out.add(candidates.points[k]);
    return;
  }
  const auto place = [&](int k) -> Vector3 { return candidates.points[k].on_a + candidates.points[k].on_b; };
  double least = std::numeric_limits<double>::infinity(), extent = 0.0;
  for (int k = 0; k < count; ++k) {
    least = std::min(least, candidates.points[k].gap);
    extent = std::max(extent, (place(k) - place(0)).norm());
  }
  const auto best = [&](const auto& value, double slack) {
    double most = -std::numeric_limits<double>::infinity();
    for (int k = 0; k < count; ++k) most = std::max(most, value(k));
    for (int k = 0; k < count; ++k)
      if (value(k) >= most - slack) return std::make_pair(k, most);
    return std::make_pair(-1, most);
  };
  // Ties are wide where they are about where, not how deep: the eighth part of a rim is far more than that.
  const double slack = 1e-3 * extent;
  std::array<int, Manifold::kPatch> kept;
  kept[0] = best([&](int k) { return -candidates.points[k].gap; }, tolerance).first;
  const Vector3 first = place(kept[0]);
  kept[1] = best([&](int k) { return (place(k) - first).norm(); }, slack).first;
  const Vector3 edge = place(kept[1]) - first, normal = candidates.points[kept[0]].normal;
  const Vector3 across = normal.cross(edge).normalized();
  const auto [third, width] = best([&](int k) { return std::abs(across.dot(place(k) - first)); }, slack);
  int total = 2;
  if (third >= 0 && width > slack) {
    kept[total++] = third;
    // The fourth adds the most to the triangle so far.
    const Vector3 corners[3] = {first, place(kept[1]), place(third)};
    const double turn = normal.dot((corners[1] - corners[0]).cross(corners[2] - corners[0])) < 0.0 ? -1.0 : 1.0;
    const auto outside = [&](int k) {
      double most = 0.0;
      for (int e = 0; e < 3; ++e) {
        const Vector3 side = corners[(e + 1) % 3] - corners[e];
        most = std::max(most, -turn * normal.dot(side.cross(place(k) - corners[e])));
      }
      return most;
    };
    const auto [fourth, added] = best(outside, slack * extent);
    if (fourth >= 0 && added > slack * extent) kept[total++] = fourth;
  }
  std::sort(kept.begin(), kept.begin() + total);
  std::array<bool, Candidates::kMost> taken{};
  for (int k = 0; k < total; ++k) {
    if (taken[kept[k]]) continue;
    taken[kept[k]] = true;
    out.add(candidates.points[kept[k]]);
  }
  // Four say nothing of a corner outside of them, or below their plane.
  const int spare = std::min(count - out.count, Manifold::kMost - out.count);
  for (int n = 0; n < spare; ++n) {
    double lowest = std::numeric_limits<double>::infinity();
    for (int k = 0; k < count; ++k)
      if (!taken[k]) lowest = std::min(lowest, candidates.points[k].gap);
    int next = 0;
    while (next < count && (taken[next] || !(candidates.points[next].gap <= lowest + tolerance))) ++next;
    if (next == count) return;
    taken[next] = true;
    out.add(candidates.points[next]);
    out.points[out.count - 1].spare = true;
  }
}

bool clip_features(const Feature& a, const Feature& b, const SurfacePair& deepest, double margin, double scale,
                   Manifold& out) {
  out.count = 0;
  if (a.count < 2 || b.count < 2) {
    out.add(deepest);
    return false;
  }
  View view;
  view.normal = deepest.normal;
  view.origin = deepest.on_a;
  complete_frame(view.normal, view.x, view.y);
  // The polygon with fewer corners is the window.
  const bool a_is_subject = a.count == 2 || (b.count > 2 && a.count > b.count);
  Flat subject = flatten(a_is_subject ? a : b, view);
  const Flat window = flatten(a_is_subject ? b : a, view);
  bool touching = true;
  if (window.count > 2)
    clip(subject, window, kOnEdge * scale);
  else
    touching = overlap(subject, window, scale);
  Candidates candidates;
  double least = std::numeric_limits<double>::infinity();
  if (touching) {
    const Height height_a(a, view, 1.0), height_b(b, view, -1.0);
    const double same = kSamePoint * scale;
    for (int k = 0; k < subject.count; ++k) {
      const Vector2& place = subject.points[k];
      const double low = height_a(place), high = height_b(place), gap = high - low;
      if (!(gap <= margin)) continue;
      bool known = false;
      for (int i = 0; i < candidates.count && !known; ++i)
        known = (view.project(candidates.points[i].on_a) - place).squaredNorm() < same * same;
      if (known) continue;
      least = std::min(least, gap);
      candidates.add({view.lift(place, low), view.lift(place, high), view.normal, gap});
    }
  }
  const bool reached = least <= deepest.gap + kAsDeep * scale;
  if (!reached) {
    if (candidates.count == Candidates::kMost) --candidates.count;
    candidates.add(deepest);
  }
  reduce(candidates, kAsDeep * scale, out);
  return reached;
}

void move(const Placement& place, Feature& feature) {
  for (int k = 0; k < feature.count; ++k) feature.points[k] = place * feature.points[k];
  feature.normal = place.rotation * feature.normal;
}

}  // namespace signorini
