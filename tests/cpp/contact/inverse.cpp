// The impulse behind a contact velocity; physics and mathematics at length: tests/python/test_inverse_contact.py.
#include "signorini/solver/inverse.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

ConstraintSets cone(double friction) { return ConstraintSets::friction_cones(Vector::Constant(1, friction)); }

InverseSettings with_law(Law law) {
  InverseSettings settings;
  settings.law = law;
  return settings;
}

InverseSolution inverse(const ConstraintSets& sets, const Vector& c, const Vector& compliance,
                        const Vector& guess = Vector(), const InverseSettings& settings = {}, double speed = 0.0) {
  InverseSolution solution;
  if (guess.size() > 0) {
    const ConstVectorRef start(guess);
    solve_inverse(c, compliance, sets, settings, solution, &start, speed);
  } else {
    solve_inverse(c, compliance, sets, settings, solution, nullptr, speed);
  }
  return solution;
}

double error(const InverseSolution& solution, const Vector& expected) {
  return (Vector(solution.impulse) - expected).norm();
}

/// Friction cones, half lines, intervals and equalities by turns.
ConstraintSets all_kinds(int rounds) {
  ConstraintSets sets;
  for (int k = 0; k < rounds; ++k) {
    sets.add_friction_cone(0.1 + 0.3 * k);
    sets.add_half_line();
    sets.add_interval(-0.5, 1.0);
    sets.add_equality(2);
  }
  return sets;
}

}  // namespace

BOOST_AUTO_TEST_CASE(stick_slide_and_open_of_a_rigid_contact) {
  const Vector rigid = Vector::Zero(3), zero = Vector::Zero(3);
  for (const Law law : {Law::Ncp, Law::Ccp}) {
    const Vector inside = vector3(0.3, -0.2, 1.0);
    const InverseSolution stuck = inverse(cone(0.5), zero, rigid, inside, with_law(law));
    BOOST_TEST((stuck.status == Status::Solved));
    BOOST_TEST(error(stuck, inside) == 0.0);
    BOOST_TEST(stuck.iterations == 0);
    const InverseSolution open = inverse(cone(0.5), vector3(0.1, 0.0, 0.4), rigid, inside, with_law(law));
    BOOST_TEST((open.status == Status::Solved));
    BOOST_TEST(error(open, zero) == 0.0);
  }
  const Vector slip = vector3(3.0, -4.0, 0.0), ray = vector3(-0.3, 0.4, 1.0);
  BOOST_TEST(error(inverse(cone(0.5), slip, rigid), zero) == 0.0);
  for (const double pressed : {1e-3, 1.0, 500.0}) {
    const InverseSolution sliding = inverse(cone(0.5), slip, rigid, vector3(0.0, 0.0, pressed));
    BOOST_TEST((sliding.status == Status::Solved));
    BOOST_TEST(error(sliding, pressed * ray) <= 1e-9 * pressed);
    const InverseSolution again = inverse(cone(0.5), slip, rigid, Vector(sliding.impulse));
    BOOST_TEST(error(again, Vector(sliding.impulse)) <= 1e-14 * pressed);
    BOOST_TEST(again.iterations == 0);
  }
}

BOOST_AUTO_TEST_CASE(compliant_closed_forms) {
  const Vector r = vector3(4e-3, 4e-3, 1e-3), c = vector3(3.0, 4.0, -0.2);
  const InverseSolution slides = inverse(cone(0.5), c, r);
  BOOST_TEST(error(slides, vector3(-60.0, -80.0, 200.0)) <= 1e-10);
  BOOST_TEST((Vector(slides.velocity) - vector3(2.76, 3.68, 0.0)).norm() <= 1e-12);
  // The relaxation: along the edge, n (d_n + mu^2 d_t) = mu |c_T| - c_N.
  const double n = (0.5 * 5.0 + 0.2) / (1e-3 + 0.25 * 4e-3);
  const InverseSolution relaxed = inverse(cone(0.5), c, r, Vector(), with_law(Law::Ccp));
  BOOST_TEST(error(relaxed, n * vector3(-0.3, -0.4, 1.0)) <= 1e-9);
  const InverseSolution sticks = inverse(cone(0.5), vector3(0.2, 0.1, -0.2), r);
  BOOST_TEST(error(sticks, vector3(-50.0, -25.0, 200.0)) <= 1e-10);

  ConstraintSets lines;
  lines.add_half_line();
  lines.add_interval(-2.0, 3.0);
  lines.add_interval(1.0, 3.0);
  lines.add_equality();
  const Vector expected = (Vector(4) << 3.0, -2.0, 1.0, -5.0).finished();
  const InverseSolution solution =
      inverse(lines, (Vector(4) << -0.3, 0.4, 0.0, 0.5).finished(), (Vector(4) << 0.1, 0.0, 0.0, 0.1).finished());
  BOOST_TEST((solution.status == Status::Solved));
  BOOST_TEST(error(solution, expected) <= 1e-12);
}

