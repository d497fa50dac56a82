// The contact models of other engines (docs/models.md): closed forms, and what each of them is held against.
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <boost/test/unit_test.hpp>
#include <functional>

#include "signorini/solver/bisection.hpp"
#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

constexpr double kPi = 3.14159265358979323846, kMass = 3.0, kFriction = 0.5, kDown = 2.0;

/// A point that a push of `share` times the friction cone moves along the angle.
ContactProblem pushed(double share, double angle, double friction = kFriction) {
  const double speed = share * kFriction * kDown;
  return point_on_ground(kMass, friction, vector3(speed * std::cos(angle), speed * std::sin(angle), -kDown));
}

Settings lcp(int facets, double tolerance = 1e-10) {
  Settings settings = settings_for(SolverType::LcpPgs, tolerance);
  settings.pyramid.facets = facets;
  settings.max_iterations = 20000;
  return settings;
}

Settings convex(double impedance, double tolerance = 1e-10) {
  Settings settings = settings_for(SolverType::ConvexNewton, tolerance);
  settings.convex.impedance = impedance;
  return settings;
}

Settings bisection(double tolerance = 1e-10) {
  Settings settings = settings_for(SolverType::Bisection, tolerance);
  settings.max_iterations = 20000;
  return settings;
}

std::vector<Settings> all_models(double tolerance) {
  return {lcp(4, tolerance),      lcp(6, tolerance),        lcp(16, tolerance),
          convex(0.9, tolerance), convex(0.999, tolerance), bisection(tolerance)};
}

bool matches(const Vector& a, const Vector& b, double tolerance = 1e-9) {
  return (a - b).norm() <= tolerance * std::max(1.0, b.norm());
}

}  // namespace

BOOST_AUTO_TEST_CASE(sliding_along_an_axis_is_exact_but_for_the_convex_model) {
  const Vector impulse = kMass * vector3(-kFriction * kDown, 0.0, kDown);
  for (const Settings& settings : {lcp(4), lcp(6), lcp(8), lcp(64), bisection()}) {
    const Solution solution = solve(pushed(1.1, 0.0), settings);
    BOOST_TEST(matches(solution.impulse, impulse), name(settings.solver) << ", " << settings.pyramid.facets);
    BOOST_TEST((solution.status == Status::Solved));
    BOOST_TEST(solution.model_residual <= settings.tolerance);
  }
}

BOOST_AUTO_TEST_CASE(pyramid_is_around_the_cone) {
  // Half way between two facets friction is mu / cos(pi / k): with 4 facets at 45 degrees a push of 1.1 moves nothing.
  for (const int facets : {4, 6, 8, 16}) {
    for (const double share : {1.1, 1.5}) {
      const double angle = kPi / facets, friction = std::min(share, 1.0 / std::cos(angle));
      const Vector along = vector3(std::cos(angle), std::sin(angle), 0.0);
      const Solution solution = solve(pushed(share, angle), lcp(facets));
      BOOST_TEST(matches(solution.velocity, (share - friction) * kFriction * kDown * along, 1e-8), facets);
      BOOST_TEST(solution.model_residual <= 1e-10);
      BOOST_TEST((solution.status == Status::Stalled));  // its own model is solved, the law is not
      BOOST_TEST(solution.residual.primal > 0.0);        // outside the cone
    }
  }
  BOOST_TEST(matches(solve(pushed(1.1, kPi / 4.0), lcp(8)).velocity,
                     0.1 * kFriction * kDown * vector3(std::sqrt(0.5), std::sqrt(0.5), 0.0)));
}

BOOST_AUTO_TEST_CASE(sticking_point) {
  const Vector g = pushed(0.9, 0.3).free_velocity();
  for (const Settings& settings : {lcp(4), lcp(8), bisection()}) {
    const Solution solution = solve(pushed(0.9, 0.3), settings);
    BOOST_TEST(matches(solution.impulse, -kMass * g), name(settings.solver));
    BOOST_TEST((solution.status == Status::Solved));
  }
  // The convex model gives in to every force: G + R = 1 / (m d).
  for (const double d : {0.5, 0.9, 0.999}) {
    const Solution solution = solve(pushed(0.9, 0.3), convex(d));
    BOOST_TEST(matches(solution.impulse, -d * kMass * g));
    BOOST_TEST(matches(solution.velocity, (1.0 - d) * g));
    BOOST_TEST((solution.status == Status::Stalled));
  }
}

BOOST_AUTO_TEST_CASE(convex_model_lifts_what_slides) {
  const Solution solution = solve(pushed(1.5, 0.7), convex(1.0 - 1e-6, 1e-8));
  const double speed = solution.velocity.head<2>().norm();
  BOOST_TEST(speed > 0.1);
  BOOST_TEST(std::abs(solution.velocity[2] - kFriction * speed) <= 1e-5);
  for (const Settings& settings : {lcp(8), bisection()})
    BOOST_TEST(std::abs(solve(pushed(1.5, 0.7), settings).velocity[2]) <= 1e-12);
}

