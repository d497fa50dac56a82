// The cheap first steps of `auto`, and `auto` at loose tolerances, cold and warm, where they are all it does.
#include "signorini/solver/block_sweeps.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

Vector compliance_of(Index contacts, bool extras) {
  return Vector(Vector::Constant(3 * contacts + (extras ? 4 : 0), 1e-3));
}

GrowVector scaled_guess(const ScaledProblem& scaled, const Vector& impulse) {
  Vector l(scaled.size());
  scaled.from_impulse(impulse, l);
  return l;
}

}  // namespace

BOOST_AUTO_TEST_CASE(columns_and_diagonal_blocks_are_those_of_the_matrix) {
  // 3 contacts make one dense matrix, 40 blocks of a sparse one.
  for (const Index contacts : {3, 40})
    for (const Operator type : kOperators) {
      const Planted planted = plant(61, contacts, Law::Ncp, type, true, compliance_of(contacts, true));
      ScaledProblem scaled;
      scaled.setup(planted.problem, 1e-4);
      const Index n = scaled.size();
      Matrix a(n, n);
      for (Index k = 0; k < n; ++k) {
        Vector column(n);
        scaled.system->apply(Vector::Unit(n, k), column);
        a.col(k) = column;
      }
      BOOST_TEST_CONTEXT(operator_name(type) << ", " << contacts << " contacts") {
        for (Index i = 0; i < scaled.sets.num_sets(); ++i) {
          const Index o = scaled.sets[i].offset, size = scaled.sets[i].size();
          const Vector x = Random(62).vector(3), y = Random(63).vector(n);
          Vector sum = y;
          scaled.system->add_columns(i, x.data(), sum.data());
          BOOST_TEST((sum - y - a.middleCols(o, size) * x.head(size)).norm() <= 1e-12);
          const Matrix block = scaled.system->diagonal_block(i).topLeftCorner(size, size);
          BOOST_TEST((block - a.block(o, o, size, size)).norm() <= 1e-12);
        }
      }
    }
}

BOOST_AUTO_TEST_CASE(sweeps_know_their_certificate_and_come_to_the_answer) {
  for (const Index contacts : {1, 4, 12})
    for (const bool warm : {false, true})
      for (const Operator type : {Operator::Dense, Operator::Sparse, Operator::Block, Operator::Coupled}) {
        const Planted planted = plant(64, contacts, Law::Ncp, type, true, compliance_of(contacts, true));
        const ContactProblem& problem = planted.problem;
        ScaledProblem scaled;
        scaled.setup(problem, 1e-6);
        const GrowVector guess = scaled_guess(scaled, planted.impulse + 0.1 * Random(65).vector(problem.size()));
        BlockSweeps sweeps;
        sweeps.start(scaled, warm ? &guess : nullptr);
        int count = 0;
        for (; sweeps.relative(scaled) > 1e-6 && count < 2000; ++count) sweeps.sweep(scaled);
        BOOST_TEST_CONTEXT(operator_name(type) << ", " << contacts << " contacts" << (warm ? ", warm" : "")) {
          Vector impulse(problem.size()), projected(problem.size());
          scaled.to_impulse(sweeps.impulse(), impulse);
          problem.sets().project(impulse, projected);
          BOOST_TEST((impulse - projected).norm() <= 1e-14 * impulse.norm());  // always in K
          // Kept up to date over all sweeps, the velocity says what a fresh one says.
          BOOST_TEST(std::abs(residual(problem, impulse).relative - sweeps.relative(scaled)) <= 1e-9);
          BOOST_TEST(residual(problem, impulse).relative <= 2e-6);
          BOOST_TEST(count < 2000);
        }
      }
}

