#pragma once

namespace signorini {

/// What kernels are compiled for; Plain where the compiler or the processor is another one.
enum class InstructionSet { Avx512, Avx2, Sse2, Plain, None };

/// The k-th best one that this processor has; None beyond the last.
inline InstructionSet instruction_set(int k) {
#ifdef SIGNORINI_KERNELS_X86
  __builtin_cpu_init();
  const bool avx512 =
      __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  if (avx512 && k-- == 0) return InstructionSet::Avx512;
  if (avx2 && k-- == 0) return InstructionSet::Avx2;
  return k == 0 ? InstructionSet::Sse2 : InstructionSet::None;
#else
  return k == 0 ? InstructionSet::Plain : InstructionSet::None;
#endif
}

}  // namespace signorini

/// Defines `const Kernels* name(int k)`, the kernels of the k-th instruction set, from a constant `constant` in each
/// namespace of kernels, and `const Kernels& name()`, the best ones.
#ifdef SIGNORINI_KERNELS_X86
#define SIGNORINI_CHOOSE_KERNELS(Kernels, name, constant) \
  const Kernels* name(int k) {                            \
    switch (instruction_set(k)) {                         \
      case InstructionSet::Avx512:                        \
        return &kernels_avx512::constant;                 \
      case InstructionSet::Avx2:                          \
        return &kernels_avx2::constant;                   \
      case InstructionSet::Sse2:                          \
        return &kernels_sse2::constant;                   \
      default:                                            \
        return nullptr;                                   \
    }                                                     \
  }                                                       \
  const Kernels& name() {                                 \
    static const Kernels chosen = *name(0);               \
    return chosen;                                        \
  }
#else
#define SIGNORINI_CHOOSE_KERNELS(Kernels, name, constant)                            \
  const Kernels* name(int k) { return k == 0 ? &kernels_plain::constant : nullptr; } \
  const Kernels& name() { return kernels_plain::constant; }
#endif
