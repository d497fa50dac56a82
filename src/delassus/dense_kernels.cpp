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

// A vector of doubles; load and store of the first r < W lanes, or of those from `first` to before `last`, for the ends
// of columns.
#if defined(__AVX512F__)
constexpr int W = 8, NR = 8;
using V = __m512d;
inline V load(const double* p) { return _mm512_loadu_pd(p); }
inline V load(const double* p, int r) { return _mm512_maskz_loadu_pd(static_cast<__mmask8>((1 << r) - 1), p); }
inline V load(const double* p, int first, int last) {
  return _mm512_maskz_loadu_pd(static_cast<__mmask8>((1 << last) - (1 << first)), p);
}
inline void store(double* p, V v) { _mm512_storeu_pd(p, v); }
inline void store(double* p, V v, int r) { _mm512_mask_storeu_pd(p, static_cast<__mmask8>((1 << r) - 1), v); }
inline void store(double* p, V v, int first, int last) {
  _mm512_mask_storeu_pd(p, static_cast<__mmask8>((1 << last) - (1 << first)), v);
}
inline V spread(double a) { return _mm512_set1_pd(a); }
inline V product(V a, V b) { return _mm512_mul_pd(a, b); }
inline V minus_product(V c, V a, V b) { return _mm512_fnmadd_pd(a, b, c); }
inline V plus_product(V c, V a, V b) { return _mm512_fmadd_pd(a, b, c); }
inline V zero() { return _mm512_setzero_pd(); }
#elif defined(__AVX2__)
constexpr int W = 4, NR = 4;
using V = __m256d;
inline __m256i lanes(int r) { return _mm256_cmpgt_epi64(_mm256_set1_epi64x(r), _mm256_set_epi64x(3, 2, 1, 0)); }
inline V load(const double* p) { return _mm256_loadu_pd(p); }
inline V load(const double* p, int r) { return _mm256_maskload_pd(p, lanes(r)); }
inline V load(const double* p, int first, int last) {
  return _mm256_maskload_pd(p, _mm256_andnot_si256(lanes(first), lanes(last)));
}
inline void store(double* p, V v) { _mm256_storeu_pd(p, v); }
inline void store(double* p, V v, int r) { _mm256_maskstore_pd(p, lanes(r), v); }
inline void store(double* p, V v, int first, int last) {
  _mm256_maskstore_pd(p, _mm256_andnot_si256(lanes(first), lanes(last)), v);
}
inline V spread(double a) { return _mm256_set1_pd(a); }
inline V product(V a, V b) { return _mm256_mul_pd(a, b); }
inline V minus_product(V c, V a, V b) { return _mm256_fnmadd_pd(a, b, c); }
inline V plus_product(V c, V a, V b) { return _mm256_fmadd_pd(a, b, c); }
inline V zero() { return _mm256_setzero_pd(); }
#else
constexpr int W = 1, NR = 4;
using V = double;
inline V load(const double* p) { return *p; }
inline V load(const double* p, int) { return *p; }
inline V load(const double* p, int, int) { return *p; }
inline void store(double* p, V v) { *p = v; }
inline void store(double* p, V v, int) { *p = v; }
inline void store(double* p, V v, int, int) { *p = v; }
inline V spread(double a) { return a; }
inline V product(V a, V b) { return a * b; }
inline V minus_product(V c, V a, V b) { return c - a * b; }
inline V plus_product(V c, V a, V b) { return c + a * b; }
inline V zero() { return 0.0; }
#endif

/// y (m) -= x (m) * a.
[[maybe_unused]] inline void axpy_minus(int m, double a, const double* x, double* y) {
  const V va = spread(a);
  int i = 0;
  for (; i + W <= m; i += W) store(y + i, minus_product(load(y + i), load(x + i), va));
  if (i < m) store(y + i, minus_product(load(y + i, m - i), load(x + i, m - i), va), m - i);
}

