// Lens models other than Brown's, whose five coefficients view.hpp applies itself: OpenCV's rational,
// thin-prism and tilted models and the fisheye model of Kannala and Brandt. core/geometry/lens in Python
// defines them.
//
// They are out of line: a view's model is the same for all its pixels, so Brown's path pays one branch that
// is always predicted, and none of the others' registers.
#pragma once

#include "simd.hpp"

#ifdef __CUDACC__
#define BELTSCAPE_OUT_OF_LINE __host__ __device__ __noinline__
#else
#define BELTSCAPE_OUT_OF_LINE __attribute__((noinline, cold))
#endif

namespace beltscape {

inline constexpr float kBrown = 0.0f, kRational = 1.0f, kTilted = 2.0f, kFisheye = 3.0f;

// 23 floats in this order; kernels/projection.py packs them. The fisheye has k1 ... k4, the rational model
// all of k, p and s, the tilted one the homography as well.
struct Lens {
    float k1, k2, p1, p2, k3;
    float radius_squared;  // of the domain of validity, in undistorted coordinates
    float model;
    float k4, k5, k6, s1, s2, s3, s4;
    float tilt[9];
};

// A distorted direction.
template <class F>
struct Distorted {
    F x, y;
};

// Its derivatives: xy is that of the distorted x by the undistorted y.
template <class F>
struct LensSlopes {
    F xx, xy, yx, yy;
};

// The radial factor, and twice its derivative by r^2.
template <class F>
struct Radial {
    F factor, slope;
};

template <class F>
BELTSCAPE_INLINE Radial<F> rational_factor(const Lens& lens, F rr) {
    const F numerator = multiply_add(rr, multiply_add(rr, multiply_add(rr, lens.k3, lens.k2), lens.k1), 1.0f);
    const F denominator =
        multiply_add(rr, multiply_add(rr, multiply_add(rr, lens.k6, lens.k5), lens.k4), 1.0f);
    const F inverse = 1.0f / denominator, factor = numerator * inverse;
    const F above = multiply_add(rr, multiply_add(rr, 3.0f * lens.k3, 2.0f * lens.k2), lens.k1);
    const F below = multiply_add(rr, multiply_add(rr, 3.0f * lens.k6, 2.0f * lens.k5), lens.k4);
    return {factor, 2.0f * (above - below * factor) * inverse};
}

// With a = atan(r) / r and t = (r a)^2 = theta^2: a (1 + k1 t + k2 t^2 + k3 t^3 + k4 t^4).
template <class F>
BELTSCAPE_INLINE Radial<F> fisheye_factor(const Lens& lens, F rr) {
    const F r = greater(square_root(rr), broadcast<F>(1e-12f));
    const F a = arc_tangent(r) / r, t = rr * a * a;
    // the quotient loses its digits below r^2 = 0.1, where six terms of the series are exact to 3e-7
    const F series = multiply_add(
        rr,
        multiply_add(
            rr,
            multiply_add(rr, multiply_add(rr, multiply_add(rr, 6.0f / 13, -5.0f / 11), 4.0f / 9), -3.0f / 7),
            2.0f / 5),
        -1.0f / 3);
    const F quotient = (1.0f / (1.0f + rr) - a) / (2.0f * rr);
    const F a_slope = select(rr < 0.1f, series, quotient);
    const F power = multiply_add(
        t, multiply_add(t, multiply_add(t, multiply_add(t, lens.k4, lens.k3), lens.k2), lens.k1), 1.0f);
    const F by_t = multiply_add(
        t, multiply_add(t, multiply_add(t, 4.0f * lens.k4, 3.0f * lens.k3), 2.0f * lens.k2), lens.k1);
    const F t_slope = a * multiply_add(rr, 2.0f * a_slope, a);
    return {a * power, 2.0f * multiply_add(a * by_t, t_slope, a_slope * power)};
}

// NaN beyond the domain of validity.
template <class F>
BELTSCAPE_INLINE Radial<F> radial_factor(const Lens& lens, F rr) {
    const Radial<F> radial = lens.model == kFisheye ? fisheye_factor(lens, rr) : rational_factor(lens, rr);
    return {select(rr <= lens.radius_squared, radial.factor, broadcast<F>(kNotANumber)), radial.slope};
}

template <class F>
BELTSCAPE_INLINE Distorted<F> untilted(const Lens& lens, F x, F y, F factor) {
    const F xx = x * x, xy = x * y, yy = y * y, rr = xx + yy;
    const F across =
        multiply_add(rr, multiply_add(rr, lens.s2, lens.s1), multiply_add(xx, 2.0f, rr) * lens.p2);
    const F down = multiply_add(rr, multiply_add(rr, lens.s4, lens.s3), multiply_add(yy, 2.0f, rr) * lens.p1);
    return {multiply_add(x, factor, multiply_add(xy, 2.0f * lens.p1, across)),
            multiply_add(y, factor, multiply_add(xy, 2.0f * lens.p2, down))};
}

template <class F>
BELTSCAPE_INLINE LensSlopes<F> untilted_slopes(const Lens& lens, F x, F y, const Radial<F>& radial) {
    const F xx = x * x, xy = x * y, yy = y * y, rr = xx + yy;
    const F across = multiply_add(rr, 4.0f * lens.s2, 2.0f * lens.s1),
            down = multiply_add(rr, 4.0f * lens.s4, 2.0f * lens.s3);
    const F both = multiply_add(radial.slope, xy, multiply_add(x, 2.0f * lens.p1, y * (2.0f * lens.p2)));
    const F by_x = multiply_add(
        radial.slope, xx, multiply_add(y, 2.0f * lens.p1, multiply_add(x, 6.0f * lens.p2, radial.factor)));
    const F by_y = multiply_add(
        radial.slope, yy, multiply_add(y, 6.0f * lens.p1, multiply_add(x, 2.0f * lens.p2, radial.factor)));
    return {multiply_add(across, x, by_x), multiply_add(across, y, both), multiply_add(down, x, both),
            multiply_add(down, y, by_y)};
}

// 1 / the third homogeneous coordinate on a tilted sensor; NaN where the direction does not meet it.
template <class F>
BELTSCAPE_INLINE F tilt_scale(const Lens& lens, const Distorted<F>& at) {
    const F third = multiply_add(at.x, lens.tilt[6], multiply_add(at.y, lens.tilt[7], lens.tilt[8]));
    return select(third > 0.0f, 1.0f / third, broadcast<F>(kNotANumber));
}

template <class F>
BELTSCAPE_INLINE Distorted<F> tilted(const Lens& lens, const Distorted<F>& at, F scale) {
    return {multiply_add(at.x, lens.tilt[0], multiply_add(at.y, lens.tilt[1], lens.tilt[2])) * scale,
            multiply_add(at.x, lens.tilt[3], multiply_add(at.y, lens.tilt[4], lens.tilt[5])) * scale};
}

template <class F>
BELTSCAPE_OUT_OF_LINE Distorted<F> distort(const Lens& lens, F x, F y) {
    const Distorted<F> at = untilted(lens, x, y, radial_factor(lens, x * x + y * y).factor);
    return lens.model == kTilted ? tilted(lens, at, tilt_scale(lens, at)) : at;
}

template <class F>
BELTSCAPE_OUT_OF_LINE LensSlopes<F> lens_slopes(const Lens& lens, F x, F y) {
    const Radial<F> radial = radial_factor(lens, x * x + y * y);
    const LensSlopes<F> slopes = untilted_slopes(lens, x, y, radial);
    if (lens.model != kTilted) return slopes;
    const Distorted<F> at = untilted(lens, x, y, radial.factor);
    const F scale = tilt_scale(lens, at);
    const Distorted<F> on_sensor = tilted(lens, at, scale);
    const float* h = lens.tilt;
    const F a = (h[0] - on_sensor.x * h[6]) * scale, b = (h[1] - on_sensor.x * h[7]) * scale;
    const F c = (h[3] - on_sensor.y * h[6]) * scale, d = (h[4] - on_sensor.y * h[7]) * scale;
    return {a * slopes.xx + b * slopes.yx, a * slopes.xy + b * slopes.yy, c * slopes.xx + d * slopes.yx,
            c * slopes.xy + d * slopes.yy};
}

}  // namespace beltscape
