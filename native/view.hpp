// Projection of the pixels of the core's undistorted grid, with inverse depth s, into an auxiliary camera.
//
// s is inverse depth in units that a stage chooses so that a step of 1 is about a pixel of disparity. A core
// pixel (u, v) at inverse depth s lies, up to scale, at  direction (u, v, 1) + shift s  in the auxiliary's
// frame: the division by depth happens once, in the projection. The lens follows: Brown's model here, the
// others in lens.hpp.
#pragma once

#include "lens.hpp"

namespace beltscape {

// 39 floats in this order: a row of `views` in Python, kernels/projection.py.
struct View {
    float direction[9], shift[3];
    float focal_u, focal_v, center_u, center_v;
    Lens lens;
};
inline constexpr int kViewFloats = 39;
static_assert(sizeof(View) == kViewFloats * sizeof(float));

// The projected pixel, and the inverse depth from the auxiliary (in units of s).
template <class F>
struct Seen {
    F u, v, inverse_depth;
};

// The projected pixel, and its derivatives by s.
template <class F>
struct Moving {
    F u, v, du, dv;
};

// All of these are NaN for points behind the auxiliary, and u, v beyond its lens's domain of validity.
template <class F>
struct Ideal {
    F x, y, inverse_depth;  // x and y before distortion
};

template <class F>
BELTSCAPE_INLINE Ideal<F> ideal(const View& view, F u, F v, F s) {
    const float* d = view.direction;
    const F x = multiply_add(s, view.shift[0], multiply_add(u, d[0], multiply_add(v, d[1], d[2])));
    const F y = multiply_add(s, view.shift[1], multiply_add(u, d[3], multiply_add(v, d[4], d[5])));
    const F depth = multiply_add(s, view.shift[2], multiply_add(u, d[6], multiply_add(v, d[7], d[8])));
    const F inverse_depth = select(depth > 0.0f, 1.0f / depth, broadcast<F>(kNotANumber));
    return {x * inverse_depth, y * inverse_depth, inverse_depth};
}

template <class F>
struct Pixel {
    F u, v;
};

// The radial factor of Brown's model at r^2; NaN beyond the domain of validity.
template <class F>
BELTSCAPE_INLINE F radial_of(const Lens& lens, F rr) {
    const F factor = multiply_add(rr, multiply_add(rr, multiply_add(rr, lens.k3, lens.k2), lens.k1), 1.0f);
    return select(rr <= lens.radius_squared, factor, broadcast<F>(kNotANumber));
}

// The direction of (x, y, 1) distorted by Brown's model, where xx = x^2 and so on.
template <class F>
BELTSCAPE_INLINE Distorted<F> distorted(const Lens& lens, F x, F y, F xx, F xy, F yy, F radial) {
    const F rr = xx + yy;
    return {multiply_add(x, radial, multiply_add(xy, 2.0f * lens.p1, multiply_add(xx, 2.0f, rr) * lens.p2)),
            multiply_add(y, radial, multiply_add(xy, 2.0f * lens.p2, multiply_add(yy, 2.0f, rr) * lens.p1))};
}

template <class F>
BELTSCAPE_INLINE Pixel<F> pixel_of(const View& view, const Distorted<F>& at) {
    return {multiply_add(at.x, view.focal_u, view.center_u), multiply_add(at.y, view.focal_v, view.center_v)};
}

// The auxiliary's pixel of a direction (x, y, 1) in its frame.
template <class F>
BELTSCAPE_INLINE Pixel<F> image_of(const View& view, F x, F y) {
    if (__builtin_expect(view.lens.model != kBrown, 0)) return pixel_of(view, distort(view.lens, x, y));
    const F xx = x * x, xy = x * y, yy = y * y;
    return pixel_of(view, distorted(view.lens, x, y, xx, xy, yy, radial_of(view.lens, xx + yy)));
}

template <class F>
BELTSCAPE_INLINE Seen<F> see(const View& view, F u, F v, F s) {
    const auto [x, y, inverse_depth] = ideal(view, u, v, s);
    const auto [seen_u, seen_v] = image_of(view, x, y);
    return {seen_u, seen_v, s * inverse_depth};
}

// brown: whether the view's lens is Brown's. A caller's loop is compiled for each, because a call in it would
// cost the registers that hold the view: a sixth of a warp's time.
template <bool brown, class F>
BELTSCAPE_INLINE Moving<F> see_moving(const View& view, F u, F v, F s) {
    const auto [x, y, inverse_depth] = ideal(view, u, v, s);
    const F dx = (view.shift[0] - x * view.shift[2]) * inverse_depth;
    const F dy = (view.shift[1] - y * view.shift[2]) * inverse_depth;
    const Lens& lens = view.lens;
    if constexpr (!brown) {
        const Pixel<F> pixel = pixel_of(view, distort(lens, x, y));
        const LensSlopes<F> by = lens_slopes(lens, x, y);
        return {pixel.u, pixel.v, (by.xx * dx + by.xy * dy) * view.focal_u,
                (by.yx * dx + by.yy * dy) * view.focal_v};
    }
    const F xx = x * x, xy = x * y, yy = y * y, rr = xx + yy;
    const F radial = radial_of(lens, rr);
    const F slope = 2.0f * multiply_add(rr, multiply_add(rr, 3.0f * lens.k3, 2.0f * lens.k2), lens.k1);
    const Pixel<F> pixel = pixel_of(view, distorted(lens, x, y, xx, xy, yy, radial));
    const F by_xx =
        multiply_add(slope, xx, multiply_add(y, 2.0f * lens.p1, multiply_add(x, 6.0f * lens.p2, radial)));
    const F by_xy = multiply_add(slope, xy, multiply_add(x, 2.0f * lens.p1, y * (2.0f * lens.p2)));
    const F by_yy =
        multiply_add(slope, yy, multiply_add(y, 6.0f * lens.p1, multiply_add(x, 2.0f * lens.p2, radial)));
    return {pixel.u, pixel.v, (by_xx * dx + by_xy * dy) * view.focal_u,
            (by_xy * dx + by_yy * dy) * view.focal_v};
}

}  // namespace beltscape
