// Least-squares quadratics in windows about cells (kernels/images.py); the order of
// operations is the reference's. For the CPU alone.
#pragma once

#include <array>
#include <cmath>
#include <limits>

#include "images/cell_indices.hpp"
#include "images/power_tables.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr double kFewest = 12, kMostLeverage = 30,
                        kRidge = 1e-6;                                      // kernels/images.py
inline constexpr std::size_t kPlacesPerJob = 2048, kCellsPerJob = 1 << 17;  // a millisecond or two
inline constexpr int kTogether = 16;                                        // places in step
inline constexpr int kChoose[5][5] = {
    {1, 0, 0, 0, 0}, {1, 1, 0, 0, 0}, {1, 2, 1, 0, 0}, {1, 3, 3, 1, 0}, {1, 4, 6, 4, 1}};

template <class T>
using Together = std::array<T, kTogether>;

template <class Each>
inline void for_each_together(const Each& each) {
    for (std::size_t i = 0; i < kTogether; ++i) each(i);
}

// Sums over a window about each of some cells, of powers about the field's middle; x, y: powers of the
// negated cell indices.
struct WindowSums {
    std::array<Together<std::uint64_t>, kPowers> counts;
    std::array<Together<double>, kSums> heights;
    std::array<Together<std::int64_t>, 5> x, y;
};

inline void sum_windows(const PowerTables& tables, const std::size_t* places, std::int64_t side,
                        WindowSums& sums) {
    const WindowsInput& in = tables.in;
    const std::int64_t first = tables.band.first, half = side / 2;
    for_each_together([&](std::size_t i) {
        const std::int64_t row = in.rows[places[i]], column = in.columns[places[i]];
        const auto at = [&](std::int64_t v, std::int64_t u) {
            return static_cast<std::size_t>(v - first) * tables.stride + static_cast<std::size_t>(u);
        };
        const std::int64_t top = std::max(row - half, first),
                           bottom = std::min(row + half + 1, tables.band.end);
        const std::int64_t left = std::max<std::int64_t>(column - half, 0);
        const std::int64_t right = std::min(column + half + 1, in.width());
        const std::size_t a = at(bottom, right), b = at(bottom, left), c = at(top, right), d = at(top, left);
        const auto* const n = tables.counts.get();
        const auto* const z = tables.heights.get();
        for (std::size_t k = 0; k < kPowers; ++k) sums.counts[k][i] = n[a][k] - n[b][k] - n[c][k] + n[d][k];
        for (std::size_t k = 0; k < kSums; ++k) sums.heights[k][i] = z[a][k] - z[b][k] - z[c][k] + z[d][k];
        sums.x[0][i] = sums.y[0][i] = 1;
        for (std::size_t k = 1; k < 5; ++k) {
            sums.x[k][i] = sums.x[k - 1][i] * -tables.x(column);
            sums.y[k][i] = sums.y[k - 1][i] * -tables.y(row);
        }
    });
}

// The sum of a power about the cells themselves, by the binomial theorem.
template <class T, class Of>
inline Together<T> shifted_moment(const WindowSums& sums, Power power, const Of& of) {
    Together<T> total = of(power.x, power.y);
    for (int a = 0; a <= power.x; ++a) {
        for (int b = 0; b <= power.y; ++b) {
            if (a == power.x && b == power.y) continue;
            const Together<T>& part = of(a, b);
            const auto &x = sums.x[static_cast<std::size_t>(power.x - a)],
                       &y = sums.y[static_cast<std::size_t>(power.y - b)];
            const auto ways = static_cast<std::uint64_t>(kChoose[power.x][a] * kChoose[power.y][b]);
            for_each_together([&](std::size_t i) {
                const std::uint64_t weight =
                    ways * static_cast<std::uint64_t>(x[i]) * static_cast<std::uint64_t>(y[i]);
                total[i] += static_cast<T>(static_cast<std::int64_t>(weight)) * part[i];
            });
        }
    }
    return total;
}

using Column = std::array<Together<double>, kTerms>;

// Solves L Lᵀ x = x for a lower triangle L.
inline void solve(const std::array<Column, kTerms>& lower, Column& x) {
    for (std::size_t j = 0; j < kTerms; ++j)
        for_each_together([&](std::size_t n) {
            double sum = 0;
            for (std::size_t i = 0; i < j; ++i) sum += lower[j][i][n] * x[i][n];
            x[j][n] = (x[j][n] - sum) / lower[j][j][n];
        });
    for (std::size_t j = kTerms; j-- > 0;)
        for_each_together([&](std::size_t n) {
            double sum = 0;
            for (std::size_t i = j + 1; i < kTerms; ++i) sum += lower[i][j][n] * x[i][n];
            x[j][n] = (x[j][n] - sum) / lower[j][j][n];
        });
}

