#include "cone_kernels.hpp"
#include "instruction_sets.hpp"

#define SIGNORINI_DECLARE_CONE_KERNELS(space)                                                            \
  namespace signorini::space {                                                                           \
  void cone_scalings(int n, ConeBlock* blocks);                                                          \
  void cone_corrector(int n, ConeBlock* blocks, double target);                                          \
  void cone_dual_direction(int n, ConeBlock* blocks);                                                    \
  double cone_longest_step(int n, const ConeBlock* blocks);                                              \
  double cone_complementarity(int n, const ConeBlock* blocks, double step);                              \
  constexpr ConeKernels cones{&cone_scalings, &cone_corrector, &cone_dual_direction, &cone_longest_step, \
                              &cone_complementarity};                                                    \
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
