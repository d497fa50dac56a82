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
namespace {

DenseKernels choose() {
#ifdef SIGNORINI_KERNELS_X86
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    return kernels_avx512::kernels;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return kernels_avx2::kernels;
  return kernels_sse2::kernels;
#else
  return kernels_plain::kernels;
#endif
}

}  // namespace

const DenseKernels& dense_kernels() {
  static const DenseKernels chosen = choose();
  return chosen;
}

}  // namespace signorini
