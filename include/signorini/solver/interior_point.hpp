#pragma once

#include <vector>

#include "signorini/solver/cone_block.hpp"
#include "signorini/solver/scaled_problem.hpp"
#include "signorini/solver/solution.hpp"

namespace signorini {

/// Primal-dual interior point for the NCP and the CCP: Nesterov-Todd scaling, Mehrotra's corrector, and the derivative
/// of the De Saxce term inside the Newton step (docs/theory.md, section 8). One step at a time, so that others can
/// finish what it started.
class InteriorPoint {
 public:
  /// Starts at the centre of the cones, or next to l_guess (scaled impulse) when given.
  void start(ScaledProblem& problem, Law law, const GrowVector* l_guess = nullptr);

  /// One step; false when it cannot go on (not finite).
  bool step();

  double relative() const { return relative_; }     ///< certificate of impulse()
  const GrowVector& impulse() const { return l_; }  ///< scaled, inside the cones
  int factorizations() const { return factorizations_; }
  int iterations() const { return iterations_; }
  /// True after a step whose matrix had a negative determinant: the De Saxce derivative is held back.
  bool held_back() const { return theta_ < options.theta; }
  /// Whether x and z tell the same of every contact as l and t do: open, sticks or slips.
  bool settled() const;
  double last_step() const { return step_; }

  /// What restarts vary: every fixed choice stalls on some problems, and different choices on different ones.
  struct Options {
    double start_scale = 30.0;     ///< size of the starting impulse
    double least_centring = 0.03;  ///< of the first iterations
    double theta = 1.0;            ///< share of the De Saxce derivative kept in the matrix
    /// On a branch of the NCP that turns away: 0, holds that share back; else a proximal term, of this weight at first,
    /// holds back the contacts that slip.
    double weight = 0.0;
  };
  Options options;

 private:
  /// A cone (Jordan coordinates: (mu l_N, l_T1, l_T2)) or, with line set, one bound of a one-row set. Its numbers are
  /// in cones_.
  struct Element {
    int set = 0, row = 0;
    bool line = false;
    double friction = 0.0;           // cone
    double sign = 1.0, bound = 0.0;  // line: x = sign (l - bound)
  };

  const ConeBlock& block_of(std::size_t i) const { return cones_[i / ConeBlock::kWidth]; }
  ConeBlock& block_of(std::size_t i) { return cones_[i / ConeBlock::kWidth]; }
  void arrange_cones();
  void evaluate();                            // t_, residual_, relative_ and the complementarity
  bool factor();                              // X + A (T23)
  bool turns_away();                          // whether that has a negative determinant
  void direction();                           // dx, dz of every element from its centre
  double complementarity(double step) const;  // sum of x . z after the step

  ScaledProblem* problem_ = nullptr;
  Law law_ = Law::Ncp;
  std::vector<Element> elements_;
  std::vector<ConeBlock> cones_;
  std::vector<std::uint8_t> fixed_;  // rows whose impulse is fixed: tangents of frictionless contacts, points
  bool any_fixed_ = false;
  GrowVector l_, t_, natural_, residual_, rhs_;
  BlockDiagonal x_, y_;
  double relative_ = 0.0, mu_ = 0.0, step_ = 1.0, theta_ = 1.0, weight_ = 0.0;
  int iterations_ = 0, factorizations_ = 0, negatives_ = 0, hold_ = 0, hold_length_ = 8;
};

struct InteriorPointWorkspace {
  ScaledProblem problem;
  InteriorPoint method;
  GrowVector best, scratch;
};

void solve_interior_point(const ContactProblem& problem, const Settings& settings, InteriorPointWorkspace& workspace,
                          const Guess* guess, Solution& solution);

}  // namespace signorini
