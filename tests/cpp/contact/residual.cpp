#include "signorini/problem/residual.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

bool all_nan(const Residual& r) {
  for (const double x :
       {r.primal, r.dual, r.complementarity, r.relative, r.against_free_velocity, r.signorini, r.dissipation}) {
    if (!std::isnan(x)) return false;
  }
  return true;
}

bool near(double a, double b, double tolerance = 1e-14) { return std::abs(a - b) <= tolerance * std::abs(b); }

}  // namespace

BOOST_AUTO_TEST_CASE(a_falling_point_that_nothing_stops) {
  const ContactProblem problem = point_on_ground(2.0, 0.5, vector3(0.0, 0.0, -3.0));
  Vector velocity;
  const Residual r = residual(problem, Vector::Zero(3), Law::Ncp, &velocity);
  BOOST_TEST(velocity == vector3(0.0, 0.0, -3.0));
  BOOST_TEST(r.primal == 0.0);
  BOOST_TEST(r.dual == 3.0);
  BOOST_TEST(r.complementarity == 0.0);
  BOOST_TEST(near(r.relative, 1.0));
  BOOST_TEST(near(r.against_free_velocity, 1.0));
  BOOST_TEST(r.signorini == 3.0);
  BOOST_TEST(!r.solves(0.9));
}

BOOST_AUTO_TEST_CASE(half_of_the_impulse_leaves_half_of_the_residual) {
  const ContactProblem problem = point_on_ground(2.0, 0.5, vector3(0.0, 0.0, -3.0));
  const Residual r = residual(problem, vector3(0.0, 0.0, 3.0));  // sigma_N = -1.5
  BOOST_TEST(near(r.dual, 1.5));
  BOOST_TEST(near(r.complementarity, 4.5));
  BOOST_TEST(near(r.relative, 0.5));
  BOOST_TEST(near(r.signorini, 1.5));
}

BOOST_AUTO_TEST_CASE(an_impulse_outside_the_cone) {
  const ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, 0.0));
  BOOST_TEST(near(residual(problem, vector3(1.0, 0.0, 0.0)).primal, std::sqrt(0.8)));
  const Residual pull = residual(problem, vector3(0.0, 0.0, -2.0));
  BOOST_TEST(pull.primal == 2.0);
  BOOST_TEST(pull.signorini == 2.0);
}

BOOST_AUTO_TEST_CASE(sliding_against_coulomb_and_not_against_the_relaxation) {
  // Slides at 1 with full friction and no normal velocity: solves the NCP; the relaxation would lift it off.
  const ContactProblem problem = point_on_ground(1.0, 0.5, vector3(2.0, 0.0, -2.0));
  const Vector impulse = vector3(-1.0, 0.0, 2.0);
  const Residual ncp = residual(problem, impulse, Law::Ncp), ccp = residual(problem, impulse, Law::Ccp);
  BOOST_TEST(ncp.relative <= 1e-16);
  BOOST_TEST(ncp.dissipation <= 1e-16);
  BOOST_TEST(ccp.relative > 0.1);
  BOOST_TEST(near(ccp.dual, 0.5 / std::sqrt(1.25)));  // dist((1, 0, 0), K*), K* = {0.5 |x_T| <= x_N}
  // Friction half as strong as it could be: not of maximum dissipation.
  BOOST_TEST(near(residual(problem, vector3(-0.5, 0.0, 2.0)).dissipation, 0.75));
}

BOOST_AUTO_TEST_CASE(half_line_interval_and_equality) {
  ConstraintSets sets;
  sets.add_half_line();
  sets.add_interval(-1.0, 2.0);
  sets.add_equality();
  const ContactProblem problem(dense(Matrix::Identity(3, 3)), vector3(-2.0, 3.0, 4.0), sets);
  // The interval is at its lower end and pushed there (s = 2): that solves it.
  const Residual solved = residual(problem, vector3(2.0, -1.0, -4.0));
  BOOST_TEST(solved.relative == 0.0);
  BOOST_TEST(solved.complementarity == 0.0);
  const Residual r = residual(problem, vector3(0.0, 0.0, 0.0));
  BOOST_TEST(r.dual == 4.0);             // the equality's velocity; the half line's is -2
  BOOST_TEST(r.complementarity == 3.0);  // (0 - lower) * 3
  BOOST_TEST(r.relative == 1.0);
  BOOST_TEST(residual(problem, vector3(-1.0, 5.0, 0.0)).primal == 3.0);
}

BOOST_AUTO_TEST_CASE(compliance_counts) {
  const ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, -3.0), Vector::Constant(3, 0.5));
  BOOST_TEST(residual(problem, vector3(0.0, 0.0, 2.0)).relative <= 1e-16);
  BOOST_TEST(residual(problem, vector3(0.0, 0.0, 3.0)).relative > 0.1);
}

