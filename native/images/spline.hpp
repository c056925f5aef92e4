// The value and the slopes of a cubic B-spline at any place, from the coefficients of prefilter.hpp.
#pragma once

#include "simd.hpp"

namespace beltscape {

struct Spline {
    const float* coefficients;  // (height, width)
    int width, height;
};

template <class F>
struct Sample {
    F value, du, dv;
};

// The 4x4 coefficients about a position: the index of the first, and the position relative to the second
// one's centre.
template <class F>
struct Footprint {
    IntOf<F> first;
    F u, v;
    MaskOf<F> inside;  // all 16 within the image; else `first` is some other footprint that is
};

// The image is at least 4 x 4; u and v may be anything.
template <class F>
BELTSCAPE_INLINE Footprint<F> footprint(const Spline& spline, F u, F v) {
    const float right = to_float(spline.width - 2), bottom = to_float(spline.height - 2);
    const F near_u = clamp(u, 1.0f, right), near_v = clamp(v, 1.0f, bottom);
    const IntOf<F> x = clamp(to_int(near_u), 1, spline.width - 3);
    const IntOf<F> y = clamp(to_int(near_v), 1, spline.height - 3);
    const MaskOf<F> inside = (u >= 1.0f) & (u < right) & (v >= 1.0f) & (v < bottom);
    return {(y - 1) * spline.width + x - 1, near_u - to_float(x), near_v - to_float(y), inside};
}

// The weights of the four coefficients of a row or column at 0 ... 1 past the second, and their derivatives.
template <class F>
struct Weights {
    F value[4], slope[4];
};

template <class F>
BELTSCAPE_INLINE Weights<F> cubic_weights(F at) {
    const F to = 1.0f - at, square = at * at, to_square = to * to;
    const F half = 0.5f * square, to_half = 0.5f * to_square;
    return {{to_half * to * (1.0f / 3), (2.0f / 3) - half * (2.0f - at), (2.0f / 3) - to_half * (2.0f - to),
             half * at * (1.0f / 3)},
            {-to_half, at * (1.5f * at - 2.0f), to * (2.0f - 1.5f * to), half}};
}

template <class F>
BELTSCAPE_INLINE F weighted(const F (&weights)[4], const F (&taps)[4]) {
    return multiply_add(weights[0], taps[0], weights[1] * taps[1]) +
           multiply_add(weights[2], taps[2], weights[3] * taps[3]);
}

template <class F>
BELTSCAPE_INLINE Sample<F> sample(const Spline& spline, const Footprint<F>& place) {
    const Weights<F> across = cubic_weights(place.u), down = cubic_weights(place.v);
    F rows[4], slopes[4];
    for (int y = 0; y < 4; ++y) {
        F taps[4];
        gather_four(spline.coefficients + y * spline.width, place.first, taps);
        rows[y] = weighted(across.value, taps), slopes[y] = weighted(across.slope, taps);
    }
    return {weighted(down.value, rows), weighted(down.value, slopes), weighted(down.slope, rows)};
}

// The weights of the four pixels of a row or column at 0 ... 1 past the second, for an image without
// prefilter: the interpolating cubic that is right to the third order (Keys 1981,
// doi:10.1109/TASSP.1981.1163711).
template <class F>
BELTSCAPE_INLINE void interpolating_weights(F at, F (&weights)[4]) {
    const F square = at * at, cube = square * at;
    weights[0] = square - 0.5f * (cube + at), weights[1] = 1.5f * cube - 2.5f * square + 1.0f;
    weights[2] = 2.0f * square - 1.5f * cube + 0.5f * at, weights[3] = 0.5f * (cube - square);
}

// An image at a footprint, by the same cubic in both directions.
template <class F>
BELTSCAPE_INLINE F interpolated(const Spline& image, const Footprint<F>& place) {
    F across[4], down[4], rows[4];
    interpolating_weights(place.u, across), interpolating_weights(place.v, down);
    for (int y = 0; y < 4; ++y) {
        F taps[4];
        gather_four(image.coefficients + y * image.width, place.first, taps);
        rows[y] = weighted(across, taps);
    }
    return weighted(down, rows);
}

}  // namespace beltscape
