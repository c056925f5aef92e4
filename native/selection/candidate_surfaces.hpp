// Candidate surfaces of an uncertain pixel: its own, and those of the nearest reliable pixels in eight
// directions, extrapolated along their slopes.
#pragma once

#include "selection/candidate_list.hpp"

namespace beltscape {

inline constexpr int kSurfaces = 9;       // its own, then one of each direction
inline constexpr float kSteepest = 1.5f;  // no slope is continued more steeply

// Rows of candidates, `stride` apart: inverse depth and slopes at the pixel, the distance in steps to the
// pixel that it comes from (NaN: there is none), and the number of others that agree, weighted by their
// distance.
struct CandidateRows {
    float *s, *slope_u, *slope_v, *distance, *support;
    size_t stride;
};

struct CandidateSearch {
    Surface surface;
    const unsigned char* reliable;  // (height, width), 0 where a pixel gives no candidate
    int reach;                      // steps, along a row, a column or a diagonal
    float separation;               // candidates closer than this in s agree
};

BELTSCAPE_INLINE float slope_of(const float* slopes, size_t at) {
    return clamp(finite_or_zero(slopes[at]), -kSteepest, kSteepest);
}

BELTSCAPE_INLINE void write_no_candidate(const CandidateRows& out, size_t to) {
    out.s[to] = out.slope_u[to] = out.slope_v[to] = out.distance[to] = kNotANumber;
}

// Writes the candidate of one direction for pixel (x, y) into place `to`.
BELTSCAPE_INLINE void find_candidate(const CandidateSearch& in, int x, int y, int dx, int dy,
                                     const CandidateRows& out, size_t to) {
    const Surface& surface = in.surface;
    for (int step = 1; step <= in.reach; ++step) {
        const int from_x = x + step * dx, from_y = y + step * dy;
        if (from_x < 0 || from_x >= surface.width || from_y < 0 || from_y >= surface.height) break;
        const size_t at =
            static_cast<size_t>(from_y) * static_cast<size_t>(surface.width) + static_cast<size_t>(from_x);
        if (!in.reliable[at] || !finite(surface.s[at])) continue;
        const float slope_u = slope_of(surface.slope_u, at), slope_v = slope_of(surface.slope_v, at);
        out.s[to] = surface.s[at] - slope_u * to_float(step * dx) - slope_v * to_float(step * dy);
        out.slope_u[to] = slope_u, out.slope_v[to] = slope_v, out.distance[to] = to_float(step);
        return;
    }
    write_no_candidate(out, to);
}

BELTSCAPE_INLINE void count_support(const CandidateRows& out, size_t first, float separation) {
    for (int i = 0; i < kSurfaces; ++i) {
        float support = 0;
        for (int k = 1; k < kSurfaces; ++k) {
            const size_t at = first + static_cast<size_t>(k) * out.stride;
            const float apart = out.s[at] - out.s[first + static_cast<size_t>(i) * out.stride];
            if (k != i && absolute(apart) < separation) support += 1.0f / (1.0f + out.distance[at]);
        }
        out.support[first + static_cast<size_t>(i) * out.stride] = support;
    }
}

// Writes all candidates of pixel (x, y) into column `first`.
BELTSCAPE_INLINE void find_candidates(const CandidateSearch& in, int x, int y, const CandidateRows& out,
                                      size_t first) {
    const size_t at = static_cast<size_t>(y) * static_cast<size_t>(in.surface.width) + static_cast<size_t>(x);
    if (finite(in.surface.s[at])) {
        out.s[first] = in.surface.s[at], out.distance[first] = 0;
        out.slope_u[first] = slope_of(in.surface.slope_u, at);
        out.slope_v[first] = slope_of(in.surface.slope_v, at);
    } else {
        write_no_candidate(out, first);
    }
    size_t to = first;
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx)
            if (dx || dy) find_candidate(in, x, y, dx, dy, out, to += out.stride);
    count_support(out, first, in.separation);
}

#ifndef __CUDACC__
struct CandidatesInput {
    SurfaceInput surface;
    Grid<const std::uint8_t> reliable;
    List<const float> u, v;  // columns and rows of the pixels
    int reach;
    float separation;

    void fields(const auto& read) {
        read("surface", surface), read("reliable", reliable), read("u", u), read("v", v);
        read("reach", reach), read("separation", separation);
    }
};

// out: s, slope_u, slope_v, distance, support, each (9, pixels).
inline void candidate_surfaces(const CandidatesInput& in, std::size_t threads,
                               const std::vector<Grid<float>>& out) {
    const CandidateSearch search{surface_of(in.surface), in.reliable.data, in.reach, in.separation};
    const CandidateRows to{out[0].data, out[1].data, out[2].data, out[3].data, out[4].data, in.u.shape[0]};
    for_bands(0, static_cast<int>(to.stride), kPixelsPerJob, threads, [&](int first, int end) {
        for (std::size_t i = static_cast<std::size_t>(first); i < static_cast<std::size_t>(end); ++i)
            find_candidates(search, static_cast<int>(in.u[i]), static_cast<int>(in.v[i]), to, i);
    });
}
#endif

}  // namespace beltscape