BOOST_AUTO_TEST_CASE(planted_solutions_are_certified) {
  for (const Law law : {Law::Ncp, Law::Ccp}) {
    const Planted planted = plant(7, 6, law, Operator::Dense, true);
    Vector velocity;
    const Residual r = residual(planted.problem, planted.impulse, law, &velocity);
    BOOST_TEST(r.relative <= 1e-14);
    BOOST_TEST(r.primal <= 1e-14);
    BOOST_TEST(r.dual <= 1e-14);
    BOOST_TEST(r.complementarity <= 1e-14);
    BOOST_TEST((velocity - planted.velocity).norm() <= 1e-13);
    const Law other = law == Law::Ncp ? Law::Ccp : Law::Ncp;
    BOOST_TEST(residual(planted.problem, planted.impulse, other).relative > 1e-2);
  }
}

BOOST_AUTO_TEST_CASE(relative_does_not_know_units_or_masses) {
  const Planted planted = plant(8, 6, Law::Ncp);
  const Vector impulse = planted.impulse + 0.1 * Random(9).vector(planted.impulse.size());
  const double expected = residual(planted.problem, impulse).relative;
  BOOST_TEST(expected > 1e-3);
  const Matrix g = Matrix(planted.problem.delassus().matrix());
  for (const double mass : {1e-6, 1e3, 1e9}) {
    for (const double time : {1e-4, 1e5}) {
      const ContactProblem scaled(dense(g / mass), time * planted.problem.free_velocity(), planted.problem.sets());
      BOOST_TEST(near(residual(scaled, mass * time * impulse).relative, expected, 1e-10));
    }
  }
}

BOOST_AUTO_TEST_CASE(impulses_that_grow_without_bound_solve_nothing) {
  for (const ContactProblem& problem : unsolvable_problems()) {
    for (const double size : {1e3, 1e9, 1e15, 1e25}) {  // at the last, impulse - velocity is impulse but for rounding
      Vector impulse = Vector::Constant(2, size);
      if (problem.num_contacts() > 0) impulse = Vector::Unit(6, 2) + size * Vector::Unit(6, 5);
      const Residual r = residual(problem, impulse);
      BOOST_TEST(r.relative <= 2.0 / size);
      BOOST_TEST(r.against_free_velocity >= 0.5);
      BOOST_TEST(!r.solves(0.5));
    }
  }
}

BOOST_AUTO_TEST_CASE(what_is_left_of_the_free_velocity_is_at_most_1000_tolerances_and_a_tenth) {
  // Two walls that give way or not: the impulse between them is large, whatever the second one still closes with.
  Matrix g(2, 2);
  g << 1.0, -1.0, -1.0, 1.0;
  ConstraintSets sets;
  sets.add_half_line();
  sets.add_half_line();
  Residual r;
  for (const double left : {0.2, 0.09, 1e-3, 1e-6}) {
    const ContactProblem problem(dense(g), Eigen::Vector2d(-1.0, 1.0 - left), sets);
    r = residual(problem, Eigen::Vector2d(1e9 + 1.0, 1e9));  // velocities 0 and -left
    BOOST_TEST(std::abs(r.against_free_velocity - left) <= 1e-9);
    BOOST_TEST(r.relative <= 1e-9);
    for (const double tolerance : {1e-1, 1e-3, 1e-5, 1e-7, 1e-9}) {
      const double allowed = std::min(0.1, 1000.0 * tolerance);
      if (std::abs(left - allowed) > 1e-3 * allowed) BOOST_TEST(r.solves(tolerance) == (left < allowed));
      BOOST_TEST(r.solves(tolerance) == (r.excess(tolerance) <= 1.0));
    }
  }
}

BOOST_AUTO_TEST_CASE(an_impulse_that_nothing_asked_for_solves_nothing) {
  const ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, 0.0));
  BOOST_TEST(residual(problem, Vector::Zero(3)).against_free_velocity == 0.0);
  const Residual r = residual(problem, vector3(0.0, 0.0, 1e-9));
  BOOST_TEST(r.against_free_velocity == kInfinity);
  BOOST_TEST(!r.solves(0.999));
}

BOOST_AUTO_TEST_CASE(nan_is_never_solved) {
  ConstraintSets sets;
  sets.add_friction_cone(0.5);
  sets.add_half_line();
  sets.add_interval(-1.0, 1.0);
  sets.add_equality();
  const ContactProblem problem(dense(Matrix::Identity(6, 6)), Vector::Zero(6), sets);
  for (Index i = 0; i < 6; ++i) {
    for (const double bad : {kNan, kInfinity, -kInfinity}) {
      Vector impulse = Vector::Zero(6);
      impulse[i] = bad;
      const Residual r = residual(problem, impulse);
      BOOST_TEST(all_nan(r));
      BOOST_TEST(!r.solves(1e300));
    }
  }
}

BOOST_AUTO_TEST_CASE(no_rows_nothing_to_violate) {
  const ContactProblem problem(dense(Matrix(0, 0)), Vector(0), ConstraintSets());
  BOOST_TEST(residual(problem, Vector(0)).relative == 0.0);
  BOOST_TEST(residual(problem, Vector(0)).solves(1e-12));
}
