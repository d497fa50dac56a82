#include "signorini/solver/anderson.hpp"

#include <cmath>
#include <cstdlib>

namespace signorini {
namespace {
double env(const char* n, double d) { const char* e = std::getenv(n); return e ? std::atof(e) : d; }
}  // namespace

void Anderson::setup(Index n, int memory) {
  memory_ = memory;
  if (memory > 0) {
    images_.resize(n, memory), residuals_.resize(n, memory);
    gram_.resize(memory, memory), factor_.resize(memory, memory);
    gamma_.resize(memory);
    g_.resize(n), last_image_.resize(n), last_g_.resize(n);
  }
  pause_ = cool_ = 0;
  reset();
}

void Anderson::reset() {
  count_ = next_ = 0;
  started_ = extrapolated_ = false;
}

void Anderson::step(const Vector& x, const Vector& image, Vector& next) {
  if (memory_ == 0) {
    next = image;
    return;
  }
  static const double grow = env("AA_GROW", 1.0), regu = env("AA_REG", 1e-10), back = env("AA_BACK", 1);
  g_ = image - x;
  const double norm = g_.norm();
  if (extrapolated_ && !(norm <= grow * last_norm_)) {
    // The extrapolation went astray: take the plain step it replaced.
    if (back) next = last_image_; else next = image;
    if (env("AA_RESET",1)) reset(); else started_ = extrapolated_ = false;
    pause_ = std::min<int>(2 * pause_ + env("AA_P0", 10), env("AA_PMAX", 200));
    cool_ = pause_;
    return;
  }
  if (extrapolated_) pause_ = static_cast<int>(pause_ * env("AA_PDEC", 0.9));
  if (started_) {
    const Index k = next_;
    images_.col(k) = image - last_image_;
    residuals_.col(k) = g_ - last_g_;
    next_ = (next_ + 1) % memory_;
    count_ = std::min(count_ + 1, memory_);
    for (Index j = 0; j < count_; ++j) gram_(j, k) = gram_(k, j) = residuals_.col(j).dot(residuals_.col(k));
  }
  last_image_ = image, last_g_ = g_;
  last_norm_ = norm;
  started_ = true;
  extrapolated_ = false;
  next = image;
  if (count_ == 0 || cool_-- > 0) return;
  cool_ = 0;
  const Index m = count_;
  double trace = gram_.diagonal().head(m).sum();
  // Cholesky, regularised
  auto l = factor_.topLeftCorner(m, m);
  l = gram_.topLeftCorner(m, m);
  l.diagonal().array() += regu * trace;
  for (Index j = 0; j < m; ++j) gamma_[j] = residuals_.col(j).dot(g_);
  for (Index j = 0; j < m; ++j) {
    double d = l(j, j);
    for (Index k = 0; k < j; ++k) d -= l(j, k) * l(j, k);
    if (!(d > 0.0)) { reset(); return; }
    l(j, j) = std::sqrt(d);
    for (Index i = j + 1; i < m; ++i) {
      double v = l(i, j);
      for (Index k = 0; k < j; ++k) v -= l(i, k) * l(j, k);
      l(i, j) = v / l(j, j);
    }
  }
  for (Index j = 0; j < m; ++j) {
    for (Index k = 0; k < j; ++k) gamma_[j] -= l(j, k) * gamma_[k];
    gamma_[j] /= l(j, j);
  }
  for (Index j = m; j-- > 0;) {
    for (Index k = j + 1; k < m; ++k) gamma_[j] -= l(k, j) * gamma_[k];
    gamma_[j] /= l(j, j);
  }
  for (Index j = 0; j < m; ++j) next -= gamma_[j] * images_.col(j);
  extrapolated_ = true;
}

}  // namespace signorini
