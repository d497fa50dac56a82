// Gauss-Seidel patch by patch, what `auto` does with large islands.
#include "signorini/solver/patch_sweeps.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

constexpr Operator kListed[] = {Operator::Sparse, Operator::Block, Operator::MassSpace};

/// A heap of `columns` towers of `height` points each, one on the other, that touch the tower beside them at every
/// height: a grid of contacts in three dimensions each, sparse. All fall with unit speed.
ContactProblem towers(Index columns, Index height, double friction, Operator type = Operator::Sparse) {
  const Index bodies = columns * height;
  std::vector<Eigen::Triplet<double>> entries;
  Index row = 0;
  std::vector<double> free;
  // The normal points from `below` (-1: the ground) to `above`; its axis is 2 for a floor, 0 for a wall between towers.
  const auto contact = [&](Index below, Index above, int axis) {
    const int rows[3] = {(axis + 1) % 3, (axis + 2) % 3, axis};
    for (const int k : rows) {
      entries.emplace_back(row, 3 * above + k, 1.0);
      if (below >= 0) entries.emplace_back(row, 3 * below + k, -1.0);
      free.push_back(below < 0 && k == 2 ? -1.0 : 0.0);  // all bodies fall alike
      ++row;
    }
  };
  for (Index c = 0; c < columns; ++c)
    for (Index h = 0; h < height; ++h) {
      contact(h == 0 ? -1 : c * height + h - 1, c * height + h, 2);
      if (c > 0) contact((c - 1) * height + h, c * height + h, 0);
    }
  SparseMatrix jacobian(row, 3 * bodies), mass(3 * bodies, 3 * bodies);
  jacobian.setFromTriplets(entries.begin(), entries.end());
  mass.setIdentity();
  const ConstraintSets sets = ConstraintSets::friction_cones(Vector::Constant(row / 3, friction));
  const Vector velocity = Eigen::Map<const Vector>(free.data(), row);
  if (type == Operator::MassSpace)
    return ContactProblem(std::make_shared<MassSpaceDelassus>(mass, jacobian), velocity, sets);
  return ContactProblem(std::make_shared<SparseDelassus>(SparseMatrix(jacobian * jacobian.transpose())), velocity,
                        sets);
}

Vector impulse_of(const ScaledProblem& scaled, const GrowVector& l) {
  Vector impulse(l.size());
  scaled.to_impulse(l, impulse);
  return impulse;
}

}  // namespace

