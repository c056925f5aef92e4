// The features of hole cells in the order of kernels/holes.py HOLE_FEATURES. First their arguments are
// written for many cells, in double; then angles and logarithms are taken, in float. For the CPU alone.
#pragma once

#include <bit>
#include <string_view>

#include "holes/quadratics.hpp"
#include "simd.hpp"

namespace beltscape {

inline constexpr int kOpens = 4, kLows = 3, kRoughs = 2;  // kernels/holes.py
inline constexpr int kOpenCells[kOpens] = {5, 11, 25, 51}, kLowCells[kLows] = {11, 25, 51},
                     kRoughCells[kRoughs] = {25, 71};
inline constexpr int kMeanCells[] = {5, 9, 11, 25, 51, 101};  // of both
inline constexpr double kMostRatio = 4, kNoLeverage = 99, kBareCells = 3;

// What becomes of each argument: P, nothing; A, the angle of this slope; L, the logarithm of a positive
// number, and of another one its opposite.
inline constexpr int kHoleFeatures = 140;
inline constexpr std::array<char, kHoleFeatures> kArgument = [] {
    std::array<char, kHoleFeatures> all{};
    std::size_t at = 0;
    const auto append = [&](std::string_view kinds, int times) {
        for (; times > 0; --times)
            for (const char kind : kinds) all[at++] = kind;
    };
    append("PPPAPAAPPLPPPAAL", kLines);
    append("PPAAAAAAAPLPPAAAPP", 1);
    append("P", kOpens);
    append("L", 1);
    append("PPPAL", kWindows);
    append("P", kRoughs);
    append("PPLLPA", 1);
    append("PAA", kLows);
    return all;
}();

// The statistics of a hole cell's windows.
struct CellWindows {
    QuadraticFits fits;
    double open[kOpens], mean[kWindows], rough[kRoughs], low[kLows], depth;
};

// Writes one cell's arguments, one below the other.
class ArgumentWriter {
public:
    ArgumentWriter(float* first, std::ptrdiff_t down) : to(first), stride(down) {}

