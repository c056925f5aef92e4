// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "holes/continuation.hpp"
#include "holes/fill_holes.hpp"

void beltscape::bind_holes(nb::module_& m) {
    bind(m, "hole_inputs", &hole_inputs);
    bind(m, "fill_holes", &fill_holes);
    bind(m, "continue_surface", &continue_surface);
}