BOOST_AUTO_TEST_CASE(without_friction_all_are_one_model) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    Random random(seed);
    const Index contacts = 5, n = 3 * contacts;
    const Matrix root = random.matrix(n, n + 3);
    const ContactProblem problem(dense(root * root.transpose()), random.vector(n),
                                 ConstraintSets::friction_cones(Vector::Zero(contacts)));
    const Vector expected = solve(problem, settings_for(SolverType::Auto, 1e-11)).impulse;
    for (const Settings& settings : {lcp(4, 1e-11), lcp(8, 1e-11), bisection(1e-11)})
      BOOST_TEST(matches(solve(problem, settings).impulse, expected, 1e-8), name(settings.solver));
    BOOST_TEST(matches(solve(problem, convex(1.0 - 1e-6, 1e-9)).impulse, expected, 1e-3));
  }
}

BOOST_AUTO_TEST_CASE(one_contact_by_bisection_has_the_least_energy_that_stops_the_normal) {
  Random random(7);
  int slips = 0;
  for (int k = 0; k < 300; ++k) {
    const Matrix root = random.matrix(3, 4);
    const Eigen::Matrix3d g = root * root.transpose() + 0.05 * Matrix::Identity(3, 3);
    const double mu = random.uniform(0.05, 1.5);
    const Eigen::Vector3d c = random.vector(3, 1.0);
    Eigen::Vector3d x;
    solve_contact_by_bisection(g, g.inverse(), mu, c.data(), x.data());
    const Eigen::Vector3d sigma = g * x + c;
    if (c[2] >= 0.0) {
      BOOST_TEST(x.norm() == 0.0);
      continue;
    }
    // Signorini, and the cone.
    BOOST_TEST(std::abs(sigma[2]) <= 1e-12 * (1.0 + g.norm() * x.norm()));
    BOOST_TEST(x.head<2>().norm() <= mu * x[2] * (1.0 + 1e-12));
    if (sigma.norm() <= 1e-10) continue;
    ++slips;
    const auto energy = [&](const Eigen::Vector3d& y) { return 0.5 * y.dot(g * y) + c.dot(y); };
    double least = kInfinity;
    for (int i = 0; i < 3600; ++i) {
      const Eigen::Vector3d edge(mu * std::cos(kPi * i / 1800), mu * std::sin(kPi * i / 1800), 1.0);
      const double denominator = g.row(2).dot(edge);
      if (denominator > 0.0) least = std::min(least, energy(-c[2] / denominator * edge));
    }
    BOOST_TEST(energy(x) <= least + 1e-12 * (1.0 + std::abs(least)));
  }
  BOOST_TEST(slips > 50);
}

BOOST_AUTO_TEST_CASE(bisection_is_coulomb_where_normal_and_tangent_do_not_couple_and_else_is_not) {
  Matrix g = Matrix::Identity(3, 3);
  g(0, 0) = 2.0;
  const ConstraintSets cone = ConstraintSets::friction_cones(Vector::Constant(1, kFriction));
  const Vector free = vector3(1.0, 1.5, -1.0);
  BOOST_TEST((solve(ContactProblem(dense(g), free, cone), bisection()).status == Status::Solved));
  g(0, 2) = g(2, 0) = 0.4;
  const Solution coupled = solve(ContactProblem(dense(g), free, cone), bisection());
  BOOST_TEST((coupled.status == Status::Stalled));
  BOOST_TEST(coupled.model_residual <= 1e-10);
  BOOST_TEST(coupled.residual.signorini <= 1e-12);
  BOOST_TEST(coupled.residual.dissipation > 1e-3);
}

BOOST_AUTO_TEST_CASE(each_model_is_solved) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    for (const Operator type : kOperators) {
      const Planted planted = plant(seed, 6, Law::Ncp, type, seed % 2 == 0);
      for (const Settings& settings : all_models(1e-9)) {
        const Solution solution = solve(planted.problem, settings);
        BOOST_TEST_CONTEXT(name(settings.solver) << ", " << operator_name(type) << ", seed " << seed) {
          BOOST_TEST(solution.model_residual < 1e-8);
          const Residual certificate = residual(planted.problem, solution.impulse);
          BOOST_TEST(solution.residual.relative == certificate.relative);
          BOOST_TEST((solution.status == Status::Solved) == certificate.solves(settings.tolerance));
          BOOST_TEST((solution.solver == settings.solver));
          Guess guess;
          guess.impulse = solution.impulse;
          BOOST_TEST(solve(planted.problem, settings, &guess).iterations <= 2);
        }
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(models_from_the_answer_of_a_problem_nearby) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Planted planted = plant(seed, 6, Law::Ncp);
    const Vector free = planted.problem.free_velocity();
    const ContactProblem nearby(planted.problem.delassus_ptr(), 1.05 * free + 0.02 * Random(seed).vector(free.size()),
                                planted.problem.sets());
    for (const Settings& settings : all_models(1e-9)) {
      Guess guess;
      guess.impulse = solve(planted.problem, settings).impulse;
      const Solution warm = solve(nearby, settings, &guess), cold = solve(nearby, settings);
      BOOST_TEST(warm.model_residual <= 1e-9, name(settings.solver) << ", " << settings.pyramid.facets);
      BOOST_TEST(matches(warm.velocity, cold.velocity, 1e-6));
    }
  }
}

