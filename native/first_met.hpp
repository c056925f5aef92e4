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
    const auto columns = static_cast<std::size_t>(width);
    // a cell is at most one farther than each of its eight neighbours
    const auto spread = [&](std::uint8_t* row, const std::uint8_t* beside) {
        for (std::size_t u = 0; u < columns; ++u) {
            const std::uint8_t near = std::min(beside[u], std::min(beside[u + 1], beside[u + 2]));
            row[u + 1] = std::min(row[u + 1], static_cast<std::uint8_t>(near < kFar ? near + 1 : kFar));
        }
    };
    const auto farther = [](int other) { return other < kFar ? other + 1 : kFar; };
    for (std::size_t v = 0; v < static_cast<std::size_t>(height); ++v) {
        std::uint8_t* const row = far.data() + (v + 1) * stride;
        for (std::size_t u = 0; u < columns; ++u) row[u + 1] = measured[v * columns + u] ? 0 : kFar;
        spread(row, row - stride);
        int run = kFar;
        for (std::size_t u = 1; u <= columns; ++u)
            row[u] = static_cast<std::uint8_t>(run = std::min<int>(row[u], farther(run)));
    }
    for (std::size_t v = static_cast<std::size_t>(height); v > 0; --v) {
        std::uint8_t* const row = far.data() + v * stride;
        spread(row, row + stride);
        int run = kFar;
        for (std::size_t u = columns; u > 0; --u)
            row[u] = static_cast<std::uint8_t>(run = std::min<int>(row[u], farther(run)));
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
    constexpr std::size_t kPerJob = 1 << 15;  // a millisecond: less is not worth a thread
    const std::vector<std::uint8_t> far = clearances(in.measured, in.height, in.width);
    const std::size_t lines = in.ways * in.count;
    for_jobs((lines + kPerJob - 1) / kPerJob, threads, [&](std::size_t job) {
        for (std::size_t line = job * kPerJob; line < std::min((job + 1) * kPerJob, lines); ++line) {
            const std::size_t way = line / in.count, place = line % in.count, own = in.fixed ? way : line;
            cell[line] = march(in, far.data(), in.rows[place], in.columns[place], in.down[own],
                               in.across[own], steps[line]);
        }
    });
}

}  // namespace beltscape
