// Binds gathering.hpp.
#include <nanobind/stl/vector.h>

#include <vector>

#include "bind_pixels.hpp"
#include "gathering.hpp"
#include "pool.hpp"

namespace beltscape {
namespace {

// offsets: du, dv; out (planes, offsets, N).
void gather_all(const std::vector<Grid>& planes, Numbers u, Numbers v, Offsets offsets, GridOut out,
                std::size_t threads) {
    const int width = width_of(planes[0]), height = height_of(planes[0]);
    const std::size_t count = u.shape(0), moves = offsets.shape(0);
    std::vector<const float*> from;
    for (const Grid& plane : planes) from.push_back(plane.data());
    const float *const us = u.data(), *const vs = v.data();
    const std::int32_t* const by = offsets.data();
    float* const to = out.data();
    nb::gil_scoped_release release;
    for_bands(0, static_cast<int>(count), kPixelsPerJob, threads, [&](int first, int end) {
        for (std::size_t p = 0; p < from.size(); ++p)
            for (std::size_t k = 0; k < moves; ++k)
                for (int i = first; i < end; i += kFloatLanes) {
                    const std::size_t at = static_cast<std::size_t>(i);
                    neighbours<Floats>(from[p], width, height, us + at, vs + at, by[2 * k], by[2 * k + 1],
                                       end - i, to + (p * moves + k) * count + at);
                }
    });
}

}  // namespace

void bind_gathering(nb::module_& m) {
    m.def("gather", &gather_all, nb::arg("planes"), nb::arg("u"), nb::arg("v"), nb::arg("offsets"),
          nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
