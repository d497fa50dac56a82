#include "convex_pair.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

namespace signorini {
namespace {

// A candidate has to separate by so much more than one before it in the list, relative to the smaller shape.
constexpr double kClearlyBetter = 1e-9;
constexpr double kDeep = 1e-3;  // relative to the smaller shape
constexpr int kNewtonSteps = 12;
constexpr double kNewtonDone = 1e-12;  // [rad]
// Faces this near to the normal take part with all their area, if the normal is a face's and if it is not.
constexpr double kFaceCosine = 0.8, kFaceCosineFree = 0.95;
// What is followed from the last step: faces within about 8 degrees of its normal; a face nearer than 0.001 rad must be
// what touches, else the pair is searched anew. kOnFeature: relative to the smaller shape.
constexpr double kFollowCosine = 0.99, kAlongFace = 1.0 - 5e-7, kOnFeature = 1e-9;
constexpr int kMostEdges = 32;         // at a corner that is followed
constexpr double kFollowSlope = 0.02;  // square of the sine of an edge with the plane of contact, at most
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// A normal from a to b, how far it separates the cores, and what the closest points are determined by.
struct Axis {
  enum Kind { None, CornerOfA, CornerOfB, Edges, Searched } kind = None;
  Vector3 normal = Vector3::Zero();
  double separation = -kInfinity;
  Vector3 on_a = Vector3::Zero(), on_b = Vector3::Zero();  // support points
  Vector3 edge_a = Vector3::Zero(), edge_b = Vector3::Zero();
  bool of_face = false;
};

}  // namespace

struct ConvexPair::Search {
  Difference difference;
  ClosestSearch closest_search;
  double scale = 1.0;
  int hint_a = 0, hint_b = 0;
  Axis best;

  /// Lets the normal compete; true if it is the best so far.
  bool propose(const Vector3& normal, Axis::Kind kind, bool of_face = false) {
    const Vector3 a = difference.support_a(normal, hint_a), b = difference.support_b(-normal, hint_b);
    const double separation = normal.dot(b - a);
    if (!(separation > best.separation + kClearlyBetter * scale)) return false;
    best.kind = kind, best.normal = normal, best.separation = separation, best.of_face = of_face;
    best.on_a = a, best.on_b = b;
    return true;
  }

  /// Newton's method for the normal that separates most, on the sphere, or on its great circle across `edge`.
  Vector3 ascend(Vector3 normal, const Vector3* edge) {
    double separation = -kInfinity;
    Vector3 step_from = normal, step = Vector3::Zero();
    double share = 1.0;
    for (int k = 0; k < kNewtonSteps; ++k) {
      const Vector3 a = difference.support_a(normal, hint_a), b = difference.support_b(-normal, hint_b);
      const double now = normal.dot(b - a);
      if (!(now >= separation - 1e-15 * scale)) {
        // Too far: half of the step.
        share *= 0.5;
        normal = (step_from + share * step).normalized();
        continue;
      }
      separation = now, step_from = normal, share = 1.0;
      const Matrix3 curvature = difference.a->curvature(normal) +
                                difference.rotation * difference.b->curvature(-(difference.inverse_rotation * normal)) *
                                    difference.inverse_rotation;
      const Vector3 slope = b - a;
      if (edge) {
        const Vector3 along = edge->cross(normal);
        const double bend = along.dot(curvature * along) + separation;
        if (!(bend > 1e-9 * scale)) break;
        step = along * (along.dot(slope) / bend);
      } else {
        Vector3 x, y;
        complete_frame(normal, x, y);
        Eigen::Matrix2d bend;
        const Vector3 bend_x = curvature * x, bend_y = curvature * y;
        bend << x.dot(bend_x) + separation, x.dot(bend_y), y.dot(bend_x), y.dot(bend_y) + separation;
        const double determinant = bend.determinant();
        if (!(determinant > 1e-12 * bend.squaredNorm() && bend.trace() > 0.0)) break;
        const Eigen::Vector2d toward(x.dot(slope), y.dot(slope));
        const Eigen::Vector2d turn = bend.inverse() * toward;
        step = turn[0] * x + turn[1] * y;
      }
      const double size = step.norm();
      if (!(size > kNewtonDone)) break;
      if (size > 1.0) step /= size;
      normal = (step_from + step).normalized();
    }
    return step_from;
  }

