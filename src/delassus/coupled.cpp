#include "signorini/delassus/coupled.hpp"

#include "dense_kernels.hpp"
#include "explicit_system.hpp"
#include "require.hpp"
#include "signorini/delassus/dense.hpp"

namespace signorini {

double* CoupledDelassus::reset(Index rows) {
  require(rows >= 0, "rows", rows, "at least 0");
  size_ = rows;
  const auto count = static_cast<std::size_t>(rows * rows);
  if (values_.size() < count) values_.resize(count);
  return values_.data();
}

void CoupledDelassus::check(const ConstraintSets&) const {
  if (sum_is_bounded(values_.data(), size_ * size_)) return;
  for (Index c = 0; c < size_; ++c)
    for (Index r = 0; r < size_; ++r) require_finite("delassus", r, c, dense()(r, c));
}

void CoupledDelassus::apply(const ConstVectorRef& x, VectorRef y) const {
  const auto n = static_cast<int>(size_);
  dense_kernels().multiply(n, n, values_.data(), n, x.data(), y.data());
}

void CoupledDelassus::diagonal(VectorRef diagonal) const { diagonal = dense().diagonal(); }

SparseMatrix CoupledDelassus::matrix() const { return Matrix(dense()).sparseView(0.0, 0.0); }

std::vector<int> CoupledDelassus::islands(const ConstraintSets& sets) const {
  return std::vector<int>(static_cast<std::size_t>(sets.num_sets()), 0);
}

void CoupledDelassus::label_islands(const ConstraintSets& sets, std::vector<int>& labels) const {
  labels.assign(static_cast<std::size_t>(sets.num_sets()), 0);
}

std::shared_ptr<const DelassusOperator> CoupledDelassus::restrict(const std::vector<Index>& rows) const {
  return DenseDelassus(dense()).restrict(rows);
}

void CoupledDelassus::prepare(const ConstraintSets& sets, const ConstVectorRef& scale, const ConstVectorRef& compliance,
                              std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->setup(values_.data(), sets, scale, compliance);
}

}  // namespace signorini
