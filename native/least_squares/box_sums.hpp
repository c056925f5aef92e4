// Sums over square windows, as sums of columns and then across. Every sum is computed anew in one order, so
// that results do not depend on where a part of the grid begins and rounding errors do not accumulate.
//
// A row begins at its first pixel and has `margin` more at its left; at its right, a vector more than that.
#pragma once

#include "simd.hpp"

namespace beltscape {

// Repeats the outermost pixels of a row.
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

// Computes also the sums of squares.
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

// The sum of a window from the sums of its columns.
template <class F>
BELTSCAPE_INLINE F across(const float* column, int radius) {
    F sum{};
    for (int i = -radius; i <= radius; ++i) sum += load<F>(column + i);
    return sum;
}

}  // namespace beltscape