BOOST_AUTO_TEST_CASE(forward_and_back) {
  for (const Law law : {Law::Ncp, Law::Ccp}) {
    for (int seed = 0; seed < 5; ++seed) {
      Random random(static_cast<std::uint64_t>(70 + seed));
      const Index contacts = 4, n = 3 * contacts;
      const Matrix j = random.matrix(n, n + 5), g = j * j.transpose() / 10.0;
      const Vector free = random.vector(n, 2.0);
      Vector compliance(n), friction(contacts);
      for (Index i = 0; i < contacts; ++i) {
        friction[i] = random.uniform(0.1, 1.0);
        compliance.segment(3 * i, 2).setConstant(random.uniform(0.01, 1.0));
        compliance[3 * i + 2] = random.uniform(0.01, 1.0);
      }
      const ConstraintSets sets = ConstraintSets::friction_cones(friction);
      Settings settings;
      settings.law = law;
      settings.tolerance = 1e-12;
      const Solution there = solve(ContactProblem(dense(g), free, sets, compliance), settings);
      BOOST_TEST((there.status == Status::Solved));
      const Vector impulse = there.impulse;
      const InverseSolution back = inverse(sets, g * impulse + free, compliance, Vector(), with_law(law));
      BOOST_TEST((back.status == Status::Solved));
      BOOST_TEST(error(back, impulse) <= 1e-8 * impulse.norm());
    }
  }
}

BOOST_AUTO_TEST_CASE(what_no_impulse_allows_is_infeasible) {
  const Vector rigid = Vector::Zero(3), soft = Vector::Constant(3, 1e-3);
  const Vector into = vector3(0.0, 0.0, -0.3), slip = vector3(1.0, 0.0, 0.0);
  for (const Law law : {Law::Ncp, Law::Ccp}) {
    const InverseSolution solution = inverse(cone(0.5), into, rigid, Vector(), with_law(law));
    BOOST_TEST((solution.status == Status::Infeasible));
    BOOST_TEST(std::abs(solution.residual - 0.3) <= 1e-9);
    BOOST_TEST(std::abs(solution.relative - 1.0) <= 1e-9);
    BOOST_TEST(solution.worst == 0);
    BOOST_TEST((inverse(cone(0.5), into, soft, Vector(), with_law(law)).status == Status::Solved));
    BOOST_TEST((inverse(cone(0.5), slip, soft, Vector(), with_law(law)).status == Status::Solved));
  }
  BOOST_TEST((inverse(cone(0.5), slip, rigid).status == Status::Solved));
  const InverseSolution relaxed = inverse(cone(0.5), slip, rigid, Vector(), with_law(Law::Ccp));
  BOOST_TEST((relaxed.status == Status::Infeasible));
  BOOST_TEST(relaxed.residual >= 0.5 / std::hypot(1.0, 0.5) * (1.0 - 1e-6));  // to the dual cone

  ConstraintSets lines;
  lines.add_equality();
  lines.add_half_line();
  lines.add_interval(-kInfinity, 1.0);
  for (int bad = 0; bad < 3; ++bad) {
    Vector c = Vector::Zero(3);
    c[bad] = bad == 1 ? -0.2 : 0.2;
    const InverseSolution solution = inverse(lines, c, rigid);
    BOOST_TEST((solution.status == Status::Infeasible));
    BOOST_TEST(std::abs(solution.residual - 0.2) <= 1e-12);
    BOOST_TEST(solution.worst == bad);
  }
}

BOOST_AUTO_TEST_CASE(the_speed_given_sets_the_scale) {
  const Vector c = vector3(0.0, 0.0, -1e-8), guess = vector3(0.0, 0.0, 1.0);
  BOOST_TEST((inverse(cone(0.5), c, Vector::Zero(3), guess).status == Status::Infeasible));
  const InverseSolution solution = inverse(cone(0.5), c, Vector::Zero(3), guess, {}, 0.1);
  BOOST_TEST((solution.status == Status::Solved));
  BOOST_TEST(error(solution, guess) == 0.0);
  BOOST_TEST(std::abs(solution.relative - 1e-7) <= 1e-15);
  const InverseSolution slow = inverse(cone(0.5), vector3(0.0, 0.0, -0.3), Vector::Zero(3), guess, {}, 0.1);
  BOOST_TEST(std::abs(slow.relative - 3.0) <= 1e-9);
}

