// The plane sweep on a GPU: every auxiliary is aligned once, then a block of pixels goes through all planes.
// An aligned image lies in one array with the others; Aligned says where.
#pragma once

#include "cuda/device.hpp"
#include "sweep/aligned_image.hpp"

namespace beltscape {

inline constexpr int kMeanThreads = 256;
inline constexpr int kTileWidth = 32, kTileHeight = 8, kTileThreads = kTileWidth * kTileHeight;
inline constexpr int kHaloWidth = kTileWidth + 2, kHaloHeight = kTileHeight + 2;
inline constexpr int kPlanesAtOnce = 32;               // whose costs are written together
inline constexpr int kCostStride = kPlanesAtOnce + 4;  // of a pixel, so that lanes use different banks
inline constexpr int kMostBest = 8;                    // views that are averaged

// Six numbers of an aligned image: the field it covers, its first pixel (in units of kAlignedUnit) and the
// length of its rows.
struct Aligned {
    int left, top, width, height, first, stride;
};
inline constexpr int kAlignedUnit = 32;

// The mean of the finite pixels in level[0]; one block of kMeanThreads, always summed in the same order.
extern "C" __global__ void mean_level(const float* pixels, int count, float* level) {
    BELTSCAPE_SHARED(double, sums, kMeanThreads);
    BELTSCAPE_SHARED(double, counts, kMeanThreads);
    const int own = static_cast<int>(threadIdx.x);
    double sum = 0, finite = 0;
    for (int i = own; i < count; i += kMeanThreads)
        if (is_finite(pixels[i])) sum += pixels[i], finite += 1;
    sums[own] = sum, counts[own] = finite;
    for (int half = kMeanThreads / 2; half > 0; half /= 2) {
        __syncthreads();
        if (own < half) sums[own] += sums[own + half], counts[own] += counts[own + half];
    }
    if (own == 0) level[0] = counts[0] > 0 ? static_cast<float>(sums[0] / counts[0]) : 0.0f;
}

// A thread takes a view: its shift (views, 3), and left, top, width, height (views, 4) of its aligned image.
extern "C" __global__ void aligned_fields(const float* views, int view_count, float first, float step,
                                          int planes, int width, int height, float* shifts, int* fields) {
    const int i = grid_x();
    if (i >= view_count) return;
    const AlignedShift shift = aligned_shift(view_at(views, i));
    const Field field = aligned_field(shift, {first, step, planes}, width, height);
    shifts[3 * i] = shift.u, shifts[3 * i + 1] = shift.v, shifts[3 * i + 2] = shift.z;
    fields[4 * i] = field.left, fields[4 * i + 1] = field.top;
    fields[4 * i + 2] = field.width, fields[4 * i + 3] = field.height;
}

// A thread takes a plane of a view: scale, u, v and 1 where it is seen, else 0 (views, planes, 4).
extern "C" __global__ void plane_places(const float* shifts, int view_count, float first, float step,
                                        int planes, float* places) {
    const int plane = grid_x(), view = grid_y();
    if (plane >= planes || view >= view_count) return;
    const AlignedShift shift{shifts[3 * view], shifts[3 * view + 1], shifts[3 * view + 2]};
    const PlanePlace place = shift.place(PlaneRange{first, step, planes}.inverse_depth(plane));
    float* const out = places + 4 * (static_cast<size_t>(view) * planes + plane);
    out[0] = place.scale, out[1] = place.u, out[2] = place.v, out[3] = place.seen ? 1.0f : 0.0f;
}

// A thread takes a pixel of view `i`'s aligned image.
extern "C" __global__ void align_image(const float* views, int i, const float* image, int width, int height,
                                       const int* aligned, const float* level, float* out) {
    const Aligned& place = reinterpret_cast<const Aligned*>(aligned)[i];
    const int x = grid_x(), y = grid_y();
    if (x >= place.stride || y >= place.height) return;
    const float seen = aligned_level<float>(view_at(views, i), {image, width, height},
                                            to_float(place.left + x), to_float(place.top + y));
    const size_t row = static_cast<size_t>(y) * place.stride + x;
    out[static_cast<size_t>(place.first) * kAlignedUnit + row] = seen - level[0];
}

// What a view sees of the core's pixel (x, y) on a plane; NaN where it sees nothing.
__device__ inline float sampled_level(const Aligned& image, const float* place, const float* pixels, int x,
                                      int y) {
    const float v = multiply_add(place[0], to_float(y), place[2]) - to_float(image.top);
    const bool seen = place[3] != 0.0f;
    const int row = seen ? to_int(v) : 0;
    if (!seen || row + 1 >= image.height) return kNotANumber;
    const float* const above =
        pixels + static_cast<size_t>(image.first) * kAlignedUnit + static_cast<size_t>(row) * image.stride;
    const float u = multiply_add(to_float(x), place[0], place[1] - to_float(image.left));
    return resampled(above, above + image.stride, v - to_float(row), u, image.stride);
}

// The sums of three pixels of J and of I in a column.
__device__ inline WindowSums<float> column_of(const float* aux, const float* core) {
    const float a = aux[0], b = aux[kHaloWidth], c = aux[2 * kHaloWidth];
    return {a + b + c, three_products(a, b, c, a, b, c), three_products(a, b, c, core[0], core[1], core[2])};
}

// A window's sums; `aux` is its upper left pixel, `core` has it column by column.
__device__ inline WindowSums<float> window_of(const float* aux, const float* core) {
    const WindowSums<float> a = column_of(aux, core), b = column_of(aux + 1, core + 3),
                            c = column_of(aux + 2, core + 6);
    return {a.aux + b.aux + c.aux, a.aux_squared + b.aux_squared + c.aux_squared,
            a.product + b.product + c.product};
}

// Inserts a value into the `best` least ones.
__device__ inline void insert_least(float* least, int best, float value) {
    for (int i = 0; i < kMostBest; ++i) {
        if (i >= best) return;
        const float before = least[i];
        least[i] = lesser(before, value), value = greater(before, value);
    }
}

// The costs of all planes; a block takes kTileWidth x kTileHeight pixels and a thread one of them, which is
// sampled together with its neighbours'. core (height, width), out (rows, width, planes) from row first_row
// on.
extern "C" __global__ void sweep_planes(const float* core, int width, int height, const float* level,
                                        const float* pixels, const int* aligned, const float* places,
                                        int view_count, int planes, const float* floor, int best,
                                        int first_row, int rows, unsigned char* out) {
    BELTSCAPE_SHARED(float, halo, 2 * kHaloWidth * kHaloHeight);
    BELTSCAPE_SHARED(unsigned char, costs, kTileThreads* kCostStride);
    const int own = static_cast<int>(threadIdx.y * kTileWidth + threadIdx.x);
    const int left = static_cast<int>(blockIdx.x) * kTileWidth,
              top = first_row + static_cast<int>(blockIdx.y) * kTileHeight;
    const auto column = [=](int i) { return clamp(left + i - 1, 0, width - 1); };
    const auto row = [=](int i) { return clamp(top + i - 1, 0, height - 1); };

    float window[9];  // of the core, column by column
    float sum = 0, squares = 0;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
            window[3 * i + j] = core[static_cast<size_t>(row(static_cast<int>(threadIdx.y) + j)) * width +
                                     column(static_cast<int>(threadIdx.x) + i)] -
                                level[0];
        const float a = window[3 * i], b = window[3 * i + 1], c = window[3 * i + 2];
        sum = i ? sum + (a + b + c) : a + b + c;
        squares = i ? squares + three_products(a, b, c, a, b, c) : three_products(a, b, c, a, b, c);
    }
    const CoreWindow<float> own_window = core_window(sum, squares, *floor);

