#include "signorini/solver/admm.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "no_malloc.hpp"
#include "signorini/problem/de_saxce.hpp"

namespace signorini {
namespace {
double env(const char* n, double d) { const char* e = std::getenv(n); return e ? std::atof(e) : d; }

constexpr int kDefaultIterations = 5000;
constexpr int kPowerIterations = 20;
constexpr int kCheckInterval = 10;

/// Largest eigenvalue of A, from below by power iteration, plus a margin.
double largest_eigenvalue(const ScaledDelassus& a, Vector& x, Vector& ax) {
  const Index n = a.size();
  // A fixed start without the symmetries that a contact problem may have.
  for (Index i = 0; i < n; ++i) x[i] = 1.0 + 0.5 * std::sin(1.0 + 2.7 * static_cast<double>(i));
  double eigenvalue = 0.0;
  for (int k = 0; k < kPowerIterations; ++k) {
    x /= x.norm();
    a.apply(x, ax);
    eigenvalue = ax.norm();
    if (!(eigenvalue > 0.0)) return 0.0;
    x.swap(ax);
  }
  return eigenvalue;
}

double max_norm(const Vector& x) { return x.size() > 0 ? x.cwiseAbs().maxCoeff() : 0.0; }

}  // namespace

void solve_admm(const ContactProblem& problem, const Settings& settings, AdmmWorkspace& w, const Guess* guess,
                Solution& solution) {
  const AdmmSettings& admm = settings.admm;
  const Index n = problem.size();
  const Law law = settings.law;
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : kDefaultIterations;
  static const double relax = env("RELAX", 1.0);

  w.problem.setup(problem, admm.scaling);
  const ScaledProblem& p = w.problem;
  for (Vector* v : {&w.f, &w.f_last, &w.y, &w.y_last, &w.z, &w.s, &w.w, &w.w_next, &w.w_last, &w.velocity, &w.best,
                    &w.impulse, &w.sigma, &w.scratch}) {
    v->setZero(n);
  }
  w.damping.assign(static_cast<std::size_t>(p.sets.num_sets()), Eigen::Matrix3d::Zero());
  w.anderson.setup(n, admm.anderson_memory);
  solution.impulse.setZero(n);
  solution.velocity.setZero(n);
  solution.history.clear();
  if (settings.record_history) solution.history.reserve(static_cast<std::size_t>(max_iterations) + 1);
  solution.status = Status::MaxIterations;
  solution.solver = SolverType::Admm;
  solution.iterations = solution.factorizations = 0;

  NoMalloc no_malloc;
  const double eta = admm.proximal_weight;
  const double m = eta + (n > 0 ? p.scale.cwiseAbs2().cwiseProduct(problem.compliance()).minCoeff() : 0.0);
  const double L = std::max(eta + largest_eigenvalue(*p.system, w.w, w.scratch), m);
  w.penalty.start(admm, m, L, guess && guess->penalty > 0.0 ? guess->penalty : admm.penalty);

  if (guess) {
    p.from_impulse(guess->impulse, w.y);
    p.sets.project(w.y, w.y);
  }
  w.f = w.y;
  p.system->apply(w.f, w.z);
  w.z += p.b;
  add_de_saxce_correction(p.sets, law, w.z);
  w.best = w.y;
  if (env("Z0", 1)) w.z.setZero();
  if (env("ZP", 0)) p.sets.project_dual(w.z, w.z);

  double best_residual = std::numeric_limits<double>::infinity();
  const auto factor = [&] {
    for (Eigen::Matrix3d& block : w.damping) block.diagonal().setConstant(eta + w.penalty.value());
    ++solution.factorizations;
    return p.system->factor(w.damping);
  };
  const auto certify = [&](const Vector& y) {
    p.to_impulse(y, w.impulse);
    return residual(problem, w.impulse, law, w.sigma, w.scratch);
  };
  bool factored = factor();
  if (!factored) solution.status = Status::Stalled;
  w.w = w.y - w.z / w.penalty.value();
  while (factored && solution.iterations < max_iterations) {
    ++solution.iterations;
    const double rho = w.penalty.value();
    w.f_last = w.f;
    w.y_last = w.y;
    de_saxce_correction(p.sets, law, w.z, w.s);
    w.f = eta * w.f_last + rho * w.y + w.z - p.b - w.s;
    w.velocity = w.f + p.b;
    p.system->solve(w.f);                                       // (37)
    w.velocity -= (eta + rho) * w.f;                            // A f + b, without a product
    if (relax != 1.0) w.w_next = relax * w.f + (1 - relax) * w.y - w.z / rho;
    else w.w_next = w.f - w.z / rho;
    p.sets.project(w.w_next, w.y);                              // (39)
    w.z = rho * (w.y - w.w_next);                               // (36c)
    const double primal = max_norm(w.f - w.y);                                       // (40)
    w.velocity.swap(w.scratch); de_saxce_correction(p.sets, law, w.z, w.velocity); static const double dg=env("DUALG",0); const double dual = max_norm(eta * (w.f - w.f_last) + rho * (w.y - w.y_last) + dg*(w.velocity-w.s)); w.velocity.swap(w.scratch);   // (41)

    // stop
    bool check;
    if (admm.scaling) {
      const double natural = natural_residual(p, law, w.f, w.velocity, w.scratch);
      if (!std::isfinite(natural)) { solution.status = Status::Stalled; break; }
      check = natural <= settings.tolerance;
      if (natural < best_residual) { best_residual = natural; w.best = w.y; }
    } else {
      check = solution.iterations % kCheckInterval == 0;
    }
    bool paper_stop = false;
    if (admm.paper_tolerance > 0.0 && primal <= admm.paper_tolerance && dual <= admm.paper_tolerance) {
      double comp = 0;
      for (const ConstraintSet& set : p.sets) comp = std::max(comp, std::abs(w.f.segment(set.offset, set.size()).dot(w.z.segment(set.offset, set.size()))));
      paper_stop = comp <= admm.paper_tolerance;
    }
    if (check || paper_stop || settings.record_history) {
      solution.residual = certify(w.y);
      if (settings.record_history) solution.history.push_back({solution.iterations, solution.factorizations, rho, solution.residual});
      if (!admm.scaling && solution.residual.relative < best_residual) { best_residual = solution.residual.relative; w.best = w.y; }
      if (solution.residual.solves(settings.tolerance)) { w.best = w.y; solution.status = Status::Solved; break; }
      if (paper_stop) { w.best = w.y; break; }
    }
    const double ps = std::max(max_norm(w.f), max_norm(w.y)), ds = std::max(max_norm(p.b), max_norm(w.z));
    if (w.penalty.update(primal, dual, ps, ds)) {
      if (!factor()) { solution.status = Status::Stalled; break; }
      w.anderson.reset();
      w.w = w.y - w.z / w.penalty.value();
    } else if (admm.anderson_memory > 0) {
      w.anderson.step(w.w, w.w_next, w.w_last);
      w.w.swap(w.w_last);
      p.sets.project(w.w, w.y);
      w.z = rho * (w.y - w.w);
    }
  }
  solution.residual = certify(w.best);
  solution.impulse = w.impulse;
  solution.velocity = w.sigma;
  solution.penalty = w.penalty.value();
  if (solution.residual.solves(settings.tolerance)) solution.status = Status::Solved;
}

}  // namespace signorini