/// C (MV vectors x N columns, the last one of r lanes when Tail) -= A (.. x k) B (k x N), or = A B when Fresh;
/// B(q, j) = b[q qs + j js].
template <int MV, int N, bool Tail, bool Fresh>
inline void tile(int k, const double* a, int lda, const double* b, int qs, int js, double* c, int ldc, int r) {
  V acc[MV][N];
  for (int v = 0; v < MV; ++v)
    for (int j = 0; j < N; ++j)
      acc[v][j] = Fresh ? zero() : Tail && v == MV - 1 ? load(c + j * ldc + v * W, r) : load(c + j * ldc + v * W);
  for (int q = 0; q < k; ++q) {
    V av[MV];
    for (int v = 0; v < MV; ++v) av[v] = Tail && v == MV - 1 ? load(a + q * lda + v * W, r) : load(a + q * lda + v * W);
    for (int j = 0; j < N; ++j) {
      const V bv = spread(b[j * js + q * qs]);
      for (int v = 0; v < MV; ++v)
        acc[v][j] = Fresh ? plus_product(acc[v][j], av[v], bv) : minus_product(acc[v][j], av[v], bv);
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

template <int N, bool Fresh = false>
inline void columns(int m, int k, const double* a, int lda, const double* b, int qs, int js, double* c, int ldc) {
  int i = 0;
  for (; i + 2 * W <= m; i += 2 * W) tile<2, N, false, Fresh>(k, a + i, lda, b, qs, js, c + i, ldc, 0);
  const int rest = m - i;
  if (rest == 0) return;
  if (rest < W)
    tile<1, N, true, Fresh>(k, a + i, lda, b, qs, js, c + i, ldc, rest);
  else if (rest == W)
    tile<1, N, false, Fresh>(k, a + i, lda, b, qs, js, c + i, ldc, 0);
  else
    tile<2, N, true, Fresh>(k, a + i, lda, b, qs, js, c + i, ldc, rest - W);
}

/// The same for 1 to 4 columns.
template <bool Fresh = false>
inline void few_columns(int n, int m, int k, const double* a, int lda, const double* b, int qs, int js, double* c,
                        int ldc) {
  switch (n) {
    case 4:
      columns<4, Fresh>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    case 3:
      columns<3, Fresh>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    case 2:
      columns<2, Fresh>(m, k, a, lda, b, qs, js, c, ldc);
      break;
    case 1:
      columns<1, Fresh>(m, k, a, lda, b, qs, js, c, ldc);
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

/// The lower triangle of C (n x n, and m rows below it) -= A B, or = when Fresh, A (n + m rows) x k; B(q, j) =
/// b[q qs + j js]. Of the blocks on the diagonal the upper triangle is written too.
template <bool Fresh = false>
void lower_minus(int n, int m, int k, const double* a, int lda, const double* b, int qs, int js, double* c, int ldc) {
  int j = 0;
  for (; j + 4 <= n; j += 4) columns<4, Fresh>(n + m - j, k, a + j, lda, b + j * js, qs, js, c + j * ldc + j, ldc);
  few_columns<Fresh>(n - j, n + m - j, k, a + j, lda, b + j * js, qs, js, c + j * ldc + j, ldc);
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

/// y (MV or more vectors, up to 4, the last one of r lanes when Tail) = A x, all at once: one sum alone would wait for
/// itself.
template <int MV, bool Tail>
inline void product_rows(int vectors, int n, const double* a, int lda, const double* x, double* y, int r) {
  if constexpr (MV < 4)
    if (vectors > MV) return product_rows<MV + 1, Tail>(vectors, n, a, lda, x, y, r);
  product_rows<MV, Tail>(n, a, lda, x, y, r);
}

// Triangular solves work on a copy of up to kBlock values, always in whole vectors from its start: to load what was
// just stored in other pieces takes long.
constexpr int kBlock = 64;

inline void open_block(int n, const double* x, double* work) {
  for (int i = 0; i < n; ++i) work[i] = x[i];
  for (int i = n; i % W != 0; ++i) work[i] = 0.0;
}

/// work -= a column, entries from `first` to before `last`.
inline void subtract(int first, int last, double a, const double* column, double* work) {
  const V va = spread(a);
  for (int i = first / W * W; i < last; i += W) {
    const V part = load(column + i, first > i ? first - i : 0, last - i < W ? last - i : W);
    store(work + i, minus_product(load(work + i), part, va));
  }
}

constexpr int kPanel = 8;

inline void swap_rows(int n, double* a, int lda, int r, int q) {
  if (r == q) return;
  for (int j = 0; j < n; ++j) {
    const double t = a[j * lda + r];
    a[j * lda + r] = a[j * lda + q];
    a[j * lda + q] = t;
  }
}

#if defined(__AVX512F__)
constexpr int kRegisters = 3;  // vectors of a column of a panel of 8 that fit into registers

inline __mmask8 mask(unsigned rows) { return static_cast<__mmask8>(rows); }

/// Rows k and r of a panel, k < 8, change places.
template <int MV>
inline void swap_rows(V (&a)[kPanel][MV], int k, int r) {
  const __m512i from_k = _mm512_set1_epi64(k), from_r = _mm512_set1_epi64(r % W);
#pragma GCC unroll 3
  for (int v = 0; v < MV; ++v) {
    if (v != r / W) continue;
#pragma GCC unroll 8
    for (int j = 0; j < kPanel; ++j) {
      const V row_k = _mm512_permutexvar_pd(from_k, a[j][0]), row_r = _mm512_permutexvar_pd(from_r, a[j][v]);
      a[j][v] = _mm512_mask_mov_pd(a[j][v], mask(1U << r % W), row_k);
      a[j][0] = _mm512_mask_mov_pd(a[j][0], mask(1U << k), row_r);
    }
  }
}

enum class Pivots { Sought, OnDiagonal, Symmetric };
constexpr double kLargestMultiplier = 100.0;  // with which pivots stay on the diagonal

/// factor_panel() of at most MV vectors a column, in registers: with the largest pivots; or with those on the diagonal,
/// 0 and nothing written where they are too small; or of a symmetric positive definite matrix by its lower triangle.
template <int MV, Pivots How>
int factor_panel_in_registers(int width, int p, int n, double* l, int ldl, int* pivots) {
  const __mmask8 tail = mask((1U << (n - (MV - 1) * W)) - 1U);
  V a[kPanel][MV], inverses = spread(1.0);
#pragma GCC unroll 8
  for (int j = 0; j < kPanel; ++j)
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v)
      a[j][v] = j < width ? _mm512_maskz_loadu_pd(v == MV - 1 ? tail : mask(0xff), l + j * ldl + v * W) : zero();
  int sign = 1;
  [[maybe_unused]] __mmask8 too_large = 0;
#pragma GCC unroll 8
  for (int k = 0; k < kPanel; ++k) {
    if (k >= width) break;
    if constexpr (How == Pivots::Sought) {
      const unsigned candidates = (1U << p) - (1U << k);
      V best = _mm512_maskz_mov_pd(mask(candidates), _mm512_abs_pd(a[k][0]));
#pragma GCC unroll 3
      for (int v = 1; v < MV; ++v)
        best = _mm512_mask_max_pd(best, mask(candidates >> v * W), best, _mm512_abs_pd(a[k][v]));
      best = _mm512_max_pd(best, _mm512_shuffle_f64x2(best, best, 0x4e));
      best = _mm512_max_pd(best, _mm512_shuffle_f64x2(best, best, 0xb1));
      best = _mm512_max_pd(best, _mm512_permute_pd(best, 0x55));
      const double largest = _mm512_cvtsd_f64(best);
      unsigned found = 0;
#pragma GCC unroll 3
      for (int v = 0; v < MV; ++v)
        found |= static_cast<unsigned>(
                     _mm512_mask_cmp_pd_mask(mask(candidates >> v * W), _mm512_abs_pd(a[k][v]), best, _CMP_EQ_OQ))
                 << v * W;
      if (!(largest > 0.0 && largest < 1e300) || found == 0) return 0;
      const int pivot = __builtin_ctz(found);
      pivots[k] = pivot;
      if (pivot != k) {
        sign = -sign;
        swap_rows<MV>(a, k, pivot);
      }
    }
    const __m512i row = _mm512_set1_epi64(k);
    const double value = _mm512_cvtsd_f64(_mm512_permutexvar_pd(row, a[k][0]));
    const V inverse = spread(1.0 / value);  // all lanes at once would take twice as long, and the next pivot waits
    if constexpr (How == Pivots::Symmetric) {
      if (!(value > 0.0 && value < 1e300)) return 0;
#pragma GCC unroll 8
      for (int j = k + 1; j < kPanel; ++j)
        a[j][0] = _mm512_mask_permutexvar_pd(a[j][0], mask(1U << k), _mm512_set1_epi64(j), a[k][0]);
    } else {
      if (value < 0) sign = -sign;
    }
    const __mmask8 below = mask(0xffU << (k + 1));
    inverses = _mm512_mask_mov_pd(inverses, mask(1U << k), inverse);
    V factor[MV];
    factor[0] = _mm512_maskz_mul_pd(below, a[k][0], inverse);
    a[k][0] = _mm512_mask_mov_pd(a[k][0], below, factor[0]);
#pragma GCC unroll 3
    for (int v = 1; v < MV; ++v) a[k][v] = factor[v] = product(a[k][v], inverse);
    if constexpr (How == Pivots::OnDiagonal) {
#pragma GCC unroll 3
      for (int v = 0; v < MV; ++v)
        too_large |= _mm512_mask_cmp_pd_mask(mask(((1U << p) - 1U) >> v * W), _mm512_abs_pd(factor[v]),
                                             spread(kLargestMultiplier), _CMP_NLE_UQ);
    }
#pragma GCC unroll 8
    for (int j = k + 1; j < kPanel; ++j) {
      const V u = _mm512_permutexvar_pd(row, a[j][0]);
#pragma GCC unroll 3
      for (int v = 0; v < MV; ++v) a[j][v] = minus_product(a[j][v], factor[v], u);
    }
  }
  if constexpr (How == Pivots::OnDiagonal) {
    const V size = _mm512_abs_pd(inverses);
    if (too_large || _mm512_cmp_pd_mask(size, spread(1e300), _CMP_NLE_UQ) ||
        _mm512_cmp_pd_mask(size, spread(1e-300), _CMP_NGT_UQ))
      return 0;
    for (int k = 0; k < width; ++k) pivots[k] = k;
  }
#pragma GCC unroll 8
  for (int j = 0; j < kPanel; ++j) {
    if (j >= width) break;
    a[j][0] = _mm512_mask_mov_pd(a[j][0], mask(1U << j), inverses);
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v) _mm512_mask_storeu_pd(l + j * ldl + v * W, v == MV - 1 ? tail : mask(0xff), a[j][v]);
  }
  return sign;
}

/// The r <= 8 MV rows of a panel that are no pivots, from row `first` on: A <- A U^-1, U in the panel's first rows.
template <int MV>
void divide_rows(int width, int first, int r, double* l, int ldl) {
  const __mmask8 tail = mask((1U << (r - (MV - 1) * W)) - 1U);
  V a[kPanel][MV];
#pragma GCC unroll 8
  for (int j = 0; j < kPanel; ++j) {
    if (j >= width) break;
    double* column = l + j * ldl;
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v)
      a[j][v] = _mm512_maskz_loadu_pd(v == MV - 1 ? tail : mask(0xff), column + first + v * W);
#pragma GCC unroll 8
    for (int k = 0; k < j; ++k) {
      const V u = spread(column[k]);
#pragma GCC unroll 3
      for (int v = 0; v < MV; ++v) a[j][v] = minus_product(a[j][v], a[k][v], u);
    }
    const V inverse = spread(column[j]);
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v) {
      a[j][v] = product(a[j][v], inverse);
      _mm512_mask_storeu_pd(column + first + v * W, v == MV - 1 ? tail : mask(0xff), a[j][v]);
    }
  }
}

/// Up to N columns of at most MV vectors, the panel's rows first: those <- L11^-1 times them, the rows below -= L21
/// times the result.
template <int MV, int N>
void eliminate_in_registers(int width, int n, const double* l, int ldl, int count, double* b, int ldb) {
  const __mmask8 tail = mask((1U << (n - (MV - 1) * W)) - 1U);
  V x[N][MV];
#pragma GCC unroll 8
  for (int j = 0; j < N; ++j)
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v)
      x[j][v] = j < count ? _mm512_maskz_loadu_pd(v == MV - 1 ? tail : mask(0xff), b + j * ldb + v * W) : zero();
  for (int k = 0; k < width; ++k) {
    const double* column = l + k * ldl;
    V factor[MV];
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v) {
      const __mmask8 rows = v == MV - 1 ? tail : mask(0xff);
      factor[v] = _mm512_maskz_loadu_pd(v == 0 ? mask(rows & (0xffU << (k + 1))) : rows, column + v * W);
    }
    const __m512i row = _mm512_set1_epi64(k);
#pragma GCC unroll 8
    for (int j = 0; j < N; ++j) {
      const V xk = _mm512_permutexvar_pd(row, x[j][0]);
#pragma GCC unroll 3
      for (int v = 0; v < MV; ++v) x[j][v] = minus_product(x[j][v], factor[v], xk);
    }
  }
#pragma GCC unroll 8
  for (int j = 0; j < N; ++j) {
    if (j >= count) break;
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v) _mm512_mask_storeu_pd(b + j * ldb + v * W, v == MV - 1 ? tail : mask(0xff), x[j][v]);
  }
}

