#include "signorini/solver/gauss_seidel.hpp"

namespace signorini {

void GaussSeidel::setup(const ContactProblem& problem, const Guess* guess) {
  matrix = problem.delassus().matrix();
  compliance = problem.compliance();
  impulse.setZero(problem.size());
  sigma.setZero(problem.size());
  if (guess) impulse = guess->impulse;
}

Eigen::Matrix3d GaussSeidel::block(const ConstraintSet& set) const {
  Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
  for (Index j = 0; j < set.size(); ++j) {
    for (SparseMatrix::InnerIterator it(matrix, set.offset + j); it; ++it) {
      const Index i = it.row() - set.offset;
      if (i >= 0 && i < set.size()) block(i, j) += it.value();
    }
    block(j, j) += compliance[set.offset + j];
  }
  return block;
}

}  // namespace signorini
