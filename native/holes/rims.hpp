// The rims of a hole along lines through its cells, and the smooth surface between them (kernels/holes.py);
// the order of operations is the reference's. For the CPU alone.
#pragma once

#include <array>

#include "holes/line_ends.hpp"
#include "holes/plane_slopes.hpp"
#include "holes/structure_function.hpp"

namespace beltscape {

inline constexpr int kLines = 5, kWindows = 4;  // kernels/holes.py
inline constexpr int kWindow[kWindows] = {9, 25, 51, 101};
inline constexpr double kReach = 5, kOpen = 4, kSmooth = 0.03, kTiny = 1e-6;

// What is shared by all cells of a field.
struct RimSurvey {
    RimSurvey(const HoleField& holes, std::size_t threads)
        : field(holes), slopes(holes, threads), far(holes), lines(holes), structure(holes.in, threads) {}

    const HoleField& field;
    Slopes slopes;
    Clearances far;
    FixedLines lines;
    StructureFunction structure;
};

// One side of a line: the rim's height, its distance, and the surface there.
struct Rim {
    double height = kNothing, distance = kEndless, slope = 0, rise = 0;

    bool known() const { return distance < kEndless; }
};

// A line with its rims on the near side (-) and on the far side (+).
struct RimLine {
    Rim near, far;
    double ray_slope = 0;
};

// The rims of a line: see `RimProfiles` of the reference.
struct RimProfile {
    double upper, lower, gap, share, upper_slope, lower_slope, ray_slope, upper_rise, lower_rise;

    bool both() const { return gap < kEndless; }
};

inline RimProfile order_rims(const RimLine& line) {
    const Rim &near = line.near, &far = line.far;
    const bool both = near.known() && far.known();
    // of equal heights the nearer rim, then the steeper one, so that a mirrored field is filled mirrored
    bool swapped = !near.known(), level = both;
    for (const auto& [one, two] :
         {std::array{far.height, near.height}, std::array{near.distance, far.distance},
          std::array{far.slope, near.slope}}) {
        swapped |= level && one > two;
        level &= one == two;
    }
    const Rim &upper = swapped ? far : near, &lower = swapped ? near : far;
    const double gap = both ? near.distance + far.distance : kEndless;
    const double sign = swapped ? -1.0 : 1.0;
    return {greatest(near.height, far.height),
            least(near.height, far.height),
            gap,
            both ? upper.distance / gap : 0.5,
            upper.slope,
            lower.slope,
            sign * line.ray_slope,
            sign * upper.rise,
            -sign * lower.rise};
}

// Whether a profile comes before another one: by gap, heights, then slopes; NaN goes last.
inline bool comes_before(const RimProfile& a, const RimProfile& b) {
    const double one[] = {a.gap, -a.lower, -a.upper, a.share, a.upper_slope, a.lower_slope};
    const double two[] = {b.gap, -b.lower, -b.upper, b.share, b.upper_slope, b.lower_slope};
    for (int k = 0; k < 6; ++k) {
        if (one[k] < two[k] || (two[k] != two[k] && one[k] == one[k])) return true;
        if (two[k] < one[k] || (one[k] != one[k] && two[k] == two[k])) return false;
    }
    return false;
}

// The line whose higher rim is lowest; upper = infinity where none has two rims.
struct LowestLine {
    double upper = kEndless, lower = kNothing, gap = kEndless, nearer_rim = 0;

    double nearer() const { return nearer_rim / gap; }

