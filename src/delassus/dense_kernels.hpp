#pragma once

namespace signorini {

/// Dense kernels on column-major arrays, compiled once per instruction set and chosen at the first use.
/// A front is a partly summed matrix whose first p columns and rows are eliminated:
///     [ F11 F12 ]      L = [F11; F21], n x p, holds the factors of F11 and L21 afterwards
///     [ F21 F22 ]      U = F12, p x u, holds U12 afterwards; S = F22, u x u, the Schur complement; n = p + u
struct DenseKernels {
  /// A 3 x 3 block in a row of blocks: its first row in x, and where its values start, column-major.
  struct BlockAt {
    int offset;
    long long start;
  };

  /// Partial LU with row pivoting inside the p pivot rows. The diagonal of U11 is stored inverted. Returns the sign of
  /// det F11: 0 when a pivot is zero or not finite. pivots: p row swaps. on_diagonal: pivots may stay there while they
  /// are not too small, which costs digits of ill-conditioned matrices and saves a search.
  int (*factor_front)(int p, int u, double* l, double* up, double* s, int* pivots, bool on_diagonal);
  /// x_p <- L11^-1 P x_p, y = -L21 x_p (u values, overwritten); pivots: null where there was no pivoting.
  void (*forward)(int p, int u, const double* l, const int* pivots, double* x, double* y);
  /// x_p <- U11^-1 (x_p - U12 x_u).
  void (*backward)(int p, int u, const double* l, const double* up, double* x, const double* xu);
  /// The same factors of a symmetric positive definite front, without pivoting, of which the lower triangles are read
  /// and that of S is written. Returns 0 when a pivot is not positive or not finite, else 1.
  int (*factor_symmetric_front)(int p, int u, double* l, double* up, double* s);
  /// The lower triangle of C (n x n) = A A^T, A n x k; in the upper one something may be overwritten.
  void (*symmetric_product)(int n, int k, const double* a, double* c);
  /// y = A x, A of m x n; y must not be x.
  void (*multiply)(int m, int n, const double* a, int lda, const double* x, double* y);
  /// y += A x, A of m x 3.
  void (*add_three)(int m, const double* a, int lda, const double* x, double* y);
  /// y = A x of 3 x 3 blocks: n rows of blocks, row j of those from first[j] to before first[j + 1].
  void (*multiply_blocks)(int n, const int* first, const BlockAt* blocks, const double* a, const double* x, double* y);
};

const DenseKernels& dense_kernels();
/// Those of the k-th instruction set that this processor has, the best first; null beyond the last one.
const DenseKernels* dense_kernels(int k);

}  // namespace signorini
