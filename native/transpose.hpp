// The transpose of a square of lanes.
#pragma once

#include "simd.hpp"

namespace beltscape {

// Exchanges rows and columns: each step interleaves the first half of the rows with the second one.
template <class F>
inline void transpose(F (&rows)[Lane<F>::count]) {
    constexpr int count = Lane<F>::count, half = count / 2;
    if constexpr (count > 1) {
        constexpr auto first = [](int i) { return i / 2 + i % 2 * count; };
        constexpr auto last = [](int i) { return half + i / 2 + i % 2 * count; };
#pragma GCC unroll 4
        for (int step = 1; step < count; step *= 2) {
            F next[count];
#pragma GCC unroll 8
            for (int i = 0; i < half; ++i) {
                next[2 * i] = shuffle(rows[i], rows[i + half], first);
                next[2 * i + 1] = shuffle(rows[i], rows[i + half], last);
            }
#pragma GCC unroll 16
            for (int i = 0; i < count; ++i) rows[i] = next[i];
        }
    }
}

}  // namespace beltscape
