// Sums over square windows, as sums of columns and then across. Every sum is taken anew and in one order:
// nothing depends on where a part of the grid begins, and no rounding is carried along.
//
// A row begins at its first pixel and has `margin` more at its left; at its right, a vector more than that.
#pragma once

#include "simd.hpp"

namespace beltscape {

// The row goes on as its outermost pixels.
BELTSCAPE_INLINE void repeat_ends(float* row, int width, int margin) {
    for (int i = 1; i <= margin; ++i) row[-i] = row[0], row[width - 1 + i] = row[width - 1];
}

// From -margin to width + margin.
template <class F>
BELTSCAPE_INLINE void column_sums(const float* const* rows, int count, int width, int margin, float* sums) {
    for (int x = -margin; x < width + margin; x += Lane<F>::count) {
        F sum{};
        for (int i = 0; i < count; ++i) sum += load<F>(rows[i] + x);
        store(sums + x, sum);
    }
}

// ... and the sums of their squares.
template <class F>
BELTSCAPE_INLINE void column_sums(const float* const* rows, int count, int width, int margin, float* sums,
                                  float* squares) {
    for (int x = -margin; x < width + margin; x += Lane<F>::count) {
        F sum{}, square{};
        for (int i = 0; i < count; ++i) {
            const F value = load<F>(rows[i] + x);
            sum += value, square = multiply_add(value, value, square);
        }
        store(sums + x, sum), store(squares + x, square);
    }
}

// The sum of a window, of its columns' sums about one.
template <class F>
BELTSCAPE_INLINE F across(const float* column, int radius) {
    F sum{};
    for (int i = -radius; i <= radius; ++i) sum += load<F>(column + i);
    return sum;
}

}  // namespace beltscape
