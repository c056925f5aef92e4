// Semi-global aggregation on a GPU: a warp walks along one path, a lane takes every 32nd plane, and one
// launch takes all paths of one direction, each pixel of which belongs to one of them. Sums are integers, so
// they are those of the CPU.
#pragma once

#include "cuda/device.hpp"
#include "sweep/semi_global_cost.hpp"

namespace beltscape {

inline constexpr unsigned short kBeyond = 0xffff;  // beside the first and the last plane

// Bands of rows, each aggregated by itself with a halo.
struct RowBands {
    int height, band_rows, halo_rows;

    __device__ int keep_first(int band) const { return band * band_rows; }
    __device__ int keep_last(int band) const { return lesser(height, (band + 1) * band_rows); }
    __device__ int first(int band) const { return greater(0, keep_first(band) - halo_rows); }
    __device__ int last(int band) const { return lesser(height, keep_last(band) + halo_rows); }
};

struct PathStart {
    int x, y;
    bool exists;
};

// Where path `number` of a direction begins: along rows at their ends, for the rows that are kept; else in
// the band's first row, and at the side from which a slanting path comes.
__device__ inline PathStart path_start(const RowBands& bands, int band, int width, int dx, int dy,
                                       int number) {
    const int side = dx > 0 ? 0 : width - 1;
    if (dy == 0) {
        const int y = bands.keep_first(band) + number;
        return {side, y, y < bands.keep_last(band)};
    }
    const int start = dy > 0 ? bands.first(band) : bands.last(band) - 1;
    if (number < width) return {number, start, true};
    const int down = number - width + 1;
    return {side, start + dy * down, dx != 0 && down < bands.last(band) - bands.first(band)};
}

// One path's planes of the pixel before and of this one, in turns.
class PathCosts {
public:
    __device__ PathCosts(unsigned short* memory, int planes, int lane)
        : memory_(memory), planes_(planes), lane_(lane) {
        for (int plane = lane; plane < 2 * (planes + 2); plane += kWarpSize)
            memory[plane] = is_beside(plane) ? kBeyond : static_cast<unsigned short>(0);
        __syncwarp();
    }

    // Goes on to a pixel, and gives use(plane, step) the step to each of this lane's planes.
    template <class Use>
    __device__ void advance(const unsigned char* cost, int small_jump, int large_jump, const Use& use) {
        const unsigned short* const before = memory_ + turn_ * (planes_ + 2) + 1;
        unsigned short* const now = memory_ + (1 - turn_) * (planes_ + 2) + 1;
        unsigned least = kBeyond;
        for (int plane = lane_; plane < planes_; plane += kWarpSize) {
            const int beside =
                lesser(static_cast<int>(before[plane - 1]), static_cast<int>(before[plane + 1]));
            const int step =
                lesser(lesser(static_cast<int>(before[plane]), beside + small_jump), least_ + large_jump) -
                least_;
            const int sum = step + lesser(static_cast<int>(cost[plane]), kMaxCost);
            now[plane] = static_cast<unsigned short>(sum);
            least = lesser(static_cast<int>(least), sum);
            use(plane, step);
        }
        least_ = static_cast<int>(least_of_warp(least));
        __syncwarp();
        turn_ = 1 - turn_;
    }

private:
    __device__ bool is_beside(int i) const {
        return i % (planes_ + 2) == 0 || i % (planes_ + 2) == planes_ + 1;
    }

    unsigned short* memory_;
    int planes_, lane_, least_ = 0, turn_ = 0;
};

// A warp of a block (32, warps) takes a path in direction (dx, dy); blocks along y are bands. cost (height,
// width, planes) as bytes, sums the same as words: the steps of all paths so far. Needs 4 (planes + 2) bytes
// of dynamic shared memory for a warp.
extern "C" __global__ void aggregate_direction(const unsigned char* cost, int height, int width, int planes,
                                               int band_rows, int halo_rows, int dx, int dy, int small_jump,
                                               int large_jump, int is_first, unsigned short* sums) {
    const RowBands bands{height, band_rows, halo_rows};
    const int band = static_cast<int>(blockIdx.y);
    const PathStart start =
        path_start(bands, band, width, dx, dy, static_cast<int>(blockIdx.x * blockDim.y + threadIdx.y));
    if (!start.exists) return;
    PathCosts path(dynamic_shared<unsigned short>() + threadIdx.y * 2 * (planes + 2), planes,
                   static_cast<int>(threadIdx.x));
    int x = start.x, y = start.y;
    while (x >= 0 && x < width && y >= bands.first(band) && y < bands.last(band)) {
        const size_t pixel = (static_cast<size_t>(y) * width + x) * planes;
        const bool is_kept = y >= bands.keep_first(band) && y < bands.keep_last(band);
        path.advance(cost + pixel, small_jump, large_jump, [&](int plane, int step) {
            unsigned short& sum = sums[pixel + plane];
            if (is_kept) sum = static_cast<unsigned short>(is_first ? step : sum + step);
        });
        x += dx, y += dy;
    }
}

// A warp of a block (32, warps) takes a pixel: the plane of the least sum, and the margin to the next other.
extern "C" __global__ void select_planes(const unsigned char* cost, const unsigned short* sums, int pixels,
                                         int planes, float* index, float* margin) {
    const int pixel = static_cast<int>(blockIdx.x * blockDim.y + threadIdx.y),
              lane = static_cast<int>(threadIdx.x);
    if (pixel >= pixels) return;
    const size_t at = static_cast<size_t>(pixel) * planes;
    const auto total = [=](int plane) {
        return sums[at + plane] + 2 * kPaths * lesser(static_cast<int>(cost[at + plane]), kMaxCost);
    };
    unsigned first = ~0u;  // total and plane: the first of equals is the least
    for (int plane = lane; plane < planes; plane += kWarpSize) {
        const unsigned key = static_cast<unsigned>(total(plane)) << 16 | static_cast<unsigned>(plane);
        first = key < first ? key : first;
    }
    first = least_of_warp(first);
    const int best = static_cast<int>(first >> 16), plane = static_cast<int>(first & 0xffff);
    unsigned other = kBeyond;
    for (int i = lane; i < planes; i += kWarpSize)
        if (absolute(i - plane) > 1) other = lesser(static_cast<int>(other), total(i));
    other = least_of_warp(other);
    if (lane != 0) return;
    margin[pixel] = to_float(static_cast<int>(other) - best) / to_float(kWholeMargin);
    index[pixel] = plane == 0 || plane == planes - 1
                       ? to_float(plane)
                       : interpolated_plane(plane, total(plane - 1), best, total(plane + 1));
}

}  // namespace beltscape
