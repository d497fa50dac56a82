#pragma once

#include <vector>

#include "signorini/types.hpp"

namespace signorini {

/// A square block diagonal, one block a constraint set: 3 x 3 for a friction cone; for a one-row set, entry (0, 0).
using BlockDiagonal = std::vector<Eigen::Matrix3d, Eigen::aligned_allocator<Eigen::Matrix3d>>;

/// A = S (G + R) S in a solver's own scale, and the one kind of linear system that all solvers share:
///     (X + Y A) x = r,   X and Y block diagonal (docs/theory.md, T16).
/// ADMM has X = (eta + rho) I, Y = I; the interior point X = its scaling, Y = I; Newton X and Y from the projection's
/// derivative. After construction, apply, factor and solve allocate nothing.
class ScaledDelassus {
 public:
  virtual ~ScaledDelassus() = default;
  virtual Index size() const = 0;
  /// y = A x; y must not be x.
  virtual void apply(const ConstVectorRef& x, VectorRef y) const = 0;
  /// Factors X + Y A. False when the matrix is singular or not finite.
  virtual bool factor(const BlockDiagonal& x, const BlockDiagonal& y) = 0;
  /// Factors X + A.
  virtual bool factor(const BlockDiagonal& x) = 0;
  /// Sign of det(X + Y A) of the last factorisation: -1, 0 or 1.
  virtual int determinant_sign() const = 0;
  /// Solves with the last factorisation, in place.
  virtual void solve(VectorRef rhs) const = 0;
};

}  // namespace signorini
