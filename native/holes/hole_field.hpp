// A field with holes (kernels/holes.py): its measured cells, without flying pixels at the rims, and the
// distances of its holes from them. For the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
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

// The least or greatest of two numbers; NaN counts only if both are.
inline double least(double a, double b) { return a < b || b != b ? a : b; }
inline double greatest(double a, double b) { return a > b || b != b ? a : b; }

inline constexpr int kMargin = 16;  // cells about each plane

// Numbers over a field and its margin. Planes of one field have their cells at the same distance from
// `row(0)`.
template <class T>
class Plane {
public:
    Plane(int rows, int columns)
        : stride_(columns + 2 * kMargin),
          size_((rows + 2 * kMargin) * stride_),
          cells_(std::make_unique_for_overwrite<T[]>(static_cast<std::size_t>(size_))),
          origin_(cells_.get() + kMargin * stride_ + kMargin) {}
    Plane(int rows, int columns, T value) : Plane(rows, columns) { std::fill_n(cells_.get(), size_, value); }
    Plane(Plane&&) = default;

    T* row(int v) { return origin_ + v * stride_; }
    const T* row(int v) const { return origin_ + v * stride_; }
    const T& operator[](std::ptrdiff_t at) const { return origin_[at]; }
    std::ptrdiff_t stride() const { return stride_; }

private:
    std::ptrdiff_t stride_, size_;
    std::unique_ptr<T[]> cells_;
    T* origin_;
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

inline constexpr int kNowhere = 1 << 28;  // farther than any cell

struct HoleField {
    explicit HoleField(const HoleFieldInput& input)
        : in(input),
          height(input.field.height()),
          width(input.field.width()),
          first(static_cast<int>(input.first)),
          end(static_cast<int>(input.end)),
          measured(height, width, 0.0),
          raw(height, width, 0.0),
          value(height, width),
          filtered(height, width, kNothing),
          away(height, width) {
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
    Plane<double> raw;       // heights; 0 where nothing was measured
    Plane<double> value;     // over the mean; 0 where nothing was measured
    Plane<double> filtered;  // heights whose rims are medians of their neighbours
    Plane<int> away;         // rows to the nearest measured cell of the column

private:
    void find_mean() {
        double sum = 0, count = 0;
        for (int v = 0; v < height; ++v) {
            const double* const from = row(v);
            double *const to = measured.row(v), *const to_raw = raw.row(v);
            for (int u = 0; u < width; ++u) {
                const bool known = from[u] - from[u] == 0;
                to[u] = known ? 1.0 : 0.0;
                to_raw[u] = known ? from[u] : 0.0;
            }
            for (int u = 0; u < width; ++u) sum += to_raw[u], count += to[u];
        }
        middle = sum / count;
        for (int v = 0; v < height; ++v) {
            const double *const from = raw.row(v), *const known = measured.row(v);
            double* const to = value.row(v);
            for (int u = 0; u < width; ++u) to[u] = (from[u] - middle) * known[u];
        }
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
            const int* const before = away.row(v > 0 ? v - 1 : v);
            int* const to = away.row(v);
            for (int u = 0; u < width; ++u)
                to[u] = own[u] > 0 ? 0 : v > 0 ? std::min(before[u] + 1, kNowhere) : kNowhere;
        }
        for (int v = height - 1; v-- > 0;) {
            const int* const after = away.row(v + 1);
            int* const to = away.row(v);
            for (int u = 0; u < width; ++u) to[u] = std::min(to[u], std::min(after[u] + 1, kNowhere));
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
