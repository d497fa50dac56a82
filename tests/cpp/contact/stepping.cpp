// What a stepping loop needs: problems refilled in place, warm solves that allocate nothing, islands left alone when
// their part of the guess holds, answers better than the tolerance where that is cheap.
#include <boost/test/unit_test.hpp>
#include <cstdio>
#include <cstdlib>
#include <new>

#include "../count_allocations.hpp"
#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// One step of a loop: a planted problem in blocks, its answer, and a guess next to it.
struct Step {
  Planted planted;
  std::shared_ptr<BlockDelassus> delassus = std::make_shared<BlockDelassus>();
  Guess guess;

  Step(std::uint64_t seed, Index contacts, bool extras, double error, Law law = Law::Ncp)
      : planted(plant(seed, contacts, law, Operator::Dense, extras)) {
    fill_blocks(planted.problem.sets(), Matrix(planted.problem.delassus().matrix()), *delassus);
    guess.impulse = planted.impulse + error * Random(seed).vector(planted.problem.size());
  }
  void assign(ContactProblem& problem) const {
    problem.assign(delassus, planted.problem.free_velocity(), planted.problem.sets());
  }
};

/// Several problems side by side as one.
struct Union {
  ConstraintSets sets;
  Vector free_velocity, impulse;
  std::shared_ptr<BlockDelassus> delassus = std::make_shared<BlockDelassus>();

  explicit Union(const std::vector<Planted>& parts) {
    Index n = 0;
    for (const Planted& part : parts) n += part.problem.size();
    Matrix g = Matrix::Zero(n, n);
    free_velocity.resize(n), impulse.resize(n);
    Index o = 0;
    for (const Planted& part : parts) {
      const Index size = part.problem.size();
      for (const ConstraintSet& set : part.problem.sets()) sets.add(set);
      g.block(o, o, size, size) = Matrix(part.problem.delassus().matrix());
      free_velocity.segment(o, size) = part.problem.free_velocity();
      impulse.segment(o, size) = part.impulse;
      o += size;
    }
    fill_blocks(sets, g, *delassus);
  }
};

}  // namespace

BOOST_AUTO_TEST_CASE(a_problem_is_refilled_in_place) {
  ContactProblem problem;
  BOOST_TEST(problem.size() == 0);
  BOOST_TEST(problem.num_sets() == 0);
  BOOST_TEST((solve(problem).status == Status::Solved));
  for (const bool extras : {true, false, true}) {
    const Step step(4, extras ? 3 : 6, extras, 0.0);
    step.assign(problem);
    const ContactProblem& expected = step.planted.problem;
    BOOST_TEST(problem.size() == expected.size());
    BOOST_TEST((problem.scale() - expected.scale()).norm() <= 1e-14 * expected.scale().norm());
    BOOST_TEST(problem.compliance().norm() == 0.0);
    Vector own(problem.size()), other(problem.size());
    problem.velocity(step.planted.impulse, own);
    expected.velocity(step.planted.impulse, other);
    BOOST_TEST((own - other).norm() <= 1e-13);
  }
}

BOOST_AUTO_TEST_CASE(bad_input_is_refused_in_place_too) {
  const Step step(4, 3, true, 0.0);
  const ContactProblem& good = step.planted.problem;
  const Index n = good.size();
  ContactProblem problem;
  step.assign(problem);
  const auto refused = [&](const std::shared_ptr<const DelassusOperator>& delassus, const Vector& free_velocity,
                           const ConstraintSets& sets, const Vector& compliance) {
    return refused_field([&] { problem.assign(delassus, free_velocity, sets, compliance); });
  };
  Vector bad = good.free_velocity();
  bad[2] = kNan;
  BOOST_TEST(refused(nullptr, good.free_velocity(), good.sets(), Vector()) == "delassus");
  BOOST_TEST(refused(step.delassus, bad, good.sets(), Vector()) == "free_velocity[2]");
  BOOST_TEST(problem.size() == 0);  // nothing half done is left behind
  BOOST_TEST(problem.num_sets() == 0);
  BOOST_TEST(refused(step.delassus, Vector::Zero(n - 1), good.sets(), Vector()) == "free_velocity");
  BOOST_TEST(refused(step.delassus, good.free_velocity(), good.sets(), Vector::Zero(n - 1)) == "compliance");
  BOOST_TEST(refused(step.delassus, good.free_velocity(), good.sets(), Vector::Constant(n, -1.0)) == "compliance[0]");
  ConstraintSets other;  // as many rows, otherwise grouped
  other.add_equality(4);
  for (int k = 0; k < 3; ++k) other.add_friction_cone(0.5);
  BOOST_TEST(other.size() == n);
  BOOST_TEST(refused(step.delassus, good.free_velocity(), other, Vector()) == "sets");
  const auto broken = std::make_shared<BlockDelassus>(*step.delassus);
  broken->block(0)[1] = kNan;
  BOOST_TEST(refused(broken, good.free_velocity(), good.sets(), Vector()) == "delassus block (1, 0)");
  const auto negative = std::make_shared<BlockDelassus>(*step.delassus);
  negative->diagonal_block(0)[0] = -1.0;
  BOOST_TEST(refused(negative, good.free_velocity(), good.sets(), Vector()) == "delassus diagonal[0]");

  BlockDelassus blocks;
  const auto pattern = [&](const std::vector<BlockDelassus::Pair>& pairs) {
    return refused_field([&] { blocks.reset(good.sets(), pairs); });
  };
  BOOST_TEST(pattern({{0, 1}}) == "blocks[0]");
  BOOST_TEST(pattern({{1, 1}}) == "blocks[0]");
  BOOST_TEST(pattern({{1, -1}}) == "blocks[0]");
  BOOST_TEST(pattern({{1, 0}, {100, 0}}) == "blocks[1]");
  BOOST_TEST(pattern({{2, 0}, {1, 0}}) == "blocks[1]");
  BOOST_TEST(pattern({{1, 0}, {1, 0}}) == "blocks[1]");
  BOOST_TEST(pattern({{1, 0}, {2, 0}}) == "");

  Settings settings;
  settings.aim = 1e-5;  // above the tolerance
  BOOST_TEST(refused_field([&] { settings.validate(); }) == "aim");
  settings.aim = kNan;
  BOOST_TEST(refused_field([&] { settings.validate(); }) == "aim");
}

