// Buffers of inverse depth and visibility on a GPU: a thread takes a pixel.
#pragma once

#include "cuda/device.hpp"
#include "geometry/visibility.hpp"

namespace beltscape {

extern "C" __global__ void fill_floats(float* out, int count, float value) {
    const int i = grid_x();
    if (i < count) out[i] = value;
}

// Raises the corners (image_height + 1, image_width + 1) of a view to the inverse depth s (height, width).
// The largest of whole numbers does not depend on the threads' order.
extern "C" __global__ void splat_corners(const float* views, int i, const float* s, int width, int height,
                                         int image_width, int image_height, float* corners) {
    const int x = grid_x(), y = grid_y();
    if (x < width && y < height)
        splat_row<float>(view_at(views, i), s + static_cast<size_t>(y) * width, y, x, x + 1, image_width,
                         image_height, corners);
}

// The buffer (height, width) of a view from its corners.
extern "C" __global__ void spread_corners(const float* corners, int width, int height, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x < width && y < height)
        spread_row<float>(corners, y, x, x + 1, width, out + static_cast<size_t>(y) * width);
}

// Which pixels of s (height, width) a view sees, whose buffer is (image_height, image_width).
extern "C" __global__ void visible_pixels(const float* views, const float* s, int width, int height,
                                          const float* buffer, int image_width, int image_height,
                                          float tolerance, unsigned char* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const size_t row = static_cast<size_t>(y) * width;
    visible_row<float>(view_at(views, 0), s + row, y, x, x + 1, image_width, image_height, buffer, tolerance,
                       out + row);
}

}  // namespace beltscape
