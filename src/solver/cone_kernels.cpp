// Compiled once per instruction set, each copy in its own namespace (SIGNORINI_KERNEL_NAMESPACE). Loops over the eight
// cones of a block, without branches, which the compiler turns into vectors.
#include "cone_kernels.hpp"

#ifndef SIGNORINI_KERNEL_NAMESPACE
#define SIGNORINI_KERNEL_NAMESPACE kernels_plain
#endif

namespace signorini::SIGNORINI_KERNEL_NAMESPACE {
namespace {

constexpr int W = ConeBlock::kWidth;
constexpr double kTiny = 1e-300, kInfinity = __builtin_inf();

inline double larger(double a, double b) { return a < b ? b : a; }
inline double smaller(double a, double b) { return b < a ? b : a; }

struct Vector3 {
  double a0, a1, a2;
};

inline double tangent(Vector3 x) { return __builtin_sqrt(x.a1 * x.a1 + x.a2 * x.a2); }
inline double dot(Vector3 a, Vector3 b) { return a.a0 * b.a0 + a.a1 * b.a1 + a.a2 * b.a2; }
inline Vector3 times(double a, Vector3 v) { return {a * v.a0, a * v.a1, a * v.a2}; }
inline Vector3 reflect(Vector3 w) { return {w.a0, -w.a1, -w.a2}; }

/// x_0^2 - |x_T|^2 as a product, which keeps its digits near the boundary.
inline double determinant(Vector3 x) {
  const double t = tangent(x);
  return (x.a0 - t) * (x.a0 + t);
}

inline Vector3 jordan_product(Vector3 a, Vector3 b) {
  return {dot(a, b), a.a0 * b.a1 + b.a0 * a.a1, a.a0 * b.a2 + b.a0 * a.a2};
}

/// Solves jordan_product(a, x) = b.
inline Vector3 jordan_divide(Vector3 a, Vector3 b) {
  const double inverse = 1.0 / a.a0, x0 = (a.a0 * b.a0 - a.a1 * b.a1 - a.a2 * b.a2) / determinant(a);
  return {x0, (b.a1 - x0 * a.a1) * inverse, (b.a2 - x0 * a.a2) * inverse};
}

/// Quadratic representation's square root for unit-determinant w: [w0, w_T'; w_T, I + share w_T w_T'], share =
/// 1 / (1 + w0).
inline Vector3 scale(Vector3 w, double share, Vector3 v) {
  const double t = w.a1 * v.a1 + w.a2 * v.a2, f = v.a0 + t * share;
  return {w.a0 * v.a0 + t, v.a1 + f * w.a1, v.a2 + f * w.a2};
}

/// Largest a with x + a dx in the second-order cone, c = determinant(x): the smallest positive root of
/// det(dx) a^2 + 2 b a + c.
inline double step_to_boundary(Vector3 x, double c, Vector3 dx) {
  const double a = dx.a0 * dx.a0 - dx.a1 * dx.a1 - dx.a2 * dx.a2, b = x.a0 * dx.a0 - x.a1 * dx.a1 - x.a2 * dx.a2;
  const double discriminant = b * b - a * c, root = __builtin_sqrt(larger(discriminant, 0.0));
  const bool back = (discriminant >= 0.0) & (b <= 0.0) & (root > b),
             ahead = (discriminant >= 0.0) & (b > 0.0) & (a < 0.0);
  const double numerator = back ? c : ahead ? root + b : -x.a0, denominator = back ? root - b : ahead ? -a : dx.a0;
  return (back | ahead | (dx.a0 < 0.0)) ? numerator / denominator : kInfinity;
}

inline Vector3 get(const ConeBlock::Row (&rows)[3], int k) { return {rows[0][k], rows[1][k], rows[2][k]}; }
inline void set(ConeBlock::Row (&rows)[3], int k, Vector3 v) {
  rows[0][k] = v.a0, rows[1][k] = v.a1, rows[2][k] = v.a2;
}

}  // namespace

void cone_scalings(int n, ConeBlock* blocks) {
  for (ConeBlock* block = blocks; block < blocks + n; ++block) {
    ConeBlock& e = *block;
    for (int k = 0; k < W; ++k) {
      const Vector3 x = get(e.x, k), z = get(e.z, k);
      const double det_x = larger(determinant(x), kTiny), det_z = larger(determinant(z), kTiny);
      const double root_x = __builtin_sqrt(det_x), root_z = __builtin_sqrt(det_z);
      const double over_x = 1.0 / root_x, over_z = 1.0 / root_z;
      const Vector3 xb = times(over_x, x), zb = times(over_z, z);
      const double factor = 0.5 / __builtin_sqrt(0.5 * (1.0 + dot(xb, zb)));
      const Vector3 w = {factor * (xb.a0 + zb.a0), factor * (xb.a1 - zb.a1), factor * (xb.a2 - zb.a2)}, j = reflect(w);
      const double share = 1.0 / (1.0 + w.a0), s = root_z * over_x, over_eta = __builtin_sqrt(s);
      const double over_speed = 1.0 / larger(tangent(z), kTiny);
      e.det_x[k] = det_x, e.det_z[k] = det_z;
      set(e.w, k, w);
      e.share[k] = share, e.over_eta[k] = over_eta, e.eta[k] = root_x * over_z * over_eta;
      // H = (2 Jw w'J - J) / eta^2
      e.h[0][k] = 2.0 * s * j.a0 * j.a0 - s, e.h[1][k] = 2.0 * s * j.a0 * j.a1, e.h[2][k] = 2.0 * s * j.a0 * j.a2;
      e.h[3][k] = 2.0 * s * j.a1 * j.a1 + s, e.h[4][k] = 2.0 * s * j.a1 * j.a2;
      e.h[5][k] = 2.0 * s * j.a2 * j.a2 + s;
      set(e.lambda, k, times(over_eta, scale(j, share, x)));
      e.u[0][k] = over_speed * z.a1, e.u[1][k] = over_speed * z.a2;
    }
  }
}

void cone_corrector(int n, ConeBlock* blocks, double target) {
  for (ConeBlock* block = blocks; block < blocks + n; ++block) {
    ConeBlock& e = *block;
    for (int k = 0; k < W; ++k) {
      const Vector3 w = get(e.w, k), j = reflect(w), lambda = get(e.lambda, k);
      const Vector3 sx = times(e.over_eta[k], scale(j, e.share[k], get(e.dx, k)));
      const Vector3 sz = times(e.eta[k], scale(w, e.share[k], get(e.dz, k)));
      const Vector3 second = jordan_product(sx, sz), square = jordan_product(lambda, lambda);
      const Vector3 c = {target - second.a0 - square.a0, -second.a1 - square.a1, -second.a2 - square.a2};
      set(e.centre, k, times(e.over_eta[k], scale(j, e.share[k], jordan_divide(lambda, c))));
    }
  }
}

void cone_dual_direction(int n, ConeBlock* blocks) {
  for (ConeBlock* block = blocks; block < blocks + n; ++block) {
    ConeBlock& e = *block;
    for (int k = 0; k < W; ++k) {
      const Vector3 dx = get(e.dx, k), c = get(e.centre, k);
      e.dz[0][k] = e.weight[k] * (c.a0 - e.h[0][k] * dx.a0 - e.h[1][k] * dx.a1 - e.h[2][k] * dx.a2);
      e.dz[1][k] = e.weight[k] * (c.a1 - e.h[1][k] * dx.a0 - e.h[3][k] * dx.a1 - e.h[4][k] * dx.a2);
      e.dz[2][k] = e.weight[k] * (c.a2 - e.h[2][k] * dx.a0 - e.h[4][k] * dx.a1 - e.h[5][k] * dx.a2);
    }
  }
}

double cone_longest_step(int n, const ConeBlock* blocks) {
  double least[W];
  for (int k = 0; k < W; ++k) least[k] = kInfinity;
  for (const ConeBlock* block = blocks; block < blocks + n; ++block) {
    const ConeBlock& e = *block;
    for (int k = 0; k < W; ++k) {
      const double of_x = step_to_boundary(get(e.x, k), e.det_x[k], get(e.dx, k));
      const double of_z = step_to_boundary(get(e.z, k), e.det_z[k], get(e.dz, k));
      least[k] = smaller(least[k], smaller(of_x, of_z));
    }
  }
  double step = least[0];
  for (int k = 1; k < W; ++k) step = smaller(step, least[k]);
  return step;
}

double cone_complementarity(int n, const ConeBlock* blocks, double step) {
  double sums[W] = {};
  for (const ConeBlock* block = blocks; block < blocks + n; ++block) {
    const ConeBlock& e = *block;
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < W; ++k)
        sums[k] += e.weight[k] * (e.x[r][k] + step * e.dx[r][k]) * (e.z[r][k] + step * e.dz[r][k]);
  }
  double sum = 0.0;
  for (int k = 0; k < W; ++k) sum += sums[k];
  return sum;
}

