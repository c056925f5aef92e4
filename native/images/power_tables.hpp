// Running sums of powers of a band's cells, for quadratics in windows (kernels/images.py);
// their order is the reference's. For the CPU alone.
#pragma once

#include <array>
#include <cmath>

#include "images/cell_indices.hpp"
#include "workspace.hpp"

namespace beltscape {

inline constexpr int kTerms = 6, kPowers = 15, kSums = 7;  // sums: the terms, and squares

struct Power {
    int x, y;
};
inline constexpr std::array<Power, kTerms> kTerm = {{{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}}};
// The number of the power x^i y^j of degree 4 or less.
inline constexpr int power_at(int i, int j) { return 5 * i - i * (i - 1) / 2 + j; }
inline constexpr std::array<Power, kPowers> kPower = [] {
    std::array<Power, kPowers> powers{};
    for (int i = 0; i < 5; ++i)
        for (int j = 0; j < 5 - i; ++j) powers[static_cast<std::size_t>(power_at(i, j))] = {i, j};
    return powers;
}();

// Summed-area tables of a band: cell (v, u) holds the sum above and left of it. Whole numbers may overflow;
// sums of windows are exact nevertheless.
struct PowerTables {
    using Counts = std::array<std::uint64_t, kPowers + 1>;
    using Heights = std::array<double, kSums + 1>;

    PowerTables(const WindowsInput& input, const PlaceBand& rows)
        : in(input),
          band(rows),
          stride(static_cast<std::size_t>(in.width()) + 1),
          counts(size()),
          heights(size()) {}

    std::size_t size() const { return static_cast<std::size_t>(band.end - band.first + 1) * stride; }
    std::int64_t x(std::int64_t column) const { return column - in.width() / 2; }
    std::int64_t y(std::int64_t row) const { return row - band.first - (band.end - band.first) / 2; }

    // Adds up `of(row, column, sums)` along a row and onto the row above.
    template <class Sums, class Of>
    void fill(Sums* table, const Of& of) const {
        std::fill_n(table, stride, Sums{});
        for (std::int64_t row = band.first; row < band.end; ++row) {
            const Sums* const above = table;
            table += stride;
            Sums along{};
            table[0] = along;
            for (std::int64_t column = 0; column < in.width(); ++column) {
                of(row, column, along);
                const std::size_t i = static_cast<std::size_t>(column) + 1;
                for (std::size_t k = 0; k < along.size(); ++k) table[i][k] = along[k] + above[i][k];
            }
        }
    }

    void fill_counts() const {
        fill(counts.get(), [&](std::int64_t row, std::int64_t column, Counts& along) {
            if (!std::isfinite(in.field[row * in.width() + column])) return;
            std::uint64_t px[5], py[5];
            px[0] = py[0] = 1;
            for (int i = 1; i < 5; ++i) {
                px[i] = px[i - 1] * static_cast<std::uint64_t>(x(column));
                py[i] = py[i - 1] * static_cast<std::uint64_t>(y(row));
            }
            for (std::size_t k = 0; k < kPowers; ++k) along[k] += px[kPower[k].x] * py[kPower[k].y];
        });
    }

    void fill_heights() const {
        fill(heights.get(), [&](std::int64_t row, std::int64_t column, Heights& along) {
            const double z = in.field[row * in.width() + column];
            if (!std::isfinite(z)) return;
            const double dx = static_cast<double>(x(column)), dy = static_cast<double>(y(row));
            const double zx = z * dx;
            const double terms[kSums] = {z, zx, z * dy, z * (dx * dx), zx * dy, z * (dy * dy), z * z};
            for (std::size_t k = 0; k < kSums; ++k) along[k] += terms[k];
        });
    }

    const WindowsInput& in;
    const PlaceBand& band;
    std::size_t stride;
    Workspace<Counts> counts;
    Workspace<Heights> heights;
};

}  // namespace beltscape
