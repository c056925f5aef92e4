// Sums over windows with weights, and quantiles of whole planes on a GPU: by them the noise of a frame and
// its texture stay on the device.
#pragma once

#include "cuda/device.hpp"
#include "cuda/planes.cuh"

namespace beltscape {

// Sums over a window of (rows, columns) weights around each pixel, as OpenCV's filter2D.
extern "C" __global__ void filter_plane(const float* plane, int width, int height, const float* weights,
                                        int columns, int rows, int is_repeated, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    float sum = 0;
    for (int j = 0; j < rows; ++j) {
        const size_t row = static_cast<size_t>(beyond_end(y + j - rows / 2, height, is_repeated)) * width;
        for (int i = 0; i < columns; ++i)
            sum +=
                weights[j * columns + i] * plane[row + beyond_end(x + i - columns / 2, width, is_repeated)];
    }
    out[static_cast<size_t>(y) * width + x] = sum;
}

inline constexpr int kRankThreads = 256;
inline constexpr int kDigitBits = 4, kDigits = 1 << kDigitBits;
inline constexpr int kRankStride = kRankThreads + 1;  // so that threads of a warp use different banks

// A number whose order as an unsigned integer is that of the float whose bits are given; and back.
__device__ inline unsigned key_of(unsigned bits) { return bits & 0x80000000u ? ~bits : bits | 0x80000000u; }
__device__ inline float value_of(unsigned key) {
    return __uint_as_float(key & 0x80000000u ? key & 0x7fffffffu : ~key);
}

// The values of several arrays that are no NaN, of which a thread of a block takes its part.
struct ThreadValues {
    const unsigned long long* addresses;
    const int* sizes;
    int arrays;

    template <class Take>
    __device__ void for_each(const Take& take) const {
        for (int k = 0; k < arrays; ++k) {
            const unsigned* const bits = array_at<unsigned>(addresses, k);
            for (int i = static_cast<int>(threadIdx.x); i < sizes[k]; i += kRankThreads)
                if ((bits[i] & 0x7fffffffu) <= 0x7f800000u) take(key_of(bits[i]));
        }
    }
};

// What a block shares while it looks for a value.
struct RankSpace {
    int* counts;  // (kDigits, kRankStride) of each digit and thread
    int* totals;  // (kDigits)

    // Adds up what each thread counted of each digit.
    __device__ void add_up() const {
        __syncthreads();
        const int digit = static_cast<int>(threadIdx.x);
        if (digit < kDigits) {
            int total = 0;
            for (int i = 0; i < kRankThreads; ++i) total += counts[digit * kRankStride + i];
            totals[digit] = total;
        }
        __syncthreads();
    }
};

// The key of the value that `rank` others precede, digit by digit from the highest on. Every thread counts
// its own values, so that no two write to one place.
__device__ inline unsigned key_of_rank(const ThreadValues& values, int rank, const RankSpace& space) {
    const int thread = static_cast<int>(threadIdx.x);
    unsigned found = 0;
    for (int shift = 32 - kDigitBits; shift >= 0; shift -= kDigitBits) {
        for (int digit = 0; digit < kDigits; ++digit) space.counts[digit * kRankStride + thread] = 0;
        const unsigned above = shift + kDigitBits < 32 ? ~0u << (shift + kDigitBits) : 0u;
        values.for_each([&](unsigned key) {
            if ((key & above) == found)
                ++space.counts[static_cast<int>(key >> shift & (kDigits - 1)) * kRankStride + thread];
        });
        space.add_up();
        int digit = 0;
        while (digit < kDigits - 1 && rank >= space.totals[digit]) rank -= space.totals[digit++];
        found |= static_cast<unsigned>(digit) << shift;
        __syncthreads();  // before the totals are overwritten
    }
    return found;
}

// The quantile out[0] (a share in millionths, exact unlike one in float) of the numbers in several arrays,
// NaN left out: interpolated linearly between two of them; NaN where there is none. One block of
// kRankThreads.
extern "C" __global__ void find_quantile(const unsigned long long* addresses, const int* sizes, int arrays,
                                         int millionths, float* out) {
    BELTSCAPE_SHARED(int, counts, kDigits* kRankStride);
    BELTSCAPE_SHARED(int, totals, kDigits);
    const ThreadValues values = {addresses, sizes, arrays};
    const RankSpace space = {counts, totals};
    const int thread = static_cast<int>(threadIdx.x);
    for (int digit = 0; digit < kDigits; ++digit) counts[digit * kRankStride + thread] = 0;
    values.for_each([&](unsigned) { ++counts[thread]; });
    space.add_up();
    const int count = totals[0];
    __syncthreads();
    if (count == 0) {
        if (thread == 0) out[0] = __uint_as_float(0x7fc00000u);
        return;
    }
    const double place = millionths * 1e-6 * (count - 1);
    const int rank = static_cast<int>(place);
    const unsigned lower = key_of_rank(values, rank, space);
    const unsigned upper = key_of_rank(values, lesser(count - 1, rank + 1), space);
    const float low = value_of(lower), high = value_of(upper), step = high - low;
    const double part = place - rank;  // rounded as NumPy rounds it
    if (thread == 0)
        out[0] =
            part < 0.5 ? low + step * static_cast<float>(part) : high - step * static_cast<float>(1 - part);
}

}  // namespace beltscape
