// The filling of holes (kernels/holes.py): the inputs of the prediction, the prediction, and what lies
// outside all rims. Rows are taken in bands that do not depend on the rows asked for. For the CPU alone.
#pragma once

#include <utility>

#include "holes/features.hpp"
#include "holes/window_means.hpp"
#include "networks/network.hpp"

namespace beltscape {

inline constexpr int kHoleBandRows = 80, kCellsAtOnce = 192;
// Between the features of a cell; an odd number of cache lines, which do not displace each other.
inline constexpr int kFeatureStride = kCellsAtOnce + 16;

struct HolesInput {
    HoleFieldInput holes;
    Grid<const double> sigma;
    List<const std::int32_t> order;  // the network's inputs as numbers of features
    Grid<const float> limits;        // (2, inputs): low, then high
    std::vector<Grid<const float>> layers;

    void fields(const auto& read) {
        read("holes", holes), read("sigma", sigma), read("order", order);
        read("limits", limits), read("layers", layers);
    }
};

struct HoleCell {
    int v, u;
    CellWindows windows;
};

// What the prediction of a cell takes beside the features.
struct HeightRange {
    double base, scale, floor, ceiling;
};

class HoleSurvey {
public:
    HoleSurvey(const HoleFieldInput& in, std::size_t threads)
        : field(in), rims(field, threads), rough(field, kRoughCells[kRoughs - 1] / 2) {}

    int bands() const { return (field.end - field.first + kHoleBandRows - 1) / kHoleBandRows; }

    // The hole cells of a band of rows, with the statistics of their windows.
    std::vector<HoleCell> measure_band(int band) const {
        const int start = field.first + band * kHoleBandRows;
        const int end = std::min(start + kHoleBandRows, field.end);
        std::size_t number = 0;
        for (int v = start; v < end; ++v)
            for (int u = 0; u < field.width; ++u) number += field.is_hole(v, u);
        std::vector<HoleCell> cells;
        cells.reserve(number);
        for (int v = start; v < end; ++v)
            for (int u = 0; u < field.width; ++u)
                if (field.is_hole(v, u)) cells.push_back({v, u, {}});
        if (cells.empty()) return cells;
        fit_windows(cells, start);
        average_windows(cells, start);
        find_lowest(cells, start, end);
        for (HoleCell& cell : cells) cell.windows.depth = distance_to_measured(field, cell.v, cell.u);
        return cells;
    }

    HeightRange write_arguments(const HoleCell& cell, ArgumentWriter to) const {
        const double side = field.cell();
        const Rims found = find_rims(rims, cell.v, cell.u);
        const RimSummary sum = summarise_rims(found, side);
        const SmoothSurface surface = predict_smooth_surface(sum, cell.windows.fits, rims.structure, side);
        const FeatureUnits per = {1 / surface.scale, 1 / sum.shortest, 1 / side};
        for (int k = 0; k < kLines; ++k)
            write_line(found.lines[k], sum.upper_tangent[k], sum.lower_tangent[k], surface.base, per, to);
        write_cell(found, sum, surface, field.in.pinhole.row(cell.v)[cell.u], per, to);
        write_windows(cell.windows, surface.base, per, to);
        write_depths(found, sum.floor, cell.windows, surface.base, per, to);
        return {surface.base, surface.scale, sum.floor, sum.ceiling};
    }

    HoleField field;
    RimSurvey rims;
    Roughness rough;

private:
    // Calls `row(sums)` for the rows of the cells, with the sums moved to that row, and `cell(sums, cell)`.
    template <class Sums, class OnRow, class OnCell>
    static void scan(std::vector<HoleCell>& cells, int start, Sums& sums, const OnRow& on_row,
                     const OnCell& on_cell) {
        int v = start;
        std::size_t last = cells.size();
        for (std::size_t i = 0; i < cells.size(); ++i) {
            while (v < cells[i].v) sums.move_down(++v);
            if (last == cells.size() || cells[last].v != v) on_row();
            last = i;
            on_cell(cells[i]);
        }
    }

    void fit_windows(std::vector<HoleCell>& cells, int start) const {
        const int stretches = (field.width + kMostColumns - 1) / kMostColumns;
        for (int k = 0; k < kWindows; ++k) {
            ColumnSums columns(field, kWindow[k], start);
            std::vector<WindowRowSums> rows;
            for (int s = 0; s < stretches; ++s)
                rows.emplace_back(
                    std::max(field.width * s / stretches - kWindow[k] / 2, 0),
                    std::min(field.width * (s + 1) / stretches + kWindow[k] / 2 + 1, field.width));
            QuadraticBatch batch;
            const auto fill = [&] {
                for (WindowRowSums& row : rows) row.fill(columns);
            };
            scan(cells, start, columns, fill, [&](HoleCell& cell) {
                int s = cell.u * stretches / field.width;
                while (s + 1 < stretches && cell.u >= field.width * (s + 1) / stretches) ++s;
                add_window(field, rows[s], cell.v, cell.u, k, start, &cell.windows.fits, batch);
            });
            fit_quadratics(batch, k, field.middle);
        }
    }

