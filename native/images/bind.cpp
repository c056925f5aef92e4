// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "images/gathering.hpp"
#include "images/prefilter.hpp"
#include "images/warp.hpp"

void beltscape::bind_images(nb::module_& m) {
    bind(m, "spline_coefficients", &spline_coefficients);
    bind(m, "warp", &warp);
    bind(m, "gather", &gather_neighbours);
}
