// The step as a C++ program sees it; physics is tested from Python.
#include <boost/test/unit_test.hpp>
#include <cmath>
#include <limits>

#include "signorini/errors.hpp"
#include "signorini/rollout/rollout.hpp"
#include "worlds.hpp"

using namespace signorini;
using namespace signorini::testing;

BOOST_AUTO_TEST_CASE(every_step_of_a_busy_world_is_certified) {
  Simulator simulator(busy_world());
  double deepest = 0.0;
  for (int k = 0; k < 600; ++k) {
    simulator.step();
    deepest = std::max(deepest, simulator.report().deepest_overlap);
  }
  BOOST_TEST(simulator.report().unsolved == 0u);
  BOOST_TEST(simulator.report().num_contacts > 16);
  // The soft box, 3 kg with the one tied to it, falls 1 cm onto 1e4 N/m: where a spring without damper turns it back.
  const double at_rest = 3.0 * 9.81 / 1e4;
  BOOST_TEST(deepest < at_rest + std::sqrt(at_rest * (at_rest + 2.0 * 0.01)));
  BOOST_TEST(deepest > at_rest);
  for (const Contact& contact : simulator.contacts()) {
    BOOST_TEST(contact.force[2] >= 0.0);
    BOOST_TEST(contact.force.head<2>().norm() <= 0.8 * contact.force[2] + 1e-9);
  }
}

BOOST_AUTO_TEST_CASE(a_step_that_takes_rounds_is_certified_as_a_whole) {
  Material rough;
  rough.torsion = 2e-3, rough.rolling = 1e-3;
  for (const Law law : {Law::Ncp, Law::Ccp})
    for (const Material& material : {Material(), rough}) {
      // There contact_problem() has other loads than the step (S17) for contacts that the step left out.
      if (law == Law::Ccp && material.torsion > 0.0) continue;
      SimulatorSettings settings;
      settings.solver.law = law;
      Simulator simulator(rows_of_boxes(material), settings);
      simulator.v() = speeds_of_rows();
      bool swept = false;
      for (int k = 0; k < 8; ++k) {
        simulator.step();
        BOOST_TEST((simulator.report().status == Status::Solved));
        for (const ContactPoint& point : simulator.points()) swept = swept || point.swept;
        const ContactProblem whole = simulator.contact_problem();
        const Residual found = residual(whole, simulator.impulse(), law);
        BOOST_TEST(found.solves(settings.solver.tolerance));
        BOOST_TEST(std::abs(found.relative - simulator.report().residual.relative) <= 0.1 * settings.solver.tolerance);
      }
      BOOST_TEST(swept);
    }
}

BOOST_AUTO_TEST_CASE(a_restored_simulator_goes_on_bit_for_bit) {
  const auto world = busy_world();
  Simulator simulator(world), other(world);
  for (int k = 0; k < 150; ++k) simulator.step();
  const std::string bytes = simulator.save();
  other.restore(bytes);
  BOOST_TEST(other.save() == bytes);
  for (int k = 0; k < 150; ++k) simulator.step(), other.step();
  BOOST_TEST(other.state_hash() == simulator.state_hash());
  BOOST_TEST(other.save() == simulator.save());
}

BOOST_AUTO_TEST_CASE(saved_bytes_that_are_damaged_are_refused) {
  Simulator simulator(busy_world());
  for (int k = 0; k < 30; ++k) simulator.step();
  const std::string bytes = simulator.save();
  for (std::size_t size = 0; size < bytes.size(); size += 7)
    BOOST_CHECK_THROW(simulator.restore(bytes.substr(0, size)), InvalidInput);
  BOOST_CHECK_THROW(simulator.restore(bytes + "x"), InvalidInput);
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    std::string damaged = bytes;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << at % 8));
    BOOST_CHECK_THROW(simulator.restore(damaged), InvalidInput);
  }
  BOOST_TEST(simulator.save() == bytes);  // a refused restore leaves the state
}

BOOST_AUTO_TEST_CASE(threads_do_not_change_a_rollout) {
  const auto world = busy_world();
  const Index size = world->num_q() + world->num_v(), num = 3, steps = 40;
  std::vector<double> initial(static_cast<std::size_t>(num * size), 0.0);
  for (Index i = 0; i < num; ++i) {
    Vector q = world->initial_q();
    q[2] += 0.01 * static_cast<double>(i);
    std::copy(q.data(), q.data() + q.size(), initial.begin() + i * size);
  }
  std::vector<double> states[2];
  std::vector<std::int64_t> unsolved(static_cast<std::size_t>(num));
  for (int k = 0; k < 2; ++k) {
    states[k].resize(static_cast<std::size_t>(num * steps * size));
    RolloutOptions options;
    options.num_steps = steps;
    options.num_threads = 1 + 2 * k;
    rollout(world, {}, initial.data(), nullptr, num, options, states[k].data(), unsolved.data());
  }
  BOOST_TEST((states[0] == states[1]));
  Simulator alone(world);
  alone.q()[2] += 0.01;
  for (Index k = 0; k < steps; ++k) alone.step();
  const double* last = states[0].data() + (2 * steps - 1) * size;
  BOOST_TEST((Eigen::Map<const Vector>(last, world->num_q()) == alone.q()));
}

BOOST_AUTO_TEST_CASE(a_rollout_refuses_where_no_step_can_start) {
  const auto world = busy_world();
  const Index nq = world->num_q(), size = nq + world->num_v();
  std::vector<double> initial(static_cast<std::size_t>(2 * size), 0.0), states(initial.size());
  std::vector<std::int64_t> unsolved(2);
  for (Index i = 0; i < 2; ++i)
    std::copy(world->initial_q().data(), world->initial_q().data() + nq, initial.begin() + i * size);
  const auto refusal = [&](Index at, double value) {
    std::vector<double> start = initial;
    start[static_cast<std::size_t>(at)] = value;
    try {
      rollout(world, {}, start.data(), nullptr, 2, {}, states.data(), unsolved.data());
    } catch (const InvalidInput& error) {
      return error.field();
    }
    return std::string();
  };
  BOOST_TEST(refusal(0, 0.0) == "");
  BOOST_TEST(refusal(1, std::numeric_limits<double>::quiet_NaN()) == "states[0].q[1]");
  BOOST_TEST(refusal(size + nq, kInfinity) == "states[1].v[0]");
}

BOOST_AUTO_TEST_CASE(a_state_that_is_not_finite_is_refused_and_left_alone) {
  Simulator simulator(busy_world());
  simulator.step();
  const Vector q = simulator.q();
  simulator.v()[3] = std::numeric_limits<double>::quiet_NaN();
  BOOST_CHECK_THROW(simulator.step(), InvalidInput);
  BOOST_TEST((simulator.q() == q));
  simulator.v()[3] = 0.0;
  simulator.step();
  BOOST_TEST(simulator.report().unsolved == 0u);
}