/// The lanes of vector v before row `last`.
inline __mmask8 rows_before(int last, int v) {
  return last >= (v + 1) * W ? mask(0xff) : last <= v * W ? mask(0) : mask((1U << (last - v * W)) - 1U);
}

/// forward() after the swaps of the first n rows, p <= n <= 8 MV, with x and y in one column.
template <int MV>
void forward_in_registers(int p, int n, const double* l, int ldl, double* x, double* y) {
  V z[MV];
#pragma GCC unroll 3
  for (int v = 0; v < MV; ++v) z[v] = _mm512_maskz_loadu_pd(rows_before(p, v), x + v * W);
#pragma GCC unroll 3
  for (int from = 0; from < MV; ++from)
    for (int k = from * W; k < p && k < (from + 1) * W; ++k) {
      const V zk = _mm512_permutexvar_pd(_mm512_set1_epi64(k % W), z[from]);
      const double* column = l + k * ldl;
#pragma GCC unroll 3
      for (int v = from; v < MV; ++v) {
        const __mmask8 rows = v == from ? mask(rows_before(n, v) & (0xffU << (k % W + 1))) : rows_before(n, v);
        z[v] = minus_product(z[v], _mm512_maskz_loadu_pd(rows, column + v * W), zk);
      }
    }
#pragma GCC unroll 3
  for (int v = 0; v < MV; ++v) {
    const __mmask8 top = rows_before(p, v);
    _mm512_mask_storeu_pd(x + v * W, top, z[v]);
    if (n > p) _mm512_mask_storeu_pd(y - p + v * W, mask(rows_before(n, v) & ~top), z[v]);
  }
}