// A symmetric positive definite matrix's lower triangle becomes its Cholesky factor.
inline void factorise(std::array<Column, kTerms>& a) {
    for (std::size_t j = 0; j < kTerms; ++j) {
        for_each_together([&](std::size_t n) {
            double sum = 0;
            for (std::size_t k = 0; k < j; ++k) sum += a[j][k][n] * a[j][k][n];
            const double pivot = a[j][j][n] - sum;
            a[j][j][n] = std::sqrt(pivot > 1e-30 ? pivot : 1e-30);
        });
        for (std::size_t i = j + 1; i < kTerms; ++i)
            for_each_together([&](std::size_t n) {
                double sum = 0;
                for (std::size_t k = 0; k < j; ++k) sum += a[i][k][n] * a[j][k][n];
                a[i][j][n] = (a[i][j][n] - sum) / a[j][j][n];
            });
    }
}

struct QuadraticFit {
    Together<double> value, miss, leverage;
};

inline QuadraticFit fit_quadratic(const WindowSums& sums, double half) {
    double scale[5] = {1};
    for (int i = 1; i < 5; ++i) scale[i] = scale[i - 1] * half;
    std::array<Together<double>, kPowers> mass;
    for (std::size_t p = 0; p < kPowers; ++p) {
        const auto of = [&](int i, int j) -> const auto& {
            return sums.counts[static_cast<std::size_t>(power_at(i, j))];
        };
        const Together<std::uint64_t> whole = shifted_moment<std::uint64_t>(sums, kPower[p], of);
        for_each_together([&](std::size_t n) {
            mass[p][n] =
                static_cast<double>(static_cast<std::int64_t>(whole[n])) / scale[kPower[p].x + kPower[p].y];
        });
    }
    Column right, unit{}, solution;
    for (std::size_t t = 0; t < kTerms; ++t) {
        const auto of = [&](int i, int j) -> const auto& {
            const std::size_t term = static_cast<std::size_t>(i + j == 0 ? 0 : i + j == 1 ? 1 + j : 3 + j);
            return sums.heights[term];
        };
        right[t] = shifted_moment<double>(sums, kTerm[t], of);
        for_each_together([&](std::size_t n) { right[t][n] /= scale[kTerm[t].x + kTerm[t].y]; });
    }
    const Together<double>& number = mass[0];
    std::array<Column, kTerms> normal;
    for (std::size_t a = 0; a < kTerms; ++a)
        for (std::size_t b = 0; b <= a; ++b)
            normal[a][b] =
                mass[static_cast<std::size_t>(power_at(kTerm[a].x + kTerm[b].x, kTerm[a].y + kTerm[b].y))];
    for (std::size_t a = 0; a < kTerms; ++a)
        for_each_together([&](std::size_t n) { normal[a][a][n] += kRidge * std::max(number[n], 1.0); });
    factorise(normal);
    unit[0].fill(1.0);
    solution = right;
    solve(normal, solution);
    solve(normal, unit);
    QuadraticFit fit;
    for_each_together([&](std::size_t n) {
        constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
        double explained = 0;
        for (std::size_t t = 0; t < kTerms; ++t) explained += solution[t][n] * right[t][n];
        const double rest = std::max(sums.heights[kTerms][n] - explained, 0.0);
        const double leverage = unit[0][n] * number[n];
        const bool sound = number[n] > kFewest - 0.5 && leverage > 0 && leverage < kMostLeverage;
        fit.value[n] = sound ? solution[0][n] : kNone;
        fit.miss[n] = sound ? std::sqrt(rest / std::max(number[n], 1.0)) : kNone;
        fit.leverage[n] = sound ? leverage : kNone;
    });
    return fit;
}

// value, miss, leverage: (sizes, count).
inline void quadratics(const WindowsInput& in, std::size_t threads, Grid<double> value, Grid<double> miss,
                       Grid<double> leverage) {
    for (const PlaceBand& band : bands_of(in)) {
        const PowerTables tables(in, band);
        for_jobs(2, tables.size() < kCellsPerJob ? 1 : threads,
                 [&](std::size_t job) { job ? tables.fill_heights() : tables.fill_counts(); });
        const std::size_t end = band.own.size(), jobs = (end + kPlacesPerJob - 1) / kPlacesPerJob;
        for_jobs(jobs, threads, [&](std::size_t job) {
            const std::size_t last = std::min(end, (job + 1) * kPlacesPerJob);
            for (std::size_t first = job * kPlacesPerJob; first < last; first += kTogether) {
                std::array<std::size_t, kTogether> places;  // beyond the last one, that one again
                for_each_together(
                    [&](std::size_t n) { places[n] = band.own[std::min(first + n, last - 1)]; });
                for (std::size_t k = 0; k < in.sizes(); ++k) {
                    WindowSums sums;
                    sum_windows(tables, places.data(), in.sides[k], sums);
                    const QuadraticFit fit = fit_quadratic(sums, 0.5 * static_cast<double>(in.sides[k]));
                    for_each_together([&](std::size_t n) {
                        const std::size_t to = k * in.count() + places[n];
                        value[to] = fit.value[n], miss[to] = fit.miss[n], leverage[to] = fit.leverage[n];
                    });
                }
            }
        });
    }
}

}  // namespace beltscape