  /// All exact normals near `start` compete.
  /// farthest: no normal separates more, so that one which does as much ends the search.
  void polish(const Vector3& start, Axis::Kind kind, double farthest = kInfinity) {
    const auto done = [&] { return best.separation >= farthest - kClearlyBetter * scale; };
    // An order of preference: faces first, so that rounding cannot turn a face's normal into an edge's.
    Vector3 normal;
    const Vector3 start_b = -(difference.inverse_rotation * start);
    if (difference.a->face_normal(start, hint_a, normal)) propose(normal, Axis::CornerOfB, true);
    if (difference.b->face_normal(start_b, hint_b, normal))
      propose(-(difference.rotation * normal), Axis::CornerOfA, true);
    if (done()) return;
    std::array<Vector3, 4> edges_a, edges_b;
    const int count_a = difference.a->edges(start, hint_a, edges_a);
    const int count_b = difference.b->edges(start_b, hint_b, edges_b);
    for (int j = 0; j < count_b; ++j) edges_b[j] = difference.rotation * edges_b[j];
    for (int i = 0; i < count_a; ++i)
      for (int j = 0; j < count_b; ++j) {
        normal = edges_a[i].cross(edges_b[j]);
        const double sine = normal.norm();
        if (sine < 1e-6) continue;
        normal *= (normal.dot(start) < 0.0 ? -1.0 : 1.0) / sine;
        if (propose(normal, Axis::Edges)) best.edge_a = edges_a[i], best.edge_b = edges_b[j];
      }
    if (done()) return;
    const auto on_circle = [&](const Vector3& edge, Axis::Kind its_kind) {
      const Vector3 across = start - edge * edge.dot(start);
      if (across.squaredNorm() > 0.5) propose(ascend(across.normalized(), &edge), its_kind);
    };
    for (int i = 0; i < count_a; ++i) on_circle(edges_a[i], Axis::CornerOfB);
    for (int j = 0; j < count_b; ++j) on_circle(edges_b[j], Axis::CornerOfA);
    propose(ascend(start, nullptr), Axis::CornerOfA);
    propose(start, kind);
  }

  /// Polishes as long as that separates more.
  void search_from(const Vector3& direction) {
    const double length = direction.norm();
    if (!(length > 1e-12 && length < kInfinity)) return;
    const double before = best.separation;
    polish(direction / length, Axis::CornerOfA);
    for (int k = 0; k < 8 && best.separation > before; ++k) {
      const double last = best.separation;
      polish(Vector3(best.normal), Axis::CornerOfA);
      if (!(best.separation > last)) break;
    }
  }

  enum class Followed { Lost, Apart, Found };

