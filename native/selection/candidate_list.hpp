// Candidates of a pixel: its own inverse depth and those of its neighbours, and the few of them that it
// keeps.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr int kMostCandidates = 8;
inline constexpr float kApart = 1.5f;         // candidates farther apart in s are different surfaces
inline constexpr float kNoCandidate = 1e6f;   // the inverse depth of a free place: far from all others
inline constexpr float kNoCost = 1e3f;        // and its cost: anything is cheaper
inline constexpr float kFarthestStep = 3.0f;  // of an extrapolation

// Inverse depth and its slopes along x and y, each (height, width).
struct Surface {
    const float *s, *slope_u, *slope_v;
    int width, height;
};

#ifndef __CUDACC__
using SurfaceInput = std::array<Grid<const float>, 3>;  // s, slope_u, slope_v

inline Surface surface_of(const SurfaceInput& in) {
    return {in[0].data, in[1].data, in[2].data, in[0].width(), in[0].height()};
}
#endif

// A candidate at p comes from the pixel at p - (dx, dy), or from the nearest pixel of the edge.
struct Offset {
    int dx, dy;
};

template <class F>
BELTSCAPE_INLINE MaskOf<F> finite(F a) {
    return a - a == 0.0f;
}

template <class F>
BELTSCAPE_INLINE F finite_or_zero(F a) {
    return select(finite(a), a, F{});
}

// An inverse depth for a pixel, and the slopes of the surface that it comes from (0 where they are NaN).
template <class F>
struct Candidate {
    F s, slope_u, slope_v;
};

template <class F>
BELTSCAPE_INLINE Candidate<F> extrapolate(F s, F slope_u, F slope_v, F across, float down) {
    slope_u = finite_or_zero(slope_u), slope_v = finite_or_zero(slope_v);
    return {s + clamp(multiply_add(slope_v, down, slope_u * across), -kFarthestStep, kFarthestStep), slope_u,
            slope_v};
}

// The candidates of an offset at pixels x, x + 1, ... of row y; beyond the surface its edge is repeated.
template <class F>
BELTSCAPE_INLINE Candidate<F> shifted_candidate(const Surface& surface, const Offset& offset, int x, int y) {
    const int row = clamp(y - offset.dy, 0, surface.height - 1), first = x - offset.dx;
    const float down = to_float(y - row);
    const size_t at = static_cast<size_t>(row) * static_cast<size_t>(surface.width);
    const float *const s = surface.s + at, *const slope_u = surface.slope_u + at,
                       *const slope_v = surface.slope_v + at;
    const int last = Lane<F>::count - 1, edge = surface.width - 1;
    if (first >= 0 && first + last <= edge && x >= 0 && x + last <= edge)
        return extrapolate(load<F>(s + first), load<F>(slope_u + first), load<F>(slope_v + first),
                           broadcast<F>(to_float(offset.dx)), down);
    const IntOf<F> to = clamp(broadcast<IntOf<F>>(x) + lane_numbers<F>(), 0, edge);
    const IntOf<F> from = clamp(to - offset.dx, 0, edge);
    return extrapolate(gather(s, from), gather(slope_u, from), gather(slope_v, from), to_float(to - from),
                       down);
}

// The places of some pixels' candidates: `count` rows, `stride` apart.
struct CandidatePlaces {
    float *s, *cost, *slope_u, *slope_v;
    int count;
    size_t stride;
};

// Inserts a candidate where `allowed`, if it is cheaper: in the first place closer than `separation`, or else
// in the most expensive one.
template <class F>
BELTSCAPE_INLINE void insert_candidate(const CandidatePlaces& places, const Candidate<F>& candidate, F cost,
                                       float separation, MaskOf<F> allowed) {
    IntOf<F> place{}, near_place{};
    MaskOf<F> is_near{};
    F dearest = load<F>(places.cost), near_cost{};
    for (int k = 0; k < places.count; ++k) {
        const size_t at = static_cast<size_t>(k) * places.stride;
        const F kept = load<F>(places.cost + at);
        const MaskOf<F> here =
            (absolute(load<F>(places.s + at) - candidate.s) < separation) & negate(is_near);
        const MaskOf<F> dearer = kept > dearest;
        const IntOf<F> number = broadcast<IntOf<F>>(k);
        near_cost = select(here, kept, near_cost), near_place = select(here, number, near_place);
        dearest = select(dearer, kept, dearest), place = select(dearer, number, place);
        is_near = is_near | here;
    }
    place = select(is_near, near_place, place);
    const MaskOf<F> cheaper = allowed & (cost < select(is_near, near_cost, dearest));
    if (!any(cheaper)) return;
    for (int k = 0; k < places.count; ++k) {
        const size_t at = static_cast<size_t>(k) * places.stride;
        const MaskOf<F> here = cheaper & (place == broadcast<IntOf<F>>(k));
        store(places.s + at, select(here, candidate.s, load<F>(places.s + at)));
        store(places.cost + at, select(here, cost, load<F>(places.cost + at)));
        store(places.slope_u + at, select(here, candidate.slope_u, load<F>(places.slope_u + at)));
        store(places.slope_v + at, select(here, candidate.slope_v, load<F>(places.slope_v + at)));
    }
}

}  // namespace beltscape
