// How an auxiliary camera sees the pixels of the core's undistorted grid, by their nearness s.
//
// s is inverse depth in units that a stage chooses so that a step of 1 is about a pixel of disparity. A core
// pixel (u, v) at nearness s lies, up to scale, at  direction (u, v, 1) + shift s  in the auxiliary's frame:
// the division by depth happens once, in the projection. OpenCV's five distortion coefficients follow.
#pragma once

#include "lanes.hpp"

namespace beltscape {

// 21 floats in this order: a row of `views` in Python.
struct View {
    float direction[9], shift[3];
    float focal_u, focal_v, center_u, center_v;
    float k1, k2, p1, p2, k3;
};

// Where it is seen, and how near to the auxiliary (in units of s; larger is nearer).
template <class F>
struct Seen {
    F u, v, nearness;
};

// Where it is seen, and how that moves with s.
template <class F>
struct Moving {
    F u, v, du, dv;
};

// All of these are NaN for what is not before the auxiliary.
template <class F>
struct Ideal {
    F x, y, inverse_depth;  // x and y before distortion
};

template <class F>
BELTSCAPE_INLINE Ideal<F> ideal(const View& view, F u, F v, F s) {
    const float* d = view.direction;
    const F x = d[0] * u + d[1] * v + d[2] + view.shift[0] * s;
    const F y = d[3] * u + d[4] * v + d[5] + view.shift[1] * s;
    const F depth = d[6] * u + d[7] * v + d[8] + view.shift[2] * s;
    const F inverse_depth = select(depth > 0.0f, 1.0f / depth, broadcast<F>(kNotANumber));
    return {x * inverse_depth, y * inverse_depth, inverse_depth};
}

template <class F>
struct Pixel {
    F u, v;
};

// The auxiliary's pixel of a direction (x, y, 1) in its frame.
template <class F>
BELTSCAPE_INLINE Pixel<F> image_of(const View& view, F x, F y) {
    const F xx = x * x, xy = x * y, yy = y * y, rr = xx + yy;
    const F radial = 1.0f + rr * (view.k1 + rr * (view.k2 + rr * view.k3));
    const F distorted_x = x * radial + 2.0f * view.p1 * xy + view.p2 * (rr + 2.0f * xx);
    const F distorted_y = y * radial + view.p1 * (rr + 2.0f * yy) + 2.0f * view.p2 * xy;
    return {distorted_x * view.focal_u + view.center_u, distorted_y * view.focal_v + view.center_v};
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
    const F radial = 1.0f + rr * (view.k1 + rr * (view.k2 + rr * view.k3));
    const F slope = 2.0f * (view.k1 + rr * (2.0f * view.k2 + rr * (3.0f * view.k3)));
    const F distorted_x = x * radial + 2.0f * view.p1 * xy + view.p2 * (rr + 2.0f * xx);
    const F distorted_y = y * radial + view.p1 * (rr + 2.0f * yy) + 2.0f * view.p2 * xy;
    const F by_xx = radial + slope * xx + 2.0f * view.p1 * y + 6.0f * view.p2 * x;
    const F by_xy = slope * xy + 2.0f * view.p1 * x + 2.0f * view.p2 * y;
    const F by_yy = radial + slope * yy + 6.0f * view.p1 * y + 2.0f * view.p2 * x;
    const F dx = (view.shift[0] - x * view.shift[2]) * inverse_depth;
    const F dy = (view.shift[1] - y * view.shift[2]) * inverse_depth;
    return {distorted_x * view.focal_u + view.center_u, distorted_y * view.focal_v + view.center_v,
            (by_xx * dx + by_xy * dy) * view.focal_u, (by_xy * dx + by_yy * dy) * view.focal_v};
}

}  // namespace beltscape
