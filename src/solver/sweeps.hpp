#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "finish.hpp"
#include "no_malloc.hpp"
#include "signorini/solver/gauss_seidel.hpp"

namespace signorini {

constexpr int kDefaultSweeps = 5000;
constexpr int kSweepsBetweenChecks = 10;  // sweeps; a check costs about as much as one

/// The number by which an iterate is compared with others, and whether it will do.
struct Judgement {
  double left = 0.0;
  bool done = false;
};

/// Calls sweep() until judge(certificate) says that it is done, and finishes with the best impulse. Returns the
/// residual by which that was the best.
template <typename Sweep, typename Judge>
double sweep_and_finish(const ContactProblem& problem, const Settings& settings, GaussSeidel& rows, Sweep&& sweep,
                        Judge&& judge, Solution& solution) {
  const int max_iterations = settings.max_iterations > 0 ? settings.max_iterations : kDefaultSweeps;
  rows.best = rows.impulse;
  solution.iterations = solution.factorizations = 0;
  solution.penalty = 0.0;
  solution.history.clear();

  double least = std::numeric_limits<double>::infinity();
  bool done = false;
  // The certificate, which also refreshes sigma. True when there is nothing more to do.
  const auto check = [&] {
    const Residual certificate = residual(problem, rows.impulse, settings.law, rows.sigma);
    const Judgement now = judge(certificate);
    if (now.done || now.left <= least) {
      least = now.left;
      rows.best = rows.impulse;
    }
    if (settings.record_history && solution.iterations > 0) {
      const AllowMalloc allow;
      solution.history.push_back({solution.iterations, 0, 0.0, certificate});
    }
    done = now.done;
    return done || !std::isfinite(certificate.relative);
  };

  {
    const NoMalloc no_malloc;
    bool stop = check();
    while (!stop && solution.iterations < max_iterations) {
      sweep();
      const int k = ++solution.iterations;
      if (k < kSweepsBetweenChecks || k % kSweepsBetweenChecks == 0 || k == max_iterations || settings.record_history) {
        stop = check();
      }
    }
  }
  solution.impulse = rows.best;
  finish(problem, settings, !done && solution.iterations >= max_iterations, solution);
  return least;
}

/// Relative residual of a model that differs from the law at the contacts, as natural_residual has it: max |e| over
/// max(max |l|, max |g| / sqrt(d)), or so weighted over max |g| / sqrt(d) that it is within the tolerance where both
/// tests of the certificate hold. contact_error(i, set): |e| of contact i in units of l; for the other sets e is the
/// certificate's own. rows.sigma has to be fresh.
template <typename ContactError>
double model_relative(const ContactProblem& problem, double tolerance, const GaussSeidel& rows,
                      ContactError&& contact_error) {
  double error = 0.0, largest = 0.0, free = problem.reference();
  for (Index i = 0; i < problem.num_sets(); ++i) {
    const ConstraintSet& set = problem.sets()[i];
    const RelativePart part = relative_part(problem, i, rows.impulse, rows.sigma, Law::Ncp);
    const double e = set.type == SetType::FrictionCone ? contact_error(i, set) : part.error;
    if (!(e <= error)) error = std::isnan(error) ? error : e;  // keeps a NaN
    largest = std::max(largest, part.size), free = std::max(free, part.free);
  }
  largest = std::max(largest, free);
  const double share = free > 0.0 ? tolerance / Residual::largest_share(tolerance) * error / free : 0.0;
  return largest > 0.0 ? std::max(error / largest, share) : error;
}

/// Finishes a solver of a model of its own: judge by its residual, and keep that beside the certificate.
template <typename Sweep, typename Relative>
void solve_model(const ContactProblem& problem, const Settings& settings, GaussSeidel& rows, Sweep&& sweep,
                 Relative&& relative, Solution& solution) {
  const double best = sweep_and_finish(
      problem, settings, rows, sweep,
      [&](const Residual&) {
        const double now = relative();
        return Judgement{now, now <= settings.tolerance};
      },
      solution);
  if (solution.status != Status::Invalid) solution.model_residual = best;
}

}  // namespace signorini
