#include <Eigen/Dense>
#include <boost/test/unit_test.hpp>

#include "signorini/delassus/delassus_operator.hpp"
#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

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
        const auto g = make_operator(type, s.sets, s.mass, s.jacobian);
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
        make_operator(type, s.sets, s.mass, s.jacobian)->prepare(s.sets, s.scale, s.compliance, system);
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

BOOST_AUTO_TEST_CASE(an_ill_conditioned_mass_matrix_gives_the_exact_operator) {
  // M = T' T of whole numbers, det T = 1: its inverse, and so G, are whole numbers as well.
  const Index nv = 7;
  Matrix t = Matrix::Identity(nv, nv), j(8, nv);
  for (Index i = 1; i < nv; ++i) t(i, i - 1) = 8.0;
  for (Index r = 0; r < 8; ++r)
    for (Index c = 0; c < nv; ++c) j(r, c) = static_cast<double>((3 * r + 5 * c + r * c) % 7 - 3);
  Matrix inverse = Matrix::Identity(nv, nv);  // of T
  for (Index i = 1; i < nv; ++i) inverse.row(i) -= 8.0 * inverse.row(i - 1);
  const Matrix mass = t.transpose() * t, x = inverse.transpose() * j.transpose();
  const Matrix g = x.transpose() * x;
  const Sample s = sample(nv);
  const auto op = make_operator(Operator::MassSpace, s.sets, mass, j);
  const Vector root = g.diagonal().cwiseSqrt();
  const auto error = [&](const Matrix& other) {
    return ((other - g).array() / (root * root.transpose()).array()).abs().maxCoeff();
  };
  BOOST_TEST(error(op->matrix()) <= 1e-14);
  // Directions are as good as M's conditioning allows; the determinant has the right sign.
  const Vector scale = root.cwiseInverse();
  std::unique_ptr<ScaledDelassus> system;
  op->prepare(s.sets, scale, s.compliance, system);
  Matrix a = scale.asDiagonal() * g * scale.asDiagonal();
  a += Matrix(s.compliance.cwiseProduct(scale).cwiseProduct(scale).asDiagonal());
  Random random(29);
  const BlockDiagonal bx = random_blocks(random, 4, 2.0, 0.5), by = random_blocks(random, 4, 1.0, 0.0);
  const Matrix k = expand(s.sets, bx) + expand(s.sets, by) * a;
  BOOST_REQUIRE(system->factor(bx, by));
  const Vector rhs = random.vector(8);
  Vector solution = rhs;
  system->solve(solution);
  BOOST_TEST((k * solution - rhs).norm() <= 1e-5 * (1.0 + k.norm() * solution.norm()));
  BOOST_TEST(system->determinant_sign() == (k.determinant() > 0.0 ? 1 : -1));
}

