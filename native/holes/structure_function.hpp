// The structure function of a field: the medians of its bends at doubling distances. For the CPU alone.
#pragma once

#include <bit>
#include <memory>

#include "holes/hole_field.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr double kLoaded = 5, kMadToSigma = 1.4826;  // kernels/holes.py, core/statistics.py
inline constexpr std::size_t kLeastBends = 200;             // kernels/holes.py

// Ranks of positive numbers, by a histogram of their leading bits: these ascend with the number.
class Ranks {
public:
    Ranks(const double* positive, std::size_t number) : values(positive), count(number), counts(kBins) {
        for (std::size_t i = 0; i < count; ++i) ++counts[bin(values[i])];
    }

    double median() {
        const std::size_t half = count / 2;
        return count % 2 ? at(half) : 0.5 * (at(half - 1) + at(half));
    }

private:
    static constexpr int kShift = 64 - 17;  // the sign, the exponent and five bits of the fraction
    static constexpr std::size_t kBins = 1 << 16;

    static std::size_t bin(double number) {
        return static_cast<std::size_t>(std::bit_cast<std::uint64_t>(number) >> kShift);
    }

    // The number of a rank, not less than those before.
    double at(std::size_t rank) {
        const std::size_t last = own;
        for (; rank - before >= counts[own]; ++own) before += counts[own];
        if (own != last || near.empty()) {
            near.clear();
            near.reserve(counts[own]);
            for (std::size_t i = 0; i < count; ++i)
                if (bin(values[i]) == own) near.push_back(values[i]);
        }
        const auto place = near.begin() + static_cast<std::ptrdiff_t>(rank - before);
        std::nth_element(near.begin(), place, near.end());
        return *place;
    }

    const double* values;
    std::size_t count, own = 0, before = 0;  // numbers in the bins before `own`
    std::vector<std::uint32_t> counts;
    std::vector<double> near;
};

// Appends to `bends` those of a row's cells from `from` to `end` that are above `kLoaded` and whose
// neighbours lie `step` numbers away; returns the number of all.
inline std::size_t add_bends(const double* row, int from, int end, std::ptrdiff_t step,
                             double* __restrict buffer, double* __restrict bends, std::size_t count) {
#pragma omp simd
    for (int u = from; u < end; ++u) {
        const double bend = std::abs(row[u] - 0.5 * (row[u + step] + row[u - step]));
        buffer[u] = row[u] > kLoaded ? bend : kNothing;
    }
    for (int u = from; u < end; ++u) {
        bends[count] = buffer[u];
        count += buffer[u] < kEndless;
    }
    return count;
}

// The number of a field's bends at a distance, and their median.
inline std::size_t find_median_bend(const HoleFieldInput& in, int half, double& median) {
    const int height = in.field.height(), width = in.field.width();
    const std::size_t most = 2 * in.field.shape[0] * in.field.shape[1] + 1;
    const auto bends = std::make_unique_for_overwrite<double[]>(most);
    std::vector<double> buffer(in.field.shape[1]);
    std::size_t count = 0;
    for (int v = 0; v < height; ++v) {
        const double* const row = in.field.row(v);
        if (v >= half && v < height - half)
            count = add_bends(row, 0, width, static_cast<std::ptrdiff_t>(half) * width, buffer.data(),
                              bends.get(), count);
        count = add_bends(row, half, width - half, half, buffer.data(), bends.get(), count);
    }
    median = count < kLeastBends ? 0.0 : Ranks(bends.get(), count).median();
    return count;
}

// The roughness of a field's surface over distances between 0 and the last knot's.
class StructureFunction {
public:
    StructureFunction(const HoleFieldInput& in, std::size_t threads) : distance{0}, rms{0} {
        const int longest = std::max(in.field.height(), in.field.width());
        std::vector<int> halves;
        for (int half = 1; 2 * half < longest; half *= 2) halves.push_back(half);
        std::vector<double> medians(halves.size());
        std::vector<std::size_t> counts(halves.size());
        for_jobs(halves.size(), threads,
                 [&](std::size_t job) { counts[job] = find_median_bend(in, halves[job], medians[job]); });
        for (std::size_t k = 0; k < halves.size() && counts[k] >= kLeastBends; ++k) {
            distance.push_back(2 * halves[k] * in.cell);
            rms.push_back(std::max(rms.back(), kMadToSigma * medians[k]));
        }
    }

    double operator()(double gap) const {
        if (!(gap < distance.back())) return rms.back();
        std::size_t k = 0;
        while (gap >= distance[k + 1]) ++k;
        const double slope = (rms[k + 1] - rms[k]) / (distance[k + 1] - distance[k]);
        return slope * (gap - distance[k]) + rms[k];
    }

private:
    std::vector<double> distance, rms;
};

}  // namespace beltscape