BOOST_AUTO_TEST_CASE(a_grow_vector_keeps_its_memory) {
  GrowVector v = Vector::Constant(5, 2.0);
  const double* const memory = v.data();
  v.setZero(3);
  BOOST_TEST(v.size() == 3);
  v.resize(5);
  BOOST_TEST(v.data() == memory);
  v = Vector::Constant(2, 1.0) + Vector::Constant(2, 3.0);
  BOOST_TEST((v.size() == 2 && v[1] == 4.0 && v.data() == memory));
  GrowVector copy = v;
  copy[0] = 7.0;
  BOOST_TEST(v[0] == 4.0);
  GrowVector other = std::move(copy);
  BOOST_TEST((other.size() == 2 && other[0] == 7.0 && copy.size() == 0));
  swap(v, other);
  BOOST_TEST((v[0] == 7.0 && other[0] == 4.0 && other.data() == memory));
  other = v;
  BOOST_TEST((other[0] == 7.0 && other.data() == memory));
}

BOOST_AUTO_TEST_CASE(warm_steps_are_solved_and_beyond_the_tolerance) {
  // Of all sizes: dense fronts, and block patterns that are factored sparse.
  Workspace workspace;
  ContactProblem problem;
  Solution solution;
  Settings settings;
  for (const Index contacts : {1, 4, 9, 40})
    for (const bool extras : {false, true})
      for (std::uint64_t seed = 1; seed <= 8; ++seed) {
        const Step step(seed, contacts, extras, 1e-2);
        step.assign(problem);
        solve(problem, settings, workspace, solution, &step.guess);
        BOOST_TEST_CONTEXT(contacts << " contacts, seed " << seed << (extras ? ", extras" : "")) {
          const Residual certificate = residual(step.planted.problem, solution.impulse);
          BOOST_TEST((solution.status == Status::Solved));
          BOOST_TEST(certificate.relative <= 1e-9);
          BOOST_TEST(solution.factorizations > 0);
          BOOST_TEST((solution.velocity - step.planted.velocity).norm() <= 1e-6);
        }
        // And what comes out is left alone.
        Guess again;
        again.impulse = solution.impulse;
        solve(problem, settings, workspace, solution, &again);
        BOOST_TEST((solution.status == Status::Solved));
        BOOST_TEST((solution.factorizations == 0 || again.impulse != solution.impulse));
      }
}

BOOST_AUTO_TEST_CASE(a_guess_within_the_tolerance_is_improved_where_that_is_cheap) {
  const Step step(3, 6, true, 3e-7);
  ContactProblem problem;
  step.assign(problem);
  Settings settings;
  settings.tolerance = 1e-5;
  BOOST_TEST(residual(problem, step.guess.impulse).solves(1e-5));
  const Solution better = solve(problem, settings, &step.guess);
  BOOST_TEST(better.residual.relative <= 1e-9);
  BOOST_TEST(better.factorizations >= 1);
  settings.aim = settings.tolerance;
  const Solution enough = solve(problem, settings, &step.guess);
  BOOST_TEST((enough.status == Status::Solved));
  BOOST_TEST(enough.factorizations == 0);
}

