#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "signorini/collision/detector.hpp"

/// Shapes, poses, and what is true of them by definition: written without a look at the library.
namespace signorini::testing {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kPi = 3.14159265358979323846;

class Dice {
 public:
  explicit Dice(std::uint64_t seed) : state_(seed * 0x9e3779b97f4a7c15ull + 1) {}
  double uniform(double lower, double upper) {
    state_ ^= state_ >> 12, state_ ^= state_ << 25, state_ ^= state_ >> 27;
    return lower + (upper - lower) * static_cast<double>((state_ * 0x2545f4914f6cdd1dull) >> 11) / 9007199254740992.0;
  }
  Vector3 vector(double size = 1.0) {
    const double x = uniform(-size, size), y = uniform(-size, size);
    return {x, y, uniform(-size, size)};
  }
  Vector3 direction() {
    Vector3 v = vector();
    while (v.norm() > 1.0 || v.norm() < 0.1) v = vector();
    return v.normalized();
  }
  Matrix3 rotation() {
    const Vector3 axis = direction();
    return Eigen::AngleAxisd(uniform(-kPi, kPi), axis).toRotationMatrix();
  }
  Placement placement(double size = 1.0) {
    const Matrix3 r = rotation();
    return {r, vector(size)};
  }

 private:
  std::uint64_t state_;
};

inline Matrix3 turn(double angle, const Vector3& axis) {
  return Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
}

inline ConvexMesh cube_mesh(const Vector3& half) {
  ConvexMesh mesh;
  for (int k = 0; k < 8; ++k)
    mesh.vertices.push_back({k & 1 ? half[0] : -half[0], k & 2 ? half[1] : -half[1], k & 4 ? half[2] : -half[2]});
  mesh.triangles = {{{0, 2, 3}}, {{0, 3, 1}}, {{4, 5, 7}}, {{4, 7, 6}}, {{0, 1, 5}}, {{0, 5, 4}},
                    {{2, 6, 7}}, {{2, 7, 3}}, {{0, 4, 6}}, {{0, 6, 2}}, {{1, 3, 7}}, {{1, 7, 5}}};
  return mesh;
}

/// Rings of points on an ellipsoid: flat quadrilaterals between them, a cap of triangles at either end. About 1000
/// vertices with 22 rings of 45.
inline ConvexMesh globe_mesh(const Vector3& radii, int rings, int around) {
  ConvexMesh mesh;
  mesh.vertices.push_back({0.0, 0.0, -radii[2]});
  for (int i = 0; i < rings; ++i)
    for (int k = 0; k < around; ++k) {
      const double latitude = kPi * ((i + 1.0) / (rings + 1.0) - 0.5), longitude = 2.0 * kPi * k / around;
      mesh.vertices.push_back(radii.cwiseProduct(Vector3(
          std::cos(latitude) * std::cos(longitude), std::cos(latitude) * std::sin(longitude), std::sin(latitude))));
    }
  mesh.vertices.push_back({0.0, 0.0, radii[2]});
  const auto at = [&](int ring, int k) { return 1 + ring * around + k % around; };
  const int top = static_cast<int>(mesh.vertices.size()) - 1;
  for (int k = 0; k < around; ++k) {
    mesh.triangles.push_back({{0, at(0, k + 1), at(0, k)}});
    mesh.triangles.push_back({{top, at(rings - 1, k), at(rings - 1, k + 1)}});
    for (int i = 0; i + 1 < rings; ++i) {
      mesh.triangles.push_back({{at(i, k), at(i, k + 1), at(i + 1, k + 1)}});
      mesh.triangles.push_back({{at(i, k), at(i + 1, k + 1), at(i + 1, k)}});
    }
  }
  return mesh;
}

/// The hull of random points on a sphere, by looking at each triple of them.
inline ConvexMesh random_mesh(std::uint64_t seed, int count, double size) {
  Dice dice(seed);
  ConvexMesh mesh;
  for (int k = 0; k < count; ++k) mesh.vertices.push_back(size * dice.direction());
  for (int i = 0; i < count; ++i)
    for (int j = 0; j < count; ++j)
      for (int k = 0; k < count; ++k) {
        if (!(i < j && i < k && j != k)) continue;
        const Vector3 normal = (mesh.vertices[j] - mesh.vertices[i]).cross(mesh.vertices[k] - mesh.vertices[i]);
        bool outside = true;
        for (int l = 0; l < count && outside; ++l)
          outside = l == i || l == j || l == k || normal.dot(mesh.vertices[l] - mesh.vertices[i]) < 0.0;
        if (outside) mesh.triangles.push_back({{i, j, k}});
      }
  return mesh;
}

/// The point farthest along a direction.
inline Vector3 support(const Shape& shape, const Placement& place, const Vector3& direction) {
  const Vector3 d = place.rotation.transpose() * direction;
  const Vector3& s = shape.size;
  Vector3 p = Vector3::Zero();
  const auto side = [](double x) { return x < 0.0 ? -1.0 : 1.0; };
  const double across = std::hypot(d[0], d[1]);
  switch (shape.type) {
    case ShapeType::Sphere:
      p = s[0] * d.normalized();
      break;
    case ShapeType::Box:
      for (int k = 0; k < 3; ++k) p[k] = side(d[k]) * s[k];
      break;
    case ShapeType::Capsule:
      p = s[0] * d.normalized() + Vector3(0.0, 0.0, side(d[2]) * s[1]);
      break;
    case ShapeType::Cylinder:
      if (across > 0.0) p << s[0] * d[0] / across, s[0] * d[1] / across, 0.0;
      p[2] = side(d[2]) * s[1];
      break;
    case ShapeType::Ellipsoid:
      p = s.cwiseProduct(s.cwiseProduct(d).normalized());
      break;
    case ShapeType::Convex: {
      p = shape.mesh->vertices[0];
      for (const Vector3& v : shape.mesh->vertices)
        if (v.dot(d) > p.dot(d)) p = v;
      break;
    }
    case ShapeType::HalfSpace:
    case ShapeType::HeightField:
      break;
  }
  return place * p;
}

/// How far apart planes across n can be held between the shapes: less than the signed distance, but for the best n.
inline double separation(const Shape& a, const Placement& place_a, const Shape& b, const Placement& place_b,
                         const Vector3& n) {
  return n.dot(support(b, place_b, -n) - support(a, place_a, n));
}

/// About zero on the surface [m]; exact for all but the ellipsoid.
inline double off_surface(const Shape& shape, const Placement& place, const Vector3& point) {
  const Vector3 p = place.inverse() * point;
  const Vector3& s = shape.size;
  const double across = std::hypot(p[0], p[1]);
  switch (shape.type) {
    case ShapeType::Sphere:
      return p.norm() - s[0];
    case ShapeType::Box: {
      const Vector3 beyond = p.cwiseAbs() - s;
      return beyond.maxCoeff() > 0.0 ? beyond.cwiseMax(0.0).norm() : beyond.maxCoeff();
    }
    case ShapeType::Capsule:
      return (p - Vector3(0.0, 0.0, std::clamp(p[2], -s[1], s[1]))).norm() - s[0];
    case ShapeType::Cylinder:
      return std::max(across - s[0], std::abs(p[2]) - s[1]);
    case ShapeType::Ellipsoid:
      return (p.cwiseQuotient(s).norm() - 1.0) * s.minCoeff();
    case ShapeType::HalfSpace:
      return p[2];
    case ShapeType::HeightField:
      break;
    case ShapeType::Convex: {
      double most = -std::numeric_limits<double>::infinity();
      for (const auto& t : shape.mesh->triangles) {
        const auto& v = shape.mesh->vertices;
        const Vector3 normal = (v[t[1]] - v[t[0]]).cross(v[t[2]] - v[t[0]]).normalized();
        most = std::max(most, normal.dot(p - v[t[0]]));
      }
      return most;
    }
  }
  return kNan;
}

/// The signed distance, by search over normals: many starts, then downhill with ever smaller steps. Never too large,
/// and mostly good to 1e-7.
inline double signed_distance(const Shape& a, const Placement& place_a, const Shape& b, const Placement& place_b) {
  constexpr int kStarts = 400, kKept = 6;
  std::vector<std::pair<double, Vector3>> starts;
  for (int k = 0; k < kStarts; ++k) {
    const double z = 1.0 - 2.0 * (k + 0.5) / kStarts, angle = k * kPi * (3.0 - std::sqrt(5.0));
    const double r = std::sqrt(1.0 - z * z);
    const Vector3 n(r * std::cos(angle), r * std::sin(angle), z);
    starts.emplace_back(separation(a, place_a, b, place_b, n), n);
  }
  std::sort(starts.begin(), starts.end(), [](const auto& p, const auto& q) { return p.first > q.first; });
  double best = -std::numeric_limits<double>::infinity();
  Dice dice(1);
  for (int k = 0; k < kKept; ++k) {
    auto [value, n] = starts[k];
    for (double step = 0.1; step > 1e-9;) {
      bool better = false;
      for (int t = 0; t < 8; ++t) {
        const Vector3 trial = (n + step * dice.direction()).normalized();
        const double s = separation(a, place_a, b, place_b, trial);
        if (s > value) value = s, n = trial, better = true;
      }
      if (!better) step *= 0.5;
    }
    best = std::max(best, value);
  }
  return best;
}

inline std::vector<std::pair<int, int>> all_pairs(int count) {
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < count; ++a)
    for (int b = a + 1; b < count; ++b) pairs.emplace_back(a, b);
  return pairs;
}