/// backward() of p <= 8 MV rows.
template <int MV>
void backward_in_registers(int p, int u, const double* l, const double* up, double* x, const double* xu) {
  const int n = p + u;
  V z[MV], other[MV];  // two sums: one alone would wait for itself
#pragma GCC unroll 3
  for (int v = 0; v < MV; ++v) z[v] = _mm512_maskz_loadu_pd(rows_before(p, v), x + v * W), other[v] = zero();
  int j = 0;
  for (; j + 1 < u; j += 2) {
    const V x0 = spread(xu[j]), x1 = spread(xu[j + 1]);
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v) {
      z[v] = minus_product(z[v], _mm512_maskz_loadu_pd(rows_before(p, v), up + j * p + v * W), x0);
      other[v] = minus_product(other[v], _mm512_maskz_loadu_pd(rows_before(p, v), up + (j + 1) * p + v * W), x1);
    }
  }
  if (j < u)
#pragma GCC unroll 3
    for (int v = 0; v < MV; ++v)
      z[v] = minus_product(z[v], _mm512_maskz_loadu_pd(rows_before(p, v), up + j * p + v * W), spread(xu[j]));
#pragma GCC unroll 3
  for (int v = 0; v < MV; ++v) z[v] = _mm512_add_pd(z[v], other[v]);
