// Values at offsets from given pixels; beyond the image its edge is repeated.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

// Writes the values of a plane (height, width) at no more than `count` pixels (u + du, v + dv).
template <class F>
BELTSCAPE_INLINE void neighbours(const float* plane, int width, int height, const float* u, const float* v,
                                 int du, int dv, int count, float* out) {
    const IntOf<F> column = clamp(to_int(load_first<F>(u, count)) + du, 0, width - 1);
    const IntOf<F> row = clamp(to_int(load_first<F>(v, count)) + dv, 0, height - 1);
    store_first(out, gather(plane, row * width + column), count);
}

#ifndef __CUDACC__
struct GatherInput {
    std::vector<Grid<const float>> planes;
    List<const float> u, v;  // columns and rows of the pixels
    Array<const std::int32_t, kAny, 2> offsets;

    void fields(const auto& read) {
        read("planes", planes), read("u", u), read("v", v), read("offsets", offsets);
    }
};

// out (planes * offsets, pixels)
inline void gather_neighbours(const GatherInput& in, std::size_t threads, Grid<float> out) {
    const int width = in.planes[0].width(), height = in.planes[0].height();
    const std::size_t offsets = in.offsets.shape[0];
    for_bands(0, static_cast<int>(in.u.shape[0]), kPixelsPerJob, threads, [&](int first, int end) {
        for (std::size_t p = 0; p < in.planes.size(); ++p)
            for (std::size_t k = 0; k < offsets; ++k)
                for (int i = first; i < end; i += kFloatLanes)
                    neighbours<Floats>(in.planes[p].data, width, height, in.u.data + i, in.v.data + i,
                                       in.offsets[2 * k], in.offsets[2 * k + 1], end - i,
                                       out.row(static_cast<int>(p * offsets + k)) + i);
    });
}
#endif

}  // namespace beltscape