BOOST_AUTO_TEST_CASE(listed_columns_and_what_is_extracted_are_of_the_matrix) {
  for (const Operator type : kOperators) {
    const Planted planted = plant(81, 40, Law::Ncp, type, true, Vector(Vector::Constant(124, 1e-3)));
    ScaledProblem scaled;
    scaled.setup(planted.problem, 1e-6);
    const Index n = scaled.size();
    Matrix a(n, n), listed = Matrix::Zero(n, n);
    for (Index k = 0; k < n; ++k) {
      Vector column(n);
      scaled.system->apply(Vector::Unit(n, k), column);
      a.col(k) = column;
    }
    BOOST_TEST_CONTEXT(operator_name(type)) {
      std::vector<int> first;
      std::vector<ScaledDelassus::ColumnBlock> blocks;
      const bool lists = type != Operator::Coupled;  // which is full
      BOOST_TEST(scaled.system->list_columns(first, blocks) == lists);
      if (!lists) continue;
      const auto rows = [&](int i) { return std::pair(scaled.sets[i].offset, scaled.sets[i].size()); };
      for (int j = 0; j < static_cast<int>(scaled.sets.num_sets()); ++j)
        for (int c = first[j]; c < first[j + 1]; ++c) {
          const auto [row, height] = rows(blocks[c].set);
          const auto [column, width] = rows(j);
          listed.block(row, column, height, width) += Eigen::Map<const Matrix>(blocks[c].values, height, width);
        }
      BOOST_TEST((listed - a).norm() <= 1e-12 * a.norm());

      std::unique_ptr<ScaledDelassus> system;
      for (const std::vector<int>& part :
           {std::vector<int>{2, 3, 4, 5, 7, 8, 11, 12, 13, 14, 20, 21, 22, 23, 24, 40, 43},
            std::vector<int>{0, 1, 5}}) {
        ConstraintSets part_sets;
        std::vector<Index> index;
        for (const int i : part) {
          part_sets.add(scaled.sets[i]);
          for (Index r = 0; r < scaled.sets[i].size(); ++r) index.push_back(scaled.sets[i].offset + r);
        }
        ScaledDelassus::extract(first, blocks, part, part_sets, system);
        const Vector x = Random(82).vector(part_sets.size());
        Vector y(x.size()), whole = Vector::Zero(n);
        for (Index k = 0; k < x.size(); ++k) whole[index[k]] = x[k];
        const Vector expected = a * whole;
        system->apply(x, y);
        for (Index k = 0; k < x.size(); ++k) BOOST_TEST(std::abs(y[k] - expected[index[k]]) <= 1e-12);
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(patches_come_to_the_answer) {
  for (const Operator type : kListed)
    for (const Index contacts : {40, 300}) {
      const Planted planted =
          plant(83, contacts, Law::Ncp, type, true, Vector(Vector::Constant(3 * contacts + 4, 1e-3)));
      ScaledProblem scaled;
      scaled.setup(planted.problem, 1e-7);
      PatchSweeps patches;
      PatchResult result;
      BOOST_TEST_CONTEXT(operator_name(type) << ", " << contacts << " contacts") {
        BOOST_TEST(patches.solve(scaled, 1e-7, 1000, GrowVector(Vector::Zero(scaled.size())), result));
        const Residual found = residual(planted.problem, impulse_of(scaled, patches.impulse()));
        BOOST_TEST(found.relative <= 1.001e-7);
        BOOST_TEST(result.relative <= 1e-7);
        Vector velocity(scaled.size());
        planted.problem.velocity(impulse_of(scaled, patches.impulse()), velocity);
        BOOST_TEST((velocity - planted.velocity).norm() <= 1e-3);
      }
    }
}

BOOST_AUTO_TEST_CASE(work_is_done_where_the_error_is) {
  // A body of one tower among 100 gets a push: the others hear of it through friction alone, and less and less.
  const ContactProblem problem = towers(100, 4, 0.5);
  ScaledProblem scaled;
  scaled.setup(problem, 1e-6);
  PatchSweeps patches;
  PatchResult cold, again;
  BOOST_TEST(patches.solve(scaled, 1e-6, 1000, GrowVector(Vector::Zero(scaled.size())), cold));
  BOOST_TEST(cold.relative <= 1e-6);
  const GrowVector rest = patches.impulse();
  patches.solve(scaled, 1e-6, 1000, rest, again);
  BOOST_TEST(again.sweeps == 0.0);
  scaled.b[3 * 7 * 50 + 2] -= 0.3;
  patches.solve(scaled, 1e-6, 1000, rest, again);
  BOOST_TEST(again.relative <= 1e-6);
  BOOST_TEST(again.sweeps > 0.0);
  BOOST_TEST(again.sweeps < 1.0);
}

BOOST_AUTO_TEST_CASE(a_tower_weighs_on_its_floor) {
  // Contact k of a tower bears all that is above it. Gauss-Seidel alone takes some 1000^2 visits of each to say so. The
  // least eigenvalue of G is (pi / (2 height))^2: a certificate of 1e-9 leaves an error of 0.4 at most.
  const Index height = 1000;
  for (const Operator type : {Operator::Sparse, Operator::MassSpace}) {
    const ContactProblem problem = towers(1, height, 0.5, type);
    Settings settings;
    settings.tolerance = 1e-9;
    const Solution solution = solve(problem, settings);
    BOOST_TEST_CONTEXT(operator_name(type)) {
      BOOST_TEST((solution.status == Status::Solved));
      for (Index k = 0; k < height; ++k)
        BOOST_TEST(std::abs(solution.impulse[3 * k + 2] - static_cast<double>(height - k)) <= 1e-3 * height);
    }
  }
}

BOOST_AUTO_TEST_CASE(a_wide_heap_costs_nothing_to_factor) {
  // auto, cold: 4 high and 220 wide, in both forms, where a place hears of a few others only.
  for (const Operator type : {Operator::Sparse, Operator::MassSpace}) {
    const ContactProblem problem = towers(220, 4, 0.5, type);
    const Solution solution = solve(problem);
    BOOST_TEST_CONTEXT(operator_name(type)) {
      BOOST_TEST((solution.status == Status::Solved));
      BOOST_TEST(residual(problem, solution.impulse).relative <= 1e-6);
      BOOST_TEST(solution.factorizations == 0);
      BOOST_TEST((solution.solver == SolverType::Pgs));
    }
  }
}

BOOST_AUTO_TEST_CASE(patches_leave_no_trace) {
  PatchSweeps used;
  for (const Index columns : {60, 20, 40}) {
    const ContactProblem problem = towers(columns, 4, 0.3);
    ScaledProblem scaled;
    scaled.setup(problem, 1e-6);
    const GrowVector start = Random(84).vector(scaled.size());
    PatchSweeps fresh;
    PatchResult one, two;
    used.solve(scaled, 1e-6, 1000, start, one);
    fresh.solve(scaled, 1e-6, 1000, start, two);
    BOOST_TEST((used.impulse() == fresh.impulse()));
    BOOST_TEST(one.sweeps == two.sweeps);
    BOOST_TEST(one.relative <= 1e-6);
  }
}