#pragma GCC unroll 3
  for (int from = MV - 1; from >= 0; --from) {
    const int last = p < (from + 1) * W ? p : (from + 1) * W;
    // The rows of U over its diagonal, so that one unknown waits for another no longer than need be.
    V inverses = zero();
    for (int k = from * W; k < last; ++k)
      inverses = _mm512_mask_mov_pd(inverses, mask(1U << k % W), spread(l[k * n + k]));
    z[from] = product(z[from], inverses);
    for (int k = last - 1; k >= from * W; --k) {
      const double* column = l + k * n;
      const V zk = _mm512_permutexvar_pd(_mm512_set1_epi64(k % W), z[from]);
      const V row = product(_mm512_maskz_loadu_pd(mask((1U << k % W) - 1U), column + from * W), inverses);
      z[from] = minus_product(z[from], row, zk);
#pragma GCC unroll 3
      for (int v = 0; v < from; ++v) z[v] = minus_product(z[v], load(column + v * W), zk);
    }
  }
#pragma GCC unroll 3
  for (int v = 0; v < MV; ++v) _mm512_mask_storeu_pd(x + v * W, rows_before(p, v), z[v]);
}

template <int MV>
void eliminate_columns(int width, int n, const double* l, int ldl, int count, double* b, int ldb) {
  for (; count > 4; count -= 8, b += 8 * ldb)
    eliminate_in_registers<MV, 8>(width, n, l, ldl, count < 8 ? count : 8, b, ldb);
  if (count > 1)
    eliminate_in_registers<MV, 4>(width, n, l, ldl, count, b, ldb);
  else if (count == 1)
    eliminate_in_registers<MV, 1>(width, n, l, ldl, 1, b, ldb);
}

template <Pivots How>
int factor_top(int width, int p, int top, double* l, int ldl, int* pivots) {
  return top <= W       ? factor_panel_in_registers<1, How>(width, p, top, l, ldl, pivots)
         : top <= 2 * W ? factor_panel_in_registers<2, How>(width, p, top, l, ldl, pivots)
                        : factor_panel_in_registers<3, How>(width, p, top, l, ldl, pivots);
}

/// factor_panel() of p <= 24, and factor_symmetric_panel().
template <bool Symmetric>
int factor_small_panel(int width, int p, int n, double* l, int ldl, int* pivots, [[maybe_unused]] bool on_diagonal) {
  const int top = n < kRegisters * W ? n : kRegisters * W;
  int sign = 0;
  if constexpr (Symmetric) {
    sign = factor_top<Pivots::Symmetric>(width, p, top, l, ldl, pivots);
  } else {
    if (on_diagonal) sign = factor_top<Pivots::OnDiagonal>(width, p, top, l, ldl, pivots);
    if (sign == 0) sign = factor_top<Pivots::Sought>(width, p, top, l, ldl, pivots);
  }
  if (sign == 0) return 0;
  int first = top;
  for (; first + 2 * W < n; first += 3 * W) divide_rows<3>(width, first, n - first < 3 * W ? n - first : 3 * W, l, ldl);
  if (first + W < n)
    divide_rows<2>(width, first, n - first, l, ldl);
  else if (first < n)
    divide_rows<1>(width, first, n - first, l, ldl);
  return sign;
}
#endif

