// Shared by bindings of small networks.
#pragma once

#include <nanobind/stl/vector.h>

#include <vector>

#include "bind_grid.hpp"
#include "network.hpp"

namespace beltscape {

inline std::vector<Layer> layers_of(const std::vector<Grid>& layers) {
    std::vector<Layer> weighed;
    for (const Grid& layer : layers) weighed.push_back({layer.data(), width_of(layer) - 1, height_of(layer)});
    return weighed;
}

}  // namespace beltscape
