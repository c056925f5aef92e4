// Slopes of planes through the measured cells about each cell; sums run in SciPy's order, from the window's
// ends to its middle, so that a mirrored field has mirrored slopes. For the CPU alone.
#pragma once

#include "holes/hole_field.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr double kSlopeSide = 7, kLeastSpread = 1e-3;  // kernels/holes.py

enum class Weight { even, odd, square };  // 1, k, k² of the k-th cell

// The weighted sum of the cells -3 ... 3 strides about one.
template <Weight weight>
inline double moment(const double* cell, std::ptrdiff_t stride) {
    double sum = weight == Weight::even ? *cell : 0.0;
    for (std::ptrdiff_t k = kSlopeHalf; k > 0; --k) {
        const double before = cell[-k * stride], after = cell[k * stride], far = static_cast<double>(k);
        if constexpr (weight == Weight::even) sum += before + after;
        if constexpr (weight == Weight::odd) sum += (before - after) * -far;
        if constexpr (weight == Weight::square) sum += (before + after) * (far * far);
    }
    return sum;
}

// Sums down the columns about a row: of cells, of their heights, and of both times the row's distance.
struct ColumnMoments {
    explicit ColumnMoments(int width)
        : sums(5, width, 0.0, kSlopeHalf),
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
    for (int u = 0; u < width; ++u) {
        n[u] = moment<Weight::even>(m + u, down);
        ny[u] = moment<Weight::odd>(m + u, down);
        nyy[u] = moment<Weight::square>(m + u, down);
    }
    for (int u = 0; u < width; ++u) {
        z[u] = moment<Weight::even>(h + u, down);
        zy[u] = moment<Weight::odd>(h + u, down);
    }
}

inline void solve_slopes(const ColumnMoments& from, const double* __restrict m, int width, double cell,
                         double* __restrict to_x, double* __restrict to_y) {
    const double* __restrict n = from.n, * __restrict ny = from.ny, * __restrict nyy = from.nyy;
    const double* __restrict z = from.z, * __restrict zy = from.zy;
    for (int u = 0; u < width; ++u) {
        const double all = moment<Weight::even>(n + u, 1), number = all > 1.0 ? all : 1.0;
        const double x = moment<Weight::odd>(n + u, 1), y = moment<Weight::even>(ny + u, 1);
        const double total = moment<Weight::even>(z + u, 1);
        const double xx = moment<Weight::square>(n + u, 1) - x * x / number;
        const double yy = moment<Weight::even>(nyy + u, 1) - y * y / number;
        const double xy = moment<Weight::odd>(ny + u, 1) - x * y / number;
        const double xz = moment<Weight::odd>(z + u, 1) - x * total / number;
        const double yz = moment<Weight::even>(zy + u, 1) - y * total / number;
        const double spread = xx * yy - xy * xy;
        const bool sound = (spread > kLeastSpread * xx * yy) & (number >= kSlopeSide) & (m[u] > 0);
        const double over = sound ? spread : 1.0;
        to_x[u] = sound ? (xz * yy - yz * xy) / over / cell : 0.0;
        to_y[u] = sound ? (yz * xx - xz * xy) / over / cell : 0.0;
    }
}

// The surface's rise over run in x and y at every measured cell.
struct Slopes {
    Slopes(const HoleField& field, std::size_t threads)
        : x(field.height, field.width, 0.0), y(field.height, field.width, 0.0) {
        const int rows_per_job = std::max(1, (1 << 16) / field.width);  // about a millisecond
        Plane<double> heights(field.height, field.width, 0.0, kSlopeHalf);
        for (int v = 0; v < field.height; ++v)
            for (int u = 0; u < field.width; ++u)
                heights.row(v)[u] = field.measured.row(v)[u] > 0 ? field.row(v)[u] : 0.0;
        for_bands(0, field.height, rows_per_job, threads, [&](int first, int end) {
            const ColumnMoments sums(field.width);
            for (int v = first; v < end; ++v) {
                const double* const known = field.measured.row(v);
                sum_columns(known, heights.row(v), heights.stride(), field.width, sums);
                solve_slopes(sums, known, field.width, field.cell(), x.row(v), y.row(v));
            }
        });
    }

    Plane<double> x, y;
};

}  // namespace beltscape
