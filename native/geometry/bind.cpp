// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "geometry/arc_tangent.hpp"
#include "geometry/fuse_layers.hpp"
#include "geometry/height_rasterisation.hpp"
#include "geometry/triangulate.hpp"
#include "geometry/visibility.hpp"

void beltscape::bind_geometry(nb::module_& m) {
    bind(m, "arc_tangents", &arc_tangents);
    bind(m, "triangulate", &triangulate);
    bind(m, "inverse_depth_buffers", &inverse_depth_buffers);
    bind(m, "visible", &visible);
    bind(m, "rasterise_heights", &rasterise_heights);
    bind(m, "fuse_layers", &fuse_layers);
}
