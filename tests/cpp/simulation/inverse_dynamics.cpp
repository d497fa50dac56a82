// What only C++ can hand to inverse dynamics.
#include "signorini/simulation/inverse_dynamics.hpp"

#include <boost/test/unit_test.hpp>
#include <limits>
#include <string>
#include <vector>

#include "signorini/errors.hpp"
#include "worlds.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// Runs and returns the field that was refused, or "".
template <typename F>
std::string refused(F&& call) {
  try {
    call();
  } catch (const InvalidInput& error) {
    return error.field();
  }
  return "";
}

InverseDynamics::Input at_rest(const World& world) {
  InverseDynamics::Input input;
  input.v = input.v_next = Vector::Zero(world.num_v());
  return input;
}

}  // namespace

BOOST_AUTO_TEST_CASE(given_points_are_checked) {
  const auto world = busy_world();
  InverseDynamics inverse(world);
  const Vector q = world->initial_q();
  const auto given = [&](auto&& change) {
    ContactPoint point;
    point.geometry_a = 0, point.geometry_b = 1;
    change(point);
    return refused([&] { inverse.set_configuration(q, {ContactPoint(), point}); });
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  BOOST_TEST(given([](ContactPoint&) {}) == "");
  BOOST_TEST(given([](ContactPoint& p) { p.geometry_b = 1 << 20; }) == "points[1]");
  BOOST_TEST(given([](ContactPoint& p) { p.geometry_a = -1; }) == "points[1]");
  BOOST_TEST(given([&](ContactPoint& p) { p.position[1] = nan; }) == "points[1]");
  BOOST_TEST(given([&](ContactPoint& p) { p.distance = nan; }) == "points[1]");
  BOOST_TEST(given([](ContactPoint& p) { p.patch_size = 0; }) == "points[1]");
}

BOOST_AUTO_TEST_CASE(inputs_of_another_shape_or_world_are_refused) {
  const auto world = busy_world();
  InverseDynamics inverse(world);
  auto input = at_rest(*world);
  BOOST_TEST(refused([&] { inverse.solve(input); }) == "q");
  inverse.set_configuration(world->initial_q());
  const auto bodies = static_cast<Index>(world->bodies().size());
  BOOST_REQUIRE(bodies != 6);
  input.external_wrench = Matrix::Zero(bodies, 6);  // transposed
  BOOST_TEST(refused([&] { inverse.solve(input); }) == "external_wrench: a column");
  input.external_wrench = Matrix::Zero(6, bodies);
  BOOST_TEST(refused([&] { inverse.solve(input); }) == "");

  Simulator other(busy_world());
  other.step();
  input.simulator = &other;
  BOOST_TEST(refused([&] { inverse.solve(input); }) == "impulse_guess");
  BOOST_TEST(inverse.contacts().empty());
  BOOST_TEST(inverse.impulse().size() == 0);

  Simulator simulator(world);
  simulator.step();
  const Vector too_short = Vector::Zero(simulator.assembler().num_rows() - 1);
  BOOST_TEST(refused([&] { simulator.warm_start(simulator.assembler().sets(), too_short); }) == "impulse");
}

/// The same configuration again is not looked at again, another one is; given points are no found ones.
BOOST_AUTO_TEST_CASE(points_are_those_of_the_configuration) {
  const auto world = busy_world();
  InverseDynamics inverse(world), fresh(world);
  const Vector here = world->initial_q();
  Simulator simulator(world);
  for (int k = 0; k < 300; ++k) simulator.step();
  const Vector there = simulator.q();
  const auto positions = [](const InverseDynamics& of) {
    std::vector<Vector3> list;
    for (const ContactPoint& point : of.points()) list.push_back(point.position);
    return list;
  };
  fresh.set_configuration(there);
  BOOST_TEST(!fresh.points().empty());
  inverse.set_configuration(here);
  inverse.set_configuration(there);
  inverse.set_configuration(there);
  BOOST_TEST((positions(inverse) == positions(fresh)));
  inverse.set_configuration(there, {});
  BOOST_TEST(inverse.points().empty());
  inverse.set_configuration(there);
  BOOST_TEST((positions(inverse) == positions(fresh)));
}