  /// Starts from the normal of the last step. Apart if it still holds the cores more than `reach` apart. Found if two
  /// features of hulls next to it (a face and a corner, or two edges) separate the hulls, and the closest points of
  /// their planes and lines lie on them: no other normal separates more then, or, in an overlap, none near by.
  Followed follow(double reach, const PairMemory& memory) {
    const double length = memory.guess.norm();
    if (!(length > 0.0 && length < kInfinity) || memory.guess == PairMemory().guess) return Followed::Lost;
    const Vector3 normal = memory.guess / -length;
    hint_a = memory.hint_a, hint_b = memory.hint_b;
    const Vector3 a = difference.support_a(normal, hint_a), b = difference.support_b(-normal, hint_b);
    if (normal.dot(b - a) > reach) return Followed::Apart;
    if (!difference.a->hull || !difference.b->hull) return Followed::Lost;
    const Hull &hull_a = *difference.a->hull, &hull_b = *difference.b->hull;
    const Vector3 normal_b = -(difference.inverse_rotation * normal);
    const int vertex_a = hint_a, vertex_b = hint_b;
    if (hull_a.corner_count(vertex_a) == 0 || hull_b.corner_count(vertex_b) == 0) return Followed::Lost;
    bool along_face = false;
    // A face of either hull, and a corner of the other one over it.
    const auto touches = [&](const Hull& hull, int vertex, const Vector3& direction, const Vector3& corner, int face) {
      const Vector3& n = hull.face_normals[face];
      return hull.holds(face, corner - n * n.dot(corner - hull.vertices[vertex]), kOnFeature * scale) &&
             n.dot(direction) >= kFollowCosine;
    };
    const int face_a = hull_a.face_along(vertex_a, normal), face_b = hull_b.face_along(vertex_b, normal_b);
    if (hull_a.face_normals[face_a].dot(normal) >= kFollowCosine) {
      const Vector3& n = hull_a.face_normals[face_a];
      along_face = n.dot(normal) >= kAlongFace;
      const Vector3 corner = difference.support_b(-n, hint_b);
      if (touches(hull_a, vertex_a, normal, corner, face_a) && propose(n, Axis::CornerOfB, true))
        return deep() ? Followed::Lost : Followed::Found;
    }
    if (hull_b.face_normals[face_b].dot(normal_b) >= kFollowCosine) {
      const Vector3 n = -(difference.rotation * hull_b.face_normals[face_b]);
      along_face = along_face || n.dot(normal) >= kAlongFace;
      const Vector3 corner = difference.support_a(n, hint_a);
      const Vector3 in_b = difference.inverse_rotation * (corner - difference.translation);
      if (touches(hull_b, vertex_b, normal_b, in_b, face_b) && propose(n, Axis::CornerOfA, true))
        return deep() ? Followed::Lost : Followed::Found;
    }
    if (along_face) return Followed::Lost;
    // Two edges that cross when seen along the normal.
    const auto is_flat = [](const Vector3& edge, const Vector3& direction) {
      const double slope = edge.dot(direction);
      return slope * slope <= kFollowSlope * edge.squaredNorm();
    };
    std::array<Vector3, kMostEdges> edges_b;
    int count_b = 0;
    for (int j = hull_b.corner_begin[vertex_b]; j < hull_b.corner_begin[vertex_b + 1] && count_b < kMostEdges; ++j)
      if (const Vector3 edge = hull_b.edge(j); is_flat(edge, normal_b)) edges_b[count_b++] = difference.rotation * edge;
    const Vector3 offset = b - a;
    for (int i = hull_a.corner_begin[vertex_a]; count_b > 0 && i < hull_a.corner_begin[vertex_a + 1]; ++i) {
      const Vector3 edge_a = hull_a.edge(i);
      if (!is_flat(edge_a, normal)) continue;
      const Vector3 across = offset.cross(edge_a);
      for (int j = 0; j < count_b; ++j) {
        const Vector3& edge_b = edges_b[j];
        const Vector3 twist = edge_a.cross(edge_b);
        const double square = twist.squaredNorm(), along = twist.dot(normal), at_b = across.dot(twist);
        if (!(at_b >= 0.0 && at_b <= square && square > 0.0)) continue;
        const double at_a = offset.cross(edge_b).dot(twist);
        if (!(at_a >= 0.0 && at_a <= square && along * along > kFollowCosine * kFollowCosine * square)) continue;
        const Vector3 n = twist * ((along < 0.0 ? -1.0 : 1.0) / std::sqrt(square));
        if (!propose(n, Axis::Edges)) continue;
        if (best.separation < n.dot(offset) - kOnFeature * scale) {  // the hulls reach beyond these edges
          best = Axis();
          continue;
        }
        best.edge_a = edge_a, best.edge_b = edge_b;
        best.on_a = a, best.on_b = b;
        return deep() ? Followed::Lost : Followed::Found;
      }
    }
    return Followed::Lost;
  }

  /// So deep that other normals may do better.
  bool deep() const { return best.separation < -kDeep * scale; }

  /// Where GJK and EPA give nothing to start from: many starts.
  void search_everywhere(const Vector3& guess) {
    const auto from = [&](const Vector3& direction) { search_from(direction); };
    from(-guess);
    from(difference.rotation * difference.b->centre + difference.translation - difference.a->centre);
    for (int axis = 0; axis < 3; ++axis)
      for (const double side : {1.0, -1.0}) {
        from(side * Vector3::Unit(axis));
        from(side * difference.rotation.col(axis));
      }
    bool better = false;
    if (difference.a->hull)
      for (const Vector3& normal : difference.a->hull->face_normals)
        better = propose(normal, Axis::CornerOfB, true) || better;
    if (difference.b->hull)
      for (const Vector3& normal : difference.b->hull->face_normals)
        better = propose(-(difference.rotation * normal), Axis::CornerOfA, true) || better;
    if (better) from(Vector3(best.normal));
  }

