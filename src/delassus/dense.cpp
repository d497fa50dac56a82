#include "signorini/delassus/dense.hpp"

#include <string>

#include "dense_kernels.hpp"
#include "explicit_system.hpp"
#include "islands.hpp"
#include "require.hpp"

namespace signorini {

namespace {

/// Whether the block of two sets, i after j, is there: by the one above the diagonal, which lies in i's columns.
bool acts(const Matrix& matrix, const ConstraintSet& i, const ConstraintSet& j) {
  if (i.size() == 3 && j.size() == 3) {
    const double *a = &matrix(j.offset, i.offset), *b = a + matrix.rows(), *c = b + matrix.rows();
    return bool((a[0] != 0.0) | (a[1] != 0.0) | (a[2] != 0.0) | (b[0] != 0.0) | (b[1] != 0.0) | (b[2] != 0.0) |
                (c[0] != 0.0) | (c[1] != 0.0) | (c[2] != 0.0));
  }
  for (Index c = 0; c < i.size(); ++c) {
    const double* column = &matrix(j.offset, i.offset + c);
    for (Index r = 0; r < j.size(); ++r)
      if (column[r] != 0.0) return true;
  }
  return false;
}

}  // namespace

DenseDelassus::DenseDelassus(const Eigen::Ref<const Matrix>& matrix) {
  if (matrix.rows() != matrix.cols()) {
    throw InvalidInput(
        "delassus", "is " + std::to_string(matrix.rows()) + " x " + std::to_string(matrix.cols()) + ", must be square");
  }
  for (Index c = 0; c < matrix.cols(); ++c)
    for (Index r = 0; r < matrix.rows(); ++r) require_finite("delassus", r, c, matrix(r, c));
  const double largest = matrix.size() ? matrix.cwiseAbs().maxCoeff() : 0.0;
  asymmetry_ = largest > 0.0 ? (matrix - matrix.transpose()).cwiseAbs().maxCoeff() / largest : 0.0;
  matrix_ = 0.5 * (matrix + matrix.transpose());
}

void DenseDelassus::apply(const ConstVectorRef& x, VectorRef y) const {
  const auto n = static_cast<int>(size());
  dense_kernels().multiply(n, n, matrix_.data(), n, x.data(), y.data());
}

void DenseDelassus::diagonal(VectorRef diagonal) const { diagonal = matrix_.diagonal(); }

SparseMatrix DenseDelassus::matrix() const {
  const Index n = size();
  SparseMatrix out(n, n);
  out.resizeNonZeros((matrix_.array() != 0.0).count());
  Index at = 0;
  for (Index c = 0; c < n; ++c) {
    for (Index r = 0; r < n; ++r) {
      if (matrix_(r, c) == 0.0) continue;
      out.valuePtr()[at] = matrix_(r, c);
      out.innerIndexPtr()[at++] = static_cast<int>(r);
    }
    out.outerIndexPtr()[c + 1] = static_cast<int>(at);
  }
  return out;
}

std::vector<int> DenseDelassus::islands(const ConstraintSets& sets) const {
  std::vector<int> labels;
  label_islands(sets, labels);
  return labels;
}

void DenseDelassus::label_islands(const ConstraintSets& sets, std::vector<int>& labels) const {
  const auto count = static_cast<int>(sets.num_sets());
  IslandForest forest(count, labels);
  for (int i = 1; i < count; ++i)
    for (int j = i - 1; j >= 0 && forest.trees() > count - i; --j)  // until all up to i are one
      if (!forest.joined(i, j) && acts(matrix_, sets[i], sets[j])) forest.join(i, j);
  forest.finish();
}

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
  const auto count = static_cast<int>(sets.num_sets());
  known->blocks.clear();
  for (int i = 1; i < count; ++i)
    for (int j = 0; j < i; ++j)
      if (acts(matrix_, sets[i], sets[j])) known->blocks.push_back({i, j, &matrix_(sets[i].offset, sets[j].offset)});
  if (ExplicitSystem::is_dense(size(), count, known->blocks.size()))
    return known->setup(matrix_.data(), sets, scale, compliance);
  known->diagonal.clear();
  for (const ConstraintSet& set : sets) known->diagonal.push_back(&matrix_(set.offset, set.offset));
  known->stride = static_cast<int>(size());
  known->setup(sets, scale, compliance);
}

void DenseDelassus::prepare_part(const ConstraintSets& sets, const std::vector<int>& part,
                                 const ConstraintSets& part_sets, const ConstVectorRef& scale,
                                 const ConstVectorRef& compliance, std::unique_ptr<ScaledDelassus>& system) const {
  auto* known = dynamic_cast<ExplicitSystem*>(system.get());
  if (!known) system.reset(known = new ExplicitSystem);
  known->blocks.clear();
  known->diagonal.clear();
  const auto count = static_cast<int>(part.size());
  for (int i = 0; i < count; ++i) {
    const ConstraintSet& own = sets[part[i]];
    known->diagonal.push_back(&matrix_(own.offset, own.offset));
    for (int j = 0; j < i; ++j) {
      const ConstraintSet& other = sets[part[j]];
      if (acts(matrix_, own, other)) known->blocks.push_back({i, j, &matrix_(own.offset, other.offset)});
    }
  }
  known->stride = static_cast<int>(size());
  known->setup(part_sets, scale, compliance);
}

}  // namespace signorini
