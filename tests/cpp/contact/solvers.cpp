// Closed forms, for every solver. Each answer is judged by the certificate, asked anew.
#include <Eigen/LU>
#include <boost/test/unit_test.hpp>
#include <cstring>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// Solves, checks that the status is the certificate's and that everything else is filled in.
Solution solved(const ContactProblem& problem, const Settings& settings, const Guess* guess = nullptr) {
  const Solution solution = solve(problem, settings, guess);
  Vector velocity;
  const Residual certificate = residual(problem, solution.impulse, settings.law, &velocity);
  BOOST_TEST(solution.residual.relative == certificate.relative);
  BOOST_TEST(certificate.solves(settings.tolerance), name(settings.solver) << ": " << certificate.relative);
  BOOST_TEST((solution.status == Status::Solved) == certificate.solves(settings.tolerance));
  BOOST_TEST((solution.solver == settings.solver || settings.solver == SolverType::Auto));
  BOOST_TEST((solution.velocity - velocity).norm() <= 1e-12 * (1.0 + velocity.norm()));
  BOOST_TEST(solution.seconds >= 0.0);
  return solution;
}

template <typename Function>
void for_all_solvers(Function&& function) {
  for (const SolverType solver : kAllSolvers) {
    BOOST_TEST_CONTEXT(name(solver)) { function(settings_for(solver)); }
  }
}

bool nearly(const Vector& a, const Vector& b, double tolerance = 1e-6) {
  return (a - b).norm() <= tolerance * std::max(1e-300, b.norm());
}

}  // namespace

BOOST_AUTO_TEST_CASE(sticks_at_nine_tenths_of_the_cone) {
  for_all_solvers([](const Settings& settings) {
    const double mu = 0.5, mass = 3.0;
    const Vector g = vector3(0.9 * mu * 2.0 * 0.6, -0.9 * mu * 2.0 * 0.8, -2.0);
    const Solution solution = solved(point_on_ground(mass, mu, g), settings);
    BOOST_TEST(nearly(solution.impulse, -mass * g));
    BOOST_TEST(solution.velocity.norm() <= 1e-6);
  });
}

BOOST_AUTO_TEST_CASE(slips_at_eleven_tenths_of_the_cone) {
  for_all_solvers([](const Settings& settings) {
    const double mu = 0.5, mass = 3.0;
    const Vector direction = vector3(0.6, -0.8, 0.0);
    const Vector g = 1.1 * mu * 2.0 * direction + vector3(0.0, 0.0, -2.0);
    const Solution solution = solved(point_on_ground(mass, mu, g), settings);
    BOOST_TEST(nearly(solution.impulse, mass * (vector3(0.0, 0.0, 2.0) - mu * 2.0 * direction)));
    BOOST_TEST(nearly(solution.velocity, 0.1 * mu * 2.0 * direction));  // and no hop
  });
}

BOOST_AUTO_TEST_CASE(the_relaxation_hops_when_it_slips) {
  for_all_solvers([](Settings settings) {
    settings.law = Law::Ccp;
    const double mu = 0.5;
    const Vector g = vector3(2.0, 0.0, -2.0);
    Vector expected(3);  // of the relaxation: the projection of -g on the cone
    project_friction_cone(mu, Vector(-g).data(), expected.data());
    const Solution solution = solved(point_on_ground(1.0, mu, g), settings);
    BOOST_TEST(nearly(solution.impulse, expected));
    BOOST_TEST(solution.velocity[2] > 0.1);
  });
}

BOOST_AUTO_TEST_CASE(no_force_on_what_separates) {
  for_all_solvers([](const Settings& settings) {
    const Vector g = vector3(5.0, 1.0, 0.01);
    const Solution solution = solved(point_on_ground(3.0, 0.9, g), settings);
    BOOST_TEST(solution.impulse.norm() <= 1e-7);
    BOOST_TEST(nearly(solution.velocity, g));
  });
  for (const SolverType solver : {SolverType::Auto, SolverType::Admm, SolverType::Pgs}) {
    BOOST_TEST(solve(point_on_ground(3.0, 0.9, vector3(5.0, 1.0, 0.01)), settings_for(solver)).impulse.norm() == 0.0);
  }
}