/// LU of a panel of `width` columns and n rows, pivots among the first p; the diagonal of U is stored inverted. Returns
/// the sign of its determinant as factor_front() does.
int factor_panel(int width, int p, int n, double* l, int ldl, int* pivots, [[maybe_unused]] bool on_diagonal) {
#if defined(__AVX512F__)
  if (p <= kRegisters * W) return factor_small_panel<false>(width, p, n, l, ldl, pivots, on_diagonal);
#endif
  int sign = 1;
  for (int k = 0; k < width; ++k) {
    double* column = l + k * ldl;
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
      swap_rows(width, l, ldl, k, pivot);
    }
    if (column[k] < 0) sign = -sign;
    const double inverse = 1.0 / column[k];
    column[k] = inverse;
    // Again in whole vectors, from the panel's first row on.
    for (int i = (k + 1) / W * W; i < n; i += W) {
      const int first = i > k ? 0 : k + 1 - i, last = n - i < W ? n - i : W;
      const V part = product(load(column + i, first, last), spread(inverse));
      store(column + i, part, first, last);
      for (int j = k + 1; j < width; ++j) {
        double* y = l + j * ldl + i;
        const V factor = spread(l[j * ldl + k]);
        if (last == W)
          store(y, minus_product(load(y), part, factor));
        else
          store(y, minus_product(load(y, last), part, factor), last);
      }
    }
  }
  return sign;
}

/// LU of a panel of a symmetric positive definite matrix, from its lower triangle; 0 when it is not that.
int factor_symmetric_panel(int width, int n, double* l, int ldl) {
#if defined(__AVX512F__)
  return factor_small_panel<true>(width, width, n, l, ldl, nullptr, false);
#else
  for (int k = 0; k < width; ++k) {
    double* column = l + k * ldl;
    if (!(column[k] > 0.0 && column[k] < 1e300)) return 0;
    const double inverse = 1.0 / column[k];
    for (int j = k + 1; j < width; ++j) l[j * ldl + k] = column[j];
    column[k] = inverse;
    for (int i = k + 1; i < n; ++i) column[i] *= inverse;
    for (int j = k + 1; j < width; ++j) axpy_minus(n - j, l[j * ldl + k], column + j, l + j * ldl + j);
  }
  return 1;
#endif
}

#if defined(__AVX512F__)
inline void transpose(V (&a)[8]) {
  V pair[8], quad[8];
#pragma GCC unroll 4
  for (int i = 0; i < 8; i += 2)
    pair[i] = _mm512_unpacklo_pd(a[i], a[i + 1]), pair[i + 1] = _mm512_unpackhi_pd(a[i], a[i + 1]);
#pragma GCC unroll 2
  for (int i = 0; i < 2; ++i) {
    quad[i] = _mm512_shuffle_f64x2(pair[i], pair[i + 2], 0x88);
    quad[i + 2] = _mm512_shuffle_f64x2(pair[i], pair[i + 2], 0xdd);
    quad[i + 4] = _mm512_shuffle_f64x2(pair[i + 4], pair[i + 6], 0x88);
    quad[i + 6] = _mm512_shuffle_f64x2(pair[i + 4], pair[i + 6], 0xdd);
  }
#pragma GCC unroll 4
  for (int i = 0; i < 4; ++i) {
    a[i] = _mm512_shuffle_f64x2(quad[i], quad[i + 4], 0x88);
    a[i + 4] = _mm512_shuffle_f64x2(quad[i], quad[i + 4], 0xdd);
  }
}
#endif

/// The rows of U beside a symmetric panel: U (width x r) = D L^T for the r rows of L, D^-1 on the panel's diagonal.
void write_upper(int width, const double* diagonal, int ldl, int r, const double* l, double* up, int ldu) {
  if (r == 0) return;
  double d[kPanel] = {};
  for (int q = 0; q < width; ++q) d[q] = 1.0 / diagonal[q * (ldl + 1)];
#if defined(__AVX512F__)
  const V scale = load(d);
  for (int i = 0; i < r; i += W) {
    const int rows = r - i < W ? r - i : W;
    V a[W];
#pragma GCC unroll 8
    for (int q = 0; q < W; ++q) a[q] = q < width ? load(l + q * ldl + i, rows) : zero();
    transpose(a);
#pragma GCC unroll 8
    for (int j = 0; j < W; ++j)
      if (j < rows) store(up + (i + j) * ldu, product(a[j], scale), width);
  }
#else
  for (int q = 0; q < width; ++q)
    for (int j = 0; j < r; ++j) up[j * ldu + q] = d[q] * l[q * ldl + j];
#endif
}

