// Semi-global selection among the candidates of neighbours: a path passes to each candidate of a pixel the
// least cost of coming from any candidate of the pixel before, as in H. Hirschmüller, IEEE TPAMI 30(2),
// 328-341, 2008, doi:10.1109/TPAMI.2007.1166, with candidates in place of disparities and slopes in place of
// a preference of constant depth.
#pragma once

#include "simd.hpp"

namespace beltscape {

inline constexpr int kBandRows = 128;  // chosen at once, and the rows around them that paths begin in
inline constexpr int kHaloRows = 12;
inline constexpr float kSteepestStep = 1.0f;  // largest step that slopes may explain between neighbours

// A step of x px costs small · x, and at most large.
struct Jumps {
    float small, large;
};

// The candidates of the pixels a path comes from: `count` rows, `stride` apart.
struct PreviousCandidates {
    const float *s, *rise;  // rise: half of the slopes' step along the path
    const float* toll;      // of the path up to each, the least of a pixel's being 0
    int count;
    size_t stride;
};

// The least cost that a path passes to a candidate with inverse depth s and `rise`.
template <class F>
BELTSCAPE_INLINE F least_path_cost(const PreviousCandidates& before, F s, F rise, const Jumps& jumps) {
    F least = broadcast<F>(jumps.large);
    for (int k = 0; k < before.count; ++k) {
        const size_t at = static_cast<size_t>(k) * before.stride;
        const F step = clamp(rise + load<F>(before.rise + at), -kSteepestStep, kSteepestStep);
        const F jump = absolute(s - load<F>(before.s + at) - step);
        least = lesser(multiply_add(jump, jumps.small, load<F>(before.toll + at)), least);
    }
    return least;
}

// Subtracts the least of `count` rows of tolls from each.
template <class F>
BELTSCAPE_INLINE void level_out(float* tolls, int count, size_t stride) {
    F least = load<F>(tolls);
    for (int k = 1; k < count; ++k) least = lesser(load<F>(tolls + static_cast<size_t>(k) * stride), least);
    for (int k = 0; k < count; ++k) {
        float* const toll = tolls + static_cast<size_t>(k) * stride;
        store(toll, load<F>(toll) - least);
    }
}

}  // namespace beltscape
