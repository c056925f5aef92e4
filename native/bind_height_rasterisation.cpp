// Binds height_rasterisation.hpp.
#include "bind_grid.hpp"
#include "height_rasterisation.hpp"

namespace beltscape {
namespace {

using Mask = nb::ndarray<const bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Transform = nb::ndarray<const double, nb::shape<3, 4>, nb::c_contig, nb::device::cpu>;
using Heights = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void bound_rasterise_heights(Grid depth, Grid sigma, Mask use, Transform grid_from_pixel, float step,
                             Heights height, Heights variance, std::size_t /* runs on one thread */) {
    const RasterisationInput in{depth.data(),     sigma.data(),           use.data(), width_of(depth),
                                height_of(depth), grid_from_pixel.data(), step,       width_of(height),
                                height_of(height)};
    double *const to_height = height.data(), *const to_variance = variance.data();
    nb::gil_scoped_release release;
    rasterise_heights(in, to_height, to_variance);
}

}  // namespace

void bind_height_rasterisation(nb::module_& m) {
    m.def("rasterise_heights", &bound_rasterise_heights, nb::arg("depth"), nb::arg("sigma"), nb::arg("use"),
          nb::arg("grid_from_pixel"), nb::arg("step"), nb::arg("height"), nb::arg("variance"),
          nb::arg("threads"));
}

}  // namespace beltscape
