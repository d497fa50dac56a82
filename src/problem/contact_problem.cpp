#include "signorini/problem/contact_problem.hpp"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>

#include "require.hpp"
#include "signorini/delassus/dense.hpp"
#include "signorini/errors.hpp"

namespace signorini {
namespace {

// Squares and products of what is allowed must stay finite.
constexpr double kLargest = 1e100;
constexpr double kSmallestDiagonal = 1e-100;

void check_entries(const GrowVector& v, const char* field, double lowest) {
  for (Index i = 0; i < v.size(); ++i) {
    if (v[i] >= lowest && v[i] <= kLargest) continue;  // false for NaN
    throw InvalidInput(std::string(field) + "[" + std::to_string(i) + "]",
                       "is " + in_full(v[i]) + ", must be in [" + in_full(lowest) + ", " + in_full(kLargest) + "]");
  }
}

/// What a problem has before it is assigned.
const std::shared_ptr<const DelassusOperator>& no_rows() {
  static const std::shared_ptr<const DelassusOperator> shared = std::make_shared<DenseDelassus>(Matrix(0, 0));
  return shared;
}

}  // namespace

ContactProblem::ContactProblem() : delassus_(no_rows()) {}

ContactProblem::ContactProblem(std::shared_ptr<const DelassusOperator> delassus, const ConstVectorRef& free_velocity,
                               const ConstraintSets& sets, const ConstVectorRef& compliance) {
  assign(std::move(delassus), free_velocity, sets, compliance);
}

void ContactProblem::assign(std::shared_ptr<const DelassusOperator> delassus, const ConstVectorRef& free_velocity,
                            const ConstraintSets& sets, const ConstVectorRef& compliance, double reference) {
  try {
    require(reference >= 0.0 && reference <= kLargest, "reference", reference, "in [0, 1e100]");
    reference_ = reference;
    take(std::move(delassus), free_velocity, sets, compliance);
  } catch (...) {
    delassus_ = no_rows();
    sets_.clear();
    for (GrowVector* v : {&free_velocity_, &compliance_, &scale_}) v->resize(0);
    throw;
  }
}

void ContactProblem::take(std::shared_ptr<const DelassusOperator> delassus, const ConstVectorRef& free_velocity,
                          const ConstraintSets& sets, const ConstVectorRef& compliance) {
  if (!delassus) throw InvalidInput("delassus", "is null");
  const Index n = delassus->size();
  const auto check_size = [n](const char* field, Index size) {
    if (size == n) return;
    throw InvalidInput(field, "has " + std::to_string(size) + " rows, must have the " + std::to_string(n) +
                                  " of the Delassus operator");
  };
  check_size("free_velocity", free_velocity.size());
  check_size("sets", sets.size());
  if (compliance.size() > 0) check_size("compliance", compliance.size());
  sets.validate();
  delassus->check(sets);
  delassus_ = std::move(delassus);
  free_velocity_ = free_velocity;
  sets_ = sets;
  if (compliance.size() > 0)
    compliance_ = compliance;
  else
    compliance_.setZero(n);
  check_entries(free_velocity_, "free_velocity", -kLargest);
  check_entries(compliance_, "compliance", 0.0);

  scale_.resize(n);
  delassus_->diagonal(scale_);
  check_entries(scale_, "delassus diagonal", 0.0);
  for (const ConstraintSet& set : sets_) {
    const Index o = set.offset;
    double d = scale_[o] + compliance_[o];
    if (set.size() == 3) d = (d + scale_[o + 1] + compliance_[o + 1] + scale_[o + 2] + compliance_[o + 2]) / 3.0;
    if (d > 0.0 && d < kSmallestDiagonal) {
      throw InvalidInput("delassus diagonal[" + std::to_string(o) + "]",
                         "is " + in_full(d) + ", must be 0 or at least " + in_full(kSmallestDiagonal));
    }
    for (Index k = 0; k < set.size(); ++k) scale_[o + k] = d > 0.0 ? d : 1.0;
  }
}

void ContactProblem::velocity(const ConstVectorRef& impulse, VectorRef velocity) const {
  require_size("impulse", impulse.size(), size());
  require_size("velocity", velocity.size(), size());
  delassus_->apply(impulse, velocity);
  velocity += compliance_.cwiseProduct(impulse) + free_velocity_;
}

void ContactProblem::check_definite() const {
  if (size() == 0 || delassus_->definite_by_construction()) return;
  // With unit diagonal, and a shift for rounding (to single precision, in some files) and for what an unsymmetric part
  // can hide; real files have an asymmetry of up to 0.0025.
  const Vector s = scale_.cwiseSqrt().cwiseInverse();
  SparseMatrix a = s.asDiagonal() * delassus_->matrix() * s.asDiagonal();
  const double shift = 1e-5 + std::min(10.0 * delassus_->asymmetry(), 0.1);
  for (Index i = 0; i < size(); ++i) a.coeffRef(i, i) += shift + compliance_[i] * s[i] * s[i];
  Eigen::SimplicialLDLT<SparseMatrix> factor(a);
  const double smallest = factor.info() == Eigen::Success ? factor.vectorD().minCoeff() : -1.0;
  if (smallest >= 0.0) return;
  throw InvalidInput("delassus", "is not positive semidefinite: with its diagonal scaled to 1, a pivot is " +
                                     in_full(smallest) + ", must be >= 0");
}

}  // namespace signorini