BOOST_AUTO_TEST_CASE(convex_model_is_the_ccp_of_a_compliant_problem) {
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    for (const Operator type : kOperators) {
      const Planted planted = plant(seed, 6, Law::Ccp, type, true);
      for (const double d : {0.7, 0.99}) {
        const Vector compliance = (1.0 - d) / d * planted.problem.scale();
        const ContactProblem compliant(planted.problem.delassus_ptr(), planted.problem.free_velocity(),
                                       planted.problem.sets(), compliance);
        const Vector impulse = solve(planted.problem, convex(d, 1e-11)).impulse;
        BOOST_TEST(residual(compliant, impulse, Law::Ccp).relative <= 1e-9, operator_name(type) << ", seed " << seed);
      }
    }
  }
}

BOOST_AUTO_TEST_CASE(convex_newton_is_quick_from_anywhere) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Planted planted = plant(seed, 8, Law::Ncp, Operator::MassSpace, true);
    Guess far;
    far.impulse = 1e3 * Random(seed).vector(planted.problem.size());
    for (const Guess* guess : {static_cast<const Guess*>(nullptr), static_cast<const Guess*>(&far)}) {
      const Solution solution = solve(planted.problem, convex(0.95, 1e-10), guess);
      BOOST_TEST(solution.model_residual <= 1e-10);
      BOOST_TEST(solution.iterations <= 15);
      BOOST_TEST(solution.factorizations == solution.iterations);
    }
  }
}

BOOST_AUTO_TEST_CASE(lines_and_equalities_where_nothing_slips) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {  // one contact, which sticks; a half line each way; and so on
    const Planted planted = plant(seed, 1, Law::Ncp, Operator::Dense, true);
    for (const Settings& settings : {lcp(4, 1e-9), lcp(10, 1e-9), bisection(1e-9)}) {
      const Solution solution = solve(planted.problem, settings);
      BOOST_TEST((solution.status == Status::Solved), name(settings.solver) << ", seed " << seed);
      BOOST_TEST((solution.velocity - planted.velocity).norm() <= 1e-6);
    }
  }
}

BOOST_AUTO_TEST_CASE(statuses_of_models_that_do_not_end) {
  const Planted planted = plant(3, 6, Law::Ncp);
  for (Settings settings : all_models(1e-9)) {
    settings.max_iterations = 1;
    const Solution solution = solve(planted.problem, settings);
    BOOST_TEST((solution.status == Status::MaxIterations), name(settings.solver));
    BOOST_TEST(solution.iterations == 1);
    BOOST_TEST(solution.model_residual > 1e-9);
  }
  Settings just = lcp(4);  // solved by the one sweep that is allowed
  just.max_iterations = 1;
  BOOST_TEST((solve(pushed(1.1, kPi / 4.0), just).status == Status::Stalled));
  for (const ContactProblem& problem : unsolvable_problems()) {
    for (Settings settings : all_models(1e-9)) {
      settings.max_iterations = 200;
      const Solution solution = solve(problem, settings);
      BOOST_TEST((solution.status != Status::Solved), name(settings.solver));
      BOOST_TEST(solution.impulse.allFinite());
    }
  }
}

BOOST_AUTO_TEST_CASE(exact_methods_report_their_certificate_as_residual) {
  const Planted planted = plant(5, 6, Law::Ncp);
  for (const SolverType solver : kAllSolvers) {
    const Solution solution = solve(planted.problem, settings_for(solver));
    BOOST_TEST(solution.model_residual == solution.residual.relative, name(solver));
  }
}

BOOST_AUTO_TEST_CASE(bad_settings_are_refused) {
  const ContactProblem problem = pushed(1.0, 0.0);
  const auto field = [&](const std::function<void(Settings&)>& change) {
    Settings settings;
    change(settings);
    return refused_field([&] { solve(problem, settings); });
  };
  for (const int facets : {-4, 0, 2, 5, 66})
    BOOST_TEST(field([=](Settings& s) { s.pyramid.facets = facets; }) == "facets");
  for (const double d : {0.0, -1.0, 1.0, 2.0, kNan})
    BOOST_TEST(field([=](Settings& s) { s.convex.impedance = d; }) == "impedance");
  for (const double share : {0.0, -0.1, 1.1, kNan})
    BOOST_TEST(field([=](Settings& s) { s.bisection.least_relaxation = share; }) == "least_relaxation");
  for (const double decay : {-0.1, 1.1, kNan})
    BOOST_TEST(field([=](Settings& s) { s.bisection.relaxation_decay = decay; }) == "relaxation_decay");
}