    // Takes the line if it comes before the present one.
    void consider(const Rim& near, const Rim& far, double cell) {
        const double higher = greatest(near.height, far.height);
        if (!near.known() || !far.known() || higher > upper) return;
        const LowestLine line = {higher, least(near.height, far.height), near.distance + far.distance,
                                 std::min(near.distance, far.distance)};
        if (higher < upper || line.comes_before(*this, cell)) *this = line;
    }

private:
    // Compares lines of equal higher rims. Rounding makes equal lengths equal, in any unit.
    bool comes_before(const LowestLine& other, double cell) const {
        const double one = std::rint(gap / cell * 1e6), two = std::rint(other.gap / cell * 1e6);
        if (one != two) return one < two;
        if (lower != other.lower) return lower < other.lower;
        return std::rint(nearer() * 1e9) < std::rint(other.nearer() * 1e9);
    }
};

struct Rims {
    std::array<RimProfile, kLines> lines;  // the core's line of sight, then four others by ascending gap
    LowestLine lowest;
    double tangent;  // slope of the core's rays
};

inline Rim measure_rim(const RimSurvey& all, const LineEnd& end, double step, double down, double across) {
    if (!end.met()) return {};
    const double x = all.slopes.x[end.at], y = all.slopes.y[end.at];
    return {all.field.filtered[end.at], end.steps * step, all.slopes.steepness[end.at],
            x * across + y * down};
}

inline Rims find_rims(const RimSurvey& all, int v, int u) {
    const HoleField& field = all.field;
    const double cell = field.cell();
    const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(v) * field.width + u;
    const double tan_x = field.in.ray_slope[at];
    const double tan_y = field.in.ray_slope[at + static_cast<std::ptrdiff_t>(field.height) * field.width];
    const std::ptrdiff_t place = v * field.measured.stride() + u;
    Rims found;
    found.tangent = std::sqrt(tan_x * tan_x + tan_y * tan_y);
    const auto straight = all.lines.straight.follow(field, all.far, place);
    for (int k = 0; k < kDirections; ++k) {
        const double down = kDirection[k][0], across = kDirection[k][1];
        const double length = down != 0 && across != 0 ? std::numbers::sqrt2 : 1.0;
        const auto side = [&](int s) {
            return measure_rim(all, straight[2 * k + s], cell * length, down / length, across / length);
        };
        const RimLine line = {side(0), side(1), (tan_x * across + tan_y * down) / length};
        found.lowest.consider(line.near, line.far, cell);
        const RimProfile profile = order_rims(line);
        int number = k + 1;  // behind those that come before it
        for (; number > 1 && comes_before(profile, found.lines[number - 1]); --number)
            found.lines[number] = found.lines[number - 1];
        found.lines[number] = profile;
    }
    const auto turned = all.lines.turned.follow(field, all.far, place);
    for (int k = 0; k < kTurns; ++k) {
        const auto side = [&](int s) -> Rim {
            const LineEnd& end = turned[2 * k + s];
            if (!end.met()) return {};
            return {field.filtered[end.at], end.steps * cell};
        };
        found.lowest.consider(side(0), side(1), cell);
    }
    // vertical rays define no line: the shortest line replaces it
    found.lines[0] = found.lines[1];
    if (found.tangent >= 1e-9) {
        const double down = tan_y / found.tangent, across = tan_x / found.tangent;
        const auto side = [&](int s) {
            const auto offset = [&](int k) {
                return step_offset(k, s * down, s * across, field.measured.stride());
            };
            const LineEnd end = march(field, all.far, place, std::max(field.height, field.width) - 1, offset);
            return measure_rim(all, end, cell, down, across);
        };
        found.lines[0] = order_rims({side(-1), side(1), found.tangent});
    }
    return found;
}

// What the lines together say of a cell; NaN where no line has the rims for it.
struct RimSummary {
    double floor = kNothing, ceiling = kNothing, shortest, straight;
    std::array<double, kLines> upper_tangent, lower_tangent;
    double low, high;  // of all rims and tangents
};

inline RimSummary summarise_rims(const Rims& rims, double cell) {
    RimSummary sum;
    double weights = 0, heights = 0, shortest = kEndless;
    double low = kNothing, high = kNothing;
    for (int k = 0; k < kLines; ++k) {
        const RimProfile& line = rims.lines[k];
        sum.floor = least(sum.floor, line.lower), sum.ceiling = greatest(sum.ceiling, line.upper);
        sum.upper_tangent[k] = sum.lower_tangent[k] = kNothing;
        if (!line.both()) continue;
        shortest = std::min(shortest, line.gap);
        sum.upper_tangent[k] = line.upper + line.upper_rise * line.share * line.gap;
        sum.lower_tangent[k] = line.lower + line.lower_rise * (1 - line.share) * line.gap;
        low = least(low, least(sum.upper_tangent[k], sum.lower_tangent[k]));
        high = greatest(high, greatest(sum.upper_tangent[k], sum.lower_tangent[k]));
        const double across = std::max(line.gap, cell), weight = 1 / (across * across);
        weights += weight;
        heights += weight * (line.upper - (line.upper - line.lower) * line.share);
    }
    sum.shortest = shortest < kEndless ? shortest : cell;
    sum.straight = heights / weights;  // 0 / 0 is NaN
    sum.low = least(sum.floor, low), sum.high = greatest(sum.ceiling, high);
    return sum;
}

// Quadratics in the windows about a cell; NaN where they are not determined.
struct QuadraticFits {
    double value[kWindows], miss[kWindows], leverage[kWindows];
};

struct SmoothSurface {
    double base, scale, smooth, structure[2];
};

inline SmoothSurface predict_smooth_surface(const RimSummary& rims, const QuadraticFits& fits,
                                            const StructureFunction& structure, double cell) {
    int first = 0;  // windows before it do not span the gap
    for (int k = 0; k + 1 < kWindows; ++k) first += kWindow[k] < 2 * rims.shortest / cell + kReach;
    while (first < kWindows && !std::isfinite(fits.value[first])) ++first;
    const bool has = first < kWindows;
    double miss = 0, most = 0, steepest = 0, bend = 0, share = 0;
    if (has) {
        miss = fits.miss[first];
        bend = std::min(std::max(fits.value[first], rims.low), rims.high) - rims.straight;
        share = bend * bend / (bend * bend + 2 * miss * (2 * miss) + kTiny * kTiny);
        for (int k = first; k < std::min(first + 2, kWindows); ++k) {
            if (!std::isfinite(fits.value[k])) continue;
            most = std::max(most, fits.miss[k]);
            steepest = std::max(steepest, fits.miss[k] / (0.5 * cell * kWindow[k]));
        }
    }
    SmoothSurface surface = {
        rims.straight + share * bend, 0, share, {structure(rims.shortest), structure(4 * rims.shortest)}};
    const double range = rims.ceiling - rims.floor, rough = surface.structure[0];
    double scale = std::sqrt(range * range + 2 * miss * (2 * miss) + rough * rough);
    if (has) {
        const double part = std::min(steepest / kSmooth, 1.0);
        if (scale == scale) scale = std::min(scale, kOpen * most);
        scale *= part * part;
    }
    surface.scale = scale + kTiny;
    return surface;
}

}  // namespace beltscape
