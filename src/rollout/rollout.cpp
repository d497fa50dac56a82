#include "signorini/rollout/rollout.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <thread>

#include "require.hpp"

namespace signorini {

void run(Simulator& simulator, Index num_steps, const Eigen::Ref<const Matrix>& controls, Trace& trace,
         Matrix* states) {
  const Index nq = simulator.q().size(), nv = simulator.v().size();
  if (controls.size() > 0 && (controls.rows() != num_steps || controls.cols() != simulator.control().size()))
    throw InvalidInput("controls", "is " + std::to_string(controls.rows()) + " x " + std::to_string(controls.cols()) +
                                       ", must be " + std::to_string(num_steps) + " x " +
                                       std::to_string(simulator.control().size()));
  const auto count = trace.seconds.size() + static_cast<std::size_t>(num_steps);
  for (std::vector<double>* x : {&trace.seconds, &trace.relative, &trace.penetration}) x->reserve(count);
  for (std::vector<int>* x : {&trace.iterations, &trace.factorizations, &trace.num_contacts}) x->reserve(count);
  trace.solved.reserve(count);
  if (states) states->resize(num_steps, nq + nv);
  for (Index k = 0; k < num_steps; ++k) {
    if (controls.size() > 0) simulator.control() = controls.row(k).transpose();
    const auto start = std::chrono::steady_clock::now();
    simulator.step();
    trace.seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    const StepReport& report = simulator.report();
    trace.relative.push_back(report.residual.relative);
    trace.iterations.push_back(report.iterations);
    trace.factorizations.push_back(report.factorizations);
    trace.num_contacts.push_back(static_cast<int>(report.num_contacts));
    trace.solved.push_back(report.status == Status::Solved);
    trace.penetration.push_back(report.deepest_overlap);
    if (states) {
      states->row(k).head(nq) = simulator.q().transpose();
      states->row(k).tail(nv) = simulator.v().transpose();
    }
  }
}

void rollout(const std::shared_ptr<const World>& world, const SimulatorSettings& settings, const double* initial,
             const double* controls, Index num, const RolloutOptions& options, double* states, std::int64_t* unsolved) {
  if (!world) throw InvalidInput("world", "is null");
  settings.validate();
  if (options.num_steps < 1)
    throw InvalidInput("num_steps", "is " + std::to_string(options.num_steps) + ", must be at least 1");
  if (options.num_threads < 0)
    throw InvalidInput("threads", "is " + std::to_string(options.num_threads) + ", must be at least 0");
  const Index nq = world->num_q(), nv = world->num_v(), nu = world->num_controls(), width = nq + nv;
  std::atomic<Index> next{0};
  for (Index i = 0; i < num; ++i) {
    const std::string row = "states[" + std::to_string(i) + "].";
    Vector q = Eigen::Map<const Vector>(initial + i * width, nq);
    world->normalize(q, (row + "q").c_str());
    require_finite((row + "v").c_str(), Eigen::Map<const Vector>(initial + i * width + nq, nv));
  }
  for (Index k = 0; controls && k < num * options.num_steps * nu; ++k)
    if (!(std::abs(controls[k]) <= 1e100)) {
      const Index step = k / nu;
      const auto place = "controls[" + std::to_string(step / options.num_steps) + ", " +
                         std::to_string(step % options.num_steps) + ", " + std::to_string(k % nu) + "]";
      require(false, place, controls[k], "within +-1e100");
    }
  const auto work = [&] {
    Simulator simulator(world, settings);
    for (Index i = next++; i < num; i = next++) {
      double* out = states + i * options.num_steps * width;
      Index k = 0;
      try {
        simulator.reset();
        simulator.q() = Eigen::Map<const Vector>(initial + i * width, nq);
        simulator.v() = Eigen::Map<const Vector>(initial + i * width + nq, nv);
        for (; k < options.num_steps; ++k) {
          if (controls) simulator.control() = Eigen::Map<const Vector>(controls + (i * options.num_steps + k) * nu, nu);
          simulator.step();
          std::copy_n(simulator.q().data(), nq, out + k * width);
          std::copy_n(simulator.v().data(), nv, out + k * width + nq);
        }
        unsolved[i] = static_cast<std::int64_t>(simulator.report().unsolved);
      } catch (const InvalidInput&) {
        std::fill(out + k * width, out + options.num_steps * width, std::numeric_limits<double>::quiet_NaN());
        unsolved[i] = static_cast<std::int64_t>(simulator.report().unsolved) + (options.num_steps - k);
      }
    }
  };
  Index threads = options.num_threads > 0 ? options.num_threads
                                          : static_cast<Index>(std::max(1u, std::thread::hardware_concurrency()));
  threads = std::min(threads, num);
#ifdef SIGNORINI_NO_MALLOC
  threads = 1;  // Eigen's flag that forbids allocations is one for all threads
#endif
  std::vector<std::thread> pool;
  for (Index t = 1; t < threads; ++t) pool.emplace_back(work);
  work();
  for (std::thread& thread : pool) thread.join();
}

}  // namespace signorini
