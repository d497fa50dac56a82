#include "signorini/solver/penalty_rule.hpp"

#include <algorithm>
#include <cmath>

namespace signorini {
namespace {

// In units of L. Beyond these the damped matrix is numerically the matrix alone, or the identity alone.
constexpr double kSmallest = 1e-12, kLargest = 1e12;

// Residual balancing, constants measured (docs/solvers_admm_pgs.md): a change costs a factorisation and the
// accelerator's memory, so it looks seldom, more seldom after each change, and ignores small ratios, unless the solve
// drags on.
constexpr double kBalancedStart = 0.02;  // of L
constexpr int kFirstInterval = 20;
constexpr double kThreshold = 5.0, kLeastThreshold = 1.5;
constexpr double kThresholdDecay = 0.9;  // a look
constexpr double kLargestFactor = 1e3;

}  // namespace

void Penalty::start(const AdmmSettings& settings, double m, double L, double penalty) {
  settings_ = settings;
  base_ = std::sqrt(m * L);
  condition_ = std::max(L / m, 1.0 + 1e-6);
  exponent_ = settings.spectral_exponent;
  interval_ = wait_ = kFirstInterval;
  threshold_ = kThreshold;
  if (penalty > 0.0) {
    rho_ = penalty;
    exponent_ = std::log(penalty / base_) / std::log(condition_);
  } else if (settings.penalty_rule == PenaltyRule::ResidualBalancing) {
    rho_ = kBalancedStart * L;
  } else {
    rho_ = base_ * std::pow(condition_, exponent_);  // (45)
  }
  smallest_ = kSmallest * L, largest_ = kLargest * L;
  rho_ = std::clamp(rho_, smallest_, largest_);
}

bool Penalty::move_to(double rho) {
  rho = std::clamp(rho, smallest_, largest_);
  if (rho == rho_) return false;
  rho_ = rho;
  return true;
}

bool Penalty::update(double primal, double dual, double primal_scale, double dual_scale) {
  const bool increase = primal >= settings_.ratio * dual, decrease = dual >= settings_.ratio * primal;
  switch (settings_.penalty_rule) {
    case PenaltyRule::Spectral:  // (46)
      if (increase == decrease) return false;
      exponent_ += increase ? settings_.spectral_increment : -settings_.spectral_increment;
      return move_to(base_ * std::pow(condition_, exponent_));
    case PenaltyRule::Linear:  // (44)
      if (increase == decrease) return false;
      return move_to(increase ? rho_ * settings_.linear_factor : rho_ / settings_.linear_factor);
    case PenaltyRule::ResidualBalancing: {
      if (--wait_ > 0) return false;
      const double factor = std::sqrt((primal / primal_scale) / (dual / dual_scale));
      if (!std::isfinite(factor) || (factor < threshold_ && factor > 1.0 / threshold_)) {
        wait_ = kFirstInterval;
        threshold_ = std::max(kLeastThreshold, kThresholdDecay * threshold_);
        return false;
      }
      threshold_ = kThreshold;
      interval_ *= 2;
      wait_ = interval_;
      return move_to(rho_ * std::clamp(factor, 1.0 / kLargestFactor, kLargestFactor));
    }
    case PenaltyRule::Constant:
      break;
  }
  return false;
}

}  // namespace signorini
