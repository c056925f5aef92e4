// Visibility of the core's surface from an auxiliary: a buffer of the largest inverse depth, and the mask of
// the core's pixels that it does not hide.
#pragma once

#include "array.hpp"
#include "parallel.hpp"
#include "workspace.hpp"

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

// Raises the upper left one of the 2x2 pixels about where pixels begin ... end - 1 of the core's row v are
// seen to their inverse depth. `corners` (height + 1, width + 1) begins at pixel (-1, -1).
template <class F>
BELTSCAPE_INLINE void splat_row(const View& view, const float* s, int v, int begin, int end, int width,
                                int height, float* corners) {
    constexpr int kAtOnce = kPlacedAhead<F> * Lane<F>::count;
    const F zero{};
    int at[kAtOnce];
    float to[kAtOnce];
    for (int first = begin; first < end; first += kAtOnce) {
        const int last = lesser(end, first + kAtOnce);
        for (int x = first; x < last; x += Lane<F>::count) {
            const Seen<F> seen = seen_from<F>(view, s, v, x, end);
            const MaskOf<F> hits = (seen.u >= -1.0f) & (seen.u < to_float(width)) & (seen.v >= -1.0f) &
                                   (seen.v < to_float(height)) & (seen.inverse_depth > 0.0f);
            const IntOf<F> column = floor_int(select(hits, seen.u, zero)) + 1;
            const IntOf<F> row = floor_int(select(hits, seen.v, zero)) + 1;
            store(at + x - first, row * (width + 1) + column);
            store(to + x - first, select(hits, seen.inverse_depth, zero));
            prefetch(corners + at[x - first] + 2 * (width + 1));  // for the next row
        }
        for (int x = first; x < last; ++x) raise(corners[at[x - first]], to[x - first]);
    }
}

// Writes columns begin ... end - 1 of row v of the buffer: the largest of the four corners whose 2x2 pixels
// contain each of its pixels.
template <class F>
BELTSCAPE_INLINE void spread_row(const float* corners, int v, int begin, int end, int width, float* out) {
    const float* const above = corners + static_cast<size_t>(v) * static_cast<size_t>(width + 1);
    const float* const here = above + width + 1;
    for (int x = begin; x < end; x += Lane<F>::count) {
        const int left = end - x;
        const F upper = greater(load_first<F>(above + x, left), load_first<F>(above + x + 1, left));
        const F lower = greater(load_first<F>(here + x, left), load_first<F>(here + x + 1, left));
        store_first(out + x, greater(upper, lower), left);
    }
}

// Of columns begin ... end - 1: 1 where the pixel of the core's row v projects into the image and `buffer`
// (height, width) at the nearest pixel exceeds its inverse depth by at most `tolerance`, else 0.
template <class F>
BELTSCAPE_INLINE void visible_row(const View& view, const float* s, int v, int begin, int end, int width,
                                  int height, const float* buffer, float tolerance, unsigned char* out) {
    constexpr int kAtOnce = kPlacedAhead<F> * Lane<F>::count;
    int at[kAtOnce];
    float most[kAtOnce];  // of the buffer's inverse depth; NaN: not inside
    for (int first = begin; first < end; first += kAtOnce) {
        const int last = lesser(end, first + kAtOnce);
        for (int x = first; x < last; x += Lane<F>::count) {
            const Seen<F> seen = seen_from<F>(view, s, v, x, end);
            const F u = seen.u + 0.5f, w = seen.v + 0.5f;
            const MaskOf<F> inside =
                (u >= 0.0f) & (u < to_float(width)) & (w >= 0.0f) & (w < to_float(height));
            const IntOf<F> column = clamp(to_int(clamp(u, 0.0f, to_float(width))), 0, width - 1);
            const IntOf<F> row = clamp(to_int(clamp(w, 0.0f, to_float(height))), 0, height - 1);
            store(at + x - first, row * width + column);
            store(most + x - first,
                  select(inside, seen.inverse_depth + tolerance, broadcast<F>(kNotANumber)));
        }
        for (int x = first; x < last; ++x) out[x] = buffer[at[x - first]] <= most[x - first];
    }
}

#ifndef __CUDACC__
struct BuffersInput {
    Grid<const float> s;
    PackedViews views;

    void fields(const auto& read) { read("s", s), read("views", views); }
};

// One job per view: each raises its own corners, each pixel once instead of four.
inline void inverse_depth_buffers(const BuffersInput& in, std::size_t threads,
                                  const std::vector<Grid<float>>& buffers) {
    for_jobs(buffers.size(), threads, [&](std::size_t i) {
        const View view = view_of(in.views.data + kViewFloats * i);
        const Grid<float>& buffer = buffers[i];
        const int width = buffer.width(), height = buffer.height();
        const std::size_t count = (buffer.shape[0] + 1) * (buffer.shape[1] + 1);
        const Workspace<float> corners(count);
        std::fill_n(corners.get(), count, 0.0f);
        for (int v = 0; v < in.s.height(); ++v)
            splat_row<Floats>(view, in.s.row(v), v, 0, in.s.width(), width, height, corners.get());
        for (int v = 0; v < height; ++v) spread_row<Floats>(corners.get(), v, 0, width, width, buffer.row(v));
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
            visible_row<Floats>(view, in.s.row(v), v, 0, in.s.width(), in.buffer.width(), in.buffer.height(),
                                in.buffer.data, in.tolerance, out.row(v));
    });
}
#endif

}  // namespace beltscape
