// A plane fitted to every pixel's neighbourhood by weighted least squares, over several nested windows at
// once; the largest window that agrees with all smaller ones is taken.
//
// Pixel q has the weight  gauss(q - p) (1 - (e / tolerance)²)₊² information(q),  where e is the distance of
// its s from the plane of p so far. The plane is fitted to e + pull / information: the result is a change.
//
// The Gaussian is separable, so rows are summed first. The weights without the Gaussian are computed once for
// all windows, in pairs left and right of p, because even and odd moments need only a pair's sum and its
// difference. A pair goes at once to the sums of all windows, which stay in registers.
#pragma once

#include "simd.hpp"

namespace beltscape {

inline constexpr int kMaxRadius = 15;
inline constexpr int kMaxWindows = 4;
inline constexpr float kSlopeRidge =
    0.1f;  // holds the slopes to the earlier ones where a window has no breadth
inline constexpr float kNoWeight = 1e-12f;  // a window of no more weight is left out
inline constexpr float kLeastVariance = 1e-12f;
inline constexpr float kMostDisagreement = 25.0f;
inline constexpr float kLargestStep = 1.0f;  // of s

// A tap of a Gaussian: itself, times its distance from the centre, times the distance's square; its own
// square.
struct TapPowers {
    float one, by, by_by, square;
};

// One window, as the parts of its Gaussian.
struct FitWindow {
    int radius;
    int reach[kMaxRadius + 1];  // by row off the centre: how far its taps go left and right; -1 for no row
    TapPowers across[kMaxRadius + 1];    // by column off the centre
    TapPowers down[2 * kMaxRadius + 1];  // by row from -kMaxRadius on, divided by tolerance⁴
};

BELTSCAPE_INLINE TapPowers powers_of(float tap, float by) {
    return {tap, tap * by, tap * by * by, tap * tap};
}

// Fills a window from radius + 1 taps and reaches.
BELTSCAPE_INLINE void fill_window(FitWindow& window, int radius, const double* taps, const int* reach,
                                  double tolerance_to_fourth) {
    window.radius = radius;
    for (int i = 0; i <= kMaxRadius; ++i) window.reach[i] = i <= radius ? reach[i] : -1;
    for (int i = 0; i <= radius; ++i) {
        const float across = static_cast<float>(taps[i]), by = to_float(i);
        const float down = static_cast<float>(taps[i] / tolerance_to_fourth);
        window.across[i] = powers_of(across, by);
        window.down[kMaxRadius - i] = powers_of(down, -by), window.down[kMaxRadius + i] = powers_of(down, by);
    }
}

struct FitSettings {
    double tolerance;
    float confidence_width;   // of an interval, in standard deviations to each side
    float prior_information;  // of each pixel's present s
    float flatten;            // share of the neighbours' distance from the plane that counts

