// Levels, contrast, sharpness and traces of demosaicing of a frame's images on a GPU.
#pragma once

#include "cuda/device.hpp"
#include "photometry/contrast.hpp"
#include "photometry/sharpness.hpp"

namespace beltscape {

// Sums of stretches of the levels of an image, or of their squared deviations from mean[0]: a thread goes
// down the tree of halves by the bits of its number, and gives NaN where a stretch ends above. sums
// (2^depth).
template <class T>
__device__ inline void sum_stretches(const T* pixels, int size, int depth, int are_squares, const float* mean,
                                     float* sums) {
    const int stretch = grid_x();
    if (stretch >= 1 << depth) return;
    size_t first = 0, count = static_cast<size_t>(size);
    int bit = depth - 1;
    for (; bit >= 0 && count > kStretch; --bit) {
        const size_t half = first_half(count);
        const bool is_second = stretch >> bit & 1;
        first += is_second ? half : 0;
        count = is_second ? count - half : half;
    }
    const bool is_empty = bit >= 0 && (stretch & ((2 << bit) - 1)) != 0;
    const LevelTerms<T> terms = {pixels, are_squares ? *mean : 0.0f, are_squares != 0};
    sums[stretch] = is_empty ? kNotANumber : sum_stretch(terms, first, count);
}

extern "C" __global__ void sum_stretches_of_bytes(const unsigned char* pixels, int size, int depth,
                                                  int are_squares, const float* mean, float* sums) {
    sum_stretches(pixels, size, depth, are_squares, mean, sums);
}

extern "C" __global__ void sum_stretches_of_words(const unsigned short* pixels, int size, int depth,
                                                  int are_squares, const float* mean, float* sums) {
    sum_stretches(pixels, size, depth, are_squares, mean, sums);
}

inline constexpr int kJoinThreads = 256;

// The sum of both halves; the second may be none.
__device__ inline float join_halves(float first, float second) {
    return second != second ? first : first + second;
}

// out[0] = the mean of `size` terms by the sums of their stretches (2^depth), which are overwritten, or its
// root. One block of kJoinThreads joins halves; each of its threads those of its part first.
extern "C" __global__ void join_stretches(float* sums, int depth, int size, int is_root, float* out) {
    const int thread = static_cast<int>(threadIdx.x), count = 1 << depth;
    const int part = greater(1, count / kJoinThreads), first = thread * part;
    if (first < count)
        for (int step = 1; step < part; step *= 2)
            for (int i = first; i < first + part; i += 2 * step)
                sums[i] = join_halves(sums[i], sums[i + step]);
    for (int step = part; step < count; step *= 2) {
        __syncthreads();
        if (first < count && thread % (2 * step / part) == 0)
            sums[first] = join_halves(sums[first], sums[first + step]);
    }
    if (thread == 0) {
        const float mean = mean_of(sums[0], size);
        out[0] = is_root ? square_root(mean) : mean;
    }
}

// The levels of an image times gain[0]; a thread takes a pixel.
template <class T>
__device__ inline void write_levels(const T* pixels, int width, int height, const float* gain, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const size_t at = static_cast<size_t>(y) * width + x;
    out[at] = static_cast<float>(pixels[at]) * kLevelScale<T> * *gain;
}

extern "C" __global__ void levels_of_bytes(const unsigned char* pixels, int width, int height,
                                           const float* gain, float* out) {
    write_levels(pixels, width, height, gain, out);
}

extern "C" __global__ void levels_of_words(const unsigned short* pixels, int width, int height,
                                           const float* gain, float* out) {
    write_levels(pixels, width, height, gain, out);
}

// blurred (kBlurs, height, width): an image blurred three times along its columns.
extern "C" __global__ void blur_columns(const float* image, int width, int height, const float* weights,
                                        const int* radii, float* blurred) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const auto read = [&](int, int by) {
        return image[static_cast<size_t>(mirrored_index(y + by, height)) * width + x];
    };
    float sums[kBlurs][1];
    blur_down({weights, radii}, read, sums);
    const size_t at = static_cast<size_t>(y) * width + x, size = static_cast<size_t>(height) * width;
    for (int blur = 0; blur < kBlurs; ++blur) blurred[static_cast<size_t>(blur) * size + at] = sums[blur][0];
}

