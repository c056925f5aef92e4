// A field with holes (kernels/holes.py): its measured cells, without flying pixels at the rims, and the
// distances of its holes from them. For the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "array.hpp"

namespace beltscape {

inline constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();
inline constexpr double kEndless = std::numeric_limits<double>::infinity();

struct HoleFieldInput {
    Grid<const double> field;
    Grid<const bool> pinhole;
    Stack<const double> ray_slope;
    double cell;
    std::int64_t first, end;  // the rows whose holes count

    void fields(const auto& read) {
        read("field", field), read("pinhole", pinhole), read("ray_slope", ray_slope);
        read("cell", cell), read("first", first), read("end", end);
    }
};

// Numbers over a field; a row's number may be negative or too large by `border`.
template <class T>
class Plane {
public:
    Plane() = default;
    Plane(int rows, int columns, T value, int border = 0)
        : stride_(columns + 2 * border),
          border_(border),
          cells_(static_cast<std::size_t>((rows + 2 * border) * stride_), value) {}
    T* row(int v) { return cells_.data() + (v + border_) * stride_ + border_; }
    const T* row(int v) const { return cells_.data() + (v + border_) * stride_ + border_; }
    std::ptrdiff_t stride() const { return stride_; }

private:
    std::ptrdiff_t stride_ = 0;
    int border_ = 0;
    std::vector<T> cells_;
};

// The median of the measured cells about a cell, and of itself.
inline double median_of_nine(const double* field, int height, int width, int v, int u) {
    double sorted[9];
    int count = 0;
    for (int i = std::max(v - 1, 0); i <= std::min(v + 1, height - 1); ++i)
        for (int j = std::max(u - 1, 0); j <= std::min(u + 1, width - 1); ++j) {
            const double z = field[static_cast<std::ptrdiff_t>(i) * width + j];
            if (!std::isfinite(z)) continue;
            int at = count++;
            for (; at > 0 && sorted[at - 1] > z; --at) sorted[at] = sorted[at - 1];
            sorted[at] = z;
        }
    return 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]);
}

inline constexpr int kSlopeHalf = 3;      // kernels/holes.py SLOPE_SIDE
inline constexpr int kNowhere = 1 << 28;  // farther than any cell

struct HoleField {
    explicit HoleField(const HoleFieldInput& input)
        : in(input),
          height(input.field.height()),
          width(input.field.width()),
          first(static_cast<int>(input.first)),
          end(static_cast<int>(input.end)),
          measured(height, width, 0.0, kSlopeHalf),
          value(height, width, 0.0),
          filtered(height, width, kNothing),
          away(height, width, kNowhere) {
        find_mean();
        for (int v = 0; v < height; ++v) filter_row(v);
        find_vertical_distances();
    }

    const double* row(int v) const { return in.field.row(v); }
    double cell() const { return in.cell; }
    bool is_hole(int v, int u) const { return measured.row(v)[u] == 0; }

    const HoleFieldInput& in;
    int height, width, first, end;
    double middle = 0;       // the field's mean
    Plane<double> measured;  // 1 where a cell was measured, else 0
    Plane<double> value;     // over the mean; 0 where nothing was measured
    Plane<double> filtered;  // heights whose rims are medians of their neighbours
    Plane<int> away;         // rows to the nearest measured cell of the column

private:
    void find_mean() {
        double sum = 0, count = 0;
        for (int v = 0; v < height; ++v) {
            const double* const from = row(v);
            double* const to = measured.row(v);
            for (int u = 0; u < width; ++u) {
                const bool known = from[u] - from[u] == 0;
                to[u] = known;
                sum += known ? from[u] : 0.0;
                count += to[u];
            }
        }
        middle = sum / count;
        for (int v = 0; v < height; ++v)
            for (int u = 0; u < width; ++u)
                value.row(v)[u] = measured.row(v)[u] > 0 ? row(v)[u] - middle : 0.0;
    }

    void filter_row(int v) {
        const double *const own = measured.row(v), *const above = measured.row(std::max(v - 1, 0)),
                            *const below = measured.row(std::min(v + 1, height - 1));
        double* const to = filtered.row(v);
        for (int u = 0; u < width; ++u) {
            if (own[u] == 0) continue;
            const double beside = own[std::max(u - 1, 0)] * own[std::min(u + 1, width - 1)];
            to[u] = above[u] * below[u] * beside > 0 ? row(v)[u]
                                                     : median_of_nine(in.field.data, height, width, v, u);
        }
    }

    void find_vertical_distances() {
        for (int v = 0; v < height; ++v) {
            const double* const own = measured.row(v);
            const int* const before = v > 0 ? away.row(v - 1) : away.row(v);
            int* const to = away.row(v);
            for (int u = 0; u < width; ++u) to[u] = own[u] > 0 ? 0 : std::min(before[u] + 1, kNowhere);
        }
        for (int v = height - 1; v-- > 0;) {
            const int* const after = away.row(v + 1);
            int* const to = away.row(v);
            for (int u = 0; u < width; ++u) to[u] = std::min(to[u], after[u] + 1);
        }
    }
};

// The distance of a hole cell from the nearest measured cell.
inline double distance_to_measured(const HoleField& field, int v, int u) {
    const int* const away = field.away.row(v);
    std::int64_t best = static_cast<std::int64_t>(kNowhere) * kNowhere;
    for (std::int64_t d = 0; d * d < best && (u - d >= 0 || u + d < field.width); ++d)
        for (const std::int64_t column : {u - d, u + d}) {
            if (column < 0 || column >= field.width) continue;
            const std::int64_t rows = away[column];
            best = std::min(best, d * d + rows * rows);
        }
    return std::sqrt(static_cast<double>(best));
}

}  // namespace beltscape
