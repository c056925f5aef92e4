// Shared by bindings over the core's grid: its arrays, its views, and its rows cut into jobs.
#pragma once

#include "bind.hpp"
#include "parallel.hpp"
#include "view.hpp"

namespace beltscape {

using Grid = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using GridOut = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using ViewRow = nb::ndarray<const float, nb::shape<21>, nb::c_contig, nb::device::cpu>;
using Offsets = nb::ndarray<const std::int32_t, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;

inline int height_of(const auto& grid) { return static_cast<int>(grid.shape(0)); }
inline int width_of(const auto& grid) { return static_cast<int>(grid.shape(1)); }

inline View view_of(const float* row) {
    View view;
    static_assert(sizeof view == 21 * sizeof(float));
    __builtin_memcpy(&view, row, sizeof view);
    return view;
}

}  // namespace beltscape
