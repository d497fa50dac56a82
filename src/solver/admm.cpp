// Algorithm 1 of Carpentier et al. 2024; equation numbers are the paper's. Letters in this file:
//   A, b    scaled Delassus operator with compliance, and free velocity
//   f, y, z impulse of the unconstrained step, impulse in K, their multiplier (the velocity, with Gamma)
//   s       Gamma(z)                   rho, eta   penalty and proximal weight
//   w       f - z / rho, of the last iteration. Since y = P_K(w) and z = rho (y - w), one iteration is a map from w to
//   w
//           (but for eta f, which is small), and the one that is accelerated.
#include "signorini/solver/admm.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "no_malloc.hpp"
#include "signorini/problem/de_saxce.hpp"

namespace signorini {
namespace {

constexpr int kDefaultIterations = 5000;
constexpr int kPowerIterations = 20;
constexpr int kCheckInterval = 10;  // unscaled, where the cheap residual is not the certificate's

double max_norm(const ConstVectorRef& x) { return x.size() > 0 ? x.cwiseAbs().maxCoeff() : 0.0; }

/// Largest eigenvalue of A, by power iteration.
double largest_eigenvalue(const ScaledDelassus& a, Vector& x, Vector& ax) {
  // A fixed start that has none of the symmetries of a contact problem.
  for (Index i = 0; i < x.size(); ++i) x[i] = 1.0 + 0.5 * std::sin(1.0 + 2.7 * static_cast<double>(i));
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

/// One solve, cut into the verbs of its loop.
class Admm {
 public:
  Admm(const ContactProblem& problem, const Settings& settings, AdmmWorkspace& workspace, Solution& solution)
      : problem_(problem),
        settings_(settings),
        w_(workspace),
        scaled_(workspace.problem),
        solution_(solution),
        eta_(settings.admm.proximal_weight) {}

  void resize() {
    const Index n = problem_.size();
    for (Vector* v : {&w_.f, &w_.f_last, &w_.y, &w_.y_last, &w_.z, &w_.s, &w_.w, &w_.w_next, &w_.w_plain, &w_.velocity,
                      &w_.best, &w_.impulse, &w_.sigma, &w_.scratch}) {
      v->setZero(n);
    }
    w_.damping.assign(static_cast<std::size_t>(problem_.num_sets()), Eigen::Matrix3d::Zero());
    w_.anderson.setup(n, settings_.admm.anderson_memory);
  }

  void start(const Guess* guess) {
    start_penalty(guess);
    if (guess) {
      scaled_.from_impulse(guess->impulse, w_.y);
      scaled_.sets.project(w_.y, w_.y);
      w_.f = w_.y;
      scaled_.system->apply(w_.f, w_.z);
      w_.z += scaled_.b;
      add_de_saxce_correction(scaled_.sets, settings_.law, w_.z);
    } else {
      scaled_.sets.project(w_.y, w_.y);  // 0, but for an interval without it
    }
    w_.best = w_.y;
  }

  bool factor() {
    for (Eigen::Matrix3d& block : w_.damping) block.diagonal().setConstant(eta_ + rho());
    ++solution_.factorizations;
    w_.anderson.reset();
    w_.w = w_.y - w_.z / rho();
    return scaled_.system->factor(w_.damping);
  }

  /// Lines 2 to 6.
  void iterate() {
    w_.f.swap(w_.f_last);
    w_.y.swap(w_.y_last);
    de_saxce_correction(scaled_.sets, settings_.law, w_.z, w_.s);
    w_.f = eta_ * w_.f_last + rho() * w_.y_last + w_.z - scaled_.b - w_.s;
    w_.velocity = w_.f + scaled_.b;
    scaled_.system->solve(w_.f);           // (37)
    w_.velocity -= (eta_ + rho()) * w_.f;  // A f + b, for free
    w_.w_next = w_.f - w_.z / rho();
    scaled_.sets.project(w_.w_next, w_.y);  // (39)
    w_.z = rho() * (w_.y - w_.w_next);      // (36c)
    w_.scratch = w_.f - w_.y;
    primal_ = max_norm(w_.scratch);  // (40)
    w_.scratch = eta_ * (w_.f - w_.f_last) + rho() * (w_.y - w_.y_last);
    dual_ = max_norm(w_.scratch);  // (41)
  }

  /// True when y is the answer, or must do. Keeps the best y.
  bool stop() {
    bool look = settings_.record_history;
    if (settings_.admm.scaling) {
      // Of f, whose velocity is known; y's costs a product.
      const double relative = natural_residual(scaled_, settings_.law, w_.f, w_.velocity, w_.scratch);
      if (!std::isfinite(relative)) return true;
      keep_best(relative);
      look = look || relative <= settings_.tolerance;
    } else {
      look = look || solution_.iterations % kCheckInterval == 0;
    }
    const bool converged = paper_converged();
    if (!look && !converged) return false;

    const Residual certificate = certify(w_.y);
    if (settings_.record_history) {
      const AllowMalloc allow;
      solution_.history.push_back({solution_.iterations, solution_.factorizations, rho(), certificate});
    }
    if (!settings_.admm.scaling) {
      if (!std::isfinite(certificate.relative)) return true;
      keep_best(certificate.excess(settings_.tolerance));
    }
    if (!converged && !certificate.solves(settings_.tolerance)) return false;
    w_.best = w_.y;
    return true;
  }

  /// True when rho has moved: the damped matrix is another one.
  bool move_penalty() {
    const double primal_scale = std::max(max_norm(w_.f), max_norm(w_.y));
    const double dual_scale = std::max(max_norm(scaled_.b), max_norm(w_.z));
    return w_.penalty.update(primal_, dual_, primal_scale, dual_scale);
  }

  void accelerate() {
    if (settings_.admm.anderson_memory == 0) return;
    w_.w_plain.swap(w_.w);
    w_.anderson.step(w_.w_plain, w_.w_next, w_.w);
    scaled_.sets.project(w_.w, w_.y);
    w_.z = rho() * (w_.y - w_.w);
  }

  Residual certify(const Vector& y) {
    scaled_.to_impulse(y, w_.impulse);
    return residual(problem_, w_.impulse, settings_.law, w_.sigma);
  }

  double rho() const { return w_.penalty.value(); }

 private:
  void start_penalty(const Guess* guess) {
    const AdmmSettings& admm = settings_.admm;
    const double penalty = guess && guess->penalty > 0.0 ? guess->penalty : admm.penalty;
    const Index n = problem_.size();
    // The scaled A has diagonal blocks of unit size: residual balancing needs to know no more.
    double m = eta_, largest = 1.0;
    if (n > 0 && !(admm.scaling && admm.penalty_rule == PenaltyRule::ResidualBalancing)) {
      m += scaled_.scale.cwiseAbs2().cwiseProduct(problem_.compliance()).minCoeff();
      largest = std::max(m, eta_ + largest_eigenvalue(*scaled_.system, w_.w, w_.scratch));
    }
    w_.penalty.start(admm, m, largest, penalty);
  }

  void keep_best(double excess) {
    if (!(excess <= least_excess_)) return;
    least_excess_ = excess;
    w_.best = w_.y;
  }

  /// The paper's own stop test (43), with (42).
  bool paper_converged() const {
    const double tolerance = settings_.admm.paper_tolerance;
    if (!(tolerance > 0.0 && primal_ <= tolerance && dual_ <= tolerance)) return false;
    for (const ConstraintSet& set : scaled_.sets) {
      const double product = w_.f.segment(set.offset, set.size()).dot(w_.z.segment(set.offset, set.size()));
      if (!(std::abs(product) <= tolerance) && set.type != SetType::Interval) return false;
    }
    return true;
  }

  const ContactProblem& problem_;
  const Settings& settings_;
  AdmmWorkspace& w_;
  const ScaledProblem& scaled_;
  Solution& solution_;
  const double eta_;
  double primal_ = 0.0, dual_ = 0.0;
  double least_excess_ = std::numeric_limits<double>::infinity();
};

}  // namespace

void solve_admm(const ContactProblem& problem, const Settings& settings, AdmmWorkspace& w, const Guess* guess,
                Solution& solution) {
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : kDefaultIterations;
  w.problem.setup(problem, settings.tolerance, settings.admm.scaling);
  solution.iterations = solution.factorizations = 0;
  solution.history.clear();

  Admm admm(problem, settings, w, solution);
  admm.resize();
  {
    const NoMalloc no_malloc;
    admm.start(guess);
    bool done = admm.certify(w.best).solves(settings.tolerance) || !admm.factor();
    while (!done && solution.iterations < max_iterations) {
      ++solution.iterations;
      admm.iterate();
      if (admm.stop()) {
        done = true;
      } else if (admm.move_penalty()) {
        done = !admm.factor();
      } else {
        admm.accelerate();
      }
    }
  }
  solution.penalty = admm.rho();
  solution.impulse.resize(problem.size());
  w.problem.to_impulse(w.best, solution.impulse);
  problem.sets().project(solution.impulse, solution.impulse);  // off by rounding
  finish(problem, settings, solution.iterations >= max_iterations, solution);
}

}  // namespace signorini
