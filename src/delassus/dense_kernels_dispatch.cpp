#include "dense_kernels.hpp"
#include "instruction_sets.hpp"

#define SIGNORINI_DECLARE_KERNELS(space)                                                                               \
  namespace signorini::space {                                                                                         \
  int factor_front(int p, int u, double* l, double* up, double* s, int* pivots, bool on_diagonal);                     \
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
SIGNORINI_CHOOSE_KERNELS(DenseKernels, dense_kernels, kernels)
}  // namespace signorini
