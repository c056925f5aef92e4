// Two neighbours at once for every lane: half the loads of two gathers, and the rest is two shuffles.
#pragma once

#include "simd.hpp"

namespace beltscape {

template <class F>
struct Pair {
    F first, second;
};

#if defined(__CUDACC__) || defined(BELTSCAPE_SCALAR)
template <class F>
BELTSCAPE_INLINE Pair<F> gather_pair(const float* base, const int* index) {
    return {base[*index], base[*index + 1]};
}
#endif

#ifndef __CUDACC__
// Lists of lane numbers at compile time, for shuffles.
template <int... lane>
struct Lanes {
    template <class V>
    static V even(V low, V high) {
        return __builtin_shufflevector(low, high, 2 * lane...);
    }
    template <class V>
    static V odd(V low, V high) {
        return __builtin_shufflevector(low, high, 2 * lane + 1 ...);
    }
    template <class V>
    static auto joined(V low, V high) {
        return __builtin_shufflevector(low, high, lane...);
    }
};
template <int count, int... lane>
struct MakeLanes : MakeLanes<count - 1, count - 1, lane...> {};
template <int... lane>
struct MakeLanes<0, lane...> {
    using Type = Lanes<lane...>;
};
template <int count>
using LanesTo = typename MakeLanes<count>::Type;

#ifndef BELTSCAPE_SCALAR
// Loads `pairs` pairs of floats, each as a double; GCC optimises halves that are joined best.
template <int pairs>
inline auto load_pairs(const float* base, const std::int32_t* index) {
    if constexpr (pairs == 2) {
        typedef double Two __attribute__((vector_size(16)));
        double one, other;
        __builtin_memcpy(&one, base + index[0], sizeof one);
        __builtin_memcpy(&other, base + index[1], sizeof other);
        return Two{one, other};
    } else {
        return LanesTo<pairs>::joined(load_pairs<pairs / 2>(base, index),
                                      load_pairs<pairs / 2>(base, index + pairs / 2));
    }
}

// base[index[i]] and base[index[i] + 1] for each lane i. (From memory: taking lanes out of a vector costs
// more.)
template <class F>
inline Pair<F> gather_pair(const float* base, const std::int32_t* index) {
    static_assert(Lane<F>::count == kFloatLanes);
    const F first = reinterpret_cast<F>(load_pairs<kDoubleLanes>(base, index)),
            second = reinterpret_cast<F>(load_pairs<kDoubleLanes>(base, index + kDoubleLanes));
    return {LanesTo<kFloatLanes>::even(first, second), LanesTo<kFloatLanes>::odd(first, second)};
}
#endif
#endif

}  // namespace beltscape
