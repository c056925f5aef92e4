// Binds prefilter.hpp and warp.hpp.
#include "bind_grid.hpp"
#include "prefilter.hpp"
#include "warp.hpp"

namespace beltscape {
namespace {

constexpr int kRowsPerJob = 16;
constexpr int kColumnsPerJob = 256;  // a strip of them stays in the second-level cache
constexpr int kRowsAtOnce = 8;       // of a prefilter

void spline_coefficients(Grid image, GridOut out, std::size_t threads) {
    const int height = height_of(image), width = width_of(image);
    const float* const from = image.data();
    float* const to = out.data();
    nb::gil_scoped_release release;
    const float gain = (width > 1 ? kGain : 1.0f) * (height > 1 ? kGain : 1.0f);
    const std::size_t step = static_cast<std::size_t>(width);
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        std::size_t row = static_cast<std::size_t>(first);
        for (; row + kRowsAtOnce <= static_cast<std::size_t>(end); row += kRowsAtOnce)
            prefilter_rows<kRowsAtOnce>(from + row * step, width, gain, to + row * step);
        for (; row < static_cast<std::size_t>(end); ++row)
            prefilter_rows<1>(from + row * step, width, gain, to + row * step);
    });
    for_bands(0, width, kColumnsPerJob, threads,
              [&](int first, int end) { prefilter_columns<Floats>(to + first, height, step, end - first); });
}

void warp(Grid s, ViewRow row, Grid coefficients, GridOut value, GridOut slope, std::size_t threads) {
    const int height = height_of(s), width = width_of(s);
    const View view = view_of(row.data());
    const Spline spline{coefficients.data(), width_of(coefficients), height_of(coefficients)};
    const float* const from = s.data();
    float *const values = value.data(), *const slopes = slope.data();
    nb::gil_scoped_release release;
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v) {
            const std::size_t at = static_cast<std::size_t>(v) * static_cast<std::size_t>(width);
            warp_row<Floats>(view, spline, from + at, v, 0, width, values + at, slopes + at);
        }
    });
}

}  // namespace

void bind_warping(nb::module_& m) {
    m.def("spline_coefficients", &spline_coefficients, nb::arg("image"), nb::arg("out"), nb::arg("threads"));
    m.def("warp", &warp, nb::arg("s"), nb::arg("view"), nb::arg("coefficients"), nb::arg("value"),
          nb::arg("slope"), nb::arg("threads"));
}

}  // namespace beltscape
