// Hot loops compiled for wider vectors too, chosen when the program is loaded. Nothing may be
// contracted (-ffp-contract=off): every machine finds the same numbers.
#pragma once

#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__)
#define HELI_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define HELI_WIDE
#endif

// What such a loop calls has to be part of it.
#if defined(__GNUC__)
#define HELI_INLINE inline __attribute__((always_inline))
#else
#define HELI_INLINE inline
#endif
