#include "dense_kernels.hpp"

#define SIGNORINI_DECLARE_KERNELS(space)                                                                               \
  namespace signorini::space {                                                                                         \
  int factor_front(int p, int u, double* l, double* up, double* s, int* pivots);                                       \
  void forward(int p, int u, const double* l, const int* pivots, double* x, double* y);                                \
  void backward(int p, int u, const double* l, const double* up, double* x, const double* xu);                         \
  int factor_symmetric_front(int p, int u, double* l, double* up, double* s);                                          \
  void symmetric_product(int n, int k, const double* a, double* c);                                                    \
  void multiply(int m, int n, const double* a, int lda, const double* x, double* y);                                   \
  void add_three(int m, const double* a, int lda, const double* x, double* y);                                         \
  void multiply_blocks(int n, const int* first, const DenseKernels::BlockAt* blocks, const double* a, const double* x, \
                       double* y);                                                                                     \
  constexpr DenseKernels kernels{&factor_front,      &forward,  &backward,  &factor_symmetric_front,                   \
                                 &symmetric_product, &multiply, &add_three, &multiply_blocks};                         \
  }

#ifdef SIGNORINI_KERNELS_X86
SIGNORINI_DECLARE_KERNELS(kernels_sse2)
SIGNORINI_DECLARE_KERNELS(kernels_avx2)
SIGNORINI_DECLARE_KERNELS(kernels_avx512)
#else
SIGNORINI_DECLARE_KERNELS(kernels_plain)
#endif

namespace signorini {

const DenseKernels* dense_kernels(int k) {
#ifdef SIGNORINI_KERNELS_X86
  __builtin_cpu_init();
  const bool avx512 =
      __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  if (avx512 && k-- == 0) return &kernels_avx512::kernels;
  if (avx2 && k-- == 0) return &kernels_avx2::kernels;
  return k == 0 ? &kernels_sse2::kernels : nullptr;
#else
  return k == 0 ? &kernels_plain::kernels : nullptr;
#endif
}

const DenseKernels& dense_kernels() {
  static const DenseKernels chosen = *dense_kernels(0);
  return chosen;
}

}  // namespace signorini
