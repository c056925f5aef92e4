// Candidate surfaces of given pixels and their photo-consistency on a GPU.
#pragma once

#include "cuda/device.hpp"
#include "selection/candidate_surfaces.hpp"
#include "selection/photo_consistency.hpp"

namespace beltscape {

inline constexpr int kMostSelectionViews = 8;

// The auxiliaries: their projections (count, kViewFloats), the addresses of their images and buffers, and the
// width and height of each.
struct AuxiliaryTable {
    const float* views;
    const unsigned long long *images, *buffers;
    const int* sizes;

    __device__ Auxiliary operator[](int i) const {
        return {view_at(views, i),
                {array_at<float>(images, i), sizes[2 * i], sizes[2 * i + 1]},
                array_at<float>(buffers, i)};
    }
};

// A thread takes a pixel of u and v (pixels); s, slope_u, slope_v and reliable (height, width), out (5,
// kSurfaces, pixels): s, slope_u, slope_v, distance, support.
extern "C" __global__ void surface_candidates(const float* s, const float* slope_u, const float* slope_v,
                                              const unsigned char* reliable, int width, int height,
                                              const float* u, const float* v, int pixels, int reach,
                                              float separation, float* out) {
    const int pixel = grid_x();
    if (pixel >= pixels) return;
    const CandidateSearch search{{s, slope_u, slope_v, width, height}, reliable, reach, separation};
    const size_t stride = static_cast<size_t>(pixels), field = kSurfaces * stride;
    find_candidates(search, to_int(u[pixel]), to_int(v[pixel]),
                    {out, out + field, out + 2 * field, out + 3 * field, out + 4 * field, stride},
                    static_cast<size_t>(pixel));
}

// A thread takes a pixel, a row of the grid a plane: s, slope_u, slope_v (rows, pixels), core and variance
// (height, width), gains the addresses of as many, out (kConsistencyRows, rows, pixels).
extern "C" __global__ void plane_consistency(const float* u, const float* v, int pixels, const float* s,
                                             const float* slope_u, const float* slope_v, int rows,
                                             const float* core, const float* variance, int width, int height,
                                             const float* views, const unsigned long long* images,
                                             const unsigned long long* buffers, const int* sizes,
                                             const unsigned long long* gains, int view_count, float tolerance,
                                             float* out) {
    const int pixel = grid_x(), row = grid_y();
    if (pixel >= pixels) return;
    const AuxiliaryTable table{views, images, buffers, sizes};
    Auxiliary auxiliaries[kMostSelectionViews];
    const float* gain_planes[kMostSelectionViews];
    float own_gains[kMostSelectionViews];
    for (int i = 0; i < view_count; ++i)
        auxiliaries[i] = table[i], gain_planes[i] = array_at<float>(gains, i);
    const PhotoConsistencyProblem problem{core,        variance,    width,      height,
                                          auxiliaries, gain_planes, view_count, tolerance};
    CoreCross<float> cross;
    cross.gains = own_gains;
    read_cross<float>(problem, u + pixel, v + pixel, 1, cross);
    const size_t at = static_cast<size_t>(row) * pixels + pixel;
    photo_consistency_lanes<float>(problem, cross, {s + at, slope_u + at, slope_v + at}, 1, out + at,
                                   static_cast<size_t>(rows) * pixels);
}

}  // namespace beltscape
