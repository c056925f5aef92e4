// An auxiliary's image turned into the directions of the core's grid, where a plane of the sweep only scales
// and moves it: pixel (u, v) is what the auxiliary sees in the direction of the core's pixel (u, v). The
// core's pixel (x, y) at inverse depth s lies at  direction (x, y, 1) + shift s  in the auxiliary's frame, so
// in its aligned image at
//   (x + s g_u, y + s g_v) / (1 + s g_z)    with    g = direction^-1 shift.
// Lens and rotation are paid for once and not on every plane, and neighbours lie side by side.
#pragma once

#include "images/spline.hpp"
#include "sweep/plane_sweep.hpp"

namespace beltscape {

// Planes of the sweep: inverse depth first + step d for d = 0 ... planes - 1.
struct PlaneRange {
    float first, step;
    int planes;

    BELTSCAPE_INLINE float inverse_depth(int plane) const { return first + step * static_cast<float>(plane); }
};

// A plane that an auxiliary has at less than a quarter of the core's distance is not seen: its pixels would
// be four times as far apart as the core's.
inline constexpr float kMostScale = 4.0f;

// Where a plane is in an aligned image: pixel (x, y) of the core at (scale x + u, scale y + v).
struct PlanePlace {
    float scale, u, v;
    bool seen;
};

// The shift g of an aligned image by inverse depth.
struct AlignedShift {
    float u, v, z;

    BELTSCAPE_INLINE PlanePlace place(float s) const {
        const float depth = multiply_add(s, z, 1.0f);
        const bool seen = depth * kMostScale >= 1.0f;
        const float scale = 1.0f / (seen ? depth : 1.0f);
        return {scale, scale * (s * u), scale * (s * v), seen};
    }
};

// Solves direction g = shift; a projection has a regular direction matrix.
BELTSCAPE_INLINE AlignedShift aligned_shift(const View& view) {
    const float *d = view.direction, *t = view.shift;
    const auto minor = [d](int row, int column) {
        const int a = (row + 1) % 3 * 3, b = (row + 2) % 3 * 3, i = (column + 1) % 3, j = (column + 2) % 3;
        return static_cast<double>(d[a + i]) * d[b + j] - static_cast<double>(d[a + j]) * d[b + i];
    };
    const double determinant = d[0] * minor(0, 0) + d[1] * minor(0, 1) + d[2] * minor(0, 2);
    const auto solved = [&](int column) {
        return static_cast<float>(
            (t[0] * minor(0, column) + t[1] * minor(1, column) + t[2] * minor(2, column)) / determinant);
    };
    return {solved(0), solved(1), solved(2)};
}

// Whole pixels left ... left + width - 1, top ... top + height - 1.
struct Field {
    int left, top, width, height;
};

// The field that the planes take of an aligned image, for a core of this size; empty where none is seen.
BELTSCAPE_INLINE Field aligned_field(const AlignedShift& shift, const PlaneRange& range, int width,
                                     int height) {
    float low_u = kInfinity, low_v = kInfinity, high_u = -kInfinity, high_v = -kInfinity;
    for (int plane = 0; plane < range.planes; ++plane) {
        const PlanePlace place = shift.place(range.inverse_depth(plane));
        if (!place.seen) continue;
        low_u = lesser(place.u, low_u), low_v = lesser(place.v, low_v);
        high_u = greater(multiply_add(place.scale, to_float(width - 1), place.u), high_u);
        high_v = greater(multiply_add(place.scale, to_float(height - 1), place.v), high_v);
    }
    if (!(low_u <= high_u)) return {0, 0, 0, 0};
    const int left = floor_int(low_u) - 1, top = floor_int(low_v) - 1;  // a pixel more, for rounding's sake
    return {left, top, floor_int(high_u) + 3 - left, floor_int(high_v) + 3 - top};
}

// What the auxiliary sees in the directions of core pixels x of row y, by cubic interpolation: the planes'
// own, which is bilinear, would blur it a second time. NaN where it sees nothing, within two pixels of its
// border too.
template <class F>
BELTSCAPE_INLINE F aligned_level(const View& view, const Image& image, F x, float y) {
    const auto [seen_x, seen_y, inverse_depth] = ideal(view, x, broadcast<F>(y), broadcast<F>(0.0f));
    const auto [u, v] = image_of(view, seen_x, seen_y);
    const Spline pixels{image.pixels, image.width, image.height};
    const Footprint<F> place = footprint(pixels, u, v);
    return select(place.inside, interpolated(pixels, place), broadcast<F>(kNotANumber));
}

// The value at u between two rows, part_v of the way from `above` to `below`, of which `readable` pixels are.
template <class F>
BELTSCAPE_INLINE F resampled(const float* above, const float* below, float part_v, F u, int readable) {
    const IntOf<F> left = to_int(u), at = clamp(left, 0, readable - 2);
    const F a = gather(above, at), b = gather(above + 1, at);
    const F first = multiply_add(gather(below, at) - a, part_v, a);
    const F second = multiply_add(gather(below + 1, at) - b, part_v, b);
    return multiply_add(second - first, u - to_float(left), first);
}

// `count` pixels of an aligned row between the rows `above` and `below`, part_v of the way, `scale` apart
// from `from` on; both rows are readable from 0 to `readable`, which is past the last place by two vectors.
template <class F>
BELTSCAPE_INLINE void resample(const float* above, const float* below, float part_v, float scale, float from,
                               int readable, int count, float* out) {
    constexpr int lanes = Lane<F>::count;
    const bool close = scale * static_cast<float>(lanes - 1) < static_cast<float>(2 * lanes - 2);
    for (int x = 0; x < count; x += lanes) {
        const F u = multiply_add(to_float(broadcast<IntOf<F>>(x) + lane_numbers<F>()), scale, from);
        F value;
        if (close) {
            const IntOf<F> left = to_int(u);
            const int first = lesser(to_int(multiply_add(to_float(x), scale, from)), readable - 2 * lanes);
            const F a = load<F>(above + first), b = load<F>(above + first + lanes);
            const Pair<F> pair =
                pair_within(multiply_add(load<F>(below + first) - a, part_v, a),
                            multiply_add(load<F>(below + first + lanes) - b, part_v, b), left - first);
            value = multiply_add(pair.second - pair.first, u - to_float(left), pair.first);
        } else {
            value = resampled(above, below, part_v, u, readable);
        }
        store(out + x, value);
    }
}

}  // namespace beltscape
