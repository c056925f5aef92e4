// The first measured cell along lines from hole cells. A line skips as many steps as the nearest measured
// cell is away, because a step moves by one row and one column at most (J. C. Hart, Sphere tracing, The
// Visual Computer 12, 527-545, 1996, doi:10.1007/s003710050084). For the CPU alone.
#pragma once

#include <array>
#include <numbers>

#include "holes/hole_field.hpp"

namespace beltscape {

inline constexpr std::uint8_t kFar = 2 * kMargin - 1;  // farther cells count as that far

// The distance of each cell from the nearest one that is measured or just outside the field, the larger of
// rows and columns.
class Clearances {
public:
    explicit Clearances(const HoleField& field)
        : columns(field.width), cells(field.height, field.width, kFar), spare(columns + 2 * kMargin, kFar) {
        std::fill_n(cells.row(-1) - 1, columns + 2, 0);
        std::fill_n(cells.row(field.height) - 1, columns + 2, 0);
        for (int v = 0; v < field.height; ++v) {
            const double* const measured = field.measured.row(v);
            std::uint8_t* const to = cells.row(v);
            for (int u = 0; u < columns; ++u) to[u] = measured[u] > 0 ? 0 : kFar;
            to[-1] = to[columns] = 0;
            spread(to, cells.row(v - 1));
        }
        for (int v = field.height; v-- > 0;) spread(cells.row(v), cells.row(v + 1));
    }

    int operator[](std::ptrdiff_t at) const { return cells[at]; }

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

// A line's end: the place of the cell, and the number of steps; infinity where there is none.
struct LineEnd {
    std::ptrdiff_t at = 0;
    double steps = kEndless;

    bool met() const { return steps < kEndless; }
};

// Follows a line from the cell at `at`; `offset(k)` is the distance of k steps' end, `most` their largest
// number.
template <class Offset>
inline LineEnd march(const HoleField& field, const Clearances& far, std::ptrdiff_t at, int most,
                     const Offset& offset) {
    for (int k = far[at]; k <= most;) {
        const std::ptrdiff_t there = at + offset(k);
        const int skipped = far[there];
        if (skipped == 0) {
            if (field.filtered[there] != field.filtered[there]) break;  // outside the field
            return {there, static_cast<double>(k)};
        }
        k += skipped;
    }
    return {};
}

inline std::ptrdiff_t step_offset(int k, double down, double across, std::ptrdiff_t stride) {
    return static_cast<std::ptrdiff_t>(std::rint(k * down)) * stride +
           static_cast<std::ptrdiff_t>(std::rint(k * across));
}

// Lines in several directions that are the same from all cells.
template <int count>
class Ways {
public:
    explicit Ways(int longest) : most(longest), length(longest + kFar + 1) {}

    void append(double down, double across, std::ptrdiff_t stride) {
        for (int k = 0; k < length; ++k)
            offsets.push_back(static_cast<int>(step_offset(k, down, across, stride)));
    }

    // Follows all lines from the cell at `at` in step: a line at its end stays there. Each alone would end at
    // a moment of its own, which the processor cannot foresee.
    std::array<LineEnd, count> follow(const HoleField& field, const Clearances& far,
                                      std::ptrdiff_t at) const {
        std::array<int, count> steps;
        steps.fill(far[at]);
        for (int moved = 1; moved != 0;) {
            moved = 0;
            for (int i = 0; i < count; ++i) {
                const int skipped = far[at + offsets[i * length + steps[i]]];
                const int step = steps[i] <= most ? skipped : 0;
                steps[i] += step, moved |= step;
            }
        }
        std::array<LineEnd, count> ends;
        for (int i = 0; i < count; ++i) {
            const std::ptrdiff_t there = at + offsets[i * length + steps[i]];
            const bool met = steps[i] <= most && field.filtered[there] == field.filtered[there];
            if (met) ends[i] = {there, static_cast<double>(steps[i])};
        }
        return ends;
    }

private:
    int most, length;
    std::vector<int> offsets;  // of the steps of each line; none goes beyond the cells just outside the field
};

inline constexpr int kDirections = 4, kTurns = 8, kLongest = 95;  // kernels/holes.py
inline constexpr int kDirection[kDirections][2] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}};
inline constexpr double kTurnDegrees[kTurns] = {14, 31, 59, 76, 104, 121, 149, 166};

// The fixed lines to both of their sides: near side, far side of the first, of the second ...
struct FixedLines {
    explicit FixedLines(const HoleField& field)
        : straight(std::max(field.height, field.width)), turned(kLongest) {
        const std::ptrdiff_t stride = field.measured.stride();
        for (const auto& [down, across] : kDirection)
            for (const int side : {-1, 1}) straight.append(side * down, side * across, stride);
        for (const double degrees : kTurnDegrees)
            for (const double side : {std::numbers::pi, 0.0}) {
                const double turn = degrees * (std::numbers::pi / 180) + side;
                turned.append(std::sin(turn), std::cos(turn), stride);
            }
    }

    Ways<2 * kDirections> straight;
    Ways<2 * kTurns> turned;
};

}  // namespace beltscape
