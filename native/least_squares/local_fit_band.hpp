// The local fit of bands of rows, each with the largest window's margin around it.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "array.hpp"
#include "least_squares/local_fit.hpp"
#include "parallel.hpp"

namespace beltscape {

// A window of the Python record.
struct WindowInput {
    int radius;
    std::vector<double> taps;
    std::vector<int> reach;

    void fields(const auto& read) { read("radius", radius), read("taps", taps), read("reach", reach); }
};

struct LocalFitInput {
    Grid<const float> information, pull, s, slope_u, slope_v;
    std::vector<WindowInput> windows;
    FitSettings settings;

    void fields(const auto& read) {
        read("information", information), read("pull", pull), read("s", s);
        read("slope_u", slope_u), read("slope_v", slope_v), read("windows", windows);
        settings.fields(read);
    }
};

inline FitWindows windows_of(const std::vector<WindowInput>& given, const FitSettings& settings) {
    FitWindows windows{};
    windows.count = static_cast<int>(given.size());
    windows.tolerance = static_cast<float>(settings.tolerance);
    windows.settings = settings;
    for (int i = 0; i <= kMaxRadius; ++i) windows.distance[i] = static_cast<float>(i);
    for (std::size_t k = 0; k < given.size(); ++k) {
        fill_window(windows.window[k], given[k].radius, given[k].taps.data(), given[k].reach.data(),
                    std::pow(settings.tolerance, 4));
    }
    return windows;
}

// The fields of a band of rows, with their margins.
struct FitBand {
    FitBand(int rows, int width, int margin_)
        : stride(width + 2 * margin_ + kFloatLanes),
          margin(margin_),
          plane(static_cast<std::size_t>(stride) * static_cast<std::size_t>(rows + 2 * margin_)),
          data(3 * plane) {}
    float* at(std::size_t field, int row) {  // row: -margin ... rows + margin
        return data.data() + field * plane +
               static_cast<std::size_t>(row + margin) * static_cast<std::size_t>(stride) + margin;
    }
    int stride, margin;
    std::size_t plane;
    std::vector<float> data;
};

inline void local_fit(const LocalFitInput& in, std::size_t threads, Grid<float> s, Grid<float> slope_u,
                      Grid<float> slope_v, Grid<float> variance, Grid<float> disagreement,
                      Grid<std::uint8_t> scale) {
    constexpr int kRowsPerJob = 32;
    const int height = in.s.height(), width = in.s.width();
    const FitWindows windows = windows_of(in.windows, in.settings);
    const int margin = windows.window[windows.count - 1].radius;
    const FitRow all{in.s.data,    in.slope_u.data, in.slope_v.data,   s.data,    slope_u.data,
                     slope_v.data, variance.data,   disagreement.data, scale.data};
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        FitBand band(end - first, width, margin);
        for (int row = std::max(0, first - margin); row < std::min(height, end + margin); ++row)
            field_row<Floats>(in.information.row(row), in.pull.row(row), in.s.row(row),
                              in.settings.prior_information, width, band.at(1, row - first),
                              band.at(2, row - first), band.at(0, row - first));
        for (int row = first; row < end; ++row) {
            const FitField field{band.at(0, row - first), band.at(1, row - first), band.at(2, row - first),
                                 band.stride};
            fit_row<Floats>(field, windows, row_of(all, static_cast<std::size_t>(row) * in.s.shape[1]), 0,
                            width);
        }
    });
}

}  // namespace beltscape
