// Slopes of planes through the measured cells about each cell; sums run in SciPy's order, from the window's
// ends to its middle, so that a mirrored field has mirrored slopes. For the CPU alone.
#pragma once

#include "holes/hole_field.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr int kSlopeHalf = 3;                          // kernels/holes.py SLOPE_SIDE
inline constexpr double kSlopeSide = 7, kLeastSpread = 1e-3;  // kernels/holes.py

enum class Weight { even, odd, square };  // 1, k, k² of the k-th cell

// The weighted sum of the cells `k` strides before and after one.
template <Weight weight>
inline double pair_moment(const double* cells, std::ptrdiff_t at, std::ptrdiff_t stride, int k) {
    const double before = cells[at - k * stride], after = cells[at + k * stride];
    if constexpr (weight == Weight::even) return before + after;
    if constexpr (weight == Weight::odd) return (before - after) * -k;
    return (before + after) * (k * k);
}

// The weighted sum of the cells -3 ... 3 strides about one. (GCC makes no vectors of a loop here.)
template <Weight weight>
inline double moment(const double* cells, std::ptrdiff_t at, std::ptrdiff_t stride) {
    static_assert(kSlopeHalf == 3);
    const double middle = weight == Weight::even ? cells[at] : 0.0;
    return middle + pair_moment<weight>(cells, at, stride, 3) + pair_moment<weight>(cells, at, stride, 2) +
           pair_moment<weight>(cells, at, stride, 1);
}

// Sums down the columns about a row: of cells, of their heights, and of both times the row's distance.
struct ColumnMoments {
    explicit ColumnMoments(int width)
        : sums(5, width, 0.0),
          n(sums.row(0)),
          ny(sums.row(1)),
          nyy(sums.row(2)),
          z(sums.row(3)),
          zy(sums.row(4)) {}

    Plane<double> sums;
    double *n, *ny, *nyy, *z, *zy;
};

inline void sum_columns(const double* __restrict m, const double* __restrict h, std::ptrdiff_t down,
                        int width, const ColumnMoments& to) {
    double* __restrict n = to.n, * __restrict ny = to.ny, * __restrict nyy = to.nyy;
    double* __restrict z = to.z, * __restrict zy = to.zy;
#pragma omp simd
    for (int u = 0; u < width; ++u) {
        n[u] = moment<Weight::even>(m, u, down);
        ny[u] = moment<Weight::odd>(m, u, down);
        nyy[u] = moment<Weight::square>(m, u, down);
    }
#pragma omp simd
    for (int u = 0; u < width; ++u) {
        z[u] = moment<Weight::even>(h, u, down);
        zy[u] = moment<Weight::odd>(h, u, down);
    }
}

// The moments along a row of the sums down its columns.
inline void solve_slopes(const double* __restrict m, const double* __restrict n, const double* __restrict ny,
                         const double* __restrict nyy, const double* __restrict z,
                         const double* __restrict zy, int width, double cell, double* __restrict to_x,
                         double* __restrict to_y, double* __restrict steepness) {
#pragma omp simd
    for (int u = 0; u < width; ++u) {
        const double all = moment<Weight::even>(n, u, 1), number = all > 1.0 ? all : 1.0;
        const double x = moment<Weight::odd>(n, u, 1), y = moment<Weight::even>(ny, u, 1);
        const double total = moment<Weight::even>(z, u, 1);
        const double xx = moment<Weight::square>(n, u, 1) - x * x / number;
        const double yy = moment<Weight::even>(nyy, u, 1) - y * y / number;
        const double xy = moment<Weight::odd>(ny, u, 1) - x * y / number;
        const double xz = moment<Weight::odd>(z, u, 1) - x * total / number;
        const double yz = moment<Weight::even>(zy, u, 1) - y * total / number;
        const double spread = xx * yy - xy * xy;
        const double known = m[u], wide = spread > kLeastSpread * xx * yy ? known : 0.0;
        const double sound = number >= kSlopeSide ? wide : 0.0;
        const double over = sound > 0 ? spread : 1.0;
        const double slope_x = (xz * yy - yz * xy) / over / cell, slope_y = (yz * xx - xz * xy) / over / cell;
        to_x[u] = sound > 0 ? slope_x : 0.0;
        to_y[u] = sound > 0 ? slope_y : 0.0;
        steepness[u] = std::sqrt(to_x[u] * to_x[u] + to_y[u] * to_y[u]);
    }
}

// The surface's rise over run in x, in y and at its steepest at every measured cell.
struct Slopes {
    Slopes(const HoleField& field, std::size_t threads)
        : x(field.height, field.width), y(field.height, field.width), steepness(field.height, field.width) {
        const int rows_per_job = std::max(1, (1 << 16) / field.width);  // about a millisecond
        for_bands(0, field.height, rows_per_job, threads, [&](int first, int end) {
            const ColumnMoments sums(field.width);
            const std::ptrdiff_t down = field.measured.stride();
            for (int v = first; v < end; ++v) {
                const double* const known = field.measured.row(v);
                sum_columns(known, field.raw.row(v), down, field.width, sums);
                solve_slopes(known, sums.n, sums.ny, sums.nyy, sums.z, sums.zy, field.width, field.cell(),
                             x.row(v), y.row(v), steepness.row(v));
            }
        });
    }

    Plane<double> x, y, steepness;
};

}  // namespace beltscape
