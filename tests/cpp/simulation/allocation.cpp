// A warm step does not go to the heap, nor does its inverse.
#include <boost/test/unit_test.hpp>
#include <cmath>
#include <cstdlib>

#include "../count_allocations.hpp"
#include "signorini/simulation/inverse_dynamics.hpp"
#include "signorini/simulation/simulator.hpp"
#include "worlds.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

std::shared_ptr<const World> world_with_moments(bool moments) {
  Material surface;
  if (moments) surface.torsion = 2e-3, surface.rolling = 1e-3;
  return busy_world(surface);
}

}  // namespace

BOOST_AUTO_TEST_CASE(a_warm_step_allocates_nothing) {
#if SIGNORINI_COUNTS_ALLOCATIONS
  for (const Law law : {Law::Ncp, Law::Ccp})
    for (const bool moments : {false, true}) {
      SimulatorSettings settings;
      settings.solver.law = law;
      Simulator simulator(world_with_moments(moments), settings);
      simulator.control()[1] = 0.5;
      for (int k = 0; k < 1000; ++k) simulator.step();
      simulator.step();
      const long before = allocations;
      for (int k = 0; k < 200; ++k) simulator.step();
      BOOST_TEST(allocations - before == 0);
      BOOST_TEST(simulator.report().num_contacts > 16);
    }
#else
  BOOST_TEST_MESSAGE("not counted: a sanitizer has malloc");
#endif
}

BOOST_AUTO_TEST_CASE(a_warm_step_in_rounds_allocates_nothing) {
#if SIGNORINI_COUNTS_ALLOCATIONS
  Simulator simulator(rows_of_boxes());
  const Vector q = simulator.q(), v = speeds_of_rows();
  long before = 0;
  for (int k = 0; k < 12; ++k) {
    if (k == 8) before = allocations;
    simulator.q() = q;
    simulator.v() = v;
    for (int i = 0; i < 5; ++i) simulator.step();
  }
  BOOST_TEST(allocations - before == 0);
#else
  BOOST_TEST_MESSAGE("not counted: a sanitizer has malloc");
#endif
}

BOOST_AUTO_TEST_CASE(a_warm_inverse_step_allocates_nothing) {
#if SIGNORINI_COUNTS_ALLOCATIONS
  for (const bool moments : {false, true}) {
    const auto world = world_with_moments(moments);
    SimulatorSettings settings;
    settings.solver.tolerance = 1e-10;
    Simulator simulator(world, settings);
    for (int k = 0; k < 1000; ++k) simulator.step();
    const Vector q = simulator.q();
    InverseDynamics::Input input;
    input.v = simulator.v();
    simulator.step();
    input.v_next = simulator.v();
    input.control = simulator.control();
    input.external_wrench = simulator.external_wrench();
    InverseDynamics inverse(world, settings);
    inverse.set_configuration(q);
    const std::vector<ContactPoint> points = inverse.points();
    BOOST_TEST(points.size() > 16u);
    inverse.set_configuration(q, points);
    BOOST_TEST((inverse.solve(input).status == Status::Solved));
    input.impulse_guess = inverse.solve(input).contact_impulse;
    inverse.solve(input);
    const long before = allocations;
    for (int k = 0; k < 50; ++k) {
      inverse.set_configuration(q, points);
      inverse.solve(input);
    }
    BOOST_TEST(allocations - before == 0);
  }
#else
  BOOST_TEST_MESSAGE("not counted: a sanitizer has malloc");
#endif
}

BOOST_AUTO_TEST_CASE(a_warm_inverse_problem_allocates_nothing) {
#if SIGNORINI_COUNTS_ALLOCATIONS
  ConstraintSets sets;
  for (int k = 0; k < 20; ++k) {
    sets.add_friction_cone(0.05 * k);
    sets.add_half_line();
    sets.add_interval(-1.0, 0.5);
    sets.add_equality();
  }
  Vector c(sets.size()), compliance(sets.size());
  for (Index i = 0; i < c.size(); ++i) c[i] = std::sin(3.0 * static_cast<double>(i));
  compliance.setConstant(0.1);
  const Vector guess = Vector::Ones(c.size());
  const ConstVectorRef velocity(c), r(compliance), start(guess);
  for (const Law law : {Law::Ncp, Law::Ccp}) {
    InverseSettings settings;
    settings.law = law;
    InverseSolution solution;
    solve_inverse(velocity, r, sets, settings, solution, &start);
    const long before = allocations;
    for (int k = 0; k < 50; ++k) {
      solve_inverse(velocity, r, sets, settings, solution, &start);
      solve_inverse(velocity, r, sets, settings, solution);
    }
    BOOST_TEST(allocations - before == 0);
    BOOST_TEST((solution.status == Status::Solved));
    BOOST_TEST(solution.iterations > 0);
  }
#else
  BOOST_TEST_MESSAGE("not counted: a sanitizer has malloc");
#endif
}