BOOST_AUTO_TEST_CASE(what_cannot_be_factored_is_said) {
  const Sample s = sample(5);  // rank 5 of 8
  for (const Operator type : kOperators) {
    BOOST_TEST_CONTEXT(operator_name(type)) {
      std::unique_ptr<ScaledDelassus> system;
      make_operator(type, s.sets, s.mass, s.jacobian)->prepare(s.sets, s.scale, s.compliance, system);
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

namespace {

/// A chain of bodies with `contacts` cones between neighbours, an equality on every third: sparse when long.
struct Chain {
  ConstraintSets sets;
  Matrix jacobian, g;  // of unit masses
};

Chain chain(Index contacts, std::uint64_t seed) {
  Random random(seed);
  Chain out;
  const Index nv = 3 * (contacts + 2);
  std::vector<Vector> rows;
  for (Index c = 0; c < contacts; ++c) {
    const auto add = [&](Index count) {
      for (Index r = 0; r < count; ++r) {
        Vector row = Vector::Zero(nv);
        row.segment(3 * c, 6) = random.vector(6);
        rows.push_back(row);
      }
    };
    out.sets.add_friction_cone(random.uniform(0.1, 1.0)), add(3);
    if (c % 3 == 0) out.sets.add_equality(), add(1);
  }
  out.jacobian.resize(static_cast<Index>(rows.size()), nv);
  for (std::size_t r = 0; r < rows.size(); ++r) out.jacobian.row(static_cast<Index>(r)) = rows[r].transpose();
  out.g = out.jacobian * out.jacobian.transpose();
  return out;
}

/// E and F of (T35), by columns.
void reduction(const ConstraintSets& sets, const std::vector<ReducedSet>& reduced, Matrix& left, Matrix& right,
               Vector& weights, std::vector<Index>& rows) {
  using Kind = ReducedSet::Kind;
  std::vector<Vector> e, f;
  std::vector<double> w;
  for (Index i = 0; i < sets.num_sets(); ++i) {
    const ReducedSet& set = reduced[static_cast<std::size_t>(i)];
    const Index o = sets[i].offset;
    const auto unit = [&](Index k) { return Vector(Vector::Unit(sets.size(), o + k)); };
    const auto add = [&](const Vector& a, const Vector& b, double weight, Index place) {
      e.push_back(a), f.push_back(b), w.push_back(weight), rows.push_back(o + place);
    };
    if (set.kind == Kind::Line) add(unit(0), unit(0), 0.0, 0);
    if (set.kind == Kind::Normal) add(unit(2), unit(2), 0.0, 0);
    if (set.kind == Kind::Stick)
      for (Index k = 0; k < 3; ++k) add(unit(k), unit(k), 0.0, k);
    if (set.kind == Kind::Slip) {
      const Vector across = set.u0 * unit(1) - set.u1 * unit(0), along = set.u0 * unit(0) + set.u1 * unit(1);
      add(across, across, set.weight, 0);
      add(unit(2), unit(2) + set.friction * along, 0.0, 1);
    }
  }
  const auto count = static_cast<Index>(e.size());
  left.resize(sets.size(), count), right.resize(sets.size(), count), weights.resize(count);
  for (Index k = 0; k < count; ++k) {
    left.col(k) = e[static_cast<std::size_t>(k)], right.col(k) = f[static_cast<std::size_t>(k)];
    weights[k] = w[static_cast<std::size_t>(k)];
  }
}

}  // namespace

BOOST_AUTO_TEST_CASE(reduced_systems_are_solved) {
  using Kind = ReducedSet::Kind;
  Random random(31);
  std::unique_ptr<ScaledDelassus> system;
  for (const Index contacts : {1, 3, 8, 40}) {  // the last one sparse, the first ones dense
    const Chain c = chain(contacts, 5);
    const Vector scale = Vector::Constant(c.sets.size(), 0.7);
    const Vector compliance = 1e-2 * (random.vector(c.sets.size()).array().abs() + 0.1);
    const Matrix a = 0.49 * (c.g + Matrix(compliance.asDiagonal()));
    for (const Operator type : {Operator::Sparse, Operator::MassSpace, Operator::Block, Operator::Coupled}) {
      if (type == Operator::Sparse) {
        SparseDelassus(SparseMatrix(c.g.sparseView())).prepare(c.sets, scale, compliance, system);
      } else if (type == Operator::MassSpace) {
        const Index nv = c.jacobian.cols();
        const SparseMatrix mass = Matrix::Identity(nv, nv).sparseView(), jacobian = c.jacobian.sparseView();
        MassSpaceDelassus(mass, jacobian).prepare(c.sets, scale, compliance, system);
      } else if (type == Operator::Coupled) {
        CoupledDelassus coupled;
        Eigen::Map<Matrix>(coupled.reset(c.sets.size()), c.sets.size(), c.sets.size()) = c.g;
        coupled.prepare(c.sets, scale, compliance, system);
      } else {
        BlockDelassus blocks;
        fill_blocks(c.sets, c.g, blocks);
        blocks.prepare(c.sets, scale, compliance, system);
      }
      BOOST_REQUIRE(system->reduces());
      for (int trial = 0; trial < 24; ++trial) {
        std::vector<ReducedSet> reduced(static_cast<std::size_t>(c.sets.num_sets()));
        for (Index i = 0; i < c.sets.num_sets(); ++i) {
          ReducedSet& set = reduced[static_cast<std::size_t>(i)];
          const double draw = random.uniform(0.0, 1.0), angle = random.uniform(0.0, 6.28);
          if (c.sets[i].size() == 1) {
            set.kind = trial % 4 == 3 || draw < 0.7 ? Kind::Line : Kind::Fixed;
          } else if (trial % 4 == 3) {  // all stick: symmetric
            set.kind = Kind::Stick;
          } else {
            set.kind = draw < 0.25 ? Kind::Fixed : draw < 0.5 ? Kind::Slip : draw < 0.6 ? Kind::Normal : Kind::Stick;
            if (trial == 0) set.kind = Kind::Fixed;
          }
          set.u0 = std::cos(angle), set.u1 = std::sin(angle);
          set.friction = c.sets[i].friction;
          set.weight = random.uniform(0.0, 2.0);
        }
        Matrix e, f;
        Vector weights;
        std::vector<Index> rows;
        reduction(c.sets, reduced, e, f, weights, rows);
        Matrix k = e.transpose() * a * f;
        k.diagonal() += weights + Vector::Constant(k.rows(), 1e-2);
        BOOST_TEST_CONTEXT(contacts << " contacts, trial " << trial << ", " << operator_name(type)) {
          BOOST_REQUIRE(system->factor_reduced(reduced, 1e-2));
          const Vector rhs = random.vector(c.sets.size());
          Vector x = rhs, own(k.rows()), want(k.rows());
          system->solve_reduced(x);
          for (Index r = 0; r < k.rows(); ++r) own[r] = x[rows[r]], want[r] = rhs[rows[r]];
          BOOST_TEST((k * own - want).norm() <= 1e-9 * (1.0 + k.norm() * own.norm()));
          // Whole systems in between.
          const BlockDiagonal identity(static_cast<std::size_t>(c.sets.num_sets()), Eigen::Matrix3d::Identity());
          BOOST_REQUIRE(trial % 5 == 0 ? system->factor(identity) : system->factor(identity, identity));
          x = rhs;
          system->solve(x);
          BOOST_TEST((a * x + x - rhs).norm() <= 1e-9 * rhs.norm());
        }
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(blocks_know_their_islands_and_parts) {
  // Three chains, their sets interleaved.
  const Chain parts[3] = {chain(2, 1), chain(15, 2), chain(4, 3)};
  ConstraintSets sets;
  std::vector<int> owner;
  std::vector<Index> place[3];  // rows of each chain in the whole
  Index next[3] = {0, 0, 0};
  for (bool going = true; going;) {
    going = false;
    for (int p = 0; p < 3; ++p) {
      if (next[p] >= parts[p].sets.num_sets()) continue;
      const ConstraintSet& set = parts[p].sets[next[p]++];
      for (Index k = 0; k < set.size(); ++k) place[p].push_back(sets.size() + k);
      sets.add(set), owner.push_back(p), going = true;
    }
  }
  Matrix g = Matrix::Zero(sets.size(), sets.size());
  for (int p = 0; p < 3; ++p)
    for (std::size_t r = 0; r < place[p].size(); ++r)
      for (std::size_t c = 0; c < place[p].size(); ++c)
        g(place[p][r], place[p][c]) = parts[p].g(static_cast<Index>(r), static_cast<Index>(c));
  BlockDelassus blocks;
  fill_blocks(sets, g, blocks);
  BOOST_TEST(blocks.islands(sets) == owner, boost::test_tools::per_element());
  BOOST_TEST(blocks.islands(sets) == SparseDelassus(SparseMatrix(g.sparseView())).islands(sets),
             boost::test_tools::per_element());
  std::unique_ptr<ScaledDelassus> system;
  for (const int p : {1, 0, 2, 1}) {
    std::vector<int> members;
    for (std::size_t i = 0; i < owner.size(); ++i)
      if (owner[i] == p) members.push_back(static_cast<int>(i));
    const Index n = parts[p].sets.size();
    const Vector ones = Vector::Ones(n), x = Random(6).vector(n);
    Vector y(n), z(n);
    blocks.prepare_part(sets, members, parts[p].sets, ones, Vector::Zero(n), system);
    system->apply(x, y);
    BOOST_TEST((y - parts[p].g * x).norm() <= 1e-12 * parts[p].g.norm());
    blocks.restrict(place[p])->apply(x, z);
    BOOST_TEST((z - parts[p].g * x).norm() <= 1e-12 * parts[p].g.norm());
  }
  std::vector<Index> order;
  for (Index i = parts[2].sets.num_sets() - 1; i >= 0; --i)
    for (Index k = 0; k < parts[2].sets[i].size(); ++k) order.push_back(place[2][parts[2].sets[i].offset + k]);
  const Matrix turned(blocks.restrict(order)->matrix());
  for (std::size_t r = 0; r < order.size(); ++r)
    for (std::size_t c = 0; c < order.size(); ++c) BOOST_TEST(std::abs(turned(r, c) - g(order[r], order[c])) <= 1e-14);
}
