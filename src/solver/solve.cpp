#include "signorini/solver/solve.hpp"

#include <chrono>
#include <cmath>

#include "require.hpp"
#include "signorini/solver/admm.hpp"
#include "signorini/solver/auto.hpp"
#include "signorini/solver/bisection.hpp"
#include "signorini/solver/convex_newton.hpp"
#include "signorini/solver/interior_point.hpp"
#include "signorini/solver/lcp_pgs.hpp"
#include "signorini/solver/newton.hpp"
#include "signorini/solver/pgs.hpp"

namespace signorini {
namespace {

/// Whether nothing asks for an impulse: zero is a solution then, and next to nothing (f = 0 in (T12)) no other is good.
bool zero_is_exact(const ContactProblem& problem) {
  if (problem.reference() > 0.0 || !(problem.free_velocity().array() == 0.0).all()) return false;
  for (const ConstraintSet& set : problem.sets())
    if (set.type == SetType::Interval && (set.lower > 0.0 || set.upper < 0.0)) return false;
  return true;
}

}  // namespace

struct Workspace::Impl {
  AdmmWorkspace admm;
  PgsWorkspace pgs;
  InteriorPointWorkspace interior_point;
  NewtonWorkspace newton;
  AutoWorkspace automatic;
  LcpPgsWorkspace lcp_pgs;
  ConvexNewtonWorkspace convex_newton;
  BisectionWorkspace bisection;
};

Workspace::Workspace() : impl_(std::make_unique<Impl>()) {}
Workspace::~Workspace() = default;
Workspace::Workspace(Workspace&&) noexcept = default;
Workspace& Workspace::operator=(Workspace&&) noexcept = default;
Workspace::Impl& Workspace::impl() {
  if (!impl_) impl_ = std::make_unique<Impl>();  // was moved from
  return *impl_;
}

void solve(const ContactProblem& problem, const Settings& settings, Workspace& workspace, Solution& solution,
           const Guess* guess) {
  const auto start = std::chrono::steady_clock::now();
  settings.validate();
  if (guess) {
    require_size("guess", guess->impulse.size(), problem.size());
    require_finite("guess", guess->impulse);
    require(guess->penalty >= 0.0 && std::isfinite(guess->penalty), "guess penalty", guess->penalty, "finite and >= 0");
    if (zero_is_exact(problem)) guess = nullptr;
  }
  solution.status = Status::Invalid;
  solution.solver = settings.solver;
  solution.iterations = solution.factorizations = 0;
  solution.penalty = 0.0;
  solution.history.clear();
  solution.impulse.setZero(problem.size());
  Workspace::Impl& w = workspace.impl();
  switch (settings.solver) {
    case SolverType::Auto:
      solve_auto(problem, settings, w.automatic, guess, solution);
      break;
    case SolverType::Admm:
      solve_admm(problem, settings, w.admm, guess, solution);
      break;
    case SolverType::Pgs:
      solve_pgs(problem, settings, w.pgs, guess, solution);
      break;
    case SolverType::InteriorPoint:
      solve_interior_point(problem, settings, w.interior_point, guess, solution);
      break;
    case SolverType::Newton:
      solve_newton(problem, settings, w.newton, guess, solution);
      break;
    case SolverType::LcpPgs:
      solve_lcp_pgs(problem, settings, w.lcp_pgs, guess, solution);
      break;
    case SolverType::ConvexNewton:
      solve_convex_newton(problem, settings, w.convex_newton, guess, solution);
      break;
    case SolverType::Bisection:
      solve_bisection(problem, settings, w.bisection, guess, solution);
      break;
  }
  solution.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

Solution solve(const ContactProblem& problem, const Settings& settings, const Guess* guess) {
  Workspace workspace;
  Solution solution;
  solve(problem, settings, workspace, solution, guess);
  return solution;
}

const char* name(Status status) {
  switch (status) {
    case Status::Solved:
      return "solved";
    case Status::MaxIterations:
      return "max iterations";
    case Status::Infeasible:
      return "infeasible";
    case Status::Stalled:
      return "stalled";
    case Status::Invalid:
      return "invalid";
  }
  return "";
}

}  // namespace signorini
