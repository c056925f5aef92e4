// Values at offsets from given pixels; beyond the image, those of its edge.
#pragma once

#include "simd.hpp"

namespace beltscape {

// Of the plane (height, width), at most `count` pixels (u, v) moved by (du, dv), into out.
template <class F>
BELTSCAPE_INLINE void neighbours(const float* plane, int width, int height, const float* u, const float* v,
                                 int du, int dv, int count, float* out) {
    const IntOf<F> column = clamp(to_int(load_first<F>(u, count)) + du, 0, width - 1);
    const IntOf<F> row = clamp(to_int(load_first<F>(v, count)) + dv, 0, height - 1);
    store_first(out, gather(plane, row * width + column), count);
}

}  // namespace beltscape