/// inverse (kPanel x kPanel) = -L^-1 for the unit lower triangle L (k x k), padded with zeros.
[[maybe_unused]] inline void negative_unit_inverse(int k, const double* l, int ldl, double* inverse) {
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
[[maybe_unused]] inline void lower_solve(int k, int n, const double* inverse, double* b, int ldb) {
  constexpr int N = 4;
  int j = 0;
  for (; j + N <= n; j += N) apply_inverse<N>(k, inverse, b + j * ldb, ldb);
  for (; j < n; ++j) apply_inverse<1>(k, inverse, b + j * ldb, ldb);
}

/// Eliminates a panel from `count` other columns B of n rows: the first `width` rows <- L11^-1 times them, the others
/// -= L21 times the result.
void eliminate(int width, int n, const double* l, int ldl, int count, double* b, int ldb) {
  if (count == 0) return;
#if defined(__AVX512F__)
  const int top = n < kRegisters * W ? n : kRegisters * W;
  if (top <= W)
    eliminate_columns<1>(width, top, l, ldl, count, b, ldb);
  else if (top <= 2 * W)
    eliminate_columns<2>(width, top, l, ldl, count, b, ldb);
  else
    eliminate_columns<3>(width, top, l, ldl, count, b, ldb);
#else
  const int top = width;
  double inverse[kPanel * kPanel];
  negative_unit_inverse(width, l, ldl, inverse);
  lower_solve(width, count, inverse, b, ldb);
#endif
  gemm_minus(n - top, count, width, l + top, ldl, b, ldb, b + top, ldb);
}

}  // namespace