namespace {

/// natural_map() of W cones, side by side; their |natural|^2 and |l|^2.
template <bool DeSaxce>
inline void natural_maps(const double* friction, int stride, const double* __restrict l, const double* __restrict t,
                         double* __restrict natural, double (&error)[W], double (&size)[W]) {
  for (int k = 0; k < W; ++k) {
    const double l0 = l[3 * k], l1 = l[3 * k + 1], l2 = l[3 * k + 2];
    const double t0 = t[3 * k], t1 = t[3 * k + 1], mu = friction[k * stride];
    const double a0 = l0 - t0, a1 = l1 - t1;
    const double a2 = l2 - t[3 * k + 2] - (DeSaxce ? mu * __builtin_sqrt(t0 * t0 + t1 * t1) : 0.0);
    const double length = __builtin_sqrt(a0 * a0 + a1 * a1);
    const double factor = (a2 + mu * length) / ((1.0 + mu * mu) * length);
    const bool open = mu * length <= -a2, sticks = length <= mu * a2;
    const double share = open ? 0.0 : sticks ? 1.0 : mu * factor;
    const double e0 = l0 - share * a0, e1 = l1 - share * a1, e2 = l2 - (open ? 0.0 : sticks ? a2 : factor * length);
    natural[3 * k] = e0, natural[3 * k + 1] = e1, natural[3 * k + 2] = e2;
    error[k] = e0 * e0 + e1 * e1 + e2 * e2;
    size[k] = l0 * l0 + l1 * l1 + l2 * l2;
  }
}

template <bool DeSaxce>
inline double all_natural_maps(int n, const double* friction, int stride, const double* l, const double* t,
                               double* natural, double& size) {
  double largest[W] = {}, sizes[W] = {}, nan[W] = {};
  for (int i = 0; i < n; i += W) {
    const int first = i + W <= n ? i : n - W;  // some twice
    double error[W], own[W];
    natural_maps<DeSaxce>(friction + first * stride, stride, l + 3 * first, t + 3 * first, natural + 3 * first, error,
                          own);
    for (int k = 0; k < W; ++k) {
      nan[k] += error[k] == error[k] ? 0.0 : error[k];
      largest[k] = larger(largest[k], error[k]), sizes[k] = larger(sizes[k], own[k]);
    }
  }
  double error = largest[0], bad = nan[0];
  size = sizes[0];
  for (int k = 1; k < W; ++k) error = larger(error, largest[k]), size = larger(size, sizes[k]), bad += nan[k];
  return error + bad;
}

}  // namespace

double cone_natural_map(int n, const double* friction, int stride, bool de_saxce, const double* l, const double* t,
                        double* natural, double& size) {
  return de_saxce ? all_natural_maps<true>(n, friction, stride, l, t, natural, size)
                  : all_natural_maps<false>(n, friction, stride, l, t, natural, size);
}

}  // namespace signorini::SIGNORINI_KERNEL_NAMESPACE
