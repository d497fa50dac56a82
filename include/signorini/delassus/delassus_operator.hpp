#pragma once

#include <memory>
#include <vector>

#include "signorini/delassus/scaled_delassus.hpp"
#include "signorini/problem/constraint_set.hpp"
#include "signorini/types.hpp"

namespace signorini {

/// G = J M^-1 J^T, symmetric positive semidefinite. The solvers see it only through this interface; a matrix that was
/// given unsymmetric stands for its symmetric part.
class DelassusOperator {
 public:
  virtual ~DelassusOperator() = default;
  virtual Index size() const = 0;
  /// Raises InvalidInput when the operator cannot stand for the G of these sets. Called by ContactProblem.
  virtual void check(const ConstraintSets&) const {}
  /// y = G x; y must not be x.
  virtual void apply(const ConstVectorRef& x, VectorRef y) const = 0;
  virtual void diagonal(VectorRef diagonal) const = 0;
  /// G as an explicit sparse matrix, both triangles (Gauss-Seidel, validation, export).
  virtual SparseMatrix matrix() const = 0;
  /// max |G - G^T| / max |G| of what was given.
  virtual double asymmetry() const { return 0.0; }
  /// True when G is positive semidefinite whatever its entries.
  virtual bool definite_by_construction() const { return false; }
  /// A label 0, 1, ... for each set: sets with different labels do not act on each other, directly or through others.
  virtual std::vector<int> islands(const ConstraintSets& sets) const = 0;
  /// The same without allocating for sizes already seen, where an operator can.
  virtual void label_islands(const ConstraintSets& sets, std::vector<int>& labels) const { labels = islands(sets); }
  /// The operator of some of the rows, in the given order: whole islands.
  virtual std::shared_ptr<const DelassusOperator> restrict(const std::vector<Index>& rows) const = 0;
  /// Makes `system` stand for S (G + R) S, with S = diag(scale), R = diag(compliance). Reuses the object and its
  /// symbolic analysis when it already stands for an operator of this kind with the same pattern.
  virtual void prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
                       std::unique_ptr<ScaledDelassus>& system) const = 0;
  /// The same for a part of the sets, given by their numbers, ascending. part_sets, scale and compliance are of the
  /// part alone.
  virtual void prepare_part(const ConstraintSets& sets, const std::vector<int>& part, const ConstraintSets& part_sets,
                            const ConstVectorRef& scale, const ConstVectorRef& compliance,
                            std::unique_ptr<ScaledDelassus>& system) const;
};

}  // namespace signorini
