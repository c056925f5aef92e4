// Binds visibility.hpp.
#include <nanobind/stl/vector.h>

#include <vector>

#include "bind_grid.hpp"
#include "visibility.hpp"

namespace beltscape {
namespace {

constexpr int kRowsPerJob = 16;

using Flags = nb::ndarray<std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// One job per view: each raises only its own buffer, which begins as zeros.
void inverse_depth_buffers(Grid s, const std::vector<ViewRow>& rows, const std::vector<GridOut>& buffers,
                           std::size_t threads) {
    const int height = height_of(s), width = width_of(s);
    const float* const from = s.data();
    nb::gil_scoped_release release;
    for_jobs(rows.size(), threads, [&](std::size_t i) {
        const View view = view_of(rows[i].data());
        const GridOut& buffer = buffers[i];
        for (int v = 0; v < height; ++v)
            splat_row<Floats>(view, from + static_cast<std::size_t>(v) * static_cast<std::size_t>(width), v,
                              width, width_of(buffer), height_of(buffer), buffer.data());
    });
}

void visible(Grid s, ViewRow row, Grid buffer, float tolerance, Flags out, std::size_t threads) {
    const int height = height_of(s), width = width_of(s);
    const int buffer_width = width_of(buffer), buffer_height = height_of(buffer);
    const View view = view_of(row.data());
    const float *const from = s.data(), *const nearest = buffer.data();
    std::uint8_t* const to = out.data();
    nb::gil_scoped_release release;
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v) {
            const std::size_t at = static_cast<std::size_t>(v) * static_cast<std::size_t>(width);
            visible_row<Floats>(view, from + at, v, width, buffer_width, buffer_height, nearest, tolerance,
                                to + at);
        }
    });
}

}  // namespace

void bind_visibility(nb::module_& m) {
    m.def("inverse_depth_buffers", &inverse_depth_buffers, nb::arg("s"), nb::arg("views"), nb::arg("buffers"),
          nb::arg("threads"));
    m.def("visible", &visible, nb::arg("s"), nb::arg("view"), nb::arg("buffer"), nb::arg("tolerance"),
          nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
