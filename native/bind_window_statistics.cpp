// Binds ray_march.hpp, quadratics.hpp, window_means.hpp and plane_slopes.hpp.
#include "bind_grid.hpp"
#include "plane_slopes.hpp"
#include "quadratics.hpp"
#include "ray_march.hpp"
#include "window_means.hpp"

namespace beltscape {
namespace {

using Mask = nb::ndarray<const bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Field = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using CellsOut = nb::ndarray<std::int64_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using TableOut = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using StackOut = nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

void bound_first_hits(Mask measured, Numbers rows, Numbers columns, Field down, Field across,
                      std::int64_t most, CellsOut cell, TableOut steps, std::size_t threads) {
    const LinesInput in{measured.data(),
                        height_of(measured),
                        width_of(measured),
                        rows.data(),
                        columns.data(),
                        rows.shape(0),
                        down.data(),
                        across.data(),
                        down.shape(0),
                        down.shape(1) == 1,
                        most};
    std::int64_t* const to_cell = cell.data();
    double* const to_steps = steps.data();
    nb::gil_scoped_release release;
    first_hits(in, to_cell, to_steps, threads);
}

WindowsInput windows_of(const Field& field, const Numbers& rows, const Numbers& columns,
                        const Numbers& sides) {
    return {field.data(),   height_of(field), width_of(field), rows.data(),
            columns.data(), rows.shape(0),    sides.data(),    sides.shape(0)};
}

void bound_quadratics(Field field, Numbers rows, Numbers columns, Numbers sides, TableOut value,
                      TableOut miss, TableOut leverage, std::size_t threads) {
    const WindowsInput in = windows_of(field, rows, columns, sides);
    double *const to_value = value.data(), *const to_miss = miss.data(), *const to_leverage = leverage.data();
    nb::gil_scoped_release release;
    quadratics(in, to_value, to_miss, to_leverage, threads);
}

void bound_window_means(Field field, Numbers rows, Numbers columns, Numbers sides, TableOut share,
                        TableOut mean, std::size_t threads) {
    const WindowsInput in = windows_of(field, rows, columns, sides);
    double *const to_share = share.data(), *const to_mean = mean.data();
    nb::gil_scoped_release release;
    window_means(in, to_share, to_mean, threads);
}

void bound_window_minima(Field field, Numbers rows, Numbers columns, Numbers sides, TableOut least,
                         std::size_t /* runs on one thread */) {
    const WindowsInput in = windows_of(field, rows, columns, sides);
    double* const to = least.data();
    nb::gil_scoped_release release;
    window_minima(in, to);
}

void bound_plane_slopes(Field field, StackOut slope, std::size_t threads) {
    const double* const from = field.data();
    const std::size_t height = field.shape(0), width = field.shape(1);
    double* const to = slope.data();
    nb::gil_scoped_release release;
    plane_slopes(from, height, width, to, threads);
}

}  // namespace

void bind_window_statistics(nb::module_& m) {
    m.def("first_hits", &bound_first_hits, nb::arg("measured"), nb::arg("rows"), nb::arg("columns"),
          nb::arg("down"), nb::arg("across"), nb::arg("most"), nb::arg("cell"), nb::arg("steps"),
          nb::arg("threads"));
    m.def("quadratics", &bound_quadratics, nb::arg("field"), nb::arg("rows"), nb::arg("columns"),
          nb::arg("sides"), nb::arg("value"), nb::arg("miss"), nb::arg("leverage"), nb::arg("threads"));
    m.def("window_means", &bound_window_means, nb::arg("field"), nb::arg("rows"), nb::arg("columns"),
          nb::arg("sides"), nb::arg("share"), nb::arg("mean"), nb::arg("threads"));
    m.def("window_minima", &bound_window_minima, nb::arg("field"), nb::arg("rows"), nb::arg("columns"),
          nb::arg("sides"), nb::arg("least"), nb::arg("threads"));
    m.def("plane_slopes", &bound_plane_slopes, nb::arg("field"), nb::arg("slope"), nb::arg("threads"));
}

}  // namespace beltscape
