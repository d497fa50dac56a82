#include "signorini/delassus/dense.hpp"

#include <cmath>
#include <sstream>
#include <string>

#include "explicit_system.hpp"
#include "islands.hpp"
#include "signorini/errors.hpp"

namespace signorini {

DenseDelassus::DenseDelassus(const Eigen::Ref<const Matrix>& matrix) {
  if (matrix.rows() != matrix.cols()) {
    throw InvalidInput(
        "delassus", "is " + std::to_string(matrix.rows()) + " x " + std::to_string(matrix.cols()) + ", must be square");
  }
  for (Index c = 0; c < matrix.cols(); ++c)
    for (Index r = 0; r < matrix.rows(); ++r) {
      if (std::abs(matrix(r, c)) <= 1e100) continue;  // false for NaN
      std::ostringstream message;
      message << "is " << matrix(r, c) << ", must be within +-1e100";
      throw InvalidInput("delassus[" + std::to_string(r) + ", " + std::to_string(c) + "]", message.str());
    }
  const double largest = matrix.size() ? matrix.cwiseAbs().maxCoeff() : 0.0;
  asymmetry_ = largest > 0.0 ? (matrix - matrix.transpose()).cwiseAbs().maxCoeff() / largest : 0.0;
  matrix_ = 0.5 * (matrix + matrix.transpose());
}

void DenseDelassus::apply(const ConstVectorRef& x, VectorRef y) const { y.noalias() = matrix_ * x; }

void DenseDelassus::diagonal(VectorRef diagonal) const { diagonal = matrix_.diagonal(); }

SparseMatrix DenseDelassus::matrix() const { return matrix_.sparseView(0.0, 0.0); }

std::vector<int> DenseDelassus::islands(const ConstraintSets& sets) const { return islands_of(matrix(), sets); }

std::shared_ptr<const DelassusOperator> DenseDelassus::restrict(const std::vector<Index>& rows) const {
  const auto count = static_cast<Index>(rows.size());
  Matrix part(count, count);
  for (Index c = 0; c < count; ++c)
    for (Index r = 0; r < count; ++r) part(r, c) = matrix_(rows[r], rows[c]);
  return std::make_shared<DenseDelassus>(part);
}

void DenseDelassus::prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
                            std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->setup(matrix(), sets, scale, compliance);
}

}  // namespace signorini
