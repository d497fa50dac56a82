#include "signorini/solver/anderson.hpp"

#include <algorithm>
#include <cmath>

namespace signorini {
namespace {

// Measured, docs/solvers_admm_pgs.md.
constexpr double kRegularization = 1e-10;  // of the trace of dg^T dg: dg is rank deficient near the solution
constexpr double kFirstPause = 10.0, kLongestPause = 200.0;
constexpr double kPauseDecay = 0.9;

}  // namespace

void Anderson::setup(Index n, int memory) {
  memory_ = memory;
  if (memory > 0) {
    images_.resize(n, memory), residuals_.resize(n, memory);
    gram_.resize(memory, memory), factor_.resize(memory, memory);
    gamma_.resize(memory);
    g_.resize(n), last_g_.resize(n), last_image_.resize(n);
  }
  restart(n);
}

void Anderson::restart(Index n) {
  n_ = n;
  pause_ = 0.0;
  plain_steps_left_ = 0;
  reset();
}

void Anderson::reset() {
  columns_ = oldest_ = 0;
  has_last_ = extrapolated_ = false;
}

void Anderson::step(const ConstVectorRef& x, const ConstVectorRef& image, VectorRef next) {
  if (memory_ == 0) {
    next = image;
    return;
  }
  auto g = g_.head(n_);
  g = image - x;
  const double norm = g.norm();
  if (extrapolated_ && !(norm <= last_norm_)) {
    next = last_image_.head(n_);  // the plain step instead
    reset();
    pause_ = std::min(2.0 * pause_ + kFirstPause, kLongestPause);
    plain_steps_left_ = static_cast<int>(pause_);
    return;
  }
  if (extrapolated_) pause_ *= kPauseDecay;

  if (has_last_) remember(image);
  last_image_.head(n_) = image, last_g_.head(n_) = g, last_norm_ = norm;
  has_last_ = true;

  next = image;
  extrapolated_ = false;
  if (plain_steps_left_ > 0) {
    --plain_steps_left_;
  } else if (columns_ > 0 && solve_least_squares()) {
    for (Index j = 0; j < columns_; ++j) next -= gamma_[j] * images_.col(j).head(n_);
    extrapolated_ = true;
  }
}

void Anderson::remember(const ConstVectorRef& image) {
  const Index k = oldest_;
  images_.col(k).head(n_) = image - last_image_.head(n_);
  residuals_.col(k).head(n_) = g_.head(n_) - last_g_.head(n_);
  oldest_ = (oldest_ + 1) % memory_;
  columns_ = std::min(columns_ + 1, memory_);
  for (Index j = 0; j < columns_; ++j)
    gram_(j, k) = gram_(k, j) = residuals_.col(j).head(n_).dot(residuals_.col(k).head(n_));
}

bool Anderson::solve_least_squares() {
  // Normal equations: at most a few dozen unknowns, written out since Eigen's solvers allocate.
  const Index m = columns_;
  const double shift = kRegularization * gram_.diagonal().head(m).sum();
  for (Index j = 0; j < m; ++j) {
    for (Index i = j; i < m; ++i) {
      double v = gram_(i, j) + (i == j ? shift : 0.0);
      for (Index k = 0; k < j; ++k) v -= factor_(i, k) * factor_(j, k);
      if (i == j && !(v > 0.0)) return false;
      factor_(i, j) = i == j ? std::sqrt(v) : v / factor_(j, j);
    }
  }
  for (Index j = 0; j < m; ++j) {
    double v = residuals_.col(j).head(n_).dot(g_.head(n_));
    for (Index k = 0; k < j; ++k) v -= factor_(j, k) * gamma_[k];
    gamma_[j] = v / factor_(j, j);
  }
  for (Index j = m; j-- > 0;) {
    for (Index k = j + 1; k < m; ++k) gamma_[j] -= factor_(k, j) * gamma_[k];
    gamma_[j] /= factor_(j, j);
  }
  return gamma_.head(m).allFinite();
}

}  // namespace signorini
