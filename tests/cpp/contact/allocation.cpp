// Iterations allocate nothing. Bites only when built with SIGNORINI_NO_MALLOC: there, an allocation by Eigen or by
// `new` inside a NoMalloc scope aborts; elsewhere this is one more run of every solver.
#include <boost/test/unit_test.hpp>
#include <cstdio>
#include <cstdlib>
#include <new>

#include "solver/no_malloc.hpp"
#include "support.hpp"

#ifdef SIGNORINI_NO_MALLOC
// Not inlined, lest the compiler sees free() meet new.
__attribute__((noinline)) void* operator new(std::size_t size) {
  if (!Eigen::internal::is_malloc_allowed()) {
    std::fputs("an iteration called new\n", stderr);
    std::abort();
  }
  if (void* p = std::malloc(size)) return p;
  throw std::bad_alloc();
}
__attribute__((noinline)) void operator delete(void* p) noexcept { std::free(p); }
__attribute__((noinline)) void operator delete(void* p, std::size_t) noexcept { std::free(p); }
#endif

using namespace signorini;
using namespace signorini::testing;

BOOST_AUTO_TEST_CASE(iterations_allocate_nothing) {
  std::vector<SolverType> solvers(kAllSolvers.begin(), kAllSolvers.end());
  solvers.insert(solvers.end(), kModels.begin(), kModels.end());
  for (const SolverType solver : solvers) {
    for (const Law law : {Law::Ncp, Law::Ccp}) {
      for (const Operator type : kOperators) {
        const Planted planted = plant(51, 7, law, type, true);
        Guess guess;
        guess.impulse = planted.impulse + 1e-2 * Random(52).vector(planted.problem.size());
        Settings settings = settings_for(solver, 1e-6, law);
        settings.record_history = true;
        for (const Guess* start : {static_cast<const Guess*>(nullptr), static_cast<const Guess*>(&guess)}) {
          BOOST_TEST(solve(planted.problem, settings, start).iterations > 0);
        }
      }
    }
  }
  for (const PenaltyRule rule : {PenaltyRule::Spectral, PenaltyRule::Linear, PenaltyRule::Constant}) {
    Settings settings = settings_for(SolverType::Admm, 1e-6);
    settings.admm = AdmmSettings::paper();
    settings.admm.penalty_rule = rule;
    BOOST_TEST(solve(plant(53, 7, Law::Ncp).problem, settings).iterations > 0);
  }
}

#ifdef SIGNORINI_NO_MALLOC
BOOST_AUTO_TEST_CASE(the_guard_guards_its_scope) {
  BOOST_TEST(Eigen::internal::is_malloc_allowed());
  bool allowed_inside = true, allowed_between = true;
  {
    const NoMalloc outer;
    {
      const NoMalloc inner;
    }
    allowed_between = Eigen::internal::is_malloc_allowed();
    allowed_inside = allowed_between;
  }
  BOOST_TEST(!allowed_inside);
  BOOST_TEST(!allowed_between);
  BOOST_TEST(Eigen::internal::is_malloc_allowed());
}
#endif
