// What semi-global aggregation has in common on all processors: one step of a path, and the plane between
// planes where the costs are least.
#pragma once

#include "simd.hpp"

namespace beltscape {

inline constexpr int kMaxCost = 120;
inline constexpr int kPaths = 4;  // of one pass

// A margin of 1 is this difference of the sums over all paths.
inline constexpr int kWholeMargin = 2 * kPaths * kMaxCost;

// The plane of the least sum, interpolated by two lines of equal slope through it and its neighbours' sums.
BELTSCAPE_INLINE float interpolated_plane(int plane, int before, int least, int after) {
    const int rise = greater(before, after) - least;
    const float whole = to_float(plane);
    return rise > 0 ? whole + 0.5f * to_float(before - after) / to_float(rise) : whole;
}

}  // namespace beltscape
