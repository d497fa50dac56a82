#pragma once

#include <cstdint>
#include <vector>

#include "signorini/types.hpp"

namespace signorini {

enum class SetType : std::uint8_t { FrictionCone, HalfLine, Interval, Equality };

/// One closed convex set K that holds the impulse of one constraint. The velocity s (with the De Saxce
/// term, for a friction cone) obeys -s in N_K(impulse), the normal cone (docs/theory.md, T8):
///
/// | type          | rows | K                                     | what s obeys                      |
/// | ------------- | ---- | ------------------------------------- | --------------------------------- |
/// | FrictionCone  | 3    | |x_T| <= friction x_N, rows T1 T2 N    | s in K*, x . s = 0                |
/// | HalfLine      | 1    | x >= 0                                | s >= 0, x s = 0                   |
/// | Interval      | 1    | lower <= x <= upper                   | s >= 0 at lower, <= 0 at upper, else 0 |
/// | Equality      | 1    | all x                                 | s = 0                             |
struct ConstraintSet {
  SetType type = SetType::FrictionCone;
  Index offset = 0;       ///< first row in the problem's vectors
  double friction = 0.0;  ///< FrictionCone only, >= 0
  double lower = 0.0;     ///< Interval only [N s]
  double upper = 0.0;     ///< Interval only [N s]

  Index size() const { return type == SetType::FrictionCone ? 3 : 1; }
};

/// Projection of x (3 values, normal last) on the friction cone (T9); out may be x.
void project_friction_cone(double friction, const double* x, double* out);

/// A product of constraint sets, in the row order in which they were added.
class ConstraintSets {
 public:
  ConstraintSets() = default;
  ConstraintSets(const ConstraintSets&) = default;  // a move copies, so that none is left with rows and no sets
  ConstraintSets& operator=(const ConstraintSets&) = default;
  /// One friction cone per entry of `friction`. Raises InvalidInput naming `friction[i]`.
  static ConstraintSets friction_cones(const ConstVectorRef& friction);

  /// friction: coefficient, finite and >= 0, else InvalidInput.
  void add_friction_cone(double friction);
  void add_half_line();
  /// lower <= upper, neither NaN; infinite bounds are allowed.
  void add_interval(double lower, double upper);
  /// count one-row sets.
  void add_equality(Index count = 1);
  /// The same set again; its offset is replaced. Its numbers are checked by validate().
  void add(ConstraintSet set);
  /// Of an interval; checked by validate().
  void set_bounds(Index i, double lower, double upper);
  /// Replaces the coefficient of a friction cone; checked by validate().
  void set_friction(Index i, double friction);
  /// Raises InvalidInput as the functions above do that add a set. Called by ContactProblem.
  void validate() const;
  /// No sets again; the memory is kept.
  void clear();
  /// Memory for so many sets.
  void reserve(Index count) { sets_.reserve(static_cast<std::size_t>(count)); }

  Index size() const { return size_; }  ///< rows
  Index num_sets() const { return static_cast<Index>(sets_.size()); }
  Index num_contacts() const { return num_contacts_; }
  const ConstraintSet& operator[](Index i) const { return sets_[static_cast<std::size_t>(i)]; }
  std::vector<ConstraintSet>::const_iterator begin() const { return sets_.begin(); }
  std::vector<ConstraintSet>::const_iterator end() const { return sets_.end(); }

  /// out = P_K(x), set by set; out may be x.
  void project(const ConstVectorRef& x, VectorRef out) const;
  /// out = projection of x on the dual cone K* = {s : s.y >= 0 for y in K} of a cone, by Moreau; on all of R for an
  /// interval (any velocity has its impulse), on {0} for an equality. out may be x.
  void project_dual(const ConstVectorRef& x, VectorRef out) const;

 private:
  std::vector<ConstraintSet> sets_;
  Index size_ = 0;
  Index num_contacts_ = 0;
};

/// Projection on one set; x and out point at its rows.
void project(const ConstraintSet& set, const double* x, double* out);

}  // namespace signorini
