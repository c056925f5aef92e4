// Heights up to which cells are in the shadow of higher cells (kernels/geometry.py). For the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

struct ShadowInput {
    Grid<const double> height;               // NaN: not measured, casts no shadow
    List<const std::int64_t> rows, columns;  // of the cells
    Grid<const double> down, across, fall;   // (views, cells)

    void fields(const auto& read) {
        read("height", height), read("rows", rows), read("columns", columns);
        read("down", down), read("across", across), read("fall", fall);
    }
};

inline void shadow_heights(const ShadowInput& in, std::size_t threads, Grid<double> shadow) {
    constexpr std::size_t kPerJob = 1 << 14;
    constexpr double kNone = -std::numeric_limits<double>::infinity();
    double top = kNone;
    for (std::size_t i = 0; i < in.height.shape[0] * in.height.shape[1]; ++i)
        if (in.height[i] > top) top = in.height[i];
    const std::size_t cells = in.rows.shape[0], lines = in.down.shape[0] * cells;
    const auto is_in = [](std::int64_t x, int end) { return x >= 0 && x < end; };
    for_jobs((lines + kPerJob - 1) / kPerJob, threads, [&](std::size_t job) {
        for (std::size_t line = job * kPerJob; line < std::min((job + 1) * kPerJob, lines); ++line) {
            const std::int64_t row = in.rows[line % cells], column = in.columns[line % cells];
            const double down = in.down[line], across = in.across[line], fall = in.fall[line];
            double most = kNone;
            // farther cells are too low to cast a higher shadow
            for (double k = 1; top - k * fall > most; ++k) {
                const std::int64_t v = row + static_cast<std::int64_t>(std::rint(k * down));
                const std::int64_t u = column + static_cast<std::int64_t>(std::rint(k * across));
                if (!is_in(v, in.height.height()) || !is_in(u, in.height.width())) break;
                const double own = in.height.row(static_cast<int>(v))[u] - k * fall;
                if (own > most) most = own;
            }
            shadow[line] = most;
        }
    });
}

}  // namespace beltscape
