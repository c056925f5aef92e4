// An auxiliary's image at the projections of the core's pixels with their inverse depth.
#pragma once

#include "array.hpp"
#include "images/spline.hpp"
#include "parallel.hpp"

namespace beltscape {

// Warps columns begin ... end - 1 of a row; s, value and slope start at its first pixel. slope is the
// derivative of the value by s. They are NaN and 0 where s is NaN or the spline's footprint leaves the image.
template <bool brown, class F>
BELTSCAPE_INLINE void warp_row_through(const View& view, const Spline& spline, const float* s, int row,
                                       int begin, int end, float* value, float* slope) {
    constexpr int kAtOnce = kPlacedAhead<F>;
    const F v = broadcast<F>(to_float(row));
    for (int first = begin; first < end; first += kAtOnce * Lane<F>::count) {
        const int count = lesser((end - first + Lane<F>::count - 1) / Lane<F>::count, kAtOnce);
        Moving<F> seen[kAtOnce];
        Footprint<F> places[kAtOnce];
        for (int i = 0; i < count; ++i) {
            const int x = first + i * Lane<F>::count;
            const F u = to_float(broadcast<IntOf<F>>(x) + lane_numbers<F>());
            seen[i] = see_moving<brown>(view, u, v, load_first<F>(s + x, end - x));
            places[i] = footprint(spline, seen[i].u, seen[i].v);
            const int below = Lane<IntOf<F>>::get(places[i].first, 0) + 5 * spline.width;  // for the next row
            prefetch(spline.coefficients + below);
        }
        for (int i = 0; i < count; ++i) {
            const int x = first + i * Lane<F>::count;
            F found = broadcast<F>(kNotANumber), change{};
            if (any(places[i].inside)) {
                const Sample<F> at = sample(spline, places[i]);
                found = select(places[i].inside, at.value, found);
                change = select(places[i].inside, at.du * seen[i].du + at.dv * seen[i].dv, change);
            }
            store_first(value + x, found, end - x);
            store_first(slope + x, change, end - x);
        }
    }
}

template <class F>
BELTSCAPE_INLINE void warp_row(const View& view, const Spline& spline, const float* s, int row, int begin,
                               int end, float* value, float* slope) {
    if (view.lens.model == kBrown)
        warp_row_through<true, F>(view, spline, s, row, begin, end, value, slope);
    else
        warp_row_through<false, F>(view, spline, s, row, begin, end, value, slope);
}

#ifndef __CUDACC__
struct WarpInput {
    Grid<const float> s;
    PackedView view;
    Grid<const float> coefficients;

    void fields(const auto& read) { read("s", s), read("view", view), read("coefficients", coefficients); }
};

inline void warp(const WarpInput& in, std::size_t threads, Grid<float> value, Grid<float> slope) {
    constexpr int kRowsPerJob = 16;
    const View view = view_of(in.view.data);
    const Spline spline{in.coefficients.data, in.coefficients.width(), in.coefficients.height()};
    for_bands(0, in.s.height(), kRowsPerJob, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v)
            warp_row<Floats>(view, spline, in.s.row(v), v, 0, in.s.width(), value.row(v), slope.row(v));
    });
}
#endif

}  // namespace beltscape
