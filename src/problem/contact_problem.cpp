#include "signorini/problem/contact_problem.hpp"

#include <Eigen/SparseCholesky>
#include <cmath>
#include <sstream>

#include "signorini/errors.hpp"

namespace signorini {
namespace {

// Squares and products of what is allowed must stay finite.
constexpr double kLargest = 1e100;
constexpr double kSmallestDiagonal = 1e-100;

std::string number(double value) {
  std::ostringstream out;
  out << value;
  return out.str();
}

void check_entries(const Vector& v, const char* field, double lowest) {
  for (Index i = 0; i < v.size(); ++i) {
    if (v[i] >= lowest && v[i] <= kLargest) continue;  // false for NaN
    throw InvalidInput(std::string(field) + "[" + std::to_string(i) + "]",
                       "is " + number(v[i]) + ", must be in [" + number(lowest) + ", " + number(kLargest) + "]");
  }
}

}  // namespace

ContactProblem::ContactProblem(std::shared_ptr<const DelassusOperator> delassus, Vector free_velocity,
                               ConstraintSets sets, Vector compliance)
    : delassus_(std::move(delassus)),
      free_velocity_(std::move(free_velocity)),
      sets_(std::move(sets)),
      compliance_(std::move(compliance)) {
  if (!delassus_) throw InvalidInput("delassus", "is null");
  const Index n = delassus_->size();
  const auto check_size = [n](const char* field, Index size) {
    if (size == n) return;
    throw InvalidInput(field, "has " + std::to_string(size) + " rows, must have the " + std::to_string(n) +
                                  " of the Delassus operator");
  };
  check_size("free_velocity", free_velocity_.size());
  check_size("sets", sets_.size());
  if (compliance_.size() == 0) compliance_ = Vector::Zero(n);
  check_size("compliance", compliance_.size());
  check_entries(free_velocity_, "free_velocity", -kLargest);
  check_entries(compliance_, "compliance", 0.0);

  Vector diagonal(n);
  delassus_->diagonal(diagonal);
  check_entries(diagonal, "delassus diagonal", 0.0);
  scale_.resize(n);
  for (const ConstraintSet& set : sets_) {
    const double d = (diagonal + compliance_).segment(set.offset, set.size()).mean();
    if (d > 0.0 && d < kSmallestDiagonal) {
      throw InvalidInput("delassus diagonal[" + std::to_string(set.offset) + "]",
                         "is " + number(d) + ", must be 0 or at least " + number(kSmallestDiagonal));
    }
    scale_.segment(set.offset, set.size()).setConstant(d > 0.0 ? d : 1.0);
  }
}

void ContactProblem::velocity(const ConstVectorRef& impulse, VectorRef velocity) const {
  delassus_->apply(impulse, velocity);
  velocity += compliance_.cwiseProduct(impulse) + free_velocity_;
}

void ContactProblem::check_definite() const {
  if (size() == 0 || delassus_->definite_by_construction()) return;
  // With unit diagonal, and a shift for rounding (to single precision, in some files) and for what an unsymmetric part
  // can hide.
  const Vector s = scale_.cwiseSqrt().cwiseInverse();
  SparseMatrix a = s.asDiagonal() * delassus_->matrix() * s.asDiagonal();
  const double shift = 1e-5 + 10.0 * delassus_->asymmetry();
  for (Index i = 0; i < size(); ++i) a.coeffRef(i, i) += shift + compliance_[i] * s[i] * s[i];
  Eigen::SimplicialLDLT<SparseMatrix> factor(a);
  const double smallest = factor.info() == Eigen::Success ? factor.vectorD().minCoeff() : -1.0;
  if (smallest >= 0.0) return;
  throw InvalidInput("delassus", "is not positive semidefinite: with its diagonal scaled to 1, a pivot is " +
                                     number(smallest) + ", must be >= 0");
}

}  // namespace signorini
