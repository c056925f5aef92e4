// Binds normal_band.hpp and local_fit.hpp.
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <tuple>
#include <vector>

#include "bind_grid.hpp"
#include "local_fit.hpp"
#include "normal_band.hpp"

namespace beltscape {
namespace {

constexpr int kRowsOfEquations = 64;  // of a job, which warps 9 more on both sides
constexpr int kRowsOfFit = 32;

using Counts = nb::ndarray<std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void normal_equations(Grid s, Grid core, const std::vector<Grid>& coefficients,
                      const std::vector<ViewRow>& rows, int window, int residual_window, float floor,
                      float noise_variance, float model_variance, float gate, GridOut information,
                      GridOut pull, Counts used, std::size_t threads) {
    NormalProblem problem{{window, residual_window, floor, noise_variance, model_variance, gate},
                          s.data(),
                          core.data(),
                          height_of(s),
                          width_of(s),
                          {},
                          {information.data(), pull.data(), used.data()}};
    for (std::size_t k = 0; k < rows.size(); ++k)
        problem.views.push_back(
            {view_of(rows[k].data()),
             {coefficients[k].data(), width_of(coefficients[k]), height_of(coefficients[k])}});
    nb::gil_scoped_release release;
    for_bands(0, problem.height, kRowsOfEquations, threads,
              [&](int first, int end) { NormalBand(problem).run(first, end); });
}

using Window = std::tuple<int, std::vector<double>, std::vector<int>>;  // radius, taps, reach

FitWindows windows_of(const std::vector<Window>& given, double tolerance, double width, float flatten) {
    FitWindows windows{};
    windows.count = static_cast<int>(given.size());
    windows.tolerance = static_cast<float>(tolerance), windows.width = static_cast<float>(width);
    windows.flatten = flatten;
    for (std::size_t k = 0; k < given.size(); ++k) {
        const auto& [radius, taps, reach] = given[k];
        windows.window[k].radius = radius;
        for (std::size_t i = 0; i < taps.size(); ++i) {
            windows.window[k].reach[i] = reach[i];
            windows.window[k].across[i] = static_cast<float>(taps[i]);
            windows.window[k].down[i] = static_cast<float>(taps[i] / std::pow(tolerance, 4));
        }
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

void local_fit(Grid information, Grid pull, Grid s, Grid slope_u, Grid slope_v,
               const std::vector<Window>& given, double tolerance, double confidence_width, float prior,
               float flatten, GridOut new_s, GridOut new_slope_u, GridOut new_slope_v, GridOut variance,
               GridOut disagreement, Counts scale, std::size_t threads) {
    const int height = height_of(s), width = width_of(s);
    const FitWindows windows = windows_of(given, tolerance, confidence_width, flatten);
    const int margin = windows.window[windows.count - 1].radius;
    const FitRow all{s.data(),        slope_u.data(),      slope_v.data(),
                     new_s.data(),    new_slope_u.data(),  new_slope_v.data(),
                     variance.data(), disagreement.data(), scale.data()};
    const float *const informations = information.data(), *const pulls = pull.data();
    nb::gil_scoped_release release;
    for_bands(0, height, kRowsOfFit, threads, [&](int first, int end) {
        const auto at = [&](int row) {
            return static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
        };
        FitBand band(end - first, width, margin);
        for (int row = std::max(0, first - margin); row < std::min(height, end + margin); ++row)
            field_row<Floats>(informations + at(row), pulls + at(row), all.s + at(row), prior, width,
                              band.at(1, row - first), band.at(2, row - first), band.at(0, row - first));
        for (int row = first; row < end; ++row) {
            const FitField field{band.at(0, row - first), band.at(1, row - first), band.at(2, row - first),
                                 band.stride};
            fit_row<Floats>(field, windows, row_of(all, at(row)), 0, width);
        }
    });
}

}  // namespace

void bind_least_squares(nb::module_& m) {
    m.def("normal_equations", &normal_equations, nb::arg("s"), nb::arg("core"), nb::arg("coefficients"),
          nb::arg("views"), nb::arg("window"), nb::arg("residual_window"), nb::arg("floor"),
          nb::arg("noise_variance"), nb::arg("model_variance"), nb::arg("gate"), nb::arg("information"),
          nb::arg("pull"), nb::arg("used"), nb::arg("threads"));
    m.def("local_fit", &local_fit, nb::arg("information"), nb::arg("pull"), nb::arg("s"), nb::arg("slope_u"),
          nb::arg("slope_v"), nb::arg("windows"), nb::arg("tolerance"), nb::arg("confidence_width"),
          nb::arg("prior"), nb::arg("flatten"), nb::arg("new_s"), nb::arg("new_slope_u"),
          nb::arg("new_slope_v"), nb::arg("variance"), nb::arg("disagreement"), nb::arg("scale"),
          nb::arg("threads"));
}

}  // namespace beltscape
