// The first measured cell along lines over a grid (kernels/geometry.py). A line skips as many steps
// as the nearest measured cell is away, because a step moves by one row and one column at most. For the CPU
// alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

struct RayMarchInput {
    Grid<const bool> measured;
    List<const std::int64_t> rows, columns;  // of the cells that lines start from
    Grid<const double> down, across;         // (directions, 1 or cells)
    std::int64_t most;

    void fields(const auto& read) {
        read("measured", measured), read("rows", rows), read("columns", columns);
        read("down", down), read("across", across), read("most", most);
    }
};

inline constexpr std::size_t kMargin = 16;             // cells about the grid, none measured
inline constexpr std::uint8_t kFar = 2 * kMargin - 1;  // farther cells count as that far

// The distance of each cell from the nearest measured one, the larger of rows and columns.
struct Clearances {
    Clearances(const bool* measured, std::size_t height, std::size_t width)
        : columns(width),
          stride(width + 2 * kMargin),
          cells((height + 2) * stride, kFar),
          spare(stride, kFar) {
        for (std::size_t v = 0; v < height; ++v) {
            std::uint8_t* const to = row(v);
            for (std::size_t u = 0; u < width; ++u) to[u] = measured[v * width + u] ? 0 : kFar;
            spread(to, to - stride);
        }
        for (std::size_t v = height; v-- > 0;) spread(row(v), row(v) + stride);
    }

    std::uint8_t* row(std::size_t v) { return cells.data() + (v + 1) * stride + kMargin; }
    int at(std::int64_t v, std::int64_t u) const {
        return cells[static_cast<std::size_t>(v + 1) * stride + kMargin + static_cast<std::size_t>(u)];
    }

private:
    static std::uint8_t less(std::uint8_t a, std::uint8_t b) { return a < b ? a : b; }
    static std::uint8_t plus(std::uint8_t a, std::size_t step) { return static_cast<std::uint8_t>(a + step); }

    // A cell's distance is at most one more than its neighbours' in the next row, and at most s more than
    // that of cells s columns away.
    void spread(std::uint8_t* to, const std::uint8_t* beside) {
        const std::size_t count = columns;  // bytes that are written may be anything's, but not a local's
        for (std::size_t u = 0; u < count; ++u)
            to[u] = less(to[u], plus(less(beside[u], less((beside - 1)[u], beside[u + 1])), 1));
        std::uint8_t* const other = spare.data() + kMargin;
        for (std::size_t step = 1; step <= kMargin; step *= 2) {
            const std::uint8_t *const before = to - step, *const after = to + step;
            for (std::size_t u = 0; u < count; ++u)
                other[u] = less(to[u], plus(less(before[u], after[u]), step));
            std::copy_n(other, count, to);
        }
    }

    std::size_t columns, stride;
    std::vector<std::uint8_t> cells, spare;
};

// Follows one line; returns the cell's flat index or -1, and the number of steps to it.
inline std::int64_t march(const RayMarchInput& in, const Clearances& far, std::int64_t row,
                          std::int64_t column, double down, double across, double& steps) {
    const auto is_in = [](std::int64_t x, int end) { return x >= 0 && x < end; };
    std::int64_t k = std::max<std::int64_t>(1, far.at(row, column));
    while (k <= in.most) {
        const double count = static_cast<double>(k);
        const std::int64_t v = row + static_cast<std::int64_t>(std::rint(count * down));
        const std::int64_t u = column + static_cast<std::int64_t>(std::rint(count * across));
        if (!is_in(v, in.measured.height()) || !is_in(u, in.measured.width())) break;
        const int skipped = far.at(v, u);
        if (skipped == 0) {
            steps = count;
            return v * in.measured.width() + u;
        }
        k += skipped;
    }
    steps = std::numeric_limits<double>::infinity();
    return -1;
}

inline void first_hits(const RayMarchInput& in, std::size_t threads, Grid<std::int64_t> cell,
                       Grid<double> steps) {
    constexpr std::size_t kPerJob = 1 << 15;  // a millisecond: less is not worth a thread
    const Clearances far(in.measured.data, in.measured.shape[0], in.measured.shape[1]);
    const std::size_t cells = in.rows.shape[0], lines = in.down.shape[0] * cells;
    const bool fixed = in.down.shape[1] == 1;  // the same directions from all cells
    for_jobs((lines + kPerJob - 1) / kPerJob, threads, [&](std::size_t job) {
        for (std::size_t line = job * kPerJob; line < std::min((job + 1) * kPerJob, lines); ++line) {
            const std::size_t start = line % cells, own = fixed ? line / cells : line;
            cell[line] =
                march(in, far, in.rows[start], in.columns[start], in.down[own], in.across[own], steps[line]);
        }
    });
}

}  // namespace beltscape
