// Splines and gathering on a GPU.
#pragma once

#include "cuda/device.hpp"
#include "images/gathering.hpp"
#include "images/prefilter.hpp"

namespace beltscape {

// A thread filters a row of an image (height, width) to `out`, multiplied by `gain`.
extern "C" __global__ void filter_rows(const float* image, int width, int height, float gain, float* out) {
    const int row = grid_x();
    if (row >= height) return;
    const size_t at = static_cast<size_t>(row) * width;
    prefilter_rows<1>(image + at, width, gain, out + at);
}

// A thread filters a column in place.
extern "C" __global__ void filter_columns(float* image, int width, int height) {
    const int column = grid_x();
    if (column < width) prefilter_columns<float>(image + column, height, static_cast<size_t>(width), 1);
}

// A thread takes a pixel, a row of the grid a plane and an offset: planes holds the addresses of (height,
// width), u and v (pixels), offsets (offset_count, 2), out (planes, offset_count, pixels).
extern "C" __global__ void gather_values(const unsigned long long* planes, int width, int height,
                                         const float* u, const float* v, int pixels, const int* offsets,
                                         int offset_count, float* out) {
    const int pixel = grid_x(), row = grid_y();
    if (pixel >= pixels) return;
    const int* const offset = offsets + 2 * (row % offset_count);
    neighbours<float>(array_at<float>(planes, row / offset_count), width, height, u + pixel, v + pixel,
                      offset[0], offset[1], 1, out + static_cast<size_t>(row) * pixels + pixel);
}

}  // namespace beltscape
