// What bindings over the core's grid share: its arrays, its views, and its rows cut into jobs.
#pragma once

#include <algorithm>

#include "bind.hpp"
#include "parallel.hpp"
#include "view.hpp"

namespace beltscape {

using Grid = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using GridOut = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using ViewRow = nb::ndarray<const float, nb::shape<21>, nb::c_contig, nb::device::cpu>;

inline int height_of(const auto& grid) { return static_cast<int>(grid.shape(0)); }
inline int width_of(const auto& grid) { return static_cast<int>(grid.shape(1)); }

inline View view_of(const float* row) {
    View view;
    static_assert(sizeof view == 21 * sizeof(float));
    __builtin_memcpy(&view, row, sizeof view);
    return view;
}

// Calls band(first, end) for all of 0 ... count, `per_job` of them at a time.
template <class Band>
void for_bands(int count, int per_job, std::size_t threads, const Band& band) {
    for_jobs(static_cast<std::size_t>((count + per_job - 1) / per_job), threads, [&](std::size_t job) {
        const int first = static_cast<int>(job) * per_job;
        band(first, std::min(count, first + per_job));
    });
}

}  // namespace beltscape
