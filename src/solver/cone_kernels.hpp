#pragma once

#include "signorini/solver/cone_block.hpp"

namespace signorini {

/// What is done to many cones at once; compiled once per instruction set. Blocks: those of the interior point.
struct ConeKernels {
  /// From x and z: eta, w, lambda, h and what goes with them (T20).
  void (*scalings)(int n, ConeBlock* blocks);
  /// centre = W^-1 (lambda \ (target e - (W^-1 dx) o (W dz) - lambda o lambda)) (T21).
  void (*corrector)(int n, ConeBlock* blocks, double target);
  /// dz = centre - H dx.
  void (*dual_direction)(int n, ConeBlock* blocks);
  /// Largest step that leaves all x and z in their cones.
  double (*longest_step)(int n, const ConeBlock* blocks);
  /// Sum of x . z after the step.
  double (*complementarity)(int n, const ConeBlock* blocks, double step);
  /// natural = l - P_K(l - s) of n friction cones, s = t or, with de_saxce, t + Gamma(t): three values each. Returns
  /// the largest |natural|^2 of a cone, NaN if one is, and in `size` the largest |l|^2.
  double (*natural_map)(int n, const double* friction, int stride, bool de_saxce, const double* l, const double* t,
                        double* natural, double& size);
};

const ConeKernels& cone_kernels();
/// Those of the k-th instruction set that this processor has, the best first; null beyond the last one.
const ConeKernels* cone_kernels(int k);

}  // namespace signorini
