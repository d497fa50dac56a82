#include "box_box.hpp"

#include <Eigen/Geometry>
#include <cmath>

namespace signorini {
namespace {

// What an axis later in the list has to separate more, relative to the smaller box, so that rounding does not choose
// between faces, nor between a face and edges that lie in it.
constexpr double kFaceBias = 1e-9, kEdgeBias = 1e-7;
// Edges closer to parallel than this have no product to speak of; the faces tell of them.
constexpr double kLeastSineSquared = 1e-10;
// How near to the normal a face must look to take part with its area: if the normal is a face's, and if it is not.
constexpr double kBoxFaceCosine = 0.8, kBoxFaceCosineFree = 0.95;
constexpr double kInside = 1e-6;  // slack for a point in a face or an edge, relative

struct Boxes {
  const Solid& a;
  const Placement& place_a;
  const Solid& b;
  const Placement& place_b;
  double margin, scale;
  Manifold& out;

  bool clip(const Vector3& normal, double face_cosine, const SurfacePair& deepest) const {
    Feature feature_a, feature_b;
    a.feature(place_a.rotation.transpose() * normal, 0, face_cosine, feature_a);
    b.feature(-(place_b.rotation.transpose() * normal), 0, face_cosine, feature_b);
    move(place_a, feature_a);
    move(place_b, feature_b);
    return clip_features(feature_a, feature_b, deepest, margin, scale, out);
  }

  /// The deepest corner of the other box below face `axis` of a (or of b).
  bool face(bool of_b, int axis, const Vector3& offset, double separation) const {
    const Placement &place_face = of_b ? place_b : place_a, &place_corner = of_b ? place_a : place_b;
    const Solid &with_face = of_b ? b : a, &with_corner = of_b ? a : b;
    const Vector3 normal = sign(offset.dot(place_face.rotation.col(axis))) * place_face.rotation.col(axis);
    const Vector3 toward_corner = of_b ? Vector3(normal) : Vector3(-normal);
    int hint = 0;
    const Vector3 corner = place_corner * with_corner.support(place_corner.rotation.transpose() * toward_corner, hint);
    SurfacePair deepest{corner, corner, normal, separation};
    (of_b ? deepest.on_b : deepest.on_a) += (of_b ? separation : -separation) * normal;
    if (clip(normal, kBoxFaceCosine, deepest) || separation <= 0.0) return true;
    Vector3 local = place_face.rotation.transpose() * (corner - place_face.translation);
    local[axis] = 0.0;
    return ((local.cwiseAbs() - with_face.size).array() <= kInside * scale).all();
  }

  /// Edges along axis i of a and axis j of b cross.
  bool edges(int i, int j, const Vector3& offset, double separation) const {
    const Vector3 u = place_a.rotation.col(i), v = place_b.rotation.col(j);
    Vector3 normal = u.cross(v).normalized();
    if (normal.dot(offset) < 0.0) normal = -normal;
    Vector3 middle_a = place_a.translation, middle_b = place_b.translation;
    for (int k = 0; k < 3; ++k) {
      const Vector3 axis_a = place_a.rotation.col(k), axis_b = place_b.rotation.col(k);
      if (k != i) middle_a += sign(axis_a.dot(normal)) * a.size[k] * axis_a;
      if (k != j) middle_b -= sign(axis_b.dot(normal)) * b.size[k] * axis_b;
    }
    const Vector3 between = middle_b - middle_a;
    const double cosine = u.dot(v), squared = 1.0 - cosine * cosine;
    const double s = (u.dot(between) - cosine * v.dot(between)) / squared;
    const double t = (cosine * u.dot(between) - v.dot(between)) / squared;
    if (separation > 0.0 && (std::abs(s) > a.size[i] + kInside * scale || std::abs(t) > b.size[j] + kInside * scale))
      return false;
    const Vector3 on_a = middle_a + s * u;
    clip(normal, kBoxFaceCosineFree, {on_a, on_a + separation * normal, normal, separation});
    return true;
  }
};

}  // namespace

bool box_box(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b, double margin,
             Manifold& out) {
  out.count = 0;
  const double scale = std::min(a.radius, b.radius);
  const Vector3 &half_a = a.size, &half_b = b.size;
  const Vector3 world_offset = place_b.translation - place_a.translation;
  const Vector3 offset = place_a.rotation.transpose() * world_offset;
  const Matrix3 rotation = place_a.rotation.transpose() * place_b.rotation;  // of b in the frame of a
  const Matrix3 absolute = rotation.cwiseAbs();

  const Vector3 apart_a = offset.cwiseAbs() - half_a - absolute * half_b;
  int axis_a = 0, axis_b = 0;
  const double most_a = apart_a.maxCoeff(&axis_a);
  if (!(most_a <= margin)) return true;
  const Vector3 apart_b = (rotation.transpose() * offset).cwiseAbs() - half_b - absolute.transpose() * half_a;
  const double most_b = apart_b.maxCoeff(&axis_b);
  if (!(most_b <= margin)) return true;
  const bool of_b = most_b > most_a + kFaceBias * scale;
  double separation = of_b ? most_b : most_a, to_beat = separation + kEdgeBias * scale;
  int edge_a = -1, edge_b = -1;
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    for (int j = 0; j < 3; ++j) {
      // |u x v|^2 from components: 1 - (u . v)^2 loses half of the digits where it matters.
      const double sine_squared = rotation(i1, j) * rotation(i1, j) + rotation(i2, j) * rotation(i2, j);
      if (sine_squared < kLeastSineSquared) continue;
      const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      const double reach = half_a[i1] * absolute(i2, j) + half_a[i2] * absolute(i1, j) + half_b[j1] * absolute(i, j2) +
                           half_b[j2] * absolute(i, j1);
      const double apart = std::abs(offset[i2] * rotation(i1, j) - offset[i1] * rotation(i2, j)) - reach;
      if (apart < 0.0 && separation >= 0.0) continue;
      const double along = apart / std::sqrt(sine_squared);
      if (along > margin) return true;
      if (along > to_beat) separation = to_beat = along, edge_a = i, edge_b = j;
    }
  }
  const Boxes boxes{a, place_a, b, place_b, margin, scale, out};
  if (edge_a >= 0) return boxes.edges(edge_a, edge_b, world_offset, separation);
  return of_b ? boxes.face(true, axis_b, world_offset, separation)
              : boxes.face(false, axis_a, world_offset, separation);
}

}  // namespace signorini
