#include <nanobind/eigen/dense.h>
#include <nanobind/stl/string.h>

#include <mutex>

#include "bindings.hpp"
#include "signorini/solver/inverse.hpp"
#include "signorini/solver/solve.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using namespace signorini;

/// A workspace that two threads may hold: their solves then take turns.
struct SharedWorkspace {
  Workspace workspace;
  std::mutex mutex;
};

constexpr Index kKeptRows = 300;

/// The memory of this thread's solves without a workspace of the caller's: what making it anew, with the analysis of
/// the pattern, costs most is problems of some tens of rows in a loop. Null where it would keep much.
Workspace* workspace_of_thread(Index rows) {
  if (rows > kKeptRows) return nullptr;
  thread_local Workspace workspace;
  return &workspace;
}

/// One row an iteration; the columns are those of HISTORY_TYPE in _solution.py.
Matrix history(const Solution& solution) {
  Matrix rows(static_cast<Index>(solution.history.size()), 10);
  Index i = 0;
  for (const IterationRecord& h : solution.history) {
    const Residual& r = h.residual;
    rows.row(i++) << h.iteration, h.factorizations, h.penalty, r.primal, r.dual, r.complementarity, r.relative,
        r.against_free_velocity, r.signorini, r.dissipation;
  }
  return rows;
}

}  // namespace

