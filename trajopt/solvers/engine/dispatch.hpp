// Code compiled for several processors, chosen when the library is loaded.
#pragma once

// Not with AddressSanitizer, which is not there yet when the choice is made.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define TRAJOPT_DISPATCHED __attribute__((target_clones("avx512f", "arch=haswell", "default")))
#else
#define TRAJOPT_DISPATCHED
#endif
#define TRAJOPT_INLINE inline __attribute__((always_inline))
