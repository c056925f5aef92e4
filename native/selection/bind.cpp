// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "selection/candidate_surfaces.hpp"
#include "selection/photo_consistency.hpp"
#include "selection/propagate.hpp"

void beltscape::bind_selection(nb::module_& m) {
    bind(m, "propagate", &propagate);
    bind(m, "candidate_surfaces", &candidate_surfaces);
    bind(m, "photo_consistency", &photo_consistency);
}