  /// False if the cores are more than `reach` apart.
  bool run(double reach, PairMemory& memory, const std::array<Vector3, 2>* likely) {
    best = Axis();
    if (!likely) {
      const Followed followed = follow(reach, memory);
      if (followed == Followed::Apart) return memory.hint_a = hint_a, memory.hint_b = hint_b, false;
      if (followed == Followed::Found) return remember(memory), best.separation <= reach;
      best = Axis();
    }
    const Vector3 guess = memory.guess;
    const ClosestSearch::Outcome outcome = closest_search.run(difference, reach, scale, memory);
    if (outcome == ClosestSearch::Apart) return false;
    hint_a = memory.hint_a, hint_b = memory.hint_b;
    if (outcome == ClosestSearch::Found) polish(closest_search.normal, Axis::Searched, closest_search.farthest);
    // EPA can lose its way where the cores just touch, and then reports a depth along some other side.
    if (outcome == ClosestSearch::Failed || deep()) {
      if (!likely) {
        search_everywhere(guess);
      } else {
        for (const Vector3& normal : *likely) search_from(normal);
        search_from((*likely)[0] + (*likely)[1]);
      }
    }
    if (!(best.separation > -kInfinity)) return false;
    remember(memory);
    return best.separation <= reach;
  }

  void remember(PairMemory& memory) const {
    // Not shorter than this: GJK would take it for the origin.
    memory.guess = -std::max(std::abs(best.separation), 1e-3 * scale) * best.normal;
    memory.hint_a = hint_a, memory.hint_b = hint_b;
  }

  /// The closest points of the inflated shapes, in the frame of a.
  SurfacePair closest() const {
    const double rounding_a = difference.a->rounding, rounding_b = difference.b->rounding;
    const Vector3& n = best.normal;
    SurfacePair pair;
    pair.normal = n;
    pair.gap = best.separation - rounding_a - rounding_b;
    switch (best.kind) {
      case Axis::CornerOfA:
        pair.on_a = best.on_a + rounding_a * n;
        pair.on_b = pair.on_a + pair.gap * n;
        break;
      case Axis::CornerOfB:
        pair.on_b = best.on_b - rounding_b * n;
        pair.on_a = pair.on_b - pair.gap * n;
        break;
      case Axis::Edges: {
        // The edges cross when seen along n.
        const Vector3 offset = best.on_b - best.on_a;
        const Vector3 twist = best.edge_a.cross(best.edge_b);
        const double along = offset.cross(best.edge_b).dot(twist) / twist.squaredNorm();
        pair.on_a = best.on_a + along * best.edge_a + rounding_a * n;
        pair.on_b = pair.on_a + pair.gap * n;
        break;
      }
      case Axis::Searched:
      case Axis::None: {
        pair.on_a = closest_search.middle + (rounding_a - 0.5 * best.separation) * n;
        pair.on_b = pair.on_a + pair.gap * n;
        break;
      }
    }
    return pair;
  }
};

ConvexPair::ConvexPair() : search_(std::make_unique<Search>()) {}
ConvexPair::~ConvexPair() = default;

void ConvexPair::collide(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b,
                         double margin, PairMemory& memory, Manifold& out, const std::array<Vector3, 2>* likely) {
  out.count = 0;
  Search& search = *search_;
  search.difference.set(a, place_a, b, place_b);
  search.scale = std::min(a.radius, b.radius);
  std::array<Vector3, 2> likely_in_a;
  if (likely)
    for (int k = 0; k < 2; ++k) likely_in_a[k] = place_a.rotation.transpose() * (*likely)[k];
  if (!search.run(margin + a.rounding + b.rounding, memory, likely ? &likely_in_a : nullptr)) return;

  SurfacePair deepest = search.closest();
  deepest.on_a = place_a * deepest.on_a;
  deepest.on_b = place_a * deepest.on_b;
  deepest.normal = place_a.rotation * deepest.normal;
  Feature feature_a, feature_b;
  const double face_cosine = search.best.of_face ? kFaceCosine : kFaceCosineFree;
  a.feature(search.best.normal, search.hint_a, face_cosine, feature_a);
  if (feature_a.count < 2) return out.add(deepest);
  b.feature(-(search.difference.inverse_rotation * search.best.normal), search.hint_b, face_cosine, feature_b);
  if (feature_b.count < 2) return out.add(deepest);
  move(place_a, feature_a);
  move(place_b, feature_b);
  clip_features(feature_a, feature_b, deepest, margin, search.scale, out);
}

}  // namespace signorini
