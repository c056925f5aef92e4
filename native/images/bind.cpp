// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "images/bend_medians.hpp"
#include "images/gathering.hpp"
#include "images/plane_slopes.hpp"
#include "images/prefilter.hpp"
#include "images/quadratics.hpp"
#include "images/warp.hpp"
#include "images/window_means.hpp"

void beltscape::bind_images(nb::module_& m) {
    bind(m, "spline_coefficients", &spline_coefficients);
    bind(m, "warp", &warp);
    bind(m, "gather", &gather_neighbours);
    bind(m, "quadratics", &quadratics);
    bind(m, "window_means", &window_means);
    bind(m, "window_minima", &window_minima);
    bind(m, "plane_slopes", &plane_slopes);
    bind(m, "bend_medians", &bend_medians);
}
