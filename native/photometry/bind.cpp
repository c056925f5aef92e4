// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "photometry/contrast.hpp"
#include "photometry/sharpness.hpp"

void beltscape::bind_photometry(nb::module_& m) {
    bind(m, "measure_contrast", &measure_contrast);
    bind(m, "make_levels", &make_levels);
    bind(m, "measure_sharpness", &measure_sharpness);
}
