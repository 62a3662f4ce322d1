// Kernels compiled for several processors, of which the one at hand is chosen when the library is loaded.
#pragma once

#define TRAJOPT_INLINE inline __attribute__((always_inline))

namespace trajopt {

// As many numbers as one register of the processor has: a wider vector would be taken apart in memory.
template <int kBytes>
struct Registers;
#define TRAJOPT_REGISTERS(BYTES)                                                  \
  template <>                                                                     \
  struct Registers<BYTES> {                                                       \
    typedef double Lane __attribute__((vector_size(BYTES), aligned(8), may_alias)); \
    static constexpr int kLane = BYTES / 8;                                       \
  };
TRAJOPT_REGISTERS(16)
TRAJOPT_REGISTERS(32)
TRAJOPT_REGISTERS(64)
#undef TRAJOPT_REGISTERS

// Eight numbers, as the points of a batch have them, in as many registers as they take.
template <int kBytes>
struct __attribute__((may_alias)) Eight {
  static constexpr int kParts = 64 / kBytes;
  typename Registers<kBytes>::Lane part[kParts];
  TRAJOPT_INLINE Eight& operator+=(const Eight& other) { return *this = *this + other; }
};
#define TRAJOPT_OPERATOR(SIGN)                                                                            \
  template <int kBytes>                                                                                   \
  TRAJOPT_INLINE Eight<kBytes> operator SIGN(const Eight<kBytes>& one, const Eight<kBytes>& other) {      \
    Eight<kBytes> result;                                                                                 \
    for (int k = 0; k < Eight<kBytes>::kParts; ++k) result.part[k] = one.part[k] SIGN other.part[k];      \
    return result;                                                                                        \
  }
TRAJOPT_OPERATOR(+)
TRAJOPT_OPERATOR(-)
TRAJOPT_OPERATOR(*)
#undef TRAJOPT_OPERATOR
template <int kBytes>
TRAJOPT_INLINE Eight<kBytes> operator*(const Eight<kBytes>& one, double factor) {
  Eight<kBytes> result;
  for (int k = 0; k < Eight<kBytes>::kParts; ++k) result.part[k] = one.part[k] * factor;
  return result;
}

#ifdef __x86_64__
inline const int kWidestRegister = __builtin_cpu_supports("avx512f")                                   ? 64
                                   : __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? 32
                                                                                                       : 16;
#else
inline const int kWidestRegister = 16;
#endif
// Bytes of the registers that kernels use; tests make it smaller.
inline int register_bytes = kWidestRegister;

}  // namespace trajopt

// A function `name` from the template `name_by`, with the instance for the registers in use.
#ifdef __x86_64__
#define TRAJOPT_DISPATCHED(result, name, parameters, arguments)                                                  \
  __attribute__((target("avx512f"))) static result name##_avx512 parameters { return name##_by<64> arguments; } \
  __attribute__((target("avx2,fma"))) static result name##_avx2 parameters { return name##_by<32> arguments; }  \
  result name parameters {                                                                                       \
    return register_bytes == 64   ? name##_avx512 arguments                                                      \
           : register_bytes == 32 ? name##_avx2 arguments                                                        \
                                  : name##_by<16> arguments;                                                     \
  }
#else
#define TRAJOPT_DISPATCHED(result, name, parameters, arguments) \
  result name parameters { return name##_by<16> arguments; }
#endif
