// Slopes of planes through the measured cells about each cell (kernels/images.py); sums run
// in SciPy's order, from the window's ends to its middle, so that a mirrored field has mirrored slopes. For
// the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr std::ptrdiff_t kSlopeHalf = 3;  // kernels/images.py SLOPE_SIDE
inline constexpr double kSlopeSide = 7, kLeastSpread = 1e-3;

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

// A field with a border of zeros.
struct Bordered {
    Bordered(std::size_t height, std::size_t width)
        : stride(width + 2 * kSlopeHalf), cells((height + 2 * kSlopeHalf) * stride) {}
    double* row(std::size_t v) { return cells.data() + (v + kSlopeHalf) * stride + kSlopeHalf; }

    std::size_t stride;
    std::vector<double> cells;
};

struct FieldInput {
    Grid<const double> field;

    void fields(const auto& read) { read("field", field); }
};

// slope: (2, height, width).
inline void plane_slopes(const FieldInput& in, std::size_t threads, Stack<double> slope) {
    const std::size_t height = in.field.shape[0], width = in.field.shape[1];
    const int rows_per_job = std::max(1, (1 << 16) / static_cast<int>(width));  // about a millisecond
    Bordered measured(height, width), value(height, width);
    for (std::size_t v = 0; v < height; ++v)
        for (std::size_t u = 0; u < width; ++u) {
            const double z = in.field[v * width + u];
            const bool known = std::isfinite(z);
            measured.row(v)[u] = known, value.row(v)[u] = known ? z : 0.0;
        }
    const auto down = static_cast<std::ptrdiff_t>(measured.stride);
    for_bands(0, static_cast<int>(height), rows_per_job, threads, [&](int first, int end) {
        Bordered sums(5, width);  // down the columns
        double *const n = sums.row(0), *const ny = sums.row(1), *const nyy = sums.row(2);
        double *const z = sums.row(3), *const zy = sums.row(4);
        for (auto v = static_cast<std::size_t>(first); v < static_cast<std::size_t>(end); ++v) {
            const double *const m = measured.row(v), *const h = value.row(v);
            for (std::size_t u = 0; u < width; ++u) {
                n[u] = moment<Weight::even>(m + u, down);
                ny[u] = moment<Weight::odd>(m + u, down);
                nyy[u] = moment<Weight::square>(m + u, down);
                z[u] = moment<Weight::even>(h + u, down);
                zy[u] = moment<Weight::odd>(h + u, down);
            }
            double *const to_x = slope.data + v * width, *const to_y = to_x + height * width;
            for (std::size_t u = 0; u < width; ++u) {
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
                to_x[u] = sound ? (xz * yy - yz * xy) / over : 0.0;
                to_y[u] = sound ? (yz * xx - xz * xy) / over : 0.0;
            }
        }
    });
}

}  // namespace beltscape
