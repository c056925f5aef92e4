// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "least_squares/local_fit_band.hpp"
#include "least_squares/normal_band.hpp"
#include "least_squares/shift_fit.hpp"

void beltscape::bind_least_squares(nb::module_& m) {
    bind(m, "normal_equations", &normal_equations);
    bind(m, "local_fit", &local_fit);
    bind(m, "fit_shift", &fit_shift);
}