BOOST_AUTO_TEST_CASE(without_friction_tangents_are_free) {
  for_all_solvers([](const Settings& settings) {
    const Solution solution = solved(point_on_ground(2.0, 0.0, vector3(3.0, -1.0, -4.0)), settings);
    BOOST_TEST(nearly(solution.impulse, vector3(0.0, 0.0, 8.0)));
    BOOST_TEST(nearly(solution.velocity, vector3(3.0, -1.0, 0.0)));
  });
}

BOOST_AUTO_TEST_CASE(huge_friction_sticks) {
  for_all_solvers([](Settings settings) {
    settings.tolerance = 1e-6;
    const Vector g = vector3(3.0, -1.0, -4.0);
    BOOST_TEST(nearly(solved(point_on_ground(2.0, 1e3, g), settings).impulse, -2.0 * g, 1e-4));
  });
}

BOOST_AUTO_TEST_CASE(nothing_moves_nothing_to_do) {
  for_all_solvers([](const Settings& settings) {
    const Solution solution = solved(point_on_ground(2.0, 0.5, vector3(0.0, 0.0, 0.0)), settings);
    BOOST_TEST(solution.impulse.norm() == 0.0);
  });
}

BOOST_AUTO_TEST_CASE(no_contacts) {
  for (const ContactProblem& problem :
       {ContactProblem(), ContactProblem(dense(Matrix(0, 0)), Vector(0), ConstraintSets())})
    for_all_solvers([&](const Settings& settings) {
      const Solution solution = solved(problem, settings);
      BOOST_TEST((solution.status == Status::Solved));
      BOOST_TEST(solution.impulse.size() == 0);
    });
}

BOOST_AUTO_TEST_CASE(compliance_gives_way) {
  for_all_solvers([](const Settings& settings) {
    const double mass = 2.0, compliance = 0.7;
    const Vector r = vector3(0.0, 0.0, compliance);
    const Solution solution = solved(point_on_ground(mass, 0.5, vector3(0.0, 0.0, -3.0), r), settings);
    BOOST_TEST(nearly(solution.impulse, vector3(0.0, 0.0, 3.0 / (1.0 / mass + compliance))));
  });
}

BOOST_AUTO_TEST_CASE(gauss_seidel_keeps_the_velocity_of_a_soft_contact) {
  // Its sweeps update the velocity, compliance included, and compute it anew every tenth time only. Under-relaxed, so
  // that more than ten are needed: then the first ones that miss the compliance overshoot for good.
  const double mass = 2.0, compliance = 50.0;
  Settings settings = settings_for(SolverType::Pgs, 1e-10);
  settings.pgs.over_relaxation = 0.5;
  settings.max_iterations = 100;
  const Vector r = vector3(compliance, compliance, compliance), g = vector3(0.3, -0.4, -3.0);
  const Solution solution = solved(point_on_ground(mass, 0.5, g, r), settings);
  BOOST_TEST(nearly(solution.impulse, -g / (1.0 / mass + compliance)));
  BOOST_TEST(solution.iterations > 10);
}

BOOST_AUTO_TEST_CASE(a_million_times_heavier_on_top) {
  // A point of mass 1 on the ground, one of mass 1e6 on it; both fall at 1 and slide, within their cones.
  const double light = 1.0, heavy = 1e6;
  Matrix g = Matrix::Zero(6, 6);
  const Matrix identity = Matrix::Identity(3, 3);
  g.topLeftCorner(3, 3) = identity / light;
  g.topRightCorner(3, 3) = g.bottomLeftCorner(3, 3) = -identity / light;
  g.bottomRightCorner(3, 3) = identity * (1.0 / light + 1.0 / heavy);
  Vector free(6), expected(6);
  free << 0.1, 0.0, -1.0, 0.0, 0.0, 0.0;
  expected << -0.1 * (light + heavy), 0.0, light + heavy, -0.1 * heavy, 0.0, heavy;
  const ContactProblem problem(dense(g), free, ConstraintSets::friction_cones(Vector::Constant(2, 0.5)));
  // Gauss-Seidel contracts by a factor of 1 - 1e-6 a sweep here, and Newton promises nothing from far away.
  for (const SolverType solver : {SolverType::Auto, SolverType::Admm, SolverType::InteriorPoint}) {
    BOOST_TEST_CONTEXT(name(solver)) {
      const Solution solution = solved(problem, settings_for(solver, 1e-9));
      BOOST_TEST(nearly(solution.impulse, expected, 1e-2));  // the certificate over a condition number of 1e6
    }
  }
}

