#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "signorini/simulation/simulator.hpp"

namespace signorini {

/// One entry a step.
struct Trace {
  std::vector<double> seconds;      ///< wall time of the step
  std::vector<double> relative;     ///< the certificate
  std::vector<double> penetration;  ///< deepest overlap at the start of the step [m], >= 0
  std::vector<int> iterations, factorizations, num_contacts;
  std::vector<std::uint8_t> solved;
};

/// Steps the simulator and keeps what each step reported. controls: one row a step, or empty for the control as it is.
/// states, if given: receives q then v after each step, one row a step.
void run(Simulator& simulator, Index num_steps, const Eigen::Ref<const Matrix>& controls, Trace& trace,
         Matrix* states = nullptr);

struct RolloutOptions {
  Index num_steps = 1;
  int num_threads = 1;  ///< 0: as many as the machine has
};

/// Many simulations of one world, each from its own state under its own controls, on a pool of threads. Each result is
/// bit-equal to stepping that simulation alone, whatever the number of threads.
/// initial: num x (nq + nv), row-major. controls: num x steps x nu, row-major, or null for none. states: num x steps x
/// (nq + nv), written; unsolved: num, steps that were not solved. A simulation whose state leaves the range of finite
/// numbers fills the rest of its states with NaN and does not stop the others. Raises InvalidInput, and makes no step,
/// when one cannot start: a value is not finite, or a quaternion zero.
void rollout(const std::shared_ptr<const World>& world, const SimulatorSettings& settings, const double* initial,
             const double* controls, Index num, const RolloutOptions& options, double* states, std::int64_t* unsolved);

}  // namespace signorini
