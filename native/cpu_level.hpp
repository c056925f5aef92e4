// The best instruction-set level of this processor, by the CPUID instruction. `__builtin_cpu_supports` would
// say the same, but needs a run-time library that knows it: the one of the wheel's compiler (zig) says no to
// all.
#pragma once

#if defined(__x86_64__)
#include <cpuid.h>
#endif

namespace beltscape {

#if defined(__x86_64__)
struct CpuidLeaf {
    unsigned a = 0, b = 0, c = 0, d = 0;
};

inline CpuidLeaf cpuid_leaf(unsigned number) {
    CpuidLeaf leaf;
    __get_cpuid_count(number, 0, &leaf.a, &leaf.b, &leaf.c, &leaf.d);  // all 0 where there is no such leaf
    return leaf;
}

// The registers that the system keeps for each thread; 0 if it uses no such instruction.
inline unsigned kept_registers() {
    if (!(cpuid_leaf(1).c & bit_OSXSAVE)) return 0;
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

// Levels as the x86-64 psABI, table 3.1, defines them; their modules are built for x86-64-v2, -v3 and -v4.
inline const char* cpu_level() {
    constexpr unsigned kAvx = 0x6,
                       kAvx512 = 0xe6;  // bits of XCR0: SSE and AVX; and the mask and 512-bit registers
    constexpr unsigned v3_basic = bit_AVX | bit_F16C | bit_FMA | bit_MOVBE,
                       v3_more = bit_AVX2 | bit_BMI | bit_BMI2;
    constexpr unsigned kLzcnt = 1u << 5;  // extended leaf, register C
    constexpr unsigned v4_more = bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
    const unsigned basic = cpuid_leaf(1).c, more = cpuid_leaf(7).b, kept = kept_registers();
    const bool is_v3 = (basic & v3_basic) == v3_basic && (more & v3_more) == v3_more &&
                       (cpuid_leaf(0x80000001).c & kLzcnt) && (kept & kAvx) == kAvx;
    if (!is_v3) return "v2";
    return (more & v4_more) == v4_more && (kept & kAvx512) == kAvx512 ? "v4" : "v3";
}
#else
inline const char* cpu_level() { return "base"; }
#endif

}  // namespace beltscape
