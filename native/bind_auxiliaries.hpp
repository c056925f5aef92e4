// Shared by bindings that read the auxiliaries: their images, views and buffers as the kernels take them.
#pragma once

#include <nanobind/stl/vector.h>

#include <vector>

#include "agreement.hpp"
#include "bind_grid.hpp"

namespace beltscape {

using Flags = nb::ndarray<const std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Views = nb::ndarray<const float, nb::shape<-1, 21>, nb::c_contig, nb::device::cpu>;

inline Image image_of(const Grid& grid) { return {grid.data(), width_of(grid), height_of(grid)}; }

inline std::vector<Auxiliary> auxiliaries_of(const std::vector<Grid>& images, const Views& views,
                                             const std::vector<Grid>& buffers) {
    std::vector<Auxiliary> found;
    for (std::size_t i = 0; i < images.size(); ++i)
        found.push_back({view_of(views.data() + 21 * i), image_of(images[i]), buffers[i].data()});
    return found;
}

}  // namespace beltscape
