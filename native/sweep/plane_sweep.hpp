// The dissimilarity of auxiliaries and core on one plane of the sweep, a row at a time: 3x3 windows on the
// core's grid, a centred normalised sum of squared differences per view, the best few views averaged.
//
// With I the core and J the auxiliary warped by the plane, both centred in the window,
//   sum (I - J)^2 / (sum I^2 + sum J^2 + 18 floor)  =  1 - 2 (sum I J + 9 floor) / (the same),
// so that three window sums per view are enough. NaN (nothing seen) propagates through the sums and becomes
// 1.
#pragma once

#include "array.hpp"
#include "pairs.hpp"

namespace beltscape {

inline constexpr float kWorst = 120.0f;  // the byte of a dissimilarity of 1

// Grey levels (height, width).
struct Image {
    const float* pixels;
    int width, height;
};

BELTSCAPE_INLINE Image image_of(const Grid<const float>& grid) {
    return {grid.data, grid.width(), grid.height()};
}

// The position of a sample: the upper left pixel of its footprint, and the fractional offsets from it (NaN:
// not inside).
template <class F>
struct Spot {
    IntOf<F> index;
    F u, v;
};

template <class F>
BELTSCAPE_INLINE Spot<F> spot(const Image& image, F u, F v, MaskOf<F> valid) {
    const MaskOf<F> inside = valid & (u >= 0.0f) & (u < static_cast<float>(image.width - 1)) & (v >= 0.0f) &
                             (v < static_cast<float>(image.height - 1));
    const F zero{};
    u = select(inside, u, zero), v = select(inside, v, zero);
    const IntOf<F> left = to_int(u), upper = to_int(v);  // not negative: towards zero is downwards
    return {upper * image.width + left, select(inside, u - to_float(left), broadcast<F>(kNotANumber)),
            v - to_float(upper)};
}

// Bilinear from the 2x2 pixels at each spot; NaN where u is.
template <class F>
BELTSCAPE_INLINE F bilinear(const Image& image, const int* index, F u, F v) {
    const auto [a, b] = gather_pair<F>(image.pixels, index);
    const auto [c, d] = gather_pair<F>(image.pixels + image.width, index);
    const F above = multiply_add(u, b - a, a), below = multiply_add(u, d - c, c);
    return multiply_add(v, below - above, above);
}

// The sum of products of three neighbours.
template <class F>
BELTSCAPE_INLINE F three_products(F a, F b, F c, F i, F j, F k) {
    return multiply_add(c, k, multiply_add(b, j, a * i));
}

// Sums over a window of J, J^2 and I J.
template <class F>
struct WindowSums {
    F aux, aux_squared, product;
};

// The core's share of a window: mean of I, and the sum of its centred squares + 18 floor.
template <class F>
struct CoreWindow {
    F mean, energy;
};

template <class F>
BELTSCAPE_INLINE CoreWindow<F> core_window(F sum, F sum_of_squares, float floor) {
    const F mean = sum * (1.0f / 9.0f);
    return {mean, sum_of_squares - sum * mean + 18.0f * floor};
}

// 0 (equal except for the mean level) ... 1 (dissimilar, or not seen).
template <class F>
BELTSCAPE_INLINE F dissimilarity(const WindowSums<F>& sums, const CoreWindow<F>& core, float floor) {
    const F aux_energy = multiply_add(sums.aux, sums.aux * (-1.0f / 9.0f), sums.aux_squared);
    const F alike = multiply_add(-sums.aux, core.mean, sums.product) + 9.0f * floor;
    const F value = 1.0f - 2.0f * alike / (core.energy + aux_energy);
    return greater(lesser(value, broadcast<F>(1.0f)), broadcast<F>(0.0f));
}

}  // namespace beltscape
