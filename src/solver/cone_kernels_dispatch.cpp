#include "cone_kernels.hpp"
#include "instruction_sets.hpp"

#define SIGNORINI_DECLARE_CONE_KERNELS(space)                                                                         \
  namespace signorini::space {                                                                                        \
  void cone_scalings(int n, ConeBlock* blocks);                                                                       \
  void cone_corrector(int n, ConeBlock* blocks, double target);                                                       \
  void cone_dual_direction(int n, ConeBlock* blocks);                                                                 \
  double cone_longest_step(int n, const ConeBlock* blocks);                                                           \
  double cone_complementarity(int n, const ConeBlock* blocks, double step);                                           \
  double cone_natural_map(int n, const double* friction, int stride, bool de_saxce, const double* l, const double* t, \
                          double* natural, double& size);                                                             \
  constexpr ConeKernels cones{&cone_scalings,     &cone_corrector,       &cone_dual_direction,                        \
                              &cone_longest_step, &cone_complementarity, &cone_natural_map};                          \
  }

#ifdef SIGNORINI_KERNELS_X86
SIGNORINI_DECLARE_CONE_KERNELS(kernels_sse2)
SIGNORINI_DECLARE_CONE_KERNELS(kernels_avx2)
SIGNORINI_DECLARE_CONE_KERNELS(kernels_avx512)
#else
SIGNORINI_DECLARE_CONE_KERNELS(kernels_plain)
#endif

namespace signorini {
SIGNORINI_CHOOSE_KERNELS(ConeKernels, cone_kernels, cones)
}  // namespace signorini
