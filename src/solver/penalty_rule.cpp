#include "signorini/solver/penalty_rule.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace signorini {
namespace {
double env(const char* n, double d) { const char* e = std::getenv(n); return e ? std::atof(e) : d; }

// Beyond these the damped matrix is numerically the matrix alone, or the identity alone.
constexpr double kSmallest = 1e-12, kLargest = 1e12;

// Residual balancing (constants measured, docs/solvers_admm_pgs.md): a change costs a factorisation and the
// accelerator's memory, so it looks seldom, and ever more seldom, and ignores small ratios.
const double kBalancedPenalty = env("RHO0",0.02);  // start, in units of L
const int kFirstInterval = env("INT",20);
const double kThreshold = env("THR",5);

}  // namespace

void Penalty::start(const AdmmSettings& settings, double m, double L, double penalty) {
  settings_ = settings;
  base_ = std::sqrt(m * L);
  condition_ = std::max(L / m, 1.0 + 1e-6);
  exponent_ = settings.spectral_exponent;
  interval_ = wait_ = kFirstInterval;
  if (penalty > 0.0) {
    rho_ = penalty;
    exponent_ = std::log(penalty / base_) / std::log(condition_);
  } else if (settings.penalty_rule == PenaltyRule::ResidualBalancing) {
    rho_ = kBalancedPenalty * (env("USEL",0) ? L : 1.0);
  } else {
    rho_ = base_ * std::pow(condition_, exponent_);  // (45)
  }
  rho_ = std::clamp(rho_, kSmallest, kLargest);
}

bool Penalty::move_to(double rho) {
  rho = std::clamp(rho, kSmallest, kLargest);
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
      if (!(factor > kThreshold || factor < 1.0 / kThreshold) || !std::isfinite(factor)) {
        wait_ = kFirstInterval;
        return false;
      }
      interval_ *= env("IMUL",2);
      wait_ = interval_;
      return move_to(rho_ * std::clamp(factor, 1e-3, 1e3));
    }
    case PenaltyRule::Constant:
      break;
  }
  return false;
}

}  // namespace signorini
