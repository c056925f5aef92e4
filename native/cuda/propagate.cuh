// Candidate propagation on a GPU: a block finds the candidates of a tile of pixels, a thread walks along a
// path of the selection among them, and a launch takes all paths of one direction, each pixel of which
// belongs to one of them. An inactive pixel has one candidate, as a block without an active pixel has on the
// CPU.
#pragma once

#include "cuda/aggregate.cuh"
#include "cuda/selection.cuh"
#include "cuda/sweep.cuh"
#include "selection/semi_global.hpp"

namespace beltscape {

// A tile's pixels and one more on each side.
inline constexpr int kSampledWidth = kTileWidth + 2, kSampled = kSampledWidth * (kTileHeight + 2);

// Whether any thread of a tile is active; flags has a place for each warp.
__device__ inline bool any_of_tile(bool active, int* flags) {
    const int thread = static_cast<int>(threadIdx.y * blockDim.x + threadIdx.x);
    const bool found = __any_sync(kWholeWarp, active);
    if (thread % kWarpSize == 0) flags[thread / kWarpSize] = found;
    __syncthreads();
    bool any_found = false;
    for (int warp = 0; warp < kTileThreads / kWarpSize; ++warp) any_found |= flags[warp] != 0;
    return any_found;
}

// The sums over the 3x3 samples about a pixel, whose upper left one is `first`, row by row as on the CPU.
__device__ inline WindowSums<float> window_sums(const float* grey, const float* core, int first) {
    WindowSums<float> rows[3];
    for (int row = 0; row < 3; ++row) {
        const float* const a = grey + first + row * kSampledWidth;
        const float* const i = core + first + row * kSampledWidth;
        rows[row] = {a[0] + a[1] + a[2], three_products(a[0], a[1], a[2], a[0], a[1], a[2]),
                     three_products(a[0], a[1], a[2], i[0], i[1], i[2])};
    }
    return {rows[0].aux + rows[1].aux + rows[2].aux,
            rows[0].aux_squared + rows[1].aux_squared + rows[2].aux_squared,
            rows[0].product + rows[1].product + rows[2].product};
}

__device__ inline CoreWindow<float> core_window_at(const float* core, int first, float floor) {
    float sum = 0, squares = 0;
    for (int i = 0; i < 9; ++i) {
        const float grey = core[first + i / 3 * kSampledWidth + i % 3];
        sum += grey, squares += grey * grey;
    }
    return core_window(sum, squares, floor);
}

// A tile's samples of one view with one offset's candidates s: grey levels, and whether they are seen.
__device__ inline void sample_tile(const Auxiliary& by, const float* s, int left, int top, int width,
                                   int height, float level, float tolerance, float* grey, float* seen) {
    for (int i = static_cast<int>(threadIdx.y * blockDim.x + threadIdx.x); i < kSampled; i += kTileThreads) {
        const int x = clamp(left - 1 + i % kSampledWidth, 0, width - 1),
                  y = clamp(top - 1 + i / kSampledWidth, 0, height - 1);
        const SampledPoint<float> point = sample_point(by.view, by.image, to_float(x), to_float(y), s[i]);
        grey[i] = bilinear(by.image, &point.spot.index, point.spot.u, point.spot.v) - level;
        seen[i] = unoccluded(by.buffer, &point.row, point.spot.u, point.inverse_depth, tolerance);
    }
}

// A pixel without a candidate has the slopes of its own surface.
__device__ inline void clear_candidates(const CandidatePlaces& places, const Candidate<float>& own) {
    for (int k = 0; k < places.count; ++k) {
        const size_t at = k * places.stride;
        places.s[at] = kNoCandidate, places.cost[at] = kNoCost;
        places.slope_u[at] = own.slope_u, places.slope_v[at] = own.slope_v;
    }
}

// Surface, core and active (height, width), offsets (offset_count, 2) of which the first is (0, 0), places
// (4, candidates, height, width): s, cost, slope_u, slope_v.
extern "C" __global__ void propagate_candidates(const float* s, const float* slope_u, const float* slope_v,
                                                const float* core, const float* level,
                                                const unsigned char* active, int width, int height,
                                                const float* views, const unsigned long long* images,
                                                const unsigned long long* buffers, const int* sizes,
                                                int view_count, const int* offsets, int offset_count,
                                                int candidates, float separation, const float* least_variance,
                                                float unseen_cost, float tolerance, float* places) {
    BELTSCAPE_SHARED(float, own_core, kSampled);
    BELTSCAPE_SHARED(float, given, kSampled);
    BELTSCAPE_SHARED(float, grey, kSampled);
    BELTSCAPE_SHARED(float, seen, kSampled);
    BELTSCAPE_SHARED(int, flags, kTileThreads / kWarpSize);
    const int left = static_cast<int>(blockIdx.x) * kTileWidth,
              top = static_cast<int>(blockIdx.y) * kTileHeight;
    const int x = grid_x(), y = grid_y(), thread = static_cast<int>(threadIdx.y * blockDim.x + threadIdx.x);
    const int first = static_cast<int>(threadIdx.y) * kSampledWidth + static_cast<int>(threadIdx.x);
    const bool exists = x < width && y < height;
    const size_t pixels = static_cast<size_t>(height) * width, pixel = static_cast<size_t>(y) * width + x;
    const bool is_active = exists && active[pixel];
    const Surface surface{s, slope_u, slope_v, width, height};
    const AuxiliaryTable table{views, images, buffers, sizes};
    for (int i = thread; i < kSampled; i += kTileThreads)
        own_core[i] = core[static_cast<size_t>(clamp(top - 1 + i / kSampledWidth, 0, height - 1)) * width +
                           clamp(left - 1 + i % kSampledWidth, 0, width - 1)] -
                      level[0];
    const bool any_active = any_of_tile(is_active, flags);
    const float floor = *least_variance;
    const CoreWindow<float> window = core_window_at(own_core, first, floor);
    const size_t field = candidates * pixels;
    float* const own = places + (exists ? pixel : 0);
    const CandidatePlaces kept{own, own + field, own + 2 * field, own + 3 * field, candidates, pixels};
    for (int number = 0; number < (any_active ? offset_count : 1); ++number) {
        const Offset offset{offsets[2 * number], offsets[2 * number + 1]};
        for (int i = thread; i < kSampled; i += kTileThreads)
            given[i] = shifted_candidate<float>(surface, offset, left - 1 + i % kSampledWidth,
                                                clamp(top - 1 + i / kSampledWidth, 0, height - 1))
                           .s;
        MultiviewCost<float> cost;
        for (int i = 0; i < view_count; ++i) {
            __syncthreads();  // all have read the samples before
            sample_tile(table[i], given, left, top, width, height, level[0], tolerance, grey, seen);
            __syncthreads();
            cost.add(dissimilarity(window_sums(grey, own_core, first), window, floor),
                     seen[first + kSampledWidth + 1]);
        }
        if (!exists) continue;
        const Candidate<float> candidate = shifted_candidate<float>(surface, offset, x, y);
        if (number == 0) clear_candidates(kept, candidate);
        insert_candidate<float>(kept, candidate, cost.cost(unseen_cost), separation,
                                finite(candidate.s) && (number == 0 || is_active));
    }
}

// A pixel's candidates, and the costs of a path up to each.
struct PathCandidates {
    float s[kMostCandidates] = {}, rise[kMostCandidates] = {}, toll[kMostCandidates] = {};
};

// Half of what the slopes explain of a step (dx, dy).
__device__ inline float half_rise(float slope_u, float slope_v, int dx, int dy) {
    const float half = 0.5f * to_float(dy == 0 ? dx : dy);
    if (dy == 0) return half * slope_u;
    if (dx == 0) return half * slope_v;
    return half * (dx == dy ? slope_v + slope_u : slope_v - slope_u);
}

// A thread takes a path in direction (dx, dy); blocks along y are bands. scores (candidates, height, width):
// the paths' costs so far.
extern "C" __global__ void propagate_direction(const float* places, const unsigned char* active, int width,
                                               int height, int candidates, int band_rows, int halo_rows,
                                               int dx, int dy, float small_jump, float large_jump,
                                               int is_first, float* scores) {
    const RowBands bands{height, band_rows, halo_rows};
    const int band = static_cast<int>(blockIdx.y);
    const PathStart start = path_start(bands, band, width, dx, dy, grid_x());
    if (!start.exists) return;
    const size_t pixels = static_cast<size_t>(height) * width, field = candidates * pixels;
    PathCandidates before, now;
    bool has_before = false;
    for (int x = start.x, y = start.y; x >= 0 && x < width && y >= bands.first(band) && y < bands.last(band);
         x += dx, y += dy, has_before = true) {
        const size_t pixel = static_cast<size_t>(y) * width + x;
        const float* const at = places + pixel;
        const int count = active[pixel] ? candidates : 1;
        const bool is_kept = y >= bands.keep_first(band) && y < bands.keep_last(band);
        for (int k = 0; k < candidates; ++k) {
            if (k < count)
                now.s[k] = at[k * pixels],
                now.rise[k] = half_rise(at[2 * field + k * pixels], at[3 * field + k * pixels], dx, dy);
            now.toll[k] = k == 0 ? 0.0f : kNoCost;
            if (!active[pixel]) continue;
            const float toll =
                has_before
                    ? least_path_cost(PreviousCandidates{before.s, before.rise, before.toll, candidates, 1},
                                      now.s[k], now.rise[k], Jumps{small_jump, large_jump})
                    : 0.0f;
            float& score = scores[k * pixels + pixel];
            if (is_kept) score = is_first ? toll : score + toll;
            now.toll[k] = at[field + k * pixels] + toll;
        }
        if (active[pixel]) level_out<float>(now.toll, candidates, 1);
        before = now;
    }
}

// A thread takes a pixel; all (height, width) but places and scores.
extern "C" __global__ void pick_candidates(const float* places, const float* scores,
                                           const unsigned char* active, int pixels, int candidates, float* s,
                                           float* slope_u, float* slope_v, float* cost, float* margin) {
    const int pixel = grid_x();
    if (pixel >= pixels) return;
    const size_t stride = static_cast<size_t>(pixels), field = candidates * stride;
    const float* const at = places + pixel;
    const int count = active[pixel] ? candidates : 1;
    const auto total = [=](int k) {
        const float own = at[field + k * stride];
        return active[pixel] ? own + 0.125f * scores[k * stride + pixel] : own;
    };
    float least = kInfinity, other = kInfinity;
    size_t best = 0;
    for (int k = 0; k < count; ++k)
        if (total(k) < least) least = total(k), best = k * stride;
    for (int k = 0; k < count; ++k)
        if (absolute(at[k * stride] - at[best]) > kApart) other = lesser(total(k), other);
    const bool found = at[best] < kNoCandidate;
    s[pixel] = found ? at[best] : kNotANumber, cost[pixel] = found ? at[field + best] : kNotANumber;
    margin[pixel] = found ? lesser(other - least, 1.0f) : kNotANumber;
    slope_u[pixel] = at[2 * field + best], slope_v[pixel] = at[3 * field + best];
}

}  // namespace beltscape
