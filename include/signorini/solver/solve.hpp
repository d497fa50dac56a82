#pragma once

#include <memory>

#include "signorini/solver/solution.hpp"

namespace signorini {

/// Memory of the solvers, sized at the first solve and reused by the next ones of the same pattern. One a thread.
class Workspace {
 public:
  Workspace();
  ~Workspace();
  Workspace(Workspace&&) noexcept;
  Workspace& operator=(Workspace&&) noexcept;

  struct Impl;
  Impl& impl();

 private:
  std::unique_ptr<Impl> impl_;
};

/// Solves with the method that settings.solver names, from guess if given. Bad input raises InvalidInput; a solve that
/// fails is a status.
void solve(const ContactProblem& problem, const Settings& settings, Workspace& workspace, Solution& solution,
           const Guess* guess = nullptr);

/// The same in one line, with a workspace of its own.
Solution solve(const ContactProblem& problem, const Settings& settings = {}, const Guess* guess = nullptr);

}  // namespace signorini
