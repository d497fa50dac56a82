// Compiled once per instruction set, each copy in its own namespace (SIGNORINI_KERNEL_NAMESPACE).
#include "dense_kernels.hpp"

#if defined(__AVX2__) || defined(__AVX512F__)
#include <immintrin.h>
#endif

#ifndef SIGNORINI_KERNEL_NAMESPACE
#define SIGNORINI_KERNEL_NAMESPACE kernels_plain
#endif

namespace signorini::SIGNORINI_KERNEL_NAMESPACE {
namespace {

// A vector of doubles; load and store of the first r < W lanes for the ends of columns.
#if defined(__AVX512F__)
constexpr int W = 8, NR = 8;
using V = __m512d;
inline V load(const double* p) { return _mm512_loadu_pd(p); }
inline V load(const double* p, int r) { return _mm512_maskz_loadu_pd(static_cast<__mmask8>((1 << r) - 1), p); }
inline void store(double* p, V v) { _mm512_storeu_pd(p, v); }
inline void store(double* p, V v, int r) { _mm512_mask_storeu_pd(p, static_cast<__mmask8>((1 << r) - 1), v); }
inline V spread(double a) { return _mm512_set1_pd(a); }
inline V minus_product(V c, V a, V b) { return _mm512_fnmadd_pd(a, b, c); }
inline V plus_product(V c, V a, V b) { return _mm512_fmadd_pd(a, b, c); }
inline V zero() { return _mm512_setzero_pd(); }
#elif defined(__AVX2__)
constexpr int W = 4, NR = 4;
using V = __m256d;
inline __m256i lanes(int r) { return _mm256_cmpgt_epi64(_mm256_set1_epi64x(r), _mm256_set_epi64x(3, 2, 1, 0)); }
inline V load(const double* p) { return _mm256_loadu_pd(p); }
inline V load(const double* p, int r) { return _mm256_maskload_pd(p, lanes(r)); }
inline void store(double* p, V v) { _mm256_storeu_pd(p, v); }
inline void store(double* p, V v, int r) { _mm256_maskstore_pd(p, lanes(r), v); }
inline V spread(double a) { return _mm256_set1_pd(a); }
inline V minus_product(V c, V a, V b) { return _mm256_fnmadd_pd(a, b, c); }
inline V plus_product(V c, V a, V b) { return _mm256_fmadd_pd(a, b, c); }
inline V zero() { return _mm256_setzero_pd(); }
#else
constexpr int W = 1, NR = 4;
using V = double;
inline V load(const double* p) { return *p; }
inline V load(const double* p, int) { return *p; }
inline void store(double* p, V v) { *p = v; }
inline void store(double* p, V v, int) { *p = v; }
inline V spread(double a) { return a; }
inline V minus_product(V c, V a, V b) { return c - a * b; }
inline V plus_product(V c, V a, V b) { return c + a * b; }
inline V zero() { return 0.0; }
#endif

/// y (m) -= x (m) * a.
inline void axpy_minus(int m, double a, const double* x, double* y) {
  const V va = spread(a);
  int i = 0;
  for (; i + W <= m; i += W) store(y + i, minus_product(load(y + i), load(x + i), va));
  if (i < m) store(y + i, minus_product(load(y + i, m - i), load(x + i, m - i), va), m - i);
}

/// C (MV vectors x N columns, the last one of r lanes when Tail) -= A (.. x k) B (k x N); B(q, j) = b[q qs + j js].
template <int MV, int N, bool Tail>
inline void tile(int k, const double* a, int lda, const double* b, int qs, int js, double* c, int ldc, int r) {
  V acc[MV][N];
  for (int v = 0; v < MV; ++v)
    for (int j = 0; j < N; ++j)
      acc[v][j] = Tail && v == MV - 1 ? load(c + j * ldc + v * W, r) : load(c + j * ldc + v * W);
  for (int q = 0; q < k; ++q) {
    V av[MV];
    for (int v = 0; v < MV; ++v) av[v] = Tail && v == MV - 1 ? load(a + q * lda + v * W, r) : load(a + q * lda + v * W);
    for (int j = 0; j < N; ++j) {
      const V bv = spread(b[j * js + q * qs]);
      for (int v = 0; v < MV; ++v) acc[v][j] = minus_product(acc[v][j], av[v], bv);
    }
  }
  for (int v = 0; v < MV; ++v)
    for (int j = 0; j < N; ++j) {
      if (Tail && v == MV - 1)
        store(c + j * ldc + v * W, acc[v][j], r);
      else
        store(c + j * ldc + v * W, acc[v][j]);
    }
}

template <int N>
inline void columns(int m, int k, const double* a, int lda, const double* b, int qs, int js, double* c, int ldc) {
  int i = 0;
  for (; i + 2 * W <= m; i += 2 * W) tile<2, N, false>(k, a + i, lda, b, qs, js, c + i, ldc, 0);
  const int rest = m - i;
  if (rest == 0) return;
  if (rest < W)
    tile<1, N, true>(k, a + i, lda, b, qs, js, c + i, ldc, rest);
  else if (rest == W)
    tile<1, N, false>(k, a + i, lda, b, qs, js, c + i, ldc, 0);
  else
    tile<2, N, true>(k, a + i, lda, b, qs, js, c + i, ldc, rest - W);
}

/// The same for 1 to 4 columns.
inline void few_columns(int n, int m, int k, const double* a, int lda, const double* b, int qs, int js, double* c,
                        int ldc) {
  switch (n) {
    case 4:
      columns<4>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    case 3:
      columns<3>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    case 2:
      columns<2>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    case 1:
      columns<1>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    default:
      break;
  }
}

/// C (m x n) -= A (m x k) B (k x n).
void gemm_minus(int m, int n, int k, const double* a, int lda, const double* b, int ldb, double* c, int ldc) {
  if (m <= 0 || k <= 0) return;
  int j = 0;
  for (; j + NR <= n; j += NR) columns<NR>(m, k, a, lda, b + j * ldb, 1, ldb, c + j * ldc, ldc);
  if (NR > 4 && j + 4 <= n) {
    columns<4>(m, k, a, lda, b + j * ldb, 1, ldb, c + j * ldc, ldc);
    j += 4;
  }
  few_columns(n - j, m, k, a, lda, b + j * ldb, 1, ldb, c + j * ldc, ldc);
}

/// The lower triangle of C (n x n, and m rows below it) -= A A_top^T, A (n + m rows) x k. Of the blocks on the diagonal
/// the upper triangle is written too.
void symmetric_minus(int n, int m, int k, const double* a, int lda, double* c, int ldc) {
  int j = 0;
  for (; j + 4 <= n; j += 4) columns<4>(n + m - j, k, a + j, lda, a + j, lda, 1, c + j * ldc + j, ldc);
  few_columns(n - j, n + m - j, k, a + j, lda, a + j, lda, 1, c + j * ldc + j, ldc);
}

inline double dot(int m, const double* a, const double* b) {
  V acc = zero();
  int i = 0;
  for (; i + W <= m; i += W) acc = plus_product(acc, load(a + i), load(b + i));
  if (i < m) acc = plus_product(acc, load(a + i, m - i), load(b + i, m - i));
  double lanes_of[W], sum = 0.0;
  store(lanes_of, acc);
  for (int k = 0; k < W; ++k) sum += lanes_of[k];
  return sum;
}

/// y (MV vectors, the last one of r lanes when Tail) = A x.
template <int MV, bool Tail>
inline void product_rows(int n, const double* a, int lda, const double* x, double* y, int r) {
  V acc[MV];
  for (int v = 0; v < MV; ++v) acc[v] = zero();
  for (int q = 0; q < n; ++q) {
    const V xq = spread(x[q]);
    for (int v = 0; v < MV; ++v)
      acc[v] = plus_product(acc[v], Tail && v == MV - 1 ? load(a + q * lda + v * W, r) : load(a + q * lda + v * W), xq);
  }
  for (int v = 0; v < MV; ++v) {
    if (Tail && v == MV - 1)
      store(y + v * W, acc[v], r);
    else
      store(y + v * W, acc[v]);
  }
}

constexpr int kPanel = 8;
constexpr int kColumns = 4;  // that a triangular solve takes at once

inline void swap_rows(int n, double* a, int lda, int r, int q) {
  if (r == q) return;
  for (int j = 0; j < n; ++j) {
    const double t = a[j * lda + r];
    a[j * lda + r] = a[j * lda + q];
    a[j * lda + q] = t;
  }
}

/// inverse (kPanel x kPanel) = -L^-1 for the unit lower triangle L (k x k), padded with zeros.
inline void negative_unit_inverse(int k, const double* l, int ldl, double* inverse) {
  for (int i = 0; i < kPanel * kPanel; ++i) inverse[i] = 0.0;
  for (int j = 0; j < k; ++j) {
    double* x = inverse + j * kPanel;
    x[j] = -1.0;
    for (int q = j; q + 1 < k; ++q)
      for (int i = q + 1; i < k; ++i) x[i] -= x[q] * l[q * ldl + i];
  }
}

/// B (k x N, k <= kPanel) <- L^-1 B, given -L^-1; every entry is read before any is written.
template <int N>
inline void apply_inverse(int k, const double* inverse, double* b, int ldb) {
  constexpr int MV = kPanel / W;
  V acc[MV][N];
  for (int v = 0; v < MV; ++v)
    for (int j = 0; j < N; ++j) acc[v][j] = zero();
  for (int q = 0; q < k; ++q)
    for (int j = 0; j < N; ++j) {
      const V bv = spread(b[j * ldb + q]);
      for (int v = 0; v < MV; ++v) acc[v][j] = minus_product(acc[v][j], load(inverse + q * kPanel + v * W), bv);
    }
  for (int v = 0; v < MV; ++v)
    for (int j = 0; j < N; ++j) {
      const int rest = k - v * W;
      if (rest >= W)
        store(b + j * ldb + v * W, acc[v][j]);
      else if (rest > 0)
        store(b + j * ldb + v * W, acc[v][j], rest);
    }
}

/// B (k x n) <- L^-1 B.
inline void lower_solve(int k, int n, const double* inverse, double* b, int ldb) {
  constexpr int N = 4;
  int j = 0;
  for (; j + N <= n; j += N) apply_inverse<N>(k, inverse, b + j * ldb, ldb);
  for (; j < n; ++j) apply_inverse<1>(k, inverse, b + j * ldb, ldb);
}

}  // namespace

void multiply(int m, int n, const double* a, int lda, const double* x, double* y) {
  int i = 0;
  for (; i + 4 * W <= m; i += 4 * W) product_rows<4, false>(n, a + i, lda, x, y + i, 0);
  for (; i + W <= m; i += W) product_rows<1, false>(n, a + i, lda, x, y + i, 0);
  if (i < m) product_rows<1, true>(n, a + i, lda, x, y + i, m - i);
}

void add_three(int m, const double* a, int lda, const double* x, double* y) {
  const V x0 = spread(x[0]), x1 = spread(x[1]), x2 = spread(x[2]);
  int i = 0;
  for (; i + W <= m; i += W, a += W) {
    const V sum = plus_product(plus_product(load(y + i), load(a), x0), load(a + lda), x1);
    store(y + i, plus_product(sum, load(a + 2 * lda), x2));
  }
  if (i < m) {
    const int r = m - i;
    const V sum = plus_product(plus_product(load(y + i, r), load(a, r), x0), load(a + lda, r), x1);
    store(y + i, plus_product(sum, load(a + 2 * lda, r), x2), r);
  }
}

void symmetric_update(int n, int k, const double* a, double* c) { symmetric_minus(n, 0, k, a, n, c, n); }

int factor_front(int p, int u, double* l, double* up, double* s, int* pivots) {
  const int n = p + u;
  int sign = 1;
  for (int k0 = 0; k0 < p; k0 += kPanel) {
    const int k1 = k0 + kPanel < p ? k0 + kPanel : p;
    // Panel: columns k0..k1, all rows below k0, pivots among the first p rows.
    for (int k = k0; k < k1; ++k) {
      double* column = l + k * n;
      int pivot = k;
      double largest = column[k] < 0 ? -column[k] : column[k];
      for (int i = k + 1; i < p; ++i) {
        const double value = column[i] < 0 ? -column[i] : column[i];
        if (value > largest) largest = value, pivot = i;
      }
      if (!(largest > 0.0 && largest < 1e300)) return 0;
      pivots[k] = pivot;
      if (pivot != k) {
        sign = -sign;
        swap_rows(k1 - k0, l + k0 * n, n, k, pivot);
      }
      if (column[k] < 0) sign = -sign;
      const double inverse = 1.0 / column[k];
      column[k] = inverse;
      for (int i = k + 1; i < n; ++i) column[i] *= inverse;
      for (int j = k + 1; j < k1; ++j) axpy_minus(n - k - 1, l[j * n + k], column + k + 1, l + j * n + k + 1);
    }
    for (int k = k0; k < k1; ++k) {
      swap_rows(k0, l, n, k, pivots[k]);
      swap_rows(p - k1, l + k1 * n, n, k, pivots[k]);
      swap_rows(u, up, p, k, pivots[k]);
    }
    const int width = k1 - k0;
    if (p == k1 && u == 0) break;
    double inverse[kPanel * kPanel];
    negative_unit_inverse(width, l + k0 * n + k0, n, inverse);
    lower_solve(width, p - k1, inverse, l + k1 * n + k0, n);
    gemm_minus(n - k1, p - k1, width, l + k0 * n + k1, n, l + k1 * n + k0, n, l + k1 * n + k1, n);
    lower_solve(width, u, inverse, up + k0, p);
    gemm_minus(p - k1, u, width, l + k0 * n + k1, n, up + k0, p, up + k1, p);
  }
  gemm_minus(u, u, p, l + p, n, up, p, s, u);
  return sign;
}

void forward(int p, int u, const double* l, const int* pivots, double* x, double* y) {
  const int n = p + u;
  for (int k = 0; k < p; ++k) {
    const int pivot = pivots[k];
    if (pivot != k) {
      const double t = x[k];
      x[k] = x[pivot];
      x[pivot] = t;
    }
  }
  int k = 0;
  for (; k + kColumns <= p; k += kColumns) {
    for (int j = 0; j + 1 < kColumns; ++j)
      for (int i = j + 1; i < kColumns; ++i) x[k + i] -= l[(k + j) * n + k + i] * x[k + j];
    columns<1>(p - k - kColumns, kColumns, l + k * n + k + kColumns, n, x + k, 1, 0, x + k + kColumns, n);
  }
  for (; k + 1 < p; ++k) axpy_minus(p - k - 1, x[k], l + k * n + k + 1, x + k + 1);
  for (int i = 0; i < u; ++i) y[i] = 0.0;
  gemm_minus(u, 1, p, l + p, n, x, p, y, u);
}

void backward(int p, int u, const double* l, const double* up, double* x, const double* xu) {
  const int n = p + u;
  gemm_minus(p, 1, u, up, p, xu, u, x, p);
  int k = p;
  for (; k >= kColumns; k -= kColumns) {
    const int k0 = k - kColumns;
    for (int j = k - 1; j >= k0; --j) {
      x[j] *= l[j * n + j];
      for (int i = k0; i < j; ++i) x[i] -= l[j * n + i] * x[j];
    }
    columns<1>(k0, kColumns, l + k0 * n, n, x + k0, 1, 0, x, n);
  }
  while (--k >= 0) {
    x[k] *= l[k * n + k];
    axpy_minus(k, x[k], l + k * n, x);
  }
}

int cholesky_front(int p, int u, double* l, double* s) {
  const int n = p + u;
  for (int k0 = 0; k0 < p; k0 += kPanel) {
    const int k1 = k0 + kPanel < p ? k0 + kPanel : p;
    for (int k = k0; k < k1; ++k) {
      double* column = l + k * n;
      if (!(column[k] > 0.0 && column[k] < 1e300)) return 0;
      const double inverse = 1.0 / __builtin_sqrt(column[k]);
      column[k] = inverse;
      for (int i = k + 1; i < n; ++i) column[i] *= inverse;
      for (int j = k + 1; j < k1; ++j) axpy_minus(n - j, column[j], column + j, l + j * n + j);
    }
    symmetric_minus(p - k1, u, k1 - k0, l + k0 * n + k1, n, l + k1 * n + k1, n);
  }
  symmetric_minus(u, 0, p, l + p, n, s, u);
  return 1;
}

void cholesky_forward(int p, int u, const double* l, double* x, double* y) {
  const int n = p + u;
  int k = 0;
  for (; k + kColumns <= p; k += kColumns) {
    for (int j = 0; j < kColumns; ++j) {
      x[k + j] *= l[(k + j) * n + k + j];
      for (int i = j + 1; i < kColumns; ++i) x[k + i] -= l[(k + j) * n + k + i] * x[k + j];
    }
    columns<1>(p - k - kColumns, kColumns, l + k * n + k + kColumns, n, x + k, 1, 0, x + k + kColumns, n);
  }
  for (; k < p; ++k) {
    x[k] *= l[k * n + k];
    axpy_minus(p - k - 1, x[k], l + k * n + k + 1, x + k + 1);
  }
  for (int i = 0; i < u; ++i) y[i] = 0.0;
  gemm_minus(u, 1, p, l + p, n, x, p, y, u);
}

void cholesky_backward(int p, int u, const double* l, double* x, const double* xu) {
  const int n = p + u;
  for (int k = p - 1; k >= 0; --k) {
    const double* column = l + k * n;
    x[k] = (x[k] - dot(p - k - 1, column + k + 1, x + k + 1) - dot(u, column + p, xu)) * column[k];
  }
}

}  // namespace signorini::SIGNORINI_KERNEL_NAMESPACE
