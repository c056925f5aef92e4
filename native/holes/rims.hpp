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
        : field(holes), slopes(holes, threads), far(holes), ways(holes), structure(holes.in, threads) {}

    const HoleField& field;
    Slopes slopes;
    Clearances far;
    Ways ways;
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
    return {std::fmax(near.height, far.height),
            std::fmin(near.height, far.height),
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
    double upper = kEndless, lower = kNothing, gap = kEndless, nearer = kNothing;

    // Takes the line if it comes before the present one. Rounding makes equal lengths equal, in any unit.
    void consider(const Rim& near, const Rim& far, double cell) {
        if (!near.known() || !far.known()) return;
        LowestLine line;
        line.upper = std::max(near.height, far.height), line.lower = std::min(near.height, far.height);
        line.gap = near.distance + far.distance;
        line.nearer = std::min(near.distance, far.distance) / line.gap;
        const double one[] = {line.upper, std::rint(line.gap / cell * 1e6), line.lower,
                              std::rint(line.nearer * 1e9)};
        for (int k = 0; k < 4; ++k) {
            if (one[k] > key[k]) return;
            if (one[k] == key[k]) continue;
            std::copy_n(one, 4, line.key);
            *this = line;
            return;
        }
    }

private:
    double key[4] = {kEndless, kEndless, kEndless, kEndless};
};

struct Rims {
    std::array<RimProfile, kLines> lines;  // the core's line of sight, then four others by ascending gap
    LowestLine lowest;
    double tangent;  // slope of the core's rays
};

inline Rim measure_rim(const RimSurvey& all, const LineEnd& end, double step, double down, double across) {
    if (!end.met()) return {};
    const double x = all.slopes.x.row(end.v)[end.u], y = all.slopes.y.row(end.v)[end.u];
    return {all.field.filtered.row(end.v)[end.u], end.steps * step, std::hypot(x, y), x * across + y * down};
}

inline Rims find_rims(const RimSurvey& all, int v, int u) {
    const HoleField& field = all.field;
    const double cell = field.cell();
    const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(v) * field.width + u;
    const double tan_x = field.in.ray_slope[at];
    const double tan_y = field.in.ray_slope[at + static_cast<std::ptrdiff_t>(field.height) * field.width];
    Rims found;
    found.tangent = std::hypot(tan_x, tan_y);
    for (int k = 0; k < kDirections; ++k) {
        const double down = kDirection[k][0], across = kDirection[k][1], length = std::hypot(down, across);
        const auto side = [&](int s) {
            const LineEnd end = follow(field, all.far, v, u, all.ways.straight[2 * k + s]);
            return measure_rim(all, end, cell * length, down / length, across / length);
        };
        const RimLine line = {side(0), side(1), (tan_x * across + tan_y * down) / length};
        found.lowest.consider(line.near, line.far, cell);
        const RimProfile profile = order_rims(line);
        int place = k + 1;  // behind those that come before it
        for (; place > 1 && comes_before(profile, found.lines[place - 1]); --place)
            found.lines[place] = found.lines[place - 1];
        found.lines[place] = profile;
    }
    for (int k = 0; k < kTurns; ++k) {
        const auto side = [&](int s) -> Rim {
            const LineEnd end = follow(field, all.far, v, u, all.ways.turned[2 * k + s]);
            if (!end.met()) return {};
            return {field.filtered.row(end.v)[end.u], end.steps * cell};
        };
        found.lowest.consider(side(0), side(1), cell);
    }
    // vertical rays define no line: the shortest line replaces it
    found.lines[0] = found.lines[1];
    if (found.tangent >= 1e-9) {
        const double down = tan_y / found.tangent, across = tan_x / found.tangent;
        const auto side = [&](int s) {
            const auto offset = [&](int k) {
                return Offset{static_cast<int>(std::rint(k * (s * down))),
                              static_cast<int>(std::rint(k * (s * across)))};
            };
            const LineEnd end = march(field, all.far, v, u, std::max(field.height, field.width) - 1, offset);
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
        sum.floor = std::fmin(sum.floor, line.lower), sum.ceiling = std::fmax(sum.ceiling, line.upper);
        sum.upper_tangent[k] = sum.lower_tangent[k] = kNothing;
        if (!line.both()) continue;
        shortest = std::min(shortest, line.gap);
        sum.upper_tangent[k] = line.upper + line.upper_rise * line.share * line.gap;
        sum.lower_tangent[k] = line.lower + line.lower_rise * (1 - line.share) * line.gap;
        low = std::fmin(low, std::fmin(sum.upper_tangent[k], sum.lower_tangent[k]));
        high = std::fmax(high, std::fmax(sum.upper_tangent[k], sum.lower_tangent[k]));
        const double across = std::max(line.gap, cell), weight = 1 / (across * across);
        weights += weight;
        heights += weight * (line.upper - (line.upper - line.lower) * line.share);
    }
    sum.shortest = shortest < kEndless ? shortest : cell;
    sum.straight = heights / weights;  // 0 / 0 is NaN
    sum.low = std::fmin(sum.floor, low), sum.high = std::fmax(sum.ceiling, high);
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
