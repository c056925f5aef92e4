// Visibility of the core's surface from an auxiliary: a buffer of the largest inverse depth, and the mask of
// the core's pixels that it does not hide.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

// Projects the core's pixels from (x, v) on, one F of them, into an auxiliary.
template <class F>
BELTSCAPE_INLINE Seen<F> seen_from(const View& view, const float* s, int v, int x, int end) {
    const F u = to_float(broadcast<IntOf<F>>(x) + lane_numbers<F>());
    return see(view, u, broadcast<F>(to_float(v)), load_first<F>(s + x, end - x));
}

#ifdef __CUDA_ARCH__
// Other threads may raise the same pixel; positive floats are ordered like their bits.
__device__ inline void raise(float& nearest, float inverse_depth) {
    atomicMax(reinterpret_cast<int*>(&nearest), __float_as_int(inverse_depth));
}
#else
BELTSCAPE_INLINE void raise(float& nearest, float inverse_depth) {
    nearest = greater(nearest, inverse_depth);
}
#endif

// Raises the 2x2 pixels of `buffer` from each index on, all of which lie in it.
template <class F>
BELTSCAPE_INLINE void raise_squares(IntOf<F> places, F inverse_depth, int width, float* buffer) {
    int at[Lane<F>::count];
    float to[Lane<F>::count];
    store(at, places), store(to, inverse_depth);
    for (int i = 0; i < Lane<F>::count; ++i) {
        float *const above = buffer + at[i], *const below = above + width;
        raise(above[0], to[i]), raise(above[1], to[i]);
        raise(below[0], to[i]), raise(below[1], to[i]);
    }
}

// Raises the 2x2 pixels of `buffer` (height, width) about where each pixel of the core's row v is seen to its
// inverse depth; s has the row's `end` values.
template <class F>
BELTSCAPE_INLINE void splat_row(const View& view, const float* s, int v, int end, int width, int height,
                                float* buffer) {
    for (int x = 0; x < end; x += Lane<F>::count) {
        const Seen<F> seen = seen_from<F>(view, s, v, x, end);
        const MaskOf<F> hits = (seen.u >= -1.0f) & (seen.u < to_float(width)) & (seen.v >= -1.0f) &
                               (seen.v < to_float(height)) & (seen.inverse_depth > 0.0f);
        const IntOf<F> columns = floor_int(clamp(seen.u, -1.0f, to_float(width)));
        const IntOf<F> rows = floor_int(clamp(seen.v, -1.0f, to_float(height)));
        const MaskOf<F> whole =
            hits & (columns >= 0) & (columns < width - 1) & (rows >= 0) & (rows < height - 1);
        if (end - x >= Lane<F>::count && !any(negate(whole))) {
            raise_squares(rows * width + columns, seen.inverse_depth, width, buffer);
            continue;
        }
        for (int i = 0; i < lesser(Lane<F>::count, end - x); ++i) {
            if (!Lane<MaskOf<F>>::get(hits, i)) continue;
            const int column = Lane<IntOf<F>>::get(columns, i), row = Lane<IntOf<F>>::get(rows, i);
            const float inverse_depth = Lane<F>::get(seen.inverse_depth, i);
            float* const at = buffer + static_cast<long long>(row) * width + column;
            if (column >= 0 && row >= 0) raise(at[0], inverse_depth);
            if (column + 1 < width && row >= 0) raise(at[1], inverse_depth);
            if (column >= 0 && row + 1 < height) raise(at[width], inverse_depth);
            if (column + 1 < width && row + 1 < height) raise(at[width + 1], inverse_depth);
        }
    }
}

// 1 where the pixel of the core's row v projects into the image and `buffer` (height, width) at the nearest
// pixel exceeds its inverse depth by at most `tolerance`, else 0.
template <class F>
BELTSCAPE_INLINE void visible_row(const View& view, const float* s, int v, int end, int width, int height,
                                  const float* buffer, float tolerance, unsigned char* out) {
    for (int x = 0; x < end; x += Lane<F>::count) {
        const Seen<F> seen = seen_from<F>(view, s, v, x, end);
        const F u = seen.u + 0.5f, w = seen.v + 0.5f;
        const MaskOf<F> inside = (u >= 0.0f) & (u < to_float(width)) & (w >= 0.0f) & (w < to_float(height));
        const IntOf<F> column = clamp(to_int(clamp(u, 0.0f, to_float(width))), 0, width - 1);
        const IntOf<F> row = clamp(to_int(clamp(w, 0.0f, to_float(height))), 0, height - 1);
        const F nearest = gather(buffer, row * width + column);
        const MaskOf<F> clear = inside & (nearest <= seen.inverse_depth + tolerance);
        store_first(out + x, select(clear, broadcast<IntOf<F>>(1), broadcast<IntOf<F>>(0)), end - x);
    }
}

#ifndef __CUDACC__
struct BuffersInput {
    Grid<const float> s;
    PackedViews views;

    void fields(const auto& read) { read("s", s), read("views", views); }
};

// One job per view: each raises only its own buffer, which begins as zeros.
inline void inverse_depth_buffers(const BuffersInput& in, std::size_t threads,
                                  const std::vector<Grid<float>>& buffers) {
    const int height = in.s.height(), width = in.s.width();
    for_jobs(buffers.size(), threads, [&](std::size_t i) {
        const View view = view_of(in.views.data + kViewFloats * i);
        for (int v = 0; v < height; ++v)
            splat_row<Floats>(view, in.s.row(v), v, width, buffers[i].width(), buffers[i].height(),
                              buffers[i].data);
    });
}

struct VisibleInput {
    Grid<const float> s;
    PackedView view;
    Grid<const float> buffer;
    float tolerance;

    void fields(const auto& read) {
        read("s", s), read("view", view), read("buffer", buffer), read("tolerance", tolerance);
    }
};

inline void visible(const VisibleInput& in, std::size_t threads, Grid<std::uint8_t> out) {
    constexpr int kRowsPerJob = 16;
    const View view = view_of(in.view.data);
    for_bands(0, in.s.height(), kRowsPerJob, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v)
            visible_row<Floats>(view, in.s.row(v), v, in.s.width(), in.buffer.width(), in.buffer.height(),
                                in.buffer.data, in.tolerance, out.row(v));
    });
}
#endif

}  // namespace beltscape