void bind_solver(nb::module_& m) {
  nb::enum_<SolverType>(m, "SolverType")
      .value("auto", SolverType::Auto)
      .value("admm", SolverType::Admm)
      .value("pgs", SolverType::Pgs)
      .value("interior-point", SolverType::InteriorPoint)
      .value("newton", SolverType::Newton)
      .value("lcp-pgs", SolverType::LcpPgs)
      .value("convex-newton", SolverType::ConvexNewton)
      .value("bisection", SolverType::Bisection);
  nb::enum_<PenaltyRule>(m, "PenaltyRule")
      .value("spectral", PenaltyRule::Spectral)
      .value("linear", PenaltyRule::Linear)
      .value("residual-balancing", PenaltyRule::ResidualBalancing)
      .value("constant", PenaltyRule::Constant);
  nb::enum_<Status>(m, "Status")
      .value("solved", Status::Solved)
      .value("max iterations", Status::MaxIterations)
      .value("stalled", Status::Stalled)
      .value("infeasible", Status::Infeasible)
      .value("invalid", Status::Invalid);

  nb::class_<AdmmSettings>(m, "AdmmSettings")
      .def_rw("penalty_rule", &AdmmSettings::penalty_rule)
      .def_rw("penalty", &AdmmSettings::penalty)
      .def_rw("proximal_weight", &AdmmSettings::proximal_weight)
      .def_rw("spectral_exponent", &AdmmSettings::spectral_exponent)
      .def_rw("spectral_increment", &AdmmSettings::spectral_increment)
      .def_rw("linear_factor", &AdmmSettings::linear_factor)
      .def_rw("ratio", &AdmmSettings::ratio)
      .def_rw("scaling", &AdmmSettings::scaling)
      .def_rw("anderson_memory", &AdmmSettings::anderson_memory)
      .def_rw("paper_tolerance", &AdmmSettings::paper_tolerance);
  nb::class_<PgsSettings>(m, "PgsSettings").def_rw("over_relaxation", &PgsSettings::over_relaxation);
  nb::class_<PyramidSettings>(m, "PyramidSettings").def_rw("facets", &PyramidSettings::facets);
  nb::class_<ConvexSettings>(m, "ConvexSettings").def_rw("impedance", &ConvexSettings::impedance);
  nb::class_<BisectionSettings>(m, "BisectionSettings")
      .def_rw("least_relaxation", &BisectionSettings::least_relaxation)
      .def_rw("relaxation_decay", &BisectionSettings::relaxation_decay);
  nb::class_<Settings>(m, "Settings")
      .def(nb::init<>())
      .def_rw("solver", &Settings::solver)
      .def_rw("law", &Settings::law)
      .def_rw("tolerance", &Settings::tolerance)
      .def_rw("aim", &Settings::aim)
      .def_rw("max_iterations", &Settings::max_iterations)
      .def_rw("record_history", &Settings::record_history)
      .def_rw("admm", &Settings::admm)
      .def_rw("pgs", &Settings::pgs)
      .def_rw("pyramid", &Settings::pyramid)
      .def_rw("convex", &Settings::convex)
      .def_rw("bisection", &Settings::bisection)
      .def("validate", &Settings::validate);

  nb::class_<SharedWorkspace>(m, "Workspace",
                              "Memory of the solvers, reused by solves of the same pattern. Two threads that share one "
                              "take turns.")
      .def(nb::init<>());

  nb::class_<Guess>(m, "Guess")
      .def(
          "__init__", [](Guess* self, const Vector& impulse, double penalty) { new (self) Guess{impulse, penalty}; },
          "impulse"_a, "penalty"_a);

  nb::class_<Solution>(m, "Solution")
      .def_ro("status", &Solution::status)
      .def_ro("solver", &Solution::solver)
      .def_prop_ro("impulse", [](const Solution& self) { return Vector(self.impulse); })
      .def_prop_ro("velocity", [](const Solution& self) { return Vector(self.velocity); })
      .def_ro("residual", &Solution::residual)
      .def_ro("model_residual", &Solution::model_residual)
      .def_ro("iterations", &Solution::iterations)
      .def_ro("factorizations", &Solution::factorizations)
      .def_ro("seconds", &Solution::seconds)
      .def_ro("penalty", &Solution::penalty)
      .def_prop_ro("history", &history);

  nb::class_<InverseSettings>(m, "InverseSettings")
      .def(nb::init<>())
      .def_rw("law", &InverseSettings::law)
      .def_rw("proximal_weight", &InverseSettings::proximal_weight)
      .def_rw("tolerance", &InverseSettings::tolerance)
      .def_rw("max_iterations", &InverseSettings::max_iterations)
      .def("validate", &InverseSettings::validate);
  nb::class_<InverseSolution>(m, "InverseSolution")
      .def_ro("status", &InverseSolution::status)
      .def_prop_ro("impulse", [](const InverseSolution& self) { return Vector(self.impulse); })
      .def_prop_ro("velocity", [](const InverseSolution& self) { return Vector(self.velocity); })
      .def_ro("residual", &InverseSolution::residual)
      .def_ro("relative", &InverseSolution::relative)
      .def_ro("worst", &InverseSolution::worst)
      .def_ro("iterations", &InverseSolution::iterations);
  m.def(
      "solve_inverse",
      [](const Vector& velocity, const Vector& compliance, const ConstraintSets& sets, const InverseSettings& settings,
         const Vector& guess, double speed) {
        InverseSolution solution;
        const ConstVectorRef start(guess);
        solve_inverse(velocity, compliance, sets, settings, solution, &start, speed);
        return solution;
      },
      "velocity"_a, "compliance"_a, "sets"_a, "settings"_a, "guess"_a, "speed"_a,
      nb::call_guard<nb::gil_scoped_release>());

  m.def("inverse_residual", [](const Vector& velocity, const Vector& compliance, const ConstraintSets& sets, Law law,
                               const Vector& impulse) {
    InverseSolution solution;
    solution.impulse = impulse;
    judge_inverse(velocity, compliance, sets, law, 0.0, solution);
    return solution.residual;
  });

  m.def(
      "solve",
      [](const ContactProblem& problem, const Settings& settings, SharedWorkspace* workspace, const Guess* guess) {
        Solution solution;
        if (workspace) {
          const std::lock_guard<std::mutex> lock(workspace->mutex);
          solve(problem, settings, workspace->workspace, solution, guess);
        } else if (Workspace* own = workspace_of_thread(problem.size())) {
          solve(problem, settings, *own, solution, guess);
        } else {
          solution = solve(problem, settings, guess);
        }
        return solution;
      },
      "problem"_a, "settings"_a, "workspace"_a.none(), "guess"_a.none(), nb::call_guard<nb::gil_scoped_release>());
}
