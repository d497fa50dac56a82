#pragma once

#include "signorini/solver/settings.hpp"

namespace signorini {

/// ADMM's penalty rho along one solve, moved by one of the rules of Carpentier et al. 2024, section III-F, or by
/// residual balancing. Whoever uses it refactorises when it moves.
class Penalty {
 public:
  /// m, L: (bounds of) the extreme eigenvalues of G + R + eta I. penalty > 0: where to start, else the rule's choice.
  void start(const AdmmSettings& settings, double m, double L, double penalty);

  double value() const { return rho_; }

  /// primal, dual: (40), (41) in the maximum norm; primal_scale, dual_scale: the size of what they are differences of
  /// (residual balancing only). True when rho moved.
  bool update(double primal, double dual, double primal_scale, double dual_scale);

 private:
  bool move_to(double rho);

  AdmmSettings settings_;
  double rho_ = 1.0;
  double base_ = 1.0;       ///< sqrt(m L), spectral
  double condition_ = 1.0;  ///< L / m, spectral
  double exponent_ = 0.0;   ///< p, spectral
  double smallest_ = 0.0, largest_ = 0.0;
  double threshold_ = 1.0;  ///< ratio up to which residual balancing leaves rho alone
  int wait_ = 0;            ///< iterations until residual balancing looks again
  int interval_ = 0;        ///< after the next change
};

}  // namespace signorini
