// Medians of the bends of a field at several distances (kernels/images.py). For the CPU alone.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

struct BendsInput {
    Grid<const double> field;
    List<const std::int64_t> halves;
    double above;

    void fields(const auto& read) { read("field", field), read("halves", halves), read("above", above); }
};

// Ranks of positive numbers, by a histogram of their leading bits: these ascend with the number.
class Ranks {
public:
    explicit Ranks(const std::vector<double>& positive) : values(positive), counts(kBins) {
        for (const double value : values) ++counts[bin(value)];
    }

    double median() {
        const std::size_t half = values.size() / 2;
        return values.size() % 2 ? at(half) : 0.5 * (at(half - 1) + at(half));
    }

private:
    static constexpr int kShift = 64 - 17;  // the sign, the exponent and five bits of the fraction
    static constexpr std::size_t kBins = 1 << 16;

    static std::size_t bin(double value) {
        return static_cast<std::size_t>(std::bit_cast<std::uint64_t>(value) >> kShift);
    }

    double at(std::size_t rank) {
        std::size_t own = 0;
        for (; rank >= counts[own]; ++own) rank -= counts[own];
        std::vector<double> near;
        near.reserve(counts[own]);
        for (const double value : values)
            if (bin(value) == own) near.push_back(value);
        std::nth_element(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(rank), near.end());
        return near[rank];
    }

    const std::vector<double>& values;
    std::vector<std::uint32_t> counts;
};

// Appends the bends of cells that lie `step` elements from both of their neighbours.
inline void add_bends(const BendsInput& in, std::size_t half, bool is_down, std::vector<double>& bends) {
    const std::size_t rows = in.field.shape[0], columns = in.field.shape[1];
    const std::size_t from_row = is_down ? half : 0, from_column = is_down ? 0 : half;
    const std::size_t step = is_down ? half * columns : half;
    if ((is_down ? rows : columns) <= 2 * half) return;
    for (std::size_t v = from_row; v < rows - from_row; ++v)
        for (std::size_t u = from_column; u < columns - from_column; ++u) {
            const double* const cell = in.field.data + v * columns + u;
            if (!(*cell > in.above)) continue;
            const double bend = std::abs(*cell - 0.5 * (cell[step] + *(cell - step)));
            if (std::isfinite(bend)) bends.push_back(bend);
        }
}

// count, median: (halves).
inline void bend_medians(const BendsInput& in, std::size_t threads, List<std::int64_t> count,
                         List<double> median) {
    for_jobs(in.halves.shape[0], threads, [&](std::size_t job) {
        std::vector<double> bends;
        bends.reserve(2 * in.field.shape[0] * in.field.shape[1]);
        for (const bool is_down : {true, false})
            add_bends(in, static_cast<std::size_t>(in.halves[job]), is_down, bends);
        count[job] = static_cast<std::int64_t>(bends.size());
        median[job] = bends.empty() ? std::numeric_limits<double>::quiet_NaN() : Ranks(bends).median();
    });
}

}  // namespace beltscape