    BELTSCAPE_INLINE void fields(const auto& read) {
        read("tolerance", tolerance), read("confidence_width", confidence_width);
        read("prior_information", prior_information), read("flatten", flatten);
    }
};

struct FitWindows {
    FitWindow window[kMaxWindows];   // smallest radius first
    float distance[kMaxRadius + 1];  // 0, 1, 2, ...
    float zero;  // read from memory: with a constant GCC makes two instructions of `greater` instead of one
    int count;
    float tolerance;
    FitSettings settings;
};

// What a fit reads: at pixel (0, 0) of a part of the grid, with a margin all around of the largest radius,
// and a vector more at the right. Where there is nothing, all three are 0. `information` has the prior in it.
struct FitField {
    const float *s, *information, *pull;
    int stride;
};

template <class F>
struct Fit {
    F change, slope_u, slope_v, variance;  // of s, and the slopes' changes
    F disagreement;
    IntOf<F> window;
};

template <class F>
struct Tap {
    F weight, pull, square;
};

template <class F>
BELTSCAPE_INLINE Tap<F> fit_tap(const FitField& field, int at, F expected, const FitWindows& windows) {
    const F e = load<F>(field.s + at) - expected, information = load<F>(field.information + at);
    const F near = greater(multiply_add(e, -e, broadcast<F>(windows.tolerance * windows.tolerance)),
                           broadcast<F>(windows.zero)),
            closeness = near * near;
    const F weight = closeness * information;
    return {weight,
            closeness * multiply_add(information, windows.settings.flatten * e, load<F>(field.pull + at)),
            closeness * weight};
}

// Sums and differences of the taps in the i-th columns right and left of the pixel's, without the Gaussian
// and times tolerance⁴.
template <class F>
struct TapPair {
    F weight, weight_odd, pull, pull_odd, square;
};

// expected: of s in the pixel's column, by the plane so far.
template <class F>
BELTSCAPE_INLINE TapPair<F> fit_pair(const FitField& field, int at, int i, F expected, F slope_u,
                                     const FitWindows& windows) {
    const float by = windows.distance[i];
    const Tap<F> right = fit_tap(field, at + i, multiply_add(slope_u, by, expected), windows);
    const Tap<F> left = fit_tap(field, at - i, multiply_add(-slope_u, by, expected), windows);
    return {right.weight + left.weight, right.weight - left.weight, right.pull + left.pull,
            right.pull - left.pull, right.square + left.square};
}

// Sums over a row of a window: of the weight, by the offset u, of weight times what is fitted, of weight² /
// information.
template <class F>
struct RowSums {
    F one, u, uu, pull, pull_u, square;
};

template <class F>
BELTSCAPE_INLINE void add_pair(const TapPowers& tap, const TapPair<F>& pair, RowSums<F>& sums) {
    sums.one = multiply_add(pair.weight, tap.one, sums.one);
    sums.u = multiply_add(pair.weight_odd, tap.by, sums.u);
    sums.uu = multiply_add(pair.weight, tap.by_by, sums.uu);
    sums.pull = multiply_add(pair.pull, tap.one, sums.pull);
    sums.pull_u = multiply_add(pair.pull_odd, tap.by, sums.pull_u);
    sums.square = multiply_add(pair.square, tap.square, sums.square);
}

// Adds a row's pairs from the i-th on to the windows `first` ... `count` - 1; none reaches less far than
// those before it.
template <int first, int count, class F>
BELTSCAPE_INLINE void add_pairs(const FitField& field, int at, int off, int i, F expected, F slope_u,
                                const FitWindows& windows, RowSums<F>* sums) {
    for (; i <= windows.window[first].reach[off]; ++i) {
        const TapPair<F> pair = fit_pair(field, at, i, expected, slope_u, windows);
        for (int k = first; k < count; ++k) add_pair(windows.window[k].across[i], pair, sums[k]);
    }
    if constexpr (first + 1 < count)
        add_pairs<first + 1, count>(field, at, off, i, expected, slope_u, windows, sums);
}

// Sums over a window: of the weight, by the offsets u and v, of weight times what is fitted, of weight² /
// information.
template <class F>
struct Moments {
    F one, u, v, uu, uv, vv, pull, pull_u, pull_v, square;
};

template <class F>
BELTSCAPE_INLINE void add_row(const TapPowers& tap, const RowSums<F>& row, Moments<F>& sums) {
    sums.one = multiply_add(row.one, tap.one, sums.one), sums.u = multiply_add(row.u, tap.one, sums.u);
    sums.uu = multiply_add(row.uu, tap.one, sums.uu);
    sums.v = multiply_add(row.one, tap.by, sums.v), sums.uv = multiply_add(row.u, tap.by, sums.uv);
    sums.vv = multiply_add(row.one, tap.by_by, sums.vv);
    sums.pull = multiply_add(row.pull, tap.one, sums.pull);
    sums.pull_u = multiply_add(row.pull_u, tap.one, sums.pull_u);
    sums.pull_v = multiply_add(row.pull, tap.by, sums.pull_v);
    sums.square = multiply_add(row.square, tap.square, sums.square);
}

template <class F>
BELTSCAPE_INLINE Fit<F> solve_fit(const Moments<F>& sums) {
    const MaskOf<F> nothing = sums.one <= kNoWeight;
    const F zero{}, part = 1.0f / select(nothing, zero + 1.0f, sums.one);
    const F u = sums.u * part, v = sums.v * part, pull = sums.pull * part;
    const F uu = sums.uu * part - u * u + kSlopeRidge, vv = sums.vv * part - v * v + kSlopeRidge;
    const F uv = sums.uv * part - u * v;
    const F pull_u = sums.pull_u * part - u * pull, pull_v = sums.pull_v * part - v * pull;
    const F by_determinant = 1.0f / (uu * vv - uv * uv);
    const F slope_u = (vv * pull_u - uv * pull_v) * by_determinant;
    const F slope_v = (uu * pull_v - uv * pull_u) * by_determinant;
    const F lever = (vv * u * u - 2.0f * uv * u * v + uu * v * v) * by_determinant;  // the plane's tilt, at p
    const F variance = (sums.square * part + lever) * part;
    return {select(nothing, zero, pull - slope_u * u - slope_v * v),
            select(nothing, zero, slope_u),
            select(nothing, zero, slope_v),
            select(nothing, zero + kInfinity, variance),
            zero,
            IntOf<F>{}};
}

// The squared difference of two windows' values over the smaller one's variance.
template <class F>
BELTSCAPE_INLINE F disagreement(const Fit<F>& smaller, const Fit<F>& larger) {
    const F apart = larger.change - smaller.change;
    return lesser(apart * apart / greater(smaller.variance, broadcast<F>(kLeastVariance)),
                  broadcast<F>(kMostDisagreement));
}

// The fit of the largest window up to which all confidence intervals share a value.
template <int count, class F>
BELTSCAPE_INLINE Fit<F> largest_consistent(const FitWindows& windows, const Moments<F>* sums) {
    Fit<F> taken = solve_fit(sums[0]), before = taken;
    F half = windows.settings.confidence_width * square_root(taken.variance);
    F low = taken.change - half, high = taken.change + half;
    for (int k = 1; k < count; ++k) {
        const Fit<F> next = solve_fit(sums[k]);
        half = windows.settings.confidence_width * square_root(next.variance);
        low = greater(low, next.change - half), high = lesser(high, next.change + half);
        const MaskOf<F> fits = low <= high;  // once false, false for all that follow
        taken.change = select(fits, next.change, taken.change);
        taken.slope_u = select(fits, next.slope_u, taken.slope_u);
        taken.slope_v = select(fits, next.slope_v, taken.slope_v);
        taken.variance = select(fits, next.variance, taken.variance);
        taken.window = select(fits, broadcast<IntOf<F>>(k), taken.window);
        taken.disagreement = disagreement(before, next);
        before = next;
    }
    return taken;
}

// The fit at the pixels at, at + 1, ... of the field, whose planes so far have these slopes, over `count`
// windows.
template <int count, class F>
BELTSCAPE_INLINE Fit<F> fit_plane(const FitField& field, const FitWindows& windows, int at, F slope_u,
                                  F slope_v) {
    const FitWindow& largest = windows.window[count - 1];
    const F s = load<F>(field.s + at);
    Moments<F> sums[count] = {};
    for (int row = -largest.radius; row <= largest.radius; ++row) {
        const int off = row < 0 ? -row : row, start = at + row * field.stride;
        if (largest.reach[off] < 0) continue;
        const F expected = multiply_add(slope_v, static_cast<float>(row), s);
        const Tap<F> centre = fit_tap(field, start, expected, windows);
        RowSums<F> row_sums[count];
        for (RowSums<F>& own : row_sums) own = {centre.weight, F{}, F{}, centre.pull, F{}, centre.square};
        add_pairs<0, count>(field, start, off, 1, expected, slope_u, windows, row_sums);
        for (int k = 0; k < count; ++k)
            if (windows.window[k].reach[off] >= 0)
                add_row(windows.window[k].down[kMaxRadius + row], row_sums[k], sums[k]);
    }
    return largest_consistent<count>(windows, sums);
}

// A row of the grid; `field` begins at its first pixel and s is as it was given, with NaN. A slope that is
// NaN counts as 0. variance: infinite where the windows weigh nothing.
struct FitRow {
    const float *s, *slope_u, *slope_v;
    float *new_s, *new_slope_u, *new_slope_v, *variance, *disagreement;
    unsigned char* window;
};

BELTSCAPE_INLINE FitRow row_of(const FitRow& all, size_t at) {
    return {all.s + at,        all.slope_u + at,      all.slope_v + at,
            all.new_s + at,    all.new_slope_u + at,  all.new_slope_v + at,
            all.variance + at, all.disagreement + at, all.window + at};
}

template <class F, int count = 1>
BELTSCAPE_INLINE void fit_row(const FitField& field, const FitWindows& windows, const FitRow& row, int begin,
                              int end) {
    if constexpr (count < kMaxWindows)
        if (count < windows.count) return fit_row<F, count + 1>(field, windows, row, begin, end);
    const F zero{}, nothing = broadcast<F>(kNotANumber);
    for (int x = begin; x < end; x += Lane<F>::count) {
        const int left = end - x;
        const F s = load_first<F>(row.s + x, left);
        F slope_u = load_first<F>(row.slope_u + x, left), slope_v = load_first<F>(row.slope_v + x, left);
        slope_u = select(not_a_number(slope_u), zero, slope_u);
        slope_v = select(not_a_number(slope_v), zero, slope_v);
        const Fit<F> fit = fit_plane<count>(field, windows, x, slope_u, slope_v);
        const MaskOf<F> missing = not_a_number(s - s);  // infinite, too
        const F step = clamp(fit.change, -kLargestStep, kLargestStep);
        store_first(row.new_s + x, select(missing, nothing, s + step), left);
        store_first(row.new_slope_u + x, select(missing, nothing, slope_u + fit.slope_u), left);
        store_first(row.new_slope_v + x, select(missing, nothing, slope_v + fit.slope_v), left);
        store_first(row.variance + x, select(missing, nothing, fit.variance), left);
        store_first(row.disagreement + x, select(missing, nothing, fit.disagreement), left);
        store_first(row.window + x, select(missing, IntOf<F>{}, fit.window), left);
    }
}

// Prepares a row of a field, `width` wide: 0 where s is not finite, and only the prior where information or
// pull is not.
template <class F>
BELTSCAPE_INLINE void field_row(const float* information, const float* pull, const float* s, float prior,
                                int width, float* out_information, float* out_pull, float* out_s) {
    const F zero{};
    for (int x = 0; x < width; x += Lane<F>::count) {
        const int left = width - x;
        const F a = load_first<F>(information + x, left), b = load_first<F>(pull + x, left);
        const F at = load_first<F>(s + x, left);
        const MaskOf<F> there = negate(not_a_number(at - at));
        const MaskOf<F> known = there & negate(not_a_number((a - a) + (b - b)));
        store_first(out_information + x, select(known, a, zero) + select(there, zero + prior, zero), left);
        store_first(out_pull + x, select(known, b, zero), left);
        store_first(out_s + x, select(there, at, zero), left);
    }
}

}  // namespace beltscape