BOOST_AUTO_TEST_CASE(half_line_interval_and_equality_alone) {
  ConstraintSets sets;
  sets.add_half_line();
  sets.add_half_line();
  sets.add_interval(-1.0, 2.0);
  sets.add_interval(-1.0, 2.0);
  sets.add_interval(-1.0, 2.0);
  sets.add_equality();
  Vector diagonal(6), free(6), expected(6);
  diagonal << 2.0, 2.0, 4.0, 4.0, 4.0, 0.5;
  free << -3.0, 3.0, -2.0, -20.0, 20.0, 5.0;
  expected << 1.5, 0.0, 0.5, 2.0, -1.0, -10.0;
  const ContactProblem problem(dense(diagonal.asDiagonal()), free, sets);
  for_all_solvers([&](const Settings& settings) { BOOST_TEST(nearly(solved(problem, settings).impulse, expected)); });
}

BOOST_AUTO_TEST_CASE(an_interval_without_zero) {
  ConstraintSets sets;
  sets.add_interval(1.0, 2.0);
  const ContactProblem problem(dense(Matrix::Identity(1, 1)), Vector::Constant(1, 5.0), sets);
  for_all_solvers([&](const Settings& settings) {
    BOOST_TEST(nearly(solved(problem, settings).impulse, Vector::Constant(1, 1.0)));
  });
}

BOOST_AUTO_TEST_CASE(coupled_half_lines_and_an_equality) {
  // The second half line opens; the other two rows are a linear system.
  Matrix g(3, 3);
  g << 2.0, 0.5, -0.7, 0.5, 1.0, 0.3, -0.7, 0.3, 3.0;
  const Vector free = vector3(-1.0, 4.0, 0.5);
  ConstraintSets sets;
  sets.add_half_line();
  sets.add_half_line();
  sets.add_equality();
  Eigen::Matrix2d active;
  active << 2.0, -0.7, -0.7, 3.0;
  const Eigen::Vector2d x = active.inverse() * Eigen::Vector2d(1.0, -0.5);
  const ContactProblem problem(dense(g), free, sets);
  for_all_solvers([&](const Settings& settings) {
    BOOST_TEST(nearly(solved(problem, settings).impulse, vector3(x[0], 0.0, x[1])));
  });
}

BOOST_AUTO_TEST_CASE(four_feet_share_a_load) {
  // Hyperstatic: impulses are not unique, their sum and the velocities are.
  const double mass = 5.0;
  Matrix jacobian(12, 3);
  for (int foot = 0; foot < 4; ++foot) jacobian.middleRows(3 * foot, 3) = Matrix::Identity(3, 3);
  const Vector body = vector3(0.2, 0.0, -1.0);
  const ContactProblem problem(dense(jacobian * jacobian.transpose() / mass), jacobian * body,
                               ConstraintSets::friction_cones(Vector::Constant(4, 0.5)));
  for_all_solvers([&](const Settings& settings) {
    const Solution solution = solved(problem, settings);
    BOOST_TEST(nearly(jacobian.transpose() * solution.impulse, -mass * body));
    BOOST_TEST(solution.velocity.norm() <= 1e-6);
  });
}

BOOST_AUTO_TEST_CASE(out_of_iterations_is_said) {
  const Planted planted = plant(41, 9, Law::Ncp);
  for_all_solvers([&](Settings settings) {
    settings.max_iterations = 1;
    settings.tolerance = 1e-12;
    const Solution solution = solve(planted.problem, settings);
    const Residual certificate = residual(planted.problem, solution.impulse);
    BOOST_TEST(certificate.relative == solution.residual.relative);
    BOOST_TEST((solution.status == Status::Solved) == certificate.solves(1e-12));
    BOOST_TEST(solution.impulse.allFinite());
  });
}

