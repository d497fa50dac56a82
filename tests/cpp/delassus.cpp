#include <Eigen/Dense>
#include <boost/test/unit_test.hpp>

#include "signorini/delassus/delassus_operator.hpp"
#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

constexpr Operator kOperators[] = {Operator::Dense, Operator::Sparse, Operator::MassSpace};

struct Sample {
  Matrix mass, jacobian, g;
  ConstraintSets sets;
  Vector compliance, scale;
};

/// Two cones, a half line and an equality on `nv` velocities: redundant when nv < 8.
Sample sample(Index nv) {
  Random random(21);
  Sample s;
  const Matrix root = random.matrix(nv, nv);
  s.mass = root * root.transpose() + Matrix::Identity(nv, nv);
  s.jacobian = random.matrix(8, nv);
  s.jacobian.topRightCorner(3, nv / 2).setZero();
  s.g = s.jacobian * s.mass.llt().solve(Matrix(s.jacobian.transpose()));
  s.sets.add_friction_cone(0.5);
  s.sets.add_half_line();
  s.sets.add_friction_cone(0.9);
  s.sets.add_equality();
  s.compliance = Vector::Constant(8, 1e-3) + random.vector(8, 1e-3);
  s.scale.resize(8);
  s.scale << 2.0, 2.0, 2.0, 0.5, 3.0, 3.0, 3.0, 1.0;
  return s;
}

Matrix expand(const ConstraintSets& sets, const BlockDiagonal& blocks) {
  Matrix m = Matrix::Zero(sets.size(), sets.size());
  for (Index i = 0; i < sets.num_sets(); ++i) {
    const Index o = sets[i].offset, k = sets[i].size();
    m.block(o, o, k, k) = blocks[static_cast<std::size_t>(i)].topLeftCorner(k, k);
  }
  return m;
}

BlockDiagonal random_blocks(Random& random, Index count, double diagonal, double size) {
  BlockDiagonal blocks;
  for (Index i = 0; i < count; ++i) {
    blocks.push_back(size * Eigen::Matrix3d(random.matrix(3, 3)) + diagonal * Eigen::Matrix3d::Identity());
  }
  return blocks;
}

}  // namespace

BOOST_AUTO_TEST_CASE(every_operator_is_the_same_matrix) {
  for (const Index nv : {5, 12}) {
    const Sample s = sample(nv);
    const Vector x = Random(22).vector(8);
    for (const Operator type : kOperators) {
      BOOST_TEST_CONTEXT(operator_name(type) << ", " << nv << " velocities") {
        const auto g = make_operator(type, s.mass, s.jacobian);
        Vector y(8), diagonal(8);
        g->apply(x, y);
        g->diagonal(diagonal);
        BOOST_TEST(g->size() == 8);
        BOOST_TEST((y - s.g * x).norm() <= 1e-12 * s.g.norm());
        BOOST_TEST((diagonal - s.g.diagonal()).norm() <= 1e-12 * s.g.norm());
        BOOST_TEST((Matrix(g->matrix()) - s.g).norm() <= 1e-12 * s.g.norm());
        BOOST_TEST(g->asymmetry() <= 1e-14);
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(systems_are_solved_and_their_determinant_has_the_right_sign) {
  for (const Index nv : {5, 12}) {
    const Sample s = sample(nv);
    const Matrix a = s.scale.asDiagonal() * (s.g + Matrix(s.compliance.asDiagonal())) * s.scale.asDiagonal();
    for (const Operator type : kOperators) {
      BOOST_TEST_CONTEXT(operator_name(type) << ", " << nv << " velocities") {
        std::unique_ptr<ScaledDelassus> system;
        make_operator(type, s.mass, s.jacobian)->prepare(s.sets, s.scale, s.compliance, system);
        Random random(23);
        const Vector rhs = random.vector(8);
        Vector y(8);
        system->apply(rhs, y);
        BOOST_TEST((y - a * rhs).norm() <= 1e-12 * a.norm());
        int negative = 0;
        for (int trial = 0; trial < 40; ++trial) {
          const BlockDiagonal bx = random_blocks(random, 4, trial % 2 ? 0.1 : 2.0, 0.5);
          const BlockDiagonal by = random_blocks(random, 4, 1.0, trial % 4 < 2 ? 0.0 : 1.0);
          const Matrix k = expand(s.sets, bx) + expand(s.sets, by) * a;
          BOOST_REQUIRE(system->factor(bx, by));
          Vector x = rhs;
          system->solve(x);
          BOOST_TEST((k * x - rhs).norm() <= 1e-9 * (1.0 + k.norm() * x.norm()));
          BOOST_TEST(system->determinant_sign() == (k.determinant() > 0.0 ? 1 : -1));
          negative += k.determinant() < 0.0;

          const Matrix k1 = expand(s.sets, bx) + a;
          BOOST_REQUIRE(system->factor(bx));
          x = rhs;
          system->solve(x);
          BOOST_TEST((k1 * x - rhs).norm() <= 1e-9 * (1.0 + k1.norm() * x.norm()));
        }
        BOOST_TEST(negative > 0);
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(what_cannot_be_factored_is_said) {
  const Sample s = sample(5);  // rank 5 of 8
  for (const Operator type : kOperators) {
    BOOST_TEST_CONTEXT(operator_name(type)) {
      std::unique_ptr<ScaledDelassus> system;
      make_operator(type, s.mass, s.jacobian)->prepare(s.sets, s.scale, s.compliance, system);
      BlockDiagonal bad(4, Eigen::Matrix3d::Identity());
      bad[2](1, 1) = kNan;
      BOOST_TEST(!system->factor(bad));
      const BlockDiagonal zero(4, Eigen::Matrix3d::Zero());
      BOOST_TEST(!system->factor(zero, zero));
      const BlockDiagonal good(4, Eigen::Matrix3d::Identity());  // and recovered from
      BOOST_TEST(system->factor(good));
    }
  }
}

BOOST_AUTO_TEST_CASE(an_unsymmetric_matrix_stands_for_its_symmetric_part) {
  Matrix g = Matrix::Identity(3, 3);
  g(0, 1) = 0.2;
  const Matrix symmetric = 0.5 * (g + g.transpose());
  const DenseDelassus full(g);
  const SparseDelassus sparse{SparseMatrix(g.sparseView())};
  BOOST_TEST((Matrix(full.matrix()) - symmetric).norm() == 0.0);
  BOOST_TEST((Matrix(sparse.matrix()) - symmetric).norm() == 0.0);
  BOOST_TEST(std::abs(full.asymmetry() - 0.2) <= 1e-15);
  BOOST_TEST(std::abs(sparse.asymmetry() - 0.2) <= 1e-15);
}