void multiply(int m, int n, const double* a, int lda, const double* x, double* y) {
  int i = 0;
  for (; i + 4 * W <= m; i += 4 * W) product_rows<4, false>(n, a + i, lda, x, y + i, 0);
  const int rest = m - i, r = rest % W, vectors = (rest + W - 1) / W;
  if (r > 0)
    product_rows<1, true>(vectors, n, a + i, lda, x, y + i, r);
  else if (rest > 0)
    product_rows<1, false>(vectors, n, a + i, lda, x, y + i, 0);
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

void multiply_blocks(int n, const int* first, const DenseKernels::BlockAt* blocks, const double* a, const double* x,
                     double* y) {
  for (int j = 0; j < n; ++j, y += 3) {
#if defined(__AVX2__) || defined(__AVX512F__)
    // Each load takes a neighbour of the column along, in a lane that is not stored: masks would cost as much again.
    __m256d s0 = _mm256_setzero_pd(), s1 = s0, s2 = s0;
    for (int k = first[j]; k < first[j + 1]; ++k) {
      const double *b = a + blocks[k].start, *v = x + blocks[k].offset;
      s0 = _mm256_fmadd_pd(_mm256_loadu_pd(b), _mm256_broadcast_sd(v), s0);
      s1 = _mm256_fmadd_pd(_mm256_loadu_pd(b + 3), _mm256_broadcast_sd(v + 1), s1);
      s2 = _mm256_fmadd_pd(_mm256_loadu_pd(b + 5), _mm256_broadcast_sd(v + 2), s2);
    }
    s2 = _mm256_permute4x64_pd(s2, 0x39);
    _mm256_maskstore_pd(y, _mm256_set_epi64x(0, -1, -1, -1), _mm256_add_pd(_mm256_add_pd(s0, s1), s2));
#else
    double s0 = 0.0, s1 = 0.0, s2 = 0.0;
    for (int k = first[j]; k < first[j + 1]; ++k) {
      const double *b = a + blocks[k].start, *v = x + blocks[k].offset;
      s0 += b[0] * v[0] + b[3] * v[1] + b[6] * v[2];
      s1 += b[1] * v[0] + b[4] * v[1] + b[7] * v[2];
      s2 += b[2] * v[0] + b[5] * v[1] + b[8] * v[2];
    }
    y[0] = s0, y[1] = s1, y[2] = s2;
#endif
  }
}

void symmetric_product(int n, int k, const double* a, double* c) { lower_minus<true>(n, 0, k, a, n, a, n, 1, c, n); }

int factor_front(int p, int u, double* l, double* up, double* s, int* pivots, [[maybe_unused]] bool on_diagonal) {
  const int n = p + u;
  int sign = 1;
  for (int k0 = 0; k0 < p; k0 += kPanel) {
    const int k1 = k0 + kPanel < p ? k0 + kPanel : p;
    const int panel_sign = factor_panel(k1 - k0, p - k0, n - k0, l + k0 * n + k0, n, pivots + k0, on_diagonal);
    if (panel_sign == 0) return 0;
    sign *= panel_sign;
    bool swapped = false;
    for (int k = k0; k < k1; ++k) pivots[k] += k0, swapped |= pivots[k] != k;
    for (int k = k0; swapped && k < k1; ++k) {
      swap_rows(k0, l, n, k, pivots[k]);
      swap_rows(p - k1, l + k1 * n, n, k, pivots[k]);
      swap_rows(u, up, p, k, pivots[k]);
    }
    const int width = k1 - k0;
    if (p == k1 && u == 0) break;
    eliminate(width, n - k0, l + k0 * n + k0, n, p - k1, l + k1 * n + k0, n);
    if (u > 0) eliminate(width, p - k0, l + k0 * n + k0, n, u, up + k0, p);  // else `up` may be null
  }
  gemm_minus(u, u, p, l + p, n, up, p, s, u);
  return sign;
}

void forward(int p, int u, const double* l, const int* pivots, double* x, double* y) {
  const int n = p + u;
  for (int k = 0; pivots && k < p; ++k) {
    const int pivot = pivots[k];
    if (pivot != k) {
      const double t = x[k];
      x[k] = x[pivot];
      x[pivot] = t;
    }
  }
#if defined(__AVX512F__)
  if (p <= kRegisters * W) {
    const int top = n < kRegisters * W ? n : kRegisters * W;
    if (top <= W)
      forward_in_registers<1>(p, top, l, n, x, y);
    else if (top <= 2 * W)
      forward_in_registers<2>(p, top, l, n, x, y);
    else
      forward_in_registers<3>(p, top, l, n, x, y);
    for (int i = top; i < n; ++i) y[i - p] = 0.0;
    gemm_minus(n - top, 1, p, l + top, n, x, p, y + (top - p), u);
    return;
  }
#endif
  double work[kBlock];
  for (int k0 = 0; k0 < p; k0 += kBlock) {
    const int k1 = k0 + kBlock < p ? k0 + kBlock : p, m = k1 - k0;
    const double* block = l + k0 * n + k0;
    open_block(m, x + k0, work);
    for (int k = 0; k + 1 < m; ++k) subtract(k + 1, m, work[k], block + k * n, work);
    for (int k = 0; k < m; ++k) x[k0 + k] = work[k];
    gemm_minus(p - k1, 1, m, l + k0 * n + k1, n, x + k0, p, x + k1, p);
  }
  for (int i = 0; i < u; ++i) y[i] = 0.0;
  gemm_minus(u, 1, p, l + p, n, x, p, y, u);
}

void backward(int p, int u, const double* l, const double* up, double* x, const double* xu) {
  const int n = p + u;
#if defined(__AVX512F__)
  if (p <= W) return backward_in_registers<1>(p, u, l, up, x, xu);
  if (p <= 2 * W) return backward_in_registers<2>(p, u, l, up, x, xu);
  if (p <= 3 * W) return backward_in_registers<3>(p, u, l, up, x, xu);
#endif
  gemm_minus(p, 1, u, up, p, xu, u, x, p);
  double work[kBlock];
  for (int k1 = p, k0; k1 > 0; k1 = k0) {
    k0 = (k1 - 1) / kBlock * kBlock;
    const double* block = l + k0 * n + k0;
    open_block(k1 - k0, x + k0, work);
    for (int k = k1 - k0 - 1; k >= 0; --k) {
      const double xk = x[k0 + k] = work[k] * block[k * n + k];
      subtract(0, k, xk, block + k * n, work);
    }
    columns<1>(k0, k1 - k0, l + (k1 - 1) * n, -n, x + k1 - 1, -1, 0, x, p);  // the last column first
  }
}

int factor_symmetric_front(int p, int u, double* l, double* up, double* s) {
  const int n = p + u;
  for (int k0 = 0; k0 < p; k0 += kPanel) {
    const int k1 = k0 + kPanel < p ? k0 + kPanel : p, width = k1 - k0;
    double* panel = l + k0 * n + k0;
    if (factor_symmetric_panel(width, n - k0, panel, n) == 0) return 0;
    write_upper(width, panel, n, p - k1, panel + width, l + k1 * n + k0, n);
    write_upper(width, panel, n, u, l + k0 * n + p, up + k0, p);
    lower_minus(p - k1, u, width, panel + width, n, l + k1 * n + k0, 1, n, l + k1 * n + k1, n);
  }
  lower_minus(u, 0, p, l + p, n, up, 1, p, s, u);
  return 1;
}

}  // namespace signorini::SIGNORINI_KERNEL_NAMESPACE