BOOST_AUTO_TEST_CASE(what_has_no_solution_is_never_solved) {
  for (const ContactProblem& problem : unsolvable_problems()) {
    Guess huge;
    huge.impulse = Vector::Zero(problem.size());
    for (const ConstraintSet& set : problem.sets()) huge.impulse[set.offset + set.size() - 1] = 1e12;
    for_all_solvers([&](Settings settings) {
      for (const Law law : {Law::Ncp, Law::Ccp}) {
        for (const double tolerance : {1e-8, 1e-2}) {
          settings.law = law;
          settings.tolerance = tolerance;
          for (const Guess* guess : {static_cast<const Guess*>(nullptr), static_cast<const Guess*>(&huge)}) {
            const Solution solution = solve(problem, settings, guess);
            BOOST_TEST((solution.status != Status::Solved));
            BOOST_TEST(solution.residual.against_free_velocity > Residual::largest_share(settings.tolerance));
            BOOST_TEST(solution.impulse.allFinite());
          }
        }
      }
    });
  }
}

BOOST_AUTO_TEST_CASE(auto_says_infeasible_where_a_ray_proves_it) {
  Settings settings;
  for (const ContactProblem& problem : unsolvable_problems())
    for (const Law law : {Law::Ncp, Law::Ccp}) {
      settings.law = law;
      BOOST_TEST((solve(problem, settings).status == Status::Infeasible));
    }
  // A block with given tangential velocity slides between two walls: the CCP wants it to part from both, the NCP not.
  Matrix g = Matrix::Zero(6, 6);
  g(2, 2) = g(5, 5) = 0.5, g(2, 5) = g(5, 2) = -0.5;
  Vector free = Vector::Zero(6);
  free[0] = free[3] = 1.0;
  for (const double closing : {0.0, 0.2}) {  // of one wall, which the other gives way to
    free[2] = -closing, free[5] = closing;
    const ContactProblem problem(dense(g), free, ConstraintSets::friction_cones(Vector::Constant(2, 0.5)));
    settings.law = Law::Ccp;
    BOOST_TEST((solve(problem, settings).status == Status::Infeasible));
    settings.law = Law::Ncp;
    solved(problem, settings);
  }
  // Few factorisations are no proof.
  settings.max_iterations = 3;
  BOOST_TEST((solve(unsolvable_problems().front(), settings).status != Status::Infeasible));
}

BOOST_AUTO_TEST_CASE(history_ends_with_the_answer) {
  const Planted planted = plant(42, 4, Law::Ncp);
  for (const SolverType solver : {SolverType::Admm, SolverType::Pgs}) {
    Settings settings = settings_for(solver, 1e-6);
    settings.record_history = true;
    const Solution solution = solved(planted.problem, settings);
    BOOST_REQUIRE(solution.history.size() == static_cast<std::size_t>(solution.iterations));
    BOOST_TEST(solution.iterations > 0);
    BOOST_TEST(solution.history.front().iteration == 1);
    BOOST_TEST(solution.history.back().iteration == solution.iterations);
    BOOST_TEST(solution.history.back().residual.solves(1e-6));
    BOOST_TEST(solution.history.back().factorizations == solution.factorizations);
    if (solver == SolverType::Admm) BOOST_TEST(solution.history.back().penalty == solution.penalty);
  }
}