    int turn = 0;  // which of the two halos is filled while slower threads still read the other one
    for (int first = 0; first < planes; first += kPlanesAtOnce) {
        const int count = lesser(kPlanesAtOnce, planes - first);
        for (int plane = 0; plane < count; ++plane) {
            float least[kMostBest];
            for (int i = 0; i < kMostBest; ++i) least[i] = 1.0f;
            for (int view = 0; view < view_count; ++view, turn ^= 1) {
                const Aligned& image = reinterpret_cast<const Aligned*>(aligned)[view];
                const float* const place = places + 4 * (static_cast<size_t>(view) * planes + first + plane);
                float* const samples = halo + turn * (kHaloWidth * kHaloHeight);
                for (int i = own; i < kHaloWidth * kHaloHeight; i += kTileThreads)
                    samples[i] =
                        sampled_level(image, place, pixels, column(i % kHaloWidth), row(i / kHaloWidth));
                __syncthreads();
                const float* const corner = samples + threadIdx.y * kHaloWidth + threadIdx.x;
                insert_least(least, best, dissimilarity(window_of(corner, window), own_window, *floor));
            }
            float total = least[0];
            for (int i = 1; i < kMostBest; ++i)
                if (i < best) total += least[i];
            costs[own * kCostStride + plane] =
                static_cast<unsigned char>(to_int(total * (kWorst / to_float(best)) + 0.5f));
        }
        __syncthreads();
        // a warp writes the planes of one pixel after the other
        for (int pixel = own / kWarpSize; pixel < kTileThreads; pixel += kTileThreads / kWarpSize) {
            const int x = left + pixel % kTileWidth, y = top - first_row + pixel / kTileWidth,
                      plane = own % kWarpSize;
            if (x < width && y < rows && plane < count)
                out[(static_cast<size_t>(y) * width + x) * planes + first + plane] =
                    costs[pixel * kCostStride + plane];
        }
        __syncthreads();
    }
}

}  // namespace beltscape
