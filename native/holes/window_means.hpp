// Means and minima of the measured cells in windows about hole cells. For the CPU alone.
#pragma once

#include "holes/hole_field.hpp"

namespace beltscape {

inline constexpr double kLeastShare = 1e-3;  // kernels/holes.py LEAST_SHARE
inline constexpr int kBendCells = 2;         // kernels/holes.py BEND_CELLS

// Known cells of a field (1, else 0) and their numbers (else 0).
struct KnownCells {
    const Plane<double>& known;
    const Plane<double>& value;
    int height, width;
};

// Sums over the rows of a window about a row, and along this row; the field's border is repeated outside.
class RepeatedWindow {
public:
    RepeatedWindow(const KnownCells& cells, int size, int row)
        : of(cells),
          side(size),
          half(size / 2),
          counts(static_cast<std::size_t>(cells.width)),
          totals(counts.size()),
          along(counts.size() + static_cast<std::size_t>(size) + 1) {
        for (int v = row - half; v <= row + half; ++v) add(v, 1.0);
    }

    void move_down(int row) {
        add(row + half, 1.0);
        add(row - half - 1, -1.0);
    }

    // Prepares `share` and `mean` of this row's cells.
    void sum_row() {
        Sum sum, *next = along.data();
        *next++ = sum;
        const auto append = [&](int u) {
            sum.count += counts[u], sum.total += totals[u];
            *next++ = sum;
        };
        for (int u = -half; u < 0; ++u) append(0);
        for (int u = 0; u < of.width; ++u) append(u);
        for (int u = 0; u < half; ++u) append(of.width - 1);
    }

    double share(int u) const { return (along[u + side].count - along[u].count) / (side * side); }
    double mean(int u) const {
        const double known = share(u);
        return known > kLeastShare ? (along[u + side].total - along[u].total) / (side * side) / known
                                   : kNothing;
    }

private:
    struct Sum {
        double count = 0, total = 0;
    };

    void add(int v, double sign) {
        const int row = std::clamp(v, 0, of.height - 1), width = of.width;
        const double* __restrict known = of.known.row(row), * __restrict value = of.value.row(row);
        double* __restrict to_counts = counts.data(), * __restrict to_totals = totals.data();
        for (int u = 0; u < width; ++u) {
            to_counts[u] += sign * known[u];
            to_totals[u] += sign * value[u];
        }
    }

    KnownCells of;
    int side, half;
    std::vector<double> counts, totals;
    std::vector<Sum> along;
};

// The larger second difference of both axes, up to two cells' size, of the rows that windows of `reach` need.
struct Roughness {
    Roughness(const HoleField& field, int reach)
        : known(field.height, field.width), value(field.height, field.width) {
        const int k = kBendCells, width = field.width;
        const double most = 2 * field.cell();
        const int start = std::max(field.first - reach, 0), end = std::min(field.end + reach, field.height);
        for (int v = start; v < end; ++v) {
            const double* const row = field.row(v);
            const bool is_inner = v >= k && v < field.height - k;
            const double *const above = field.row(is_inner ? v - k : v), *const below =
                                                                             field.row(is_inner ? v + k : v);
            double* __restrict to_known = known.row(v), * __restrict to = value.row(v);
            for (int u = 0; u < width; ++u) {
                const double bend = std::abs(row[u] - 0.5 * (below[u] + above[u]));
                const bool is_known = is_inner && bend < kEndless;
                to_known[u] = is_known, to[u] = is_known ? bend : 0.0;
            }
            for (int u = k; u < width - k; ++u) {
                const double bend = std::abs(row[u] - 0.5 * (row[u + k] + row[u - k]));
                const bool is_known = bend < kEndless;
                to_known[u] = is_known ? 1.0 : to_known[u];
                to[u] = is_known && bend > to[u] ? bend : to[u];
            }
            for (int u = 0; u < width; ++u) to[u] = to[u] < most ? to[u] : most;
            for (int u = 0; u < width; ++u) to[u] *= to_known[u];
        }
    }

    Plane<double> known, value;
};

// The lowest cells in squares of a side that doubles, over the rows of a band; four of them cover a window.
class LowestCells {
public:
    LowestCells(const HoleField& field, int band_first, int band_end, int window_reach)
        : first(band_first - window_reach),
          reach(window_reach),
          height(band_end - band_first + 2 * window_reach),
          width(field.width + 2 * window_reach),
          lowest(height, width, kEndless) {
        for (int v = std::max(first, 0); v < std::min(first + height, field.height); ++v) {
            const double* const from = field.filtered.row(v);
            double* const to = lowest.row(v - first) + reach;
            for (int u = 0; u < field.width; ++u) to[u] = from[u] < kEndless ? from[u] : kEndless;
        }
    }

    // Doubles the side of the squares.
    void grow() {
        std::vector<double> spare(static_cast<std::size_t>(width));
        for (int v = 0; v < height; ++v) {
            double* const row = lowest.row(v);
            const double* const below = lowest.row(std::min(v + side, height - 1));
            for (int u = 0; u < width; ++u) spare[u] = row[u] < below[u] ? row[u] : below[u];
            const double* const after = spare.data() + side;
            for (int u = 0; u < width - side; ++u) row[u] = spare[u] < after[u] ? spare[u] : after[u];
        }
        side *= 2;
    }

    int square() const { return side; }

    // The lowest cell of a window, of a side from that of the squares to less than twice as long.
    double find(int v, int u, int window) const {
        const int half = window / 2, last = half + 1 - side;
        const double *const top = lowest.row(v - half - first) + u + reach, *const bottom =
                                                                                lowest.row(v + last - first) +
                                                                                u + reach;
        const double found = std::min({top[-half], top[last], bottom[-half], bottom[last]});
        return found < kEndless ? found : kNothing;
    }

private:
    int first, reach, height, width, side = 1;
    Plane<double> lowest;
};

}  // namespace beltscape
