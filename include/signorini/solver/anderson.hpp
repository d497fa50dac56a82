#pragma once

#include "signorini/types.hpp"

namespace signorini {

/// Anderson acceleration, type II (Walker and Ni 2011), of a fixed point x = T(x). With g = T(x) - x it extrapolates
/// over the last `memory` steps to where a linear g would be smallest,
///     x_next = T(x) - dT gamma,   gamma = argmin |g - dg gamma|,
/// and is safeguarded: an extrapolation that makes |g| grow is undone, and plain steps follow, more of them after each
/// failure and fewer after each success. So it cannot keep a map from converging that converges by itself.
class Anderson {
 public:
  /// Allocates for n unknowns. memory = 0 switches acceleration off.
  void setup(Index n, int memory);
  /// Forgets all steps: T has changed.
  void reset();
  /// The same for a map of n unknowns, at most those of setup(), about which nothing is known. Allocates nothing.
  void restart(Index n);
  /// The next iterate, from x and image = T(x); next is neither of them. Allocates nothing.
  void step(const ConstVectorRef& x, const ConstVectorRef& image, VectorRef next);

 private:
  void remember(const ConstVectorRef& image);
  bool solve_least_squares();

  Index n_ = 0;
  Matrix images_;     ///< dT, a column a step, the oldest overwritten
  Matrix residuals_;  ///< dg
  Matrix gram_;       ///< dg^T dg
  Matrix factor_;     ///< its Cholesky factor
  Vector gamma_;
  Vector g_, last_g_, last_image_;
  double last_norm_ = 0.0;
  int memory_ = 0;
  int columns_ = 0;  ///< in use
  int oldest_ = 0;   ///< the column to overwrite next
  bool has_last_ = false;
  bool extrapolated_ = false;  ///< x came from an extrapolation
  double pause_ = 0.0;         ///< plain steps after a failure
  int plain_steps_left_ = 0;
};

}  // namespace signorini