BOOST_AUTO_TEST_CASE(newton_interior_point_and_auto_keep_a_history_too) {
  const Planted planted = plant(42, 3, Law::Ncp);  // one island
  Guess guess;
  guess.impulse = planted.impulse + 1e-3 * Random(47).vector(planted.problem.size());
  for (const SolverType solver : {SolverType::Auto, SolverType::InteriorPoint, SolverType::Newton}) {
    for (const Guess* start : {static_cast<const Guess*>(nullptr), static_cast<const Guess*>(&guess)}) {
      if (solver == SolverType::Newton && !start) continue;
      BOOST_TEST_CONTEXT(name(solver) << (start ? ", warm" : ", cold")) {
        Settings settings = settings_for(solver, 1e-6);  // rounding stops the interior point below
        const Solution plain = solved(planted.problem, settings, start);
        BOOST_TEST(plain.history.empty());
        settings.record_history = true;
        const Solution solution = solved(planted.problem, settings, start);
        BOOST_TEST(solution.impulse == plain.impulse);  // watching changes nothing
        BOOST_REQUIRE(!solution.history.empty());
        double best = kInfinity;
        for (std::size_t k = 0; k < solution.history.size(); ++k) {
          const IterationRecord& record = solution.history[k];
          BOOST_TEST(record.iteration == solution.history.front().iteration + static_cast<int>(k));
          BOOST_TEST(record.penalty == 0.0);
          if (k > 0) BOOST_TEST(record.factorizations >= solution.history[k - 1].factorizations);
          best = std::min(best, record.residual.relative);
        }
        BOOST_TEST(best <= 1e-5);  // the last iterate, not yet put into the cones
        BOOST_TEST(solution.history.back().factorizations == solution.factorizations);
        BOOST_TEST(solution.history.size() >= static_cast<std::size_t>(solution.iterations));
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(the_answer_names_the_method_that_found_it) {
  const Planted planted = plant(42, 4, Law::Ncp);
  Guess guess;
  guess.impulse = planted.impulse + 1e-6 * Random(48).vector(planted.problem.size());
  const Settings automatic = settings_for(SolverType::Auto);
  for (const SolverType solver : kAllSolvers) {
    if (solver == SolverType::Auto) continue;
    BOOST_TEST((solve(planted.problem, settings_for(solver), &guess).solver == solver));
  }
  BOOST_TEST((solved(planted.problem, automatic, &guess).solver == SolverType::Newton));
  const SolverType cold = solved(planted.problem, automatic).solver;
  BOOST_TEST((cold == SolverType::Newton || cold == SolverType::InteriorPoint));
  // Nothing to find: an impulse of zero, or a guess that solves.
  BOOST_TEST((solved(point_on_ground(1.0, 0.5, vector3(0.0, 0.0, 1.0)), automatic).solver == SolverType::Auto));
  guess.impulse = planted.impulse;
  BOOST_TEST((solved(planted.problem, automatic, &guess).solver == SolverType::Auto));
}

BOOST_AUTO_TEST_CASE(a_good_guess_costs_no_factorisation) {
  const Planted planted = plant(43, 6, Law::Ncp);
  Guess guess;
  guess.impulse = planted.impulse;
  for (const SolverType solver : {SolverType::Auto, SolverType::Admm, SolverType::Pgs}) {
    const Solution solution = solved(planted.problem, settings_for(solver), &guess);
    BOOST_TEST(solution.iterations == 0);
    BOOST_TEST(solution.factorizations == 0);
  }
}

BOOST_AUTO_TEST_CASE(the_papers_stop_test_does_not_make_it_solved) {
  // (43) at 1e-2, absolute, holds long before the certificate does at 1e-9.
  const Planted planted = plant(44, 9, Law::Ncp);
  Settings settings = settings_for(SolverType::Admm, 1e-9);
  settings.admm = AdmmSettings::paper(1e-2);
  const Solution early = solve(planted.problem, settings);
  BOOST_TEST((early.status != Status::Solved));
  BOOST_TEST(early.residual.relative < 0.1);
  settings.admm.paper_tolerance = 0.0;
  const Solution late = solved(planted.problem, settings);
  BOOST_TEST(late.iterations > early.iterations);
}

BOOST_AUTO_TEST_CASE(same_input_same_bits) {
  const Planted planted = plant(45, 9, Law::Ncp, Operator::Sparse, true);
  const Planted other = plant(46, 5, Law::Ncp, Operator::Dense);
  const auto same = [](const Vector& a, const Vector& b) {
    return a.size() == b.size() &&
           std::memcmp(a.data(), b.data(), sizeof(double) * static_cast<std::size_t>(a.size())) == 0;
  };
  for_all_solvers([&](Settings settings) {
    settings.tolerance = 1e-6;
    const Solution first = solve(planted.problem, settings);
    Workspace workspace;  // used for another problem, of another size and kind, and for the same one, in between
    Solution again;
    solve(other.problem, settings, workspace, again);
    solve(planted.problem, settings, workspace, again);
    solve(planted.problem, settings, workspace, again);
    BOOST_TEST(same(first.impulse, again.impulse));
    BOOST_TEST(same(first.velocity, again.velocity));
    BOOST_TEST(first.iterations == again.iterations);
    BOOST_TEST(first.factorizations == again.factorizations);
  });
}