/// Two shapes, each on a frame of its own (1 and 2).
struct Two {
  Shape a, b;
  Detector detector;
  std::vector<Placement> frames = std::vector<Placement>(3);

  Two(const Shape& its_a, const Shape& its_b, double margin = 0.005)
      : a(its_a), b(its_b), detector({{its_a, 1, {}}, {its_b, 2, {}}}, {{0, 1}}, settings(margin)) {}

  static DetectorSettings settings(double margin) {
    DetectorSettings s;
    s.margin = margin;
    return s;
  }
  const std::vector<ContactPoint>& detect(const Placement& place_a, const Placement& place_b) {
    frames[1] = place_a, frames[2] = place_b;
    return detector.detect(frames);
  }
};

inline double least_distance(const std::vector<ContactPoint>& points) {
  double least = std::numeric_limits<double>::infinity();
  for (const ContactPoint& p : points) least = std::min(least, p.distance);
  return least;
}

/// Points but spare ones.
inline std::size_t held(const std::vector<ContactPoint>& points) {
  return static_cast<std::size_t>(
      std::count_if(points.begin(), points.end(), [](const ContactPoint& p) { return !p.spare; }));
}

inline bool is_finite(const ContactPoint& p) {
  return p.position.allFinite() && p.normal.allFinite() && std::isfinite(p.distance);
}

/// One of each kind, about as large as a hand.
inline std::vector<Shape> some_shapes() {
  return {Shape::sphere(0.05),
          Shape::box({0.05, 0.03, 0.08}),
          Shape::capsule(0.03, 0.06),
          Shape::cylinder(0.04, 0.05),
          Shape::ellipsoid({0.05, 0.03, 0.08}),
          Shape::convex(cube_mesh({0.04, 0.05, 0.06})),
          Shape::convex(random_mesh(3, 16, 0.06)),
          Shape::convex(globe_mesh({0.06, 0.05, 0.04}, 8, 12))};
}

}  // namespace signorini::testing
