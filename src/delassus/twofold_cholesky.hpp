#pragma once

#include <vector>

#include "signorini/types.hpp"

namespace signorini {

/// high + low, |low| at most half a unit in the last place of high (Dekker 1971).
struct Twofold {
  double high = 0.0, low = 0.0;
};

/// M = L L^T in twice the working precision: M^-1 r is exact but for rounding as long as the condition number of M is
/// below 1e16; in working precision it is off by that number times 1e-16.
class TwofoldCholesky {
 public:
  /// False where M is not positive definite.
  bool factor(const Matrix& mass);
  /// rhs <- M^-1 rhs
  void solve(Vector& rhs);

 private:
  Index size_ = 0;
  std::vector<Twofold> l_;  // by rows
  std::vector<Twofold> x_;
};

}  // namespace signorini