    void put(double number) {
        *to = static_cast<float>(number);
        to += stride;
    }
    void ratio(double over, double inverse) {
        const double value = over * inverse;
        put(value - value == 0 ? std::clamp(value, -kMostRatio, kMostRatio) : 0.0);
    }
    void slope(double rise, double inverse) {
        const double value = rise * inverse;
        put(value - value == 0 ? value : 0.0);
    }

private:
    float* to;
    std::ptrdiff_t stride;
};

// The inverse units of features.
struct FeatureUnits {
    double scale, shortest, cell;
};

inline void write_line(const RimProfile& line, double upper_tangent, double lower_tangent, double base,
                       const FeatureUnits& per, ArgumentWriter& to) {
    const bool both = line.both();
    const double gap = both ? line.gap : 1.0, per_gap = 1 / gap, drop = both ? line.upper - line.lower : 0.0;
    to.put(!both);
    to.ratio(both ? line.upper - base : 0.0, per.scale);
    to.ratio(both ? line.lower - base : 0.0, per.scale);
    to.slope(drop, per_gap);
    to.put(line.share);
    to.put(line.upper_slope);
    to.put(line.lower_slope);
    to.ratio(std::max(line.ray_slope, 0.0) * drop, per_gap);
    to.put(line.ray_slope);
    to.put(both ? gap * per.shortest : -2.0);
    to.put(both ? std::min(line.share, 1 - line.share) * gap * per.shortest : 1.0);
    to.ratio(upper_tangent - base, per.scale);
    to.ratio(lower_tangent - base, per.scale);
    to.put(line.upper_rise);
    to.put(line.lower_rise);
    to.put(both ? gap * per.cell : -4.0);
}

inline void write_cell(const Rims& rims, const RimSummary& sum, const SmoothSurface& surface, bool pinhole,
                       const FeatureUnits& per, ArgumentWriter& to) {
    const double base = surface.base;
    to.ratio(sum.floor - base, per.scale);
    to.ratio(sum.ceiling - base, per.scale);
    to.slope(sum.ceiling - sum.floor, per.shortest);
    to.slope(base, per.scale);
    to.slope(sum.floor, per.scale);
    to.slope(base, per.shortest);
    to.slope(sum.floor, per.shortest);
    to.slope(surface.structure[0], per.shortest);
    to.slope(surface.structure[1], 0.25 * per.shortest);
    to.ratio(surface.structure[0], per.scale);
    to.put(std::clamp(sum.shortest * per.cell, 1.0, 64.0));
    to.put(rims.tangent);
    to.put(pinhole);
    to.slope(sum.floor, per.cell / kBareCells);
    to.slope(sum.ceiling, per.cell / kBareCells);
    to.slope(surface.scale, per.shortest);
    to.put(surface.smooth);
    to.ratio(sum.straight - base, per.scale);
}

inline void write_windows(const CellWindows& windows, double base, const FeatureUnits& per,
                          ArgumentWriter& to) {
    for (const double open : windows.open) to.put(open);
    to.put(windows.depth);
    for (int k = 0; k < kWindows; ++k) {
        const double miss = windows.fits.miss[k], leverage = windows.fits.leverage[k];
        to.ratio(windows.mean[k] - base, per.scale);
        to.ratio(windows.fits.value[k] - base, per.scale);
        to.ratio(miss, per.scale);
        to.slope(miss == miss ? miss : 0.0, 6.0 / kWindow[k] * per.cell);
        to.put(leverage == leverage ? std::clamp(leverage, 0.5, kNoLeverage) : kNoLeverage);
    }
    for (const double rough : windows.rough) to.put(rough == rough ? rough * per.cell : 0.0);
}

inline void write_depths(const Rims& rims, double floor, const CellWindows& windows, double base,
                         const FeatureUnits& per, ArgumentWriter& to) {
    const LowestLine& lowest = rims.lowest;
    const bool both = lowest.upper < kEndless;
    const double beneath = rims.lines[1].both() ? rims.lines[1].lower : kNothing;  // of the shortest line
    to.ratio(both ? lowest.upper - base : 0.0, per.scale);
    to.ratio(both ? lowest.lower - base : 0.0, per.scale);
    to.put(both ? lowest.gap * per.shortest : -2.0);
    to.put(both ? lowest.gap * per.cell : -4.0);
    to.put(both ? lowest.nearer() : 0.0);
    to.slope(beneath - lowest.upper, per.shortest);
    for (const double low : windows.low) {
        to.ratio(low - base, per.scale);
        to.slope(low - floor, per.shortest);
        to.slope(beneath - low, per.shortest);
    }
}

// The natural logarithm of x > 0 (S. L. Moshier's logf of the Cephes library, 1989).
inline float logarithm(float x) {
    const std::int32_t bits = std::bit_cast<std::int32_t>(x);
    const std::int32_t power = (bits - 0x3f3504f3) >> 23;  // x over 2^power is √½ ... √2
    const float f = std::bit_cast<float>(bits - power * (1 << 23)) - 1.0f, e = static_cast<float>(power);
    const float ff = f * f;
    float series = 7.0376836292e-2f;
    for (const float term : {-1.1514610310e-1f, 1.1676998740e-1f, -1.2420140846e-1f, 1.4249322787e-1f,
                             -1.6668057665e-1f, 2.0000714765e-1f, -2.4999993993e-1f, 3.3333331174e-1f})
        series = series * f + term;
    const float low = f * ff * series + e * -2.12194440e-4f - 0.5f * ff;
    return f + low + e * 0.693359375f;
}

// Turns the arguments of `count` cells into features; rows lie `stride` numbers apart.
inline void transform_arguments(float* arguments, std::ptrdiff_t stride, int count) {
    constexpr int lanes = Lane<Floats>::count;
    for (int k = 0; k < kHoleFeatures; ++k) {
        float* const row = arguments + k * stride;
        if (kArgument[k] == 'A')
            for (int i = 0; i < count; i += lanes) {
                const Floats slope = load_first<Floats>(row + i, count - i);
                const Floats angle = arc_tangent(absolute(slope));
                store_first(row + i, select(slope < 0.0f, -angle, angle), count - i);
            }
        if (kArgument[k] == 'L')
            for (int i = 0; i < count; ++i) row[i] = row[i] > 0 ? logarithm(row[i]) : -row[i];
    }
}

}  // namespace beltscape
