// A warm step does not go to the heap.
#include <boost/test/unit_test.hpp>
#include <cstdlib>

#include "signorini/simulation/simulator.hpp"
#include "worlds.hpp"

#if defined(__SANITIZE_ADDRESS__) || !defined(__GLIBC__)
#define SIGNORINI_COUNTS_ALLOCATIONS 0
#else
#define SIGNORINI_COUNTS_ALLOCATIONS 1
// Whoever allocates, `new`, Eigen or Coal, ends here.
namespace {
long allocations = 0;
}
extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);
void* malloc(std::size_t size) { return ++allocations, __libc_malloc(size); }
void* realloc(void* p, std::size_t size) { return ++allocations, __libc_realloc(p, size); }
void* calloc(std::size_t n, std::size_t size) { return ++allocations, __libc_calloc(n, size); }
void* aligned_alloc(std::size_t a, std::size_t size) { return ++allocations, __libc_memalign(a, size); }
}
#endif

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