BOOST_AUTO_TEST_CASE(any_impulse_can_be_judged) {
  InverseSolution solution;
  solution.impulse.resize(3);
  solution.impulse = vector3(0.0, 0.0, 2.0);  // inside: the velocity has to be 0
  const Vector c = vector3(0.3, 0.4, -0.1), r = vector3(0.0, 0.0, 0.05);
  judge_inverse(c, r, cone(0.5), Law::Ccp, 0.0, solution);
  BOOST_TEST(std::abs(solution.residual - 0.5) <= 1e-15);
  judge_inverse(c, r, cone(0.5), Law::Ncp, 0.0, solution);
  BOOST_TEST(std::abs(solution.residual - std::hypot(0.5, 0.25)) <= 1e-15);  // with the De Saxce term
  BOOST_TEST(std::abs(solution.relative * c.norm() - solution.residual) <= 1e-15);
  solution.impulse = vector3(-0.6, -0.8, 2.0);
  judge_inverse(c, r, cone(0.5), Law::Ncp, 0.0, solution);
  BOOST_TEST(solution.residual <= 1e-15);
  solution.impulse = vector3(kNan, 0.0, 0.0);
  BOOST_CHECK_THROW(judge_inverse(c, r, cone(0.5), Law::Ncp, 0.0, solution), InvalidInput);
}

BOOST_AUTO_TEST_CASE(no_sets_no_work) {
  const InverseSolution solution = inverse(ConstraintSets(), Vector(), Vector());
  BOOST_TEST((solution.status == Status::Solved));
  BOOST_TEST(solution.impulse.size() == 0);
  BOOST_TEST(solution.worst == -1);
  BOOST_TEST(solution.relative == 0.0);
}

BOOST_AUTO_TEST_CASE(a_solution_can_be_used_again_for_problems_of_any_size) {
  Random random(5);
  InverseSolution kept;
  for (const int rounds : {3, 1, 4, 0, 2}) {
    const ConstraintSets sets = all_kinds(rounds);
    const Vector c = random.vector(sets.size()), r = Vector::Constant(sets.size(), 0.1);
    solve_inverse(c, r, sets, {}, kept);
    const InverseSolution fresh = inverse(sets, c, r);
    BOOST_TEST((kept.status == Status::Solved));
    BOOST_TEST(kept.impulse.size() == sets.size());
    BOOST_TEST(error(fresh, Vector(kept.impulse)) == 0.0);
    BOOST_TEST(kept.residual == fresh.residual);
    BOOST_TEST(kept.worst == fresh.worst);
  }
}

BOOST_AUTO_TEST_CASE(bad_input_names_the_field) {
  const Vector good = Vector::Constant(3, 0.1);
  const auto refuses = [&](const std::string& field, const Vector& c, const Vector& r, const Vector& guess,
                           const InverseSettings& settings = {}, double speed = 0.0) {
    try {
      inverse(cone(0.5), c, r, guess, settings, speed);
    } catch (const InvalidInput& error) {
      BOOST_TEST(std::string(error.what()).find(field) != std::string::npos, error.what());
      return;
    }
    BOOST_ERROR("accepted: " + field);
  };
  BOOST_TEST((inverse(cone(0.5), good, good, good).status == Status::Solved));
  refuses("velocity", Vector::Zero(2), good, good);
  refuses("velocity[1]", vector3(0.0, kNan, 0.0), good, good);
  refuses("velocity[2]", vector3(0.0, 0.0, 1e300), good, good);
  refuses("compliance", good, Vector::Zero(4), good);
  refuses("compliance[2]", good, vector3(0.1, 0.1, -0.1), good);
  refuses("compliance[0]", good, vector3(kInfinity, 0.1, 0.1), good);
  refuses("compliance[1]", good, vector3(0.1, 0.2, 0.1), good);
  refuses("guess", good, good, Vector::Zero(6));
  refuses("guess[0]", good, good, vector3(kNan, 0.0, 0.0));
  refuses("speed", good, good, good, {}, -1.0);
  refuses("speed", good, good, good, {}, kNan);
  InverseSettings settings;
  for (const double value : {0.0, -1.0, 1e7, kNan}) {
    settings.proximal_weight = value;
    refuses("proximal_weight", good, good, good, settings);
  }
  settings = {};
  for (const double value : {0.0, 1.0, kNan}) {
    settings.tolerance = value;
    refuses("tolerance", good, good, good, settings);
  }
  settings = {};
  settings.max_iterations = 0;
  refuses("max_iterations", good, good, good, settings);
}
