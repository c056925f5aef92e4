// Projection of the pixels of the core's undistorted grid, with inverse depth s, into an auxiliary camera.
//
// s is inverse depth in units that a stage chooses so that a step of 1 is about a pixel of disparity. A core
// pixel (u, v) at inverse depth s lies, up to scale, at  direction (u, v, 1) + shift s  in the auxiliary's
// frame: the division by depth happens once, in the projection. OpenCV's five distortion coefficients follow.
#pragma once

#include "simd.hpp"

namespace beltscape {

// 21 floats in this order: a row of `views` in Python.
struct View {
    float direction[9], shift[3];
    float focal_u, focal_v, center_u, center_v;
    float k1, k2, p1, p2, k3;
};

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

// All of these are NaN for points behind the auxiliary.
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

// The radial distortion of a direction at r².
template <class F>
BELTSCAPE_INLINE F radial_of(const View& view, F rr) {
    return multiply_add(rr, multiply_add(rr, multiply_add(rr, view.k3, view.k2), view.k1), 1.0f);
}

// The distorted direction of (x, y, 1), where xx = x² and so on.
template <class F>
BELTSCAPE_INLINE Pixel<F> distorted(const View& view, F x, F y, F xx, F xy, F yy, F radial) {
    const F rr = xx + yy;
    return {multiply_add(x, radial, multiply_add(xy, 2.0f * view.p1, multiply_add(xx, 2.0f, rr) * view.p2)),
            multiply_add(y, radial, multiply_add(xy, 2.0f * view.p2, multiply_add(yy, 2.0f, rr) * view.p1))};
}

// The auxiliary's pixel of a direction (x, y, 1) in its frame.
template <class F>
BELTSCAPE_INLINE Pixel<F> image_of(const View& view, F x, F y) {
    const F xx = x * x, xy = x * y, yy = y * y;
    const auto [distorted_x, distorted_y] = distorted(view, x, y, xx, xy, yy, radial_of(view, xx + yy));
    return {multiply_add(distorted_x, view.focal_u, view.center_u),
            multiply_add(distorted_y, view.focal_v, view.center_v)};
}

template <class F>
BELTSCAPE_INLINE Seen<F> see(const View& view, F u, F v, F s) {
    const auto [x, y, inverse_depth] = ideal(view, u, v, s);
    const auto [seen_u, seen_v] = image_of(view, x, y);
    return {seen_u, seen_v, s * inverse_depth};
}

template <class F>
BELTSCAPE_INLINE Moving<F> see_moving(const View& view, F u, F v, F s) {
    const auto [x, y, inverse_depth] = ideal(view, u, v, s);
    const F xx = x * x, xy = x * y, yy = y * y, rr = xx + yy;
    const F radial = radial_of(view, rr);
    const F slope = 2.0f * multiply_add(rr, multiply_add(rr, 3.0f * view.k3, 2.0f * view.k2), view.k1);
    const auto [distorted_x, distorted_y] = distorted(view, x, y, xx, xy, yy, radial);
    const F by_xx =
        multiply_add(slope, xx, multiply_add(y, 2.0f * view.p1, multiply_add(x, 6.0f * view.p2, radial)));
    const F by_xy = multiply_add(slope, xy, multiply_add(x, 2.0f * view.p1, y * (2.0f * view.p2)));
    const F by_yy =
        multiply_add(slope, yy, multiply_add(y, 6.0f * view.p1, multiply_add(x, 2.0f * view.p2, radial)));
    const F dx = (view.shift[0] - x * view.shift[2]) * inverse_depth;
    const F dy = (view.shift[1] - y * view.shift[2]) * inverse_depth;
    return {multiply_add(distorted_x, view.focal_u, view.center_u),
            multiply_add(distorted_y, view.focal_v, view.center_v), (by_xx * dx + by_xy * dy) * view.focal_u,
            (by_xy * dx + by_yy * dy) * view.focal_v};
}

}  // namespace beltscape
