// Lists of the pixels of a mask on a GPU: found row by row, written back, and numbered.
#pragma once

#include "cuda/device.hpp"

namespace beltscape {

inline constexpr int kSegment = 64;       // pixels that a thread counts
inline constexpr int kScanThreads = 256;  // of the block that adds the counts up

// A thread counts the mask's pixels in its segment.
extern "C" __global__ void count_pixels(const unsigned char* mask, int size, int* counts) {
    const int segment = grid_x(), first = segment * kSegment;
    if (first >= size) return;
    int count = 0;
    for (int i = first; i < lesser(size, first + kSegment); ++i) count += mask[i] != 0;
    counts[segment] = count;
}

// One block replaces counts by the sums of all before, and gives the sum of all.
extern "C" __global__ void sum_counts(int* counts, int segments, int* total) {
    BELTSCAPE_SHARED(int, sums, kScanThreads);
    const int thread = static_cast<int>(threadIdx.x), each = (segments + kScanThreads - 1) / kScanThreads;
    const int first = thread * each, end = lesser(segments, first + each);
    int own = 0;
    for (int i = first; i < end; ++i) own += counts[i];
    sums[thread] = own;
    __syncthreads();
    int before = 0;
    for (int i = 0; i < thread; ++i) before += sums[i];
    for (int i = first; i < end; ++i) {
        const int count = counts[i];
        counts[i] = before;
        before += count;
    }
    if (thread == kScanThreads - 1) *total = before;
}

// A thread writes rows and columns of its segment's pixels.
extern "C" __global__ void list_pixels(const unsigned char* mask, int size, int width, const int* counts,
                                       float* rows, float* columns) {
    const int segment = grid_x(), first = segment * kSegment;
    if (first >= size) return;
    int at = counts[segment];
    for (int i = first; i < lesser(size, first + kSegment); ++i)
        if (mask[i]) rows[at] = to_float(i / width), columns[at] = to_float(i % width), ++at;
}

// Repeats the first pixel behind the last, so that a list may be taken longer than it is: at most by an
// eighth and 8 pixels.
extern "C" __global__ void repeat_first_pixel(const int* total, int size, float* rows, float* columns) {
    const int count = *total, beyond = grid_x(), i = count + beyond;
    if (count == 0 || beyond > count / 8 + 8 || i >= size) return;
    rows[i] = rows[0], columns[i] = columns[0];
}

__device__ inline size_t place_of(const float* rows, const float* columns, int pixel, int width) {
    return static_cast<size_t>(to_int(rows[pixel])) * width + to_int(columns[pixel]);
}

// Whether a pixel is the first one, repeated.
__device__ inline bool is_repeated(const float* rows, const float* columns, int pixel) {
    return pixel > 0 && rows[pixel] == rows[0] && columns[pixel] == columns[0];
}

extern "C" __global__ void copy_floats(const float* from, int size, float* to) {
    const int i = grid_x();
    if (i < size) to[i] = from[i];
}

// Writes the values of some pixels into a plane.
extern "C" __global__ void put_pixels(const float* rows, const float* columns, int pixels,
                                      const float* values, int width, float* plane) {
    const int pixel = grid_x();
    if (pixel >= pixels || is_repeated(rows, columns, pixel)) return;
    plane[place_of(rows, columns, pixel, width)] = values[pixel];
}

// The addresses of all pixels without a number: 1 where they are accepted, else 0.
extern "C" __global__ void begin_addresses(const unsigned char* accepted, int size, int* addresses) {
    const int pixel = grid_x();
    if (pixel < size) addresses[pixel] = accepted[pixel] ? 1 : 0;
}

// Numbers some pixels in their order, from `first` on.
extern "C" __global__ void number_pixels(const float* rows, const float* columns, int pixels, int width,
                                         int first, int* addresses) {
    const int pixel = grid_x();
    if (pixel >= pixels || is_repeated(rows, columns, pixel)) return;
    addresses[place_of(rows, columns, pixel, width)] = first + pixel;
}

// Of planes (count, candidates, pixels) the values of each pixel's candidate of the largest score (the first
// of equals): out (count, pixels). A NaN is no largest score.
extern "C" __global__ void pick_best(const float* scores, int candidates, int pixels,
                                     const unsigned long long* planes, int count, float* out) {
    const int pixel = grid_x();
    if (pixel >= pixels) return;
    int best = 0;
    for (int i = 1; i < candidates; ++i)
        if (scores[static_cast<size_t>(i) * pixels + pixel] >
            scores[static_cast<size_t>(best) * pixels + pixel])
            best = i;
    for (int k = 0; k < count; ++k)
        out[static_cast<size_t>(k) * pixels + pixel] =
            array_at<float>(planes, k)[static_cast<size_t>(best) * pixels + pixel];
}

}  // namespace beltscape
