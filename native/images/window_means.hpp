// Means and minima of the measured cells in windows about given cells (kernels/images.py).
// For the CPU alone.
#pragma once

#include <cmath>
#include <limits>
#include <memory>

#include "images/cell_indices.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr double kLeastShare = 1e-3;  // kernels/images.py LEAST_SHARE

// Running sums over a band whose border is repeated outside.
struct MeanTable {
    struct Sum {
        std::int64_t count = 0;
        double total = 0;
    };

    MeanTable(const WindowsInput& in, const PlaceBand& rows)
        : band(rows),
          reach(in.reach()),
          stride(static_cast<std::size_t>(in.width() + 2 * reach + 1)),
          sums(std::make_unique_for_overwrite<Sum[]>(
              static_cast<std::size_t>(band.end - band.first + 2 * reach + 1) * stride)) {
        Sum* row = sums.get();
        std::fill_n(row, stride, Sum{});
        for (std::int64_t v = band.first - reach; v < band.end + reach; ++v) {
            const Sum* const above = row;
            const double* const from = in.field.data + std::clamp(v, band.first, band.end - 1) * in.width();
            row += stride;
            Sum along;
            row[0] = along;
            for (std::int64_t u = -reach; u < in.width() + reach; ++u) {
                const double z = from[std::clamp<std::int64_t>(u, 0, in.width() - 1)];
                const std::int64_t i = u + reach + 1;
                if (std::isfinite(z)) along.count += 1, along.total += z;
                row[i] = {along.count + above[i].count, along.total + above[i].total};
            }
        }
    }

    Sum about(std::int64_t row, std::int64_t column, std::int64_t side) const {
        const std::int64_t half = side / 2;
        const auto at = [&](std::int64_t v, std::int64_t u) -> const Sum& {
            return sums[static_cast<std::size_t>(v - band.first + reach) * stride +
                        static_cast<std::size_t>(u + reach)];
        };
        const Sum &a = at(row + half + 1, column + half + 1), &b = at(row + half + 1, column - half),
                  &c = at(row - half, column + half + 1), &d = at(row - half, column - half);
        return {a.count - b.count - c.count + d.count, a.total - b.total - c.total + d.total};
    }

    const PlaceBand& band;
    std::int64_t reach;
    std::size_t stride;
    std::unique_ptr<Sum[]> sums;
};

// share, mean: (sizes, count).
inline void window_means(const WindowsInput& in, std::size_t threads, Grid<double> share, Grid<double> mean) {
    const std::vector<PlaceBand> bands = bands_of(in);
    for_jobs(bands.size(), threads, [&](std::size_t job) {
        const MeanTable table(in, bands[job]);
        for (const std::size_t i : bands[job].own) {
            for (std::size_t k = 0; k < in.sizes(); ++k) {
                const MeanTable::Sum sum = table.about(in.rows[i], in.columns[i], in.sides[k]);
                const double cells = static_cast<double>(in.sides[k] * in.sides[k]);
                const double known = static_cast<double>(sum.count) / cells;
                share[k * in.count() + i] = known;
                mean[k * in.count() + i] = known > kLeastShare ? sum.total / cells / known
                                                               : std::numeric_limits<double>::quiet_NaN();
            }
        }
    });
}

// Computes minima of squares whose sides double, in place; four of them cover a window. least: (sizes,
// count).
inline void window_minima(const WindowsInput& in, std::size_t /* runs on one thread */, Grid<double> least) {
    constexpr double kNothing = std::numeric_limits<double>::infinity();
    if (in.count() == 0) return;
    const auto [low, high] = std::minmax_element(in.rows.data, in.rows.data + in.count());
    const std::int64_t reach = in.reach(), top = *low - reach;
    const std::int64_t height = *high - *low + 1 + 2 * reach, width = in.width() + 2 * reach;
    std::vector<double> square(static_cast<std::size_t>(height * width), kNothing);
    for (std::int64_t v = std::max<std::int64_t>(top, 0); v < std::min(top + height, in.height()); ++v)
        for (std::int64_t u = 0; u < in.width(); ++u) {
            const double z = in.field.data[v * in.width() + u];
            if (std::isfinite(z)) square[static_cast<std::size_t>((v - top) * width + u + reach)] = z;
        }
    const auto at = [&](std::int64_t v, std::int64_t u) {
        return square[static_cast<std::size_t>((v - top) * width + u + reach)];
    };
    for (std::int64_t size = 1; size <= 2 * reach + 1; size *= 2) {
        for (std::size_t k = 0; k < in.sizes(); ++k) {
            const std::int64_t half = in.sides[k] / 2, last = half + 1 - size;
            if (in.sides[k] < size || in.sides[k] >= 2 * size) continue;
            for (std::size_t i = 0; i < in.count(); ++i) {
                const std::int64_t v = in.rows[i], u = in.columns[i];
                const double found = std::min({at(v - half, u - half), at(v - half, u + last),
                                               at(v + last, u - half), at(v + last, u + last)});
                least[k * in.count() + i] =
                    found < kNothing ? found : std::numeric_limits<double>::quiet_NaN();
            }
        }
        // squares that reach beyond the border are not needed
        for (std::int64_t v = 0; v + 2 * size <= height; ++v) {
            double* const row = square.data() + v * width;
            const double* const below = row + size * width;
            for (std::int64_t u = 0; u + 2 * size <= width; ++u) {
                const double upper = row[u] < row[u + size] ? row[u] : row[u + size];
                const double lower = below[u] < below[u + size] ? below[u] : below[u + size];
                row[u] = upper < lower ? upper : lower;
            }
        }
    }
}

}  // namespace beltscape
