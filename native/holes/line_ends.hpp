// The first measured cell along lines from hole cells. A line skips as many steps as the nearest measured
// cell is away, because a step moves by one row and one column at most (J. C. Hart, Sphere tracing, The
// Visual Computer 12, 527-545, 1996, doi:10.1007/s003710050084). For the CPU alone.
#pragma once

#include <numbers>

#include "holes/hole_field.hpp"

namespace beltscape {

inline constexpr int kMargin = 16;                     // cells about the field, none measured
inline constexpr std::uint8_t kFar = 2 * kMargin - 1;  // farther cells count as that far

// The distance of each cell from the nearest measured one, the larger of rows and columns.
class Clearances {
public:
    explicit Clearances(const HoleField& field)
        : columns(field.width),
          cells(field.height, field.width, kFar, kMargin),
          spare(columns + 2 * kMargin, kFar) {
        for (int v = 0; v < field.height; ++v) {
            const double* const measured = field.measured.row(v);
            std::uint8_t* const to = cells.row(v);
            for (int u = 0; u < columns; ++u) to[u] = measured[u] > 0 ? 0 : kFar;
            spread(to, cells.row(v - 1));
        }
        for (int v = field.height; v-- > 0;) spread(cells.row(v), cells.row(v + 1));
    }

    int at(int v, int u) const { return cells.row(v)[u]; }

private:
    static std::uint8_t less(std::uint8_t a, std::uint8_t b) { return a < b ? a : b; }
    static std::uint8_t plus(std::uint8_t a, int step) { return static_cast<std::uint8_t>(a + step); }

    // A cell's distance is at most one more than its neighbours' in the next row, and at most s more than
    // that of cells s columns away.
    void spread(std::uint8_t* to, const std::uint8_t* beside) {
        const int count = columns;  // bytes that are written may be anything's, but not a local's
        for (int u = 0; u < count; ++u)
            to[u] = less(to[u], plus(less(beside[u], less((beside - 1)[u], beside[u + 1])), 1));
        std::uint8_t* const other = spare.data() + kMargin;
        for (int step = 1; step <= kMargin; step *= 2) {
            const std::uint8_t *const before = to - step, *const after = to + step;
            for (int u = 0; u < count; ++u) other[u] = less(to[u], plus(less(before[u], after[u]), step));
            std::copy_n(other, count, to);
        }
    }

    int columns;
    Plane<std::uint8_t> cells;
    std::vector<std::uint8_t> spare;
};

// A line's end: the cell, or steps = infinity without any.
struct LineEnd {
    int v = 0, u = 0;
    double steps = kEndless;

    bool met() const { return steps < kEndless; }
};

// Follows a line from a cell; `offset(k)` are the rows and columns of k steps, `most` their largest number.
template <class Offset>
inline LineEnd march(const HoleField& field, const Clearances& far, int v, int u, int most,
                     const Offset& offset) {
    for (int k = std::max(1, far.at(v, u)); k <= most;) {
        const auto [down, across] = offset(k);
        const int row = v + down, column = u + across;
        if (row < 0 || row >= field.height || column < 0 || column >= field.width) break;
        const int skipped = far.at(row, column);
        if (skipped == 0) return {row, column, static_cast<double>(k)};
        k += skipped;
    }
    return {};
}

struct Offset {
    int down, across;
};

// The offsets of the steps in one of the fixed directions.
using Way = std::vector<Offset>;

inline Way make_way(double down, double across, int most) {
    Way way;
    for (int k = 0; k <= most; ++k)
        way.push_back({static_cast<int>(std::rint(k * down)), static_cast<int>(std::rint(k * across))});
    return way;
}

inline LineEnd follow(const HoleField& field, const Clearances& far, int v, int u, const Way& way) {
    return march(field, far, v, u, static_cast<int>(way.size()) - 1, [&](int k) { return way[k]; });
}

inline constexpr int kDirections = 4, kTurns = 8, kLongest = 95;  // kernels/holes.py
inline constexpr int kDirection[kDirections][2] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}};
inline constexpr double kTurnDegrees[kTurns] = {14, 31, 59, 76, 104, 121, 149, 166};

// The lines that are the same from all cells, to both of their sides.
struct Ways {
    explicit Ways(const HoleField& field) {
        const int farthest = std::max(field.height, field.width) - 1;
        for (const auto& [down, across] : kDirection)
            for (const int side : {-1, 1}) straight.push_back(make_way(side * down, side * across, farthest));
        for (const double degrees : kTurnDegrees)
            for (const double side : {std::numbers::pi, 0.0}) {
                const double turn = degrees * (std::numbers::pi / 180) + side;
                turned.push_back(make_way(std::sin(turn), std::cos(turn), kLongest));
            }
    }

    std::vector<Way> straight, turned;  // near side, far side of the first, of the second ...
};

}  // namespace beltscape