BOOST_AUTO_TEST_CASE(an_island_whose_guess_holds_is_left_alone) {
  std::vector<Planted> parts;
  for (std::uint64_t seed = 1; seed <= 12; ++seed) parts.push_back(plant(seed, 3, Law::Ncp, Operator::Dense, seed % 2));
  const Union whole(parts);
  ContactProblem problem;
  problem.assign(whole.delassus, whole.free_velocity, whole.sets);
  Guess guess;
  guess.impulse = whole.impulse;
  const Index disturbed = parts[0].problem.size();  // where the second begins
  const Index end = disturbed + parts[1].problem.size();
  guess.impulse.segment(disturbed, end - disturbed) += 1e-2 * Random(8).vector(end - disturbed);
  Vector projected(problem.size());
  problem.sets().project(guess.impulse, projected);
  const Solution solution = solve(problem, {}, &guess);
  BOOST_TEST((solution.status == Status::Solved));
  BOOST_TEST(solution.residual.relative <= 1e-9);
  BOOST_TEST(solution.factorizations > 0);
  for (Index k = 0; k < problem.size(); ++k) {
    if (k < disturbed || k >= end) BOOST_TEST(solution.impulse[k] == projected[k]);
  }
  // Each by itself, cold, is what all are together.
  const Solution cold = solve(problem, settings_for(SolverType::Auto, 1e-8));
  BOOST_TEST((cold.status == Status::Solved));
  Index o = 0;
  for (const Planted& part : parts) {
    BOOST_TEST((cold.velocity.segment(o, part.problem.size()) - part.velocity).norm() <= 1e-5);
    o += part.problem.size();
  }
}

BOOST_AUTO_TEST_CASE(a_budget_bounds_what_a_step_costs) {
  // Two walls that close on a body: no impulse holds them. The best iterate comes back, at about the cost allowed.
  for (const ContactProblem& problem : unsolvable_problems()) {
    Settings settings;
    settings.max_iterations = 20;
    Guess guess;
    guess.impulse = Vector::Constant(problem.size(), 0.1);
    const Solution solution = solve(problem, settings, &guess);
    BOOST_TEST((solution.status != Status::Solved));
    BOOST_TEST(solution.factorizations <= 20 + 12);  // an attempt of Newton's is not cut short
    BOOST_TEST(solution.impulse.allFinite());
  }
}

#if SIGNORINI_COUNTS_ALLOCATIONS
BOOST_AUTO_TEST_CASE(a_warm_loop_allocates_nothing) {
  // Sizes change from step to step; guesses are exact (check), near (Newton) and far (interior point); one is missing.
  std::vector<Step> steps;
  for (const double error : {0.0, 1e-3, 10.0})
    for (const Index contacts : {3, 8, 1, 30})
      for (const bool extras : {true, false}) steps.emplace_back(contacts + 7, contacts, extras, error);
  for (const Index contacts : {3, 8}) steps.emplace_back(contacts, contacts, true, 1e-3, Law::Ccp);
  std::vector<Planted> parts;
  for (std::uint64_t seed = 1; seed <= 5; ++seed)
    parts.push_back(plant(seed, 1 + seed, Law::Ncp, Operator::Dense, seed % 2));
  const Union whole(parts);
  Guess near;
  near.impulse = whole.impulse + 1e-2 * Random(9).vector(whole.impulse.size());

  ContactProblem problem;
  Workspace workspace;
  Solution solution;
  Settings settings;
  settings.max_iterations = 60;
  BlockDelassus refilled;
  int most_factorizations = 0, fewest_factorizations = 100;
  const auto loop = [&] {
    for (std::size_t k = 0; k < steps.size(); ++k) {
      const Step& step = steps[k];
      settings.law = k + 2 >= steps.size() ? Law::Ccp : Law::Ncp;
      step.assign(problem);
      solve(problem, settings, workspace, solution, k == 5 ? nullptr : &step.guess);
      most_factorizations = std::max(most_factorizations, solution.factorizations);
    }
    settings.law = Law::Ncp;
    problem.assign(whole.delassus, whole.free_velocity, whole.sets);
    solve(problem, settings, workspace, solution, &near);
    solve(problem, settings, workspace, solution);
    settings.tolerance = settings.aim = 1e-4;  // sweeps first
    for (const Step& step : steps) {
      step.assign(problem);
      solve(problem, settings, workspace, solution, &step.guess);
      solve(problem, settings, workspace, solution);
      fewest_factorizations = std::min(fewest_factorizations, solution.factorizations);
    }
    settings.tolerance = 1e-6, settings.aim = 0.0;
  };
  loop();
  BOOST_TEST(most_factorizations > 5);  // the interior point took part: it has the solves without a guess
  BOOST_TEST(fewest_factorizations == 0);
  const long before = allocations;
  loop();
  BOOST_TEST(allocations - before == 0);
}

BOOST_AUTO_TEST_CASE(blocks_are_refilled_without_allocating) {
  const Step large(1, 8, true, 0.0), small(2, 3, false, 0.0);
  std::vector<BlockDelassus::Pair> pairs[2];
  for (const Step* step : {&large, &small})
    for (Index k = 0; k < step->delassus->num_blocks(); ++k) pairs[step == &small].push_back(step->delassus->pair(k));
  BlockDelassus delassus;
  delassus.reset(large.planted.problem.sets(), pairs[0]);
  const long before = allocations;
  delassus.reset(small.planted.problem.sets(), pairs[1]);
  delassus.reset(large.planted.problem.sets(), pairs[0]);
  BOOST_TEST(allocations - before == 0);
}

BOOST_AUTO_TEST_CASE(allocations_are_counted) {
  const long before = allocations;
  const Vector v = Vector::Ones(100);
  const std::vector<double> w(static_cast<std::size_t>(v.sum()));
  BOOST_TEST(allocations - before == 2);
}
#endif
