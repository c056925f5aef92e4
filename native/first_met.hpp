// The first measured cell along lines over a grid (kernels/protocol/first_met.py). A line skips as many steps
// as no measured cell is near: a step moves by one cell at most, in rows and in columns. For the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "parallel.hpp"

namespace beltscape {

struct LinesInput {
    const bool* measured;
    int height, width;
    const std::int64_t *rows, *columns;  // (count)
    std::size_t count;
    const double *down, *across;  // (ways, 1 or count)
    std::size_t ways;
    bool fixed;  // the same from all places
    std::int64_t most;
};

// Cells to the nearest measured one, the larger of rows and columns, up to 255.
inline std::vector<std::uint8_t> clearances(const bool* measured, int height, int width) {
    constexpr int kFar = 255;
    const std::size_t stride = static_cast<std::size_t>(width) + 2;  // a border on which nothing is measured
    std::vector<std::uint8_t> far((static_cast<std::size_t>(height) + 2) * stride, kFar);
    const auto at = [&](int v, int u) {
        return static_cast<std::size_t>(v + 1) * stride + static_cast<std::size_t>(u + 1);
    };
    const auto nearer = [](int own, int other) { return std::min(own, other + 1); };
    for (int v = 0; v < height; ++v) {
        for (int u = 0; u < width; ++u) {
            const std::size_t i = at(v, u), up = i - stride;
            const bool here = measured[static_cast<std::size_t>(v) * static_cast<std::size_t>(width) +
                                       static_cast<std::size_t>(u)];
            const int above = std::min({far[up - 1], far[up], far[up + 1]});
            far[i] = static_cast<std::uint8_t>(here ? 0 : nearer(nearer(kFar, above), far[i - 1]));
        }
    }
    for (int v = height - 1; v >= 0; --v) {
        for (int u = width - 1; u >= 0; --u) {
            const std::size_t i = at(v, u), low = i + stride;
            const int below = std::min({far[low - 1], far[low], far[low + 1]});
            far[i] = static_cast<std::uint8_t>(nearer(nearer(far[i], below), far[i + 1]));
        }
    }
    return far;
}

// One line; gives the cell's flat index or -1, and the steps to it.
inline std::int64_t march(const LinesInput& in, const std::uint8_t* far, std::int64_t row,
                          std::int64_t column, double down, double across, double& steps) {
    const auto is_in = [](std::int64_t x, int end) { return x >= 0 && x < end; };
    const auto clearance = [&](std::int64_t v, std::int64_t u) {
        return far[(v + 1) * (in.width + 2) + u + 1];
    };
    std::int64_t k = std::max<std::int64_t>(1, clearance(row, column));
    while (k <= in.most) {
        const double count = static_cast<double>(k);
        const std::int64_t v = row + static_cast<std::int64_t>(std::rint(count * down));
        const std::int64_t u = column + static_cast<std::int64_t>(std::rint(count * across));
        if (!is_in(v, in.height) || !is_in(u, in.width)) break;
        const int skipped = clearance(v, u);
        if (skipped == 0) {
            steps = count;
            return v * in.width + u;
        }
        k += skipped;
    }
    steps = std::numeric_limits<double>::infinity();
    return -1;
}

inline void first_met(const LinesInput& in, std::int64_t* cell, double* steps, std::size_t threads) {
    constexpr std::size_t kPerJob = 1024;
    const std::vector<std::uint8_t> far = clearances(in.measured, in.height, in.width);
    const std::size_t parts = (in.count + kPerJob - 1) / kPerJob;
    for_jobs(in.ways * parts, threads, [&](std::size_t job) {
        const std::size_t way = job / parts, first = job % parts * kPerJob;
        for (std::size_t i = first; i < std::min(first + kPerJob, in.count); ++i) {
            const std::size_t own = in.fixed ? way : way * in.count + i, to = way * in.count + i;
            cell[to] =
                march(in, far.data(), in.rows[i], in.columns[i], in.down[own], in.across[own], steps[to]);
        }
    });
}

}  // namespace beltscape
