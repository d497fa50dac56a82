#include "signorini/delassus/sparse.hpp"

#include <string>

#include "explicit_system.hpp"
#include "islands.hpp"
#include "require.hpp"

namespace signorini {

SparseDelassus::SparseDelassus(const SparseMatrix& matrix) {
  if (matrix.rows() != matrix.cols()) {
    throw InvalidInput(
        "delassus", "is " + std::to_string(matrix.rows()) + " x " + std::to_string(matrix.cols()) + ", must be square");
  }
  require_finite("delassus", matrix);
  asymmetry_ = asymmetry_of(matrix);
  const SparseMatrix transpose = matrix.transpose();
  matrix_ = asymmetry_ == 0.0 ? matrix : SparseMatrix(0.5 * (matrix + transpose));
  matrix_.prune([](Index, Index, double value) { return value != 0.0; });
  matrix_.makeCompressed();
}

void SparseDelassus::apply(const ConstVectorRef& x, VectorRef y) const { y.noalias() = matrix_ * x; }

void SparseDelassus::diagonal(VectorRef diagonal) const { diagonal = matrix_.diagonal(); }

std::vector<int> SparseDelassus::islands(const ConstraintSets& sets) const { return islands_of(matrix_, sets); }

std::shared_ptr<const DelassusOperator> SparseDelassus::restrict(const std::vector<Index>& rows) const {
  auto part = std::make_shared<SparseDelassus>(SparseMatrix());
  part->matrix_ = select(matrix_, rows, rows);
  return part;
}

void SparseDelassus::prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
                             std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->setup(matrix_, sets, scale, compliance);
}

}  // namespace signorini
