// The surfaces that compete for a doubtful pixel: its own, and those that the nearest trusted pixels in eight
// directions hand on along their slopes.
#pragma once

#include "candidates.hpp"

namespace beltscape {

inline constexpr int kRivals = 9;         // its own, then one of each direction
inline constexpr float kSteepest = 1.5f;  // no slope is continued more steeply

// Rows of rivals, `stride` apart: nearness and slopes at the pixel, how many steps away the pixel is that
// hands it on (NaN: none does), and how many others say the same, each by the less the farther it comes from.
struct Rivals {
    float *s, *slope_u, *slope_v, *distance, *support;
    size_t stride;
};

struct RivalSearch {
    Surface surface;
    const unsigned char* trusted;  // (height, width), 0 where a pixel hands nothing on
    int reach;                     // steps, along a row, a column or a diagonal
    float same;                    // rivals so close in s say the same
};

BELTSCAPE_INLINE float slope_of(const float* slopes, size_t at) {
    return clamp(finite_or_zero(slopes[at]), -kSteepest, kSteepest);
}

BELTSCAPE_INLINE void no_rival(const Rivals& out, size_t to) {
    out.s[to] = out.slope_u[to] = out.slope_v[to] = out.distance[to] = kNotANumber;
}

// The rival of one direction for pixel (x, y) into place `to`.
BELTSCAPE_INLINE void find_rival(const RivalSearch& in, int x, int y, int dx, int dy, const Rivals& out,
                                 size_t to) {
    const Surface& surface = in.surface;
    for (int step = 1; step <= in.reach; ++step) {
        const int from_x = x + step * dx, from_y = y + step * dy;
        if (from_x < 0 || from_x >= surface.width || from_y < 0 || from_y >= surface.height) break;
        const size_t at =
            static_cast<size_t>(from_y) * static_cast<size_t>(surface.width) + static_cast<size_t>(from_x);
        if (!in.trusted[at] || !finite(surface.s[at])) continue;
        const float slope_u = slope_of(surface.slope_u, at), slope_v = slope_of(surface.slope_v, at);
        out.s[to] = surface.s[at] - slope_u * to_float(step * dx) - slope_v * to_float(step * dy);
        out.slope_u[to] = slope_u, out.slope_v[to] = slope_v, out.distance[to] = to_float(step);
        return;
    }
    no_rival(out, to);
}

BELTSCAPE_INLINE void support_rivals(const Rivals& out, size_t first, float same) {
    for (int i = 0; i < kRivals; ++i) {
        float support = 0;
        for (int k = 1; k < kRivals; ++k) {
            const size_t at = first + static_cast<size_t>(k) * out.stride;
            const float apart = out.s[at] - out.s[first + static_cast<size_t>(i) * out.stride];
            if (k != i && absolute(apart) < same) support += 1.0f / (1.0f + out.distance[at]);
        }
        out.support[first + static_cast<size_t>(i) * out.stride] = support;
    }
}

// All rivals of pixel (x, y), in column `first`.
BELTSCAPE_INLINE void find_rivals(const RivalSearch& in, int x, int y, const Rivals& out, size_t first) {
    const size_t at = static_cast<size_t>(y) * static_cast<size_t>(in.surface.width) + static_cast<size_t>(x);
    if (finite(in.surface.s[at])) {
        out.s[first] = in.surface.s[at], out.distance[first] = 0;
        out.slope_u[first] = slope_of(in.surface.slope_u, at);
        out.slope_v[first] = slope_of(in.surface.slope_v, at);
    } else {
        no_rival(out, first);
    }
    size_t to = first;
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx)
            if (dx || dy) find_rival(in, x, y, dx, dy, out, to += out.stride);
    support_rivals(out, first, in.same);
}

}  // namespace beltscape