// differences (2, height, width) of such blurs, blurred along rows, too.
extern "C" __global__ void blur_rows(const float* blurred, int width, int height, const float* weights,
                                     const int* radii, float* differences) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const size_t row = static_cast<size_t>(y) * width, size = static_cast<size_t>(height) * width;
    const auto read = [&](int blur, int, int by) {
        return blurred[static_cast<size_t>(blur) * size + row + mirrored_index(x + by, width)];
    };
    float fine[1], medium[1];
    blur_across({weights, radii}, read, fine, medium);
    differences[row + x] = fine[0], differences[size + row + x] = medium[0];
}

// moments (height, kMoments): of each row the sums and sums of squares of both differences, a block of
// kRowParts threads each.
extern "C" __global__ void sum_row_moments(const float* differences, int width, int height, float* moments) {
    BELTSCAPE_SHARED(float, sums, kMoments* kRowParts);
    const int thread = static_cast<int>(threadIdx.x), y = static_cast<int>(blockIdx.x);
    const size_t row = static_cast<size_t>(y) * width, size = static_cast<size_t>(height) * width;
    float own[kMoments] = {};
    for (int x = thread; x < width; x += kRowParts) {
        const float fine = differences[row + x], medium = differences[size + row + x];
        own[0] += fine, own[1] += fine * fine, own[2] += medium, own[3] += medium * medium;
    }
    for (int i = 0; i < kMoments; ++i) sums[i * kRowParts + thread] = own[i];
    __syncthreads();
    if (thread >= kMoments) return;
    float parts[kRowParts];
    for (int i = 0; i < kRowParts; ++i) parts[i] = sums[thread * kRowParts + i];
    moments[y * kMoments + thread] = join_sums(parts);
}

// variances (2) of both differences, a thread each.
extern "C" __global__ void join_row_moments(const float* moments, int width, int height, float* variances) {
    const int thread = grid_x();
    if (thread < 2) variances[thread] = variance_of_rows(moments + 2 * thread, height, width);
}

inline constexpr int kPhases = 4, kPhaseThreads = 64;

// sums (height, kPhases): over each row the absolute second differences of an image whose columns and rows
// have the same parities as the phase; whole pairs of columns and rows count. One block of kPhaseThreads to a
// row.
extern "C" __global__ void sum_phases(const float* image, int width, int height, float* sums) {
    BELTSCAPE_SHARED(float, parts, 2 * kPhaseThreads);
    const int thread = static_cast<int>(threadIdx.x), y = static_cast<int>(blockIdx.x);
    const float* const row = image + static_cast<size_t>(y) * width;
    const float* const above = image + static_cast<size_t>(mirrored_index(y - 1, height)) * width;
    const float* const below = image + static_cast<size_t>(mirrored_index(y + 1, height)) * width;
    float even = 0, odd = 0;
    for (int x = 2 * thread; x + 1 < width; x += 2 * kPhaseThreads)
        for (int i = x; i < x + 2; ++i) {
            const float around =
                above[i] + below[i] + row[mirrored_index(i - 1, width)] + row[mirrored_index(i + 1, width)];
            (i == x ? even : odd) += absolute(4 * row[i] - around);
        }
    parts[2 * thread] = even, parts[2 * thread + 1] = odd;
    __syncthreads();
    if (thread >= 2) return;
    float sum = 0;
    for (int i = thread; i < 2 * kPhaseThreads; i += 2) sum += parts[i];
    const bool is_whole = y < height / 2 * 2;
    sums[y * kPhases + 2 * (y % 2) + thread] = is_whole ? sum : 0.0f;
    sums[y * kPhases + 2 * (1 - y % 2) + thread] = 0;
}

// means (kPhases) by such sums of the rows, a thread each.
extern "C" __global__ void join_phases(const float* sums, int width, int height, float* means) {
    const int phase = grid_x();
    if (phase >= kPhases) return;
    double sum = 0;
    for (int y = 0; y < height; ++y) sum += static_cast<double>(sums[y * kPhases + phase]);
    means[phase] = static_cast<float>(sum / (static_cast<double>(width / 2) * (height / 2)));
}

}  // namespace beltscape
