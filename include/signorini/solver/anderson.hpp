#pragma once

#include "signorini/types.hpp"

namespace signorini {

/// Anderson acceleration of type II for a fixed point x = T(x), safeguarded: with g = T(x) - x, it extrapolates over
/// the last `memory` steps to where a linear g would vanish (Walker and Ni 2011),
///     x_next = T(x) - dT gamma,   gamma = argmin |g - dg gamma|,
/// and goes back to plain steps when |g| grows.
class Anderson {
 public:
  /// Allocates for n unknowns; memory 0 switches acceleration off.
  void setup(Index n, int memory);
  /// Forgets the history: T has changed.
  void reset();
  /// Next iterate, from x and image = T(x). next may be neither of them.
  void step(const Vector& x, const Vector& image, Vector& next);

 private:
  Matrix images_;     ///< dT, one column a step, oldest overwritten
  Matrix residuals_;  ///< dg
  Matrix gram_;       ///< dg^T dg
  Matrix factor_;
  Vector gamma_;
  Vector g_, last_image_, last_g_;
  double last_norm_ = 0.0;
  int memory_ = 0;
  int count_ = 0;      ///< columns in use
  int next_ = 0;       ///< column to write
  int pause_ = 0, cool_ = 0;
  bool started_ = false;
  bool extrapolated_ = false;  ///< the last step was not plain
};

}  // namespace signorini
