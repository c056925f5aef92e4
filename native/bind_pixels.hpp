// Shared by bindings about given pixels of the core's grid.
#pragma once

#include "bind_grid.hpp"

namespace beltscape {

inline constexpr int kPixelsPerJob = 1024;

using Numbers = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;  // columns or rows

}  // namespace beltscape
