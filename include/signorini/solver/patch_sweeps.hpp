#pragma once

#include <vector>

#include "signorini/solver/anderson.hpp"
#include "signorini/solver/newton.hpp"

namespace signorini {

struct PatchResult {
  double relative = 0.0;        ///< certificate of PatchSweeps::impulse()
  double sweeps = 0.0;          ///< visits over sets
  double factorizations = 0.0;  ///< each by its patch's share of the sets
  bool spent = false;           ///< given up since one more would have been more than max_factorizations
};

/// For large islands, of the NCP: Gauss-Seidel where the error is (docs/auto.md). What happens in a heap is felt a few
/// bodies away, and what holds it up are a few knots of contacts; so patches around the worst contacts are swept one
/// after the other, the impulses outside kept as they are, each accelerated by itself, and those that stall are left to
/// proximal Newton. The cost goes with the number of contacts, while that of factoring them all grows faster.
class PatchSweeps {
 public:
  /// From `impulse` until the certificate is at most `tolerance`, or that comes no nearer. False, and nothing done,
  /// where A does not list its columns.
  bool solve(const ScaledProblem& problem, double tolerance, int max_factorizations, const GrowVector& impulse,
             PatchResult& result);
  const GrowVector& impulse() const { return best_; }  ///< the best seen

 private:
  /// A's block of the columns of a set of the patch, and where its rows start in the patch.
  struct Block {
    int row, size;
    const double* values;
  };
  void start(const ScaledProblem& problem, const GrowVector& impulse);
  void find_patch(int centre, int size);
  void gather();
  void put(const double* l);
  double sweep(const ScaledProblem& problem);
  double relax(const ScaledProblem& problem, double aim, PatchResult& result);
  void newton(const ScaledProblem& problem, double tolerance, int max_factorizations, double unit, PatchResult& result);

  GrowVector l_, t_, natural_, best_;
  SweptSets swept_;
  std::vector<int> offsets_, sizes_, first_;  ///< of each set; first_: in columns_
  std::vector<ScaledDelassus::ColumnBlock> columns_;
  std::vector<int> order_;  ///< sets whose error is too large, the worst first
  std::vector<double> error_;
  std::vector<std::uint8_t> done_;

  // the patch at hand
  std::vector<int> patch_, rows_;  ///< its sets, and their first rows in it
  std::vector<int> place_;         ///< of every set: number in it, or -1
  std::vector<int> block_first_;
  std::vector<Block> blocks_;
  Index num_rows_ = 0;
  Vector state_, before_, next_;  ///< impulse and velocity of the patch, one after the other
  Anderson anderson_;
  ScaledProblem part_;
  NewtonMemory newton_;
};

}  // namespace signorini