    template <class OnCell>
    static void average(std::vector<HoleCell>& cells, int start, const KnownCells& of, int side,
                        const OnCell& on_cell) {
        RepeatedWindow window(of, side, start);
        scan(
            cells, start, window, [&] { window.sum_row(); },
            [&](HoleCell& cell) { on_cell(window, cell.u, cell.windows); });
    }

    void average_windows(std::vector<HoleCell>& cells, int start) const {
        const KnownCells heights = {field.measured, field.value, field.height, field.width};
        const KnownCells roughness = {rough.known, rough.value, field.height, field.width};
        for (const int side : kMeanCells)
            average(cells, start, heights, side, [&](const RepeatedWindow& window, int u, CellWindows& to) {
                for (int k = 0; k < kOpens; ++k)
                    if (kOpenCells[k] == side) to.open[k] = 1 - window.share(u);
                for (int k = 0; k < kWindows; ++k)
                    if (kWindow[k] == side) to.mean[k] = field.middle + window.mean(u);
            });
        for (int k = 0; k < kRoughs; ++k)
            average(
                cells, start, roughness, kRoughCells[k],
                [&](const RepeatedWindow& window, int u, CellWindows& to) { to.rough[k] = window.mean(u); });
    }

    void find_lowest(std::vector<HoleCell>& cells, int start, int end) const {
        LowestCells lowest(field, start, end, kLowCells[kLows - 1] / 2);
        for (int k = 0; k < kLows; ++k) {
            while (2 * lowest.square() <= kLowCells[k]) lowest.grow();
            for (HoleCell& cell : cells) cell.windows.low[k] = lowest.find(cell.v, cell.u, kLowCells[k]);
        }
    }
};

// Calls `take(cells, ranges, features, count)` for the hole cells of a band, no more than kCellsAtOnce at a
// time.
template <class Take>
inline void for_cells(const HoleSurvey& survey, const std::vector<HoleCell>& cells, const Take& take) {
    std::vector<float> features(kHoleFeatures * kFeatureStride);
    HeightRange ranges[kCellsAtOnce];
    for (std::size_t from = 0; from < cells.size(); from += kCellsAtOnce) {
        const int count = static_cast<int>(std::min<std::size_t>(kCellsAtOnce, cells.size() - from));
        for (int i = 0; i < count; ++i)
            ranges[i] = survey.write_arguments(cells[from + i], {features.data() + i, kFeatureStride});
        transform_arguments(features.data(), kFeatureStride, count);
        take(from, ranges, features.data(), count);
    }
}

// features: (kHoleFeatures, cells); base, scale: (cells), row by row.
inline void hole_inputs(const HoleFieldInput& in, std::size_t threads, Grid<float> features,
                        List<double> base, List<double> scale) {
    if (base.shape[0] == 0) return;
    const HoleSurvey survey(in, threads);
    const std::size_t bands = static_cast<std::size_t>(survey.bands());
    std::vector<std::size_t> first(bands + 1);
    for (int v = survey.field.first; v < survey.field.end; ++v)
        for (int u = 0; u < survey.field.width; ++u)
            first[(v - survey.field.first) / kHoleBandRows + 1] += survey.field.is_hole(v, u);
    for (std::size_t band = 0; band < bands; ++band) first[band + 1] += first[band];
    for_jobs(bands, threads, [&](std::size_t band) {
        const std::vector<HoleCell> cells = survey.measure_band(static_cast<int>(band));
        for_cells(survey, cells,
                  [&](std::size_t from, const HeightRange* ranges, const float* own, int count) {
                      const std::size_t to = first[band] + from;
                      for (int k = 0; k < kHoleFeatures; ++k)
                          std::copy_n(own + k * kFeatureStride, count, features.row(k) + to);
                      for (int i = 0; i < count; ++i)
                          base[to + i] = ranges[i].base, scale[to + i] = ranges[i].scale;
                  });
    });
}

inline constexpr double kMostOffset = 5, kLeastLogVariance = -12, kMostLogVariance = 3;  // kernels/holes.py

inline double median_of_finite(const Grid<const double>& plane) {
    const std::size_t size = plane.shape[0] * plane.shape[1];
    const auto values = std::make_unique_for_overwrite<double[]>(size + 1);
    std::size_t count = 0;
    for (std::size_t i = 0; i < size; ++i) {
        values[count] = plane[i];
        count += plane[i] - plane[i] == 0;
    }
    return count == 0 ? kNothing : Ranks(values.get(), count).median();
}

// Gives cells without two rims the nearest known cell's value and the field's standard deviation.
inline void extrapolate(const HoleField& field, const std::vector<std::pair<int, int>>& unfilled,
                        Grid<double> value, Grid<double> sigma) {
    const int height = field.height, width = field.width;
    double number = 0, total = 0, squares = 0;
    Plane<int> nearest(height, width);  // rows of the columns' nearest known cells
    for (int v = 0; v < height; ++v) {
        const double* const row = value.row(v);
        const int* const above = nearest.row(std::max(v - 1, 0));
        int* const to = nearest.row(v);
        for (int u = 0; u < width; ++u) {
            const bool known = row[u] - row[u] == 0;
            to[u] = known ? v : v > 0 ? above[u] : -kNowhere;
            number += known ? 1.0 : 0.0, total += known ? row[u] : 0.0;
        }
    }
    const double mean = total / number;
    for (std::size_t i = 0; i < static_cast<std::size_t>(height) * width; ++i) {
        const double off = value[i] - mean;
        squares += off - off == 0 ? off * off : 0.0;
    }
    const double spread = std::sqrt(squares / number);
    for (int v = height - 1; v-- > 0;)
        for (int u = 0; u < width; ++u) {
            const int above = nearest.row(v)[u], below = nearest.row(v + 1)[u];
            if (below > v && below - v < v - above) nearest.row(v)[u] = below;
        }
    std::vector<double> values, sigmas;
    for (const auto& [v, u] : unfilled) {
        std::int64_t best = static_cast<std::int64_t>(kNowhere) * kNowhere;
        int column = 0;
        for (std::int64_t d = 0; d * d <= best && d < width; ++d)
            for (const std::int64_t at : {u - d, u + d}) {
                if (at < 0 || at >= width) continue;
                const std::int64_t rows = nearest.row(v)[at] - v, squared = d * d + rows * rows;
                if (squared < best || (squared == best && at < column))
                    best = squared, column = static_cast<int>(at);
            }
        const int row = nearest.row(v)[column];
        values.push_back(value.row(row)[column]);
        sigmas.push_back(std::hypot(sigma.row(row)[column], spread));
    }
    for (std::size_t i = 0; i < unfilled.size(); ++i) {
        value.row(unfilled[i].first)[unfilled[i].second] = values[i];
        sigma.row(unfilled[i].first)[unfilled[i].second] = sigmas[i];
    }
}

// value, sigma: (height, width).
inline void fill_holes(const HolesInput& in, std::size_t threads, Grid<double> value, Grid<double> sigma) {
    const std::size_t size = value.shape[0] * value.shape[1];
    std::copy_n(in.holes.field.data, size, value.data);
    std::copy_n(in.sigma.data, size, sigma.data);
    const HoleSurvey survey(in.holes, threads);
    const double usual = median_of_finite(in.sigma);
    const std::vector<Layer> layers = layers_of(in.layers);
    const Network net = {in.limits.data, in.limits.row(1), layers.data(), static_cast<int>(layers.size())};
    const std::size_t bands = static_cast<std::size_t>(survey.bands());
    std::vector<std::vector<std::pair<int, int>>> unfilled(bands);
    for_jobs(bands, threads, [&](std::size_t band) {
        const std::vector<HoleCell> cells = survey.measure_band(static_cast<int>(band));
        for_cells(
            survey, cells,
            [&](std::size_t from, const HeightRange* ranges, const float* features, int count) {
                float outputs[2][kCellsAtOnce];
                float* const out[2] = {outputs[0], outputs[1]};
                std::vector<const float*> planes;
                for (std::size_t k = 0; k < in.order.shape[0]; ++k)
                    planes.push_back(features + in.order[k] * kFeatureStride);
                evaluate_network_pixels<Floats>(net, planes.data(), 0, count, out);
                for (int i = 0; i < count; ++i) {
                    const HoleCell& cell = cells[from + i];
                    const HeightRange& range = ranges[i];
                    const double offset = std::clamp<double>(outputs[0][i], -kMostOffset, kMostOffset);
                    const double variance =
                        std::clamp<double>(outputs[1][i], kLeastLogVariance, kMostLogVariance);
                    // no height lies below both the lowest rim and the belt
                    const double low = least(range.floor, 0.0), high = greatest(range.ceiling, range.base);
                    const double height = std::min(std::max(range.base + range.scale * offset, low), high);
                    sigma.row(cell.v)[cell.u] = std::hypot(range.scale * std::exp(0.5 * variance), usual);
                    value.row(cell.v)[cell.u] = range.base == range.base ? height : kNothing;
                    if (!(height - height == 0) || range.base != range.base)
                        unfilled[band].emplace_back(cell.v, cell.u);
                }
            });
    });
    std::vector<std::pair<int, int>> all;
    for (const auto& own : unfilled) all.insert(all.end(), own.begin(), own.end());
    if (!all.empty()) extrapolate(survey.field, all, value, sigma);
}

}  // namespace beltscape
