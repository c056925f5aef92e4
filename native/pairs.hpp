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

// Elements at[i] and at[i] + 1 of two vectors one after the other, for each lane i.
#if defined(__CUDACC__) || defined(BELTSCAPE_SCALAR)
template <class F>
BELTSCAPE_INLINE Pair<F> pair_within(F low, F high, int) {
    return {low, high};
}
#elif defined(__clang__)
template <class F>
inline Pair<F> pair_within(F low, F high, IntOf<F> at) {
    constexpr int lanes = Lane<F>::count;
    Pair<F> pair;
    for (int i = 0; i < lanes; ++i) {
        const int first = at[i], second = first + 1;
        pair.first[i] = first < lanes ? low[first] : high[first - lanes];
        pair.second[i] = second < lanes ? low[second] : high[second - lanes];
    }
    return pair;
}
#else
template <class F>
inline Pair<F> pair_within(F low, F high, IntOf<F> at) {
    return {__builtin_shuffle(low, high, at), __builtin_shuffle(low, high, at + 1)};
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

// Each lane with the one before and the one after it, in vectors one after the other.
template <class V, int... lane>
inline V with_neighbours_of(V before, V here, V after, Lanes<lane...>) {
    constexpr int lanes = sizeof...(lane);
    return __builtin_shufflevector(before, here, lanes - 1 + lane...) + here +
           __builtin_shufflevector(here, after, lane + 1 ...);
}
template <class F>
inline F with_neighbours(F before, F here, F after) {
#ifdef BELTSCAPE_SCALAR
    return before + here + after;
#else
    return with_neighbours_of(before, here, after, LanesTo<kFloatLanes>());
#endif
}

#ifndef BELTSCAPE_SCALAR
// Pairs of floats, each as a double, one after the other.
#if defined(__AVX__)
inline __m256d load_four_pairs(const float* base, const std::int32_t* index) {
    const auto two = [&](int i) {
        double one, other;
        __builtin_memcpy(&one, base + index[i], sizeof one);
        __builtin_memcpy(&other, base + index[i + 1], sizeof other);
        return _mm_set_pd(other, one);
    };
    return _mm256_insertf128_pd(_mm256_castpd128_pd256(two(0)), two(2), 1);
}
#endif

inline Doubles load_pairs(const float* base, const std::int32_t* index) {
#if defined(__AVX512F__)
    return LanesTo<8>::joined(load_four_pairs(base, index), load_four_pairs(base, index + 4));
#elif defined(__AVX__)
    return load_four_pairs(base, index);
#else
    double pairs[kDoubleLanes];
    for (int i = 0; i < kDoubleLanes; ++i) __builtin_memcpy(pairs + i, base + index[i], sizeof *pairs);
    Doubles all;
    __builtin_memcpy(&all, pairs, sizeof all);
    return all;
#endif
}

// base[index[i]] and base[index[i] + 1] for each lane i. (From memory: taking lanes out of a vector costs
// more.)
template <class F>
inline Pair<F> gather_pair(const float* base, const std::int32_t* index) {
    static_assert(Lane<F>::count == kFloatLanes);
    // GCC would derive the addresses from those of a row above, for which there are not enough registers.
    base = from_memory(base), index = from_memory(index);
    const F first = reinterpret_cast<F>(load_pairs(base, index)),
            second = reinterpret_cast<F>(load_pairs(base, index + kDoubleLanes));
    return {LanesTo<kFloatLanes>::even(first, second), LanesTo<kFloatLanes>::odd(first, second)};
}
#endif
#endif

}  // namespace beltscape
