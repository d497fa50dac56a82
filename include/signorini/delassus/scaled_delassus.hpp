#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "signorini/problem/constraint_set.hpp"
#include "signorini/types.hpp"

namespace signorini {

/// A square block diagonal, one block a constraint set: 3 x 3 for a friction cone; for a one-row set, entry (0, 0).
using BlockDiagonal = std::vector<Eigen::Matrix3d, Eigen::aligned_allocator<Eigen::Matrix3d>>;

/// What a reduced system keeps of one set (docs/theory.md, T35): its unknowns and as many equations.
struct ReducedSet {
  enum class Kind : std::uint8_t {
    Fixed,   ///< nothing: the impulse is known
    Line,    ///< the one row of a one-row set
    Normal,  ///< of a friction cone, the normal alone
    Slip,    ///< the tangent across the slip, and the normal, with which the tangent along the slip goes
    Stick    ///< all three rows
  };
  Kind kind = Kind::Fixed;
  double u0 = 1.0, u1 = 0.0;  ///< Slip: direction of the tangential impulse, a unit vector
  double friction = 0.0;      ///< Slip
  double weight = 0.0;        ///< Slip: added to the diagonal across the slip
};

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
  /// Factors X + A. rough: a few digits may be lost where that is faster.
  virtual bool factor(const BlockDiagonal& x, bool rough = false) = 0;
  /// Sign of det(X + Y A) of the last factorisation: -1, 0 or 1.
  virtual int determinant_sign() const = 0;
  /// Solves with the last factorisation, in place.
  virtual void solve(VectorRef rhs) const = 0;

  /// True when the next two are there.
  virtual bool reduces() const { return false; }
  /// Factors the reduced matrix E^T A F + delta I + weights (T35). False when it is singular or not finite.
  virtual bool factor_reduced(const std::vector<ReducedSet>& /*sets*/, double /*delta*/) { return false; }
  /// Solves with it in place: rhs and solution start at each set's first row, the rest of its rows is left alone.
  virtual void solve_reduced(VectorRef /*rhs*/) const {}

  /// Whether A is at hand, and with it the next two. In mass space the first call of one of them after setup() makes A:
  /// it allocates, and costs about as much as a factorisation.
  virtual bool cheap_columns() const { return false; }
  /// The block of A on the rows of a set; of a one-row set, entry (0, 0).
  virtual Eigen::Matrix3d diagonal_block(Index /*set*/) const { return Eigen::Matrix3d::Zero(); }
  /// y += A(:, rows of a set) x.
  virtual void add_columns(Index /*set*/, const double* /*x*/, double* /*y*/) const {}

  /// A(rows of `set`, columns of another one), column-major.
  struct ColumnBlock {
    int set;
    const double* values;
  };
  /// Of A, where many of its blocks are zero, those that are not: of the columns of set i from first[i] to first[i +
  /// 1]. False, and nothing done, where few are. In mass space the same as of add_columns() holds.
  virtual bool list_columns(std::vector<int>& /*first*/, std::vector<ColumnBlock>& /*blocks*/) const { return false; }
  /// Makes `system` the A of some of the sets alone, given by their numbers, ascending, from such lists.
  static void extract(const std::vector<int>& first, const std::vector<ColumnBlock>& blocks,
                      const std::vector<int>& part, const ConstraintSets& part_sets,
                      std::unique_ptr<ScaledDelassus>& system);
};

}  // namespace signorini