BOOST_AUTO_TEST_CASE(a_proximal_term_is_part_of_the_velocity) {
  // A + w I and b - w c; the sweeps come to where nothing moves but what w (l - c) holds.
  const double weight = 0.1;
  for (const Operator type : kOperators) {
    const Planted planted = plant(69, 12, Law::Ncp, type, true, compliance_of(12, true));
    ScaledProblem scaled;
    scaled.setup(planted.problem, 1e-6);
    const GrowVector start = scaled_guess(scaled, planted.impulse), centre = Random(70).vector(scaled.size());
    for (const bool warm : {false, true}) {
      BlockSweeps sweeps;
      sweeps.start(scaled, warm ? &start : nullptr, weight, &centre);
      for (int k = 0; k < 50; ++k) sweeps.sweep(scaled);
      Vector t(scaled.size());
      scaled.system->apply(sweeps.impulse(), t);
      t += scaled.b + weight * (sweeps.impulse() - centre);
      BOOST_TEST_CONTEXT(operator_name(type) << (warm ? ", warm" : "")) {
        BOOST_TEST((t - sweeps.velocity()).norm() <= 1e-10 * (1.0 + t.norm()));
        BOOST_TEST(sweeps.relative(scaled) <= 1e-3);
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(slipping_is_noticed) {
  // One contact at rest: pushed within the cone, and beyond.
  for (const double push : {0.3, 0.7}) {
    const ContactProblem problem(std::make_shared<DenseDelassus>(Matrix::Identity(3, 3)),
                                 Vector(Eigen::Vector3d(push, 0.0, -1.0)),
                                 ConstraintSets::friction_cones(Vector::Constant(1, 0.5)));
    ScaledProblem scaled;
    scaled.setup(problem, 1e-6);
    BlockSweeps sweeps;
    sweeps.start(scaled, nullptr);
    sweeps.sweep(scaled);
    BOOST_TEST(sweeps.slips() == (push > 0.5));
    BOOST_TEST(sweeps.relative(scaled) <= 1e-15);  // with nobody else, a visit is the solution
  }
}

BOOST_AUTO_TEST_CASE(auto_holds_loose_tolerances) {
  Workspace workspace;
  for (const double tolerance : {1e-2, 1e-4, 1e-5})
    for (const Law law : {Law::Ncp, Law::Ccp})
      for (const Operator type : kOperators)
        for (const Index contacts : {1, 4, 15, 50})
          for (std::uint64_t seed = 1; seed <= 3; ++seed)
            for (const bool warm : {false, true}) {
              const Planted planted = plant(seed, contacts, law, type, seed % 2 == 1);
              Settings settings = settings_for(SolverType::Auto, tolerance, law);
              settings.aim = tolerance;
              Guess guess;
              guess.impulse = planted.impulse + 0.1 * Random(seed).vector(planted.problem.size());
              Solution solution;
              solve(planted.problem, settings, workspace, solution, warm ? &guess : nullptr);
              BOOST_TEST_CONTEXT(operator_name(type) << ", " << contacts << " contacts, seed " << seed
                                                     << (warm ? ", warm, " : ", ") << tolerance) {
                BOOST_TEST((solution.status == Status::Solved));
                BOOST_TEST(residual(planted.problem, solution.impulse, law).relative <= tolerance);
                BOOST_TEST((solution.velocity - planted.velocity).norm() <= 3e3 * tolerance);
              }
            }
}

BOOST_AUTO_TEST_CASE(small_and_easy_costs_no_factorisation) {
  // Contacts of bodies of their own.
  const Index contacts = 6;
  Matrix g = Matrix::Identity(3 * contacts, 3 * contacts);
  g.array() += 0.01;
  const ContactProblem problem(std::make_shared<DenseDelassus>(g),
                               Vector(Random(66).vector(3 * contacts) - Vector::Constant(3 * contacts, 0.5)),
                               ConstraintSets::friction_cones(Vector::Constant(contacts, 0.5)));
  Settings settings;
  settings.tolerance = 1e-4;
  const Solution solution = solve(problem, settings);
  BOOST_TEST((solution.status == Status::Solved));
  BOOST_TEST(solution.factorizations == 0);
  BOOST_TEST(solution.iterations > 0);
  BOOST_TEST((solution.solver == SolverType::Pgs));
}

BOOST_AUTO_TEST_CASE(a_workspace_leaves_no_trace_in_the_answer) {
  // The same bits from a fresh workspace and from one that has solved other sizes, cold and warm.
  Workspace used;
  for (const double tolerance : {1e-3, 1e-6})
    for (const Operator type : {Operator::Dense, Operator::Sparse, Operator::Block, Operator::Coupled})
      for (const Index contacts : {12, 3, 40}) {
        const Planted planted = plant(67, contacts, Law::Ncp, type, true);
        Settings settings = settings_for(SolverType::Auto, tolerance);
        settings.aim = tolerance;
        Guess guess;
        guess.impulse = planted.impulse + 1e-2 * Random(68).vector(planted.problem.size());
        for (const Guess* start : {static_cast<const Guess*>(nullptr), static_cast<const Guess*>(&guess)}) {
          Solution again;
          solve(planted.problem, settings, used, again, start);
          const Solution fresh = solve(planted.problem, settings, start);
          BOOST_TEST((fresh.impulse == again.impulse));
          BOOST_TEST(fresh.iterations == again.iterations);
        }
      }
}

BOOST_AUTO_TEST_CASE(a_dense_matrix_in_pieces_is_its_islands) {
  // Two islands whose sets alternate: a dense G knows them, and solves each as it would alone.
  const Planted one = plant(71, 5, Law::Ncp), two = plant(72, 5, Law::Ncp);
  const Index n = one.problem.size(), size = 3;
  Matrix g = Matrix::Zero(2 * n, 2 * n);
  Vector free_velocity(2 * n), velocity(2 * n);
  ConstraintSets sets;
  const Matrix parts[2] = {one.problem.delassus().matrix(), two.problem.delassus().matrix()};
  const Planted* planted[2] = {&one, &two};
  for (Index i = 0; i < 10; ++i) {
    const Index p = i % 2, own = size * (i / 2);
    sets.add(planted[p]->problem.sets()[i / 2]);
    free_velocity.segment(size * i, size) = planted[p]->problem.free_velocity().segment(own, size);
    velocity.segment(size * i, size) = planted[p]->velocity.segment(own, size);
    for (Index j = p; j < 10; j += 2)
      g.block(size * i, size * j, size, size) = parts[p].block(own, size * (j / 2), size, size);
  }
  const auto delassus = std::make_shared<DenseDelassus>(g);
  std::vector<int> labels;
  delassus->label_islands(sets, labels);
  BOOST_TEST((labels == SparseDelassus(SparseMatrix(g.sparseView())).islands(sets)));
  for (std::size_t i = 0; i < 10; i += 2)
    for (std::size_t j = 1; j < 10; j += 2) BOOST_TEST(labels[i] != labels[j]);
  const ContactProblem problem(delassus, free_velocity, sets);
  for (const double tolerance : {1e-4, 1e-8}) {
    const Solution solution = solve(problem, settings_for(SolverType::Auto, tolerance));
    BOOST_TEST((solution.status == Status::Solved));
    BOOST_TEST((solution.velocity - velocity).norm() <= 1e3 * tolerance);
  }
}
