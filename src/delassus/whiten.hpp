#pragma once

#include "signorini/types.hpp"

namespace signorini {

/// Replaces J^T by X = L^-1 J^T, where M = L L^T, so that J M^-1 J^T = X^T X; false where M is not positive definite.
/// In twice the working precision: X is exact but for rounding as long as the condition number of M is below 1e16,
/// while M^-1 J^T in working precision is off by the condition number times 1e-16 (docs/theory.md, section 10).
bool whiten(const Matrix& mass, Matrix& jacobian_transpose);

}  // namespace signorini
