// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "sweep/sweep_and_aggregate.hpp"

void beltscape::bind_sweep(nb::module_& m) {
    bind(m, "sweep", &sweep);
    bind(m, "aggregate", &aggregate);
    bind(m, "sweep_and_aggregate", &sweep_and_aggregate);
}
