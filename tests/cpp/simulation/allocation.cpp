// A warm step does not go to the heap.
#include <boost/test/unit_test.hpp>
#include <cstdlib>

#include "../count_allocations.hpp"
#include "signorini/simulation/simulator.hpp"
#include "worlds.hpp"

using namespace signorini;
using namespace signorini::testing;

BOOST_AUTO_TEST_CASE(a_warm_step_allocates_nothing) {
#if SIGNORINI_COUNTS_ALLOCATIONS
  Simulator simulator(busy_world());
  for (int k = 0; k < 1000; ++k) simulator.step();
  simulator.step();
  const long before = allocations;
  for (int k = 0; k < 200; ++k) simulator.step();
  BOOST_TEST(allocations - before == 0);
  BOOST_TEST(simulator.report().num_contacts > 16);
#else
  BOOST_TEST_MESSAGE("not counted: a sanitizer has malloc");
#endif
}
