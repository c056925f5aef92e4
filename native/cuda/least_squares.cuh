// The normal equations of a surface and the fit of planes on a GPU: a thread takes a pixel in every kernel.
// Padded planes have a margin of repeated columns on either side; `at` is a thread's own place there and
// `inner` that of the pixel whose value it repeats.
#pragma once

#include "cuda/device.hpp"
#include "images/warp.hpp"
#include "least_squares/local_fit.hpp"
#include "least_squares/normal_equations.hpp"

namespace beltscape {

inline constexpr int kMostFitViews = 8;        // of one surface's normal equations
inline constexpr int kFitWindowsBytes = 4096;  // that hold FitWindows
static_assert(sizeof(FitWindows) <= kFitWindowsBytes);

// A thread's place in padded planes (height, width + 2 margin).
struct PaddedPlace {
    int x, y;  // the pixel: the nearest one in the margins
    size_t at, inner;
    bool exists;
};

__device__ inline PaddedPlace padded_place(int width, int height, int margin) {
    const int column = grid_x(), y = grid_y(), stride = width + 2 * margin;
    const int x = clamp(column - margin, 0, width - 1);
    const size_t row = static_cast<size_t>(y) * stride;
    return {x, y, row + column, row + margin + x, column < stride && y < height};
}

// The warp of one view (height, width) and its derivative by s.
extern "C" __global__ void warp_view(const float* views, int i, const float* coefficients, int image_width,
                                     int image_height, const float* s, int width, int height, float* value,
                                     float* slope) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const size_t row = static_cast<size_t>(y) * width;
    warp_row<float>(view_at(views, i), {coefficients, image_width, image_height}, s + row, y, x, x + 1,
                    value + row, slope + row);
}

// The core without NaN, and where it is; padded.
extern "C" __global__ void pad_core(const float* core, int width, int height, int margin, float* grey,
                                    float* there) {
    const PaddedPlace place = padded_place(width, height, margin);
    if (!place.exists) return;
    core_row<float>(core + static_cast<size_t>(place.y) * width + place.x, 1, grey + place.at,
                    there + place.at);
}

// A view's warp, completed by the core; padded. value and slope come from `warp_view`.
extern "C" __global__ void pad_view(const float* value, const float* slope, const float* grey,
                                    const float* there, int width, int height, int margin, float* out_value,
                                    float* out_slope) {
    const PaddedPlace place = padded_place(width, height, margin);
    if (!place.exists) return;
    const size_t from = static_cast<size_t>(place.y) * width + place.x;
    out_value[place.at] = value[from], out_slope[place.at] = slope[from];
    complete_row<float>(grey + place.at, there + place.at, 1, out_value + place.at, out_slope + place.at);
}

// Sums of values and of their squares over 2 radius + 1 rows of a padded plane, in the order of the rows;
// beyond the image its outermost rows are repeated.
extern "C" __global__ void sum_columns(const float* plane, int stride, int height, int radius, float* sums,
                                       float* squares) {
    const int x = grid_x(), y = grid_y();
    if (x >= stride || y >= height) return;
    float sum = 0, square = 0;
    for (int i = -radius; i <= radius; ++i) {
        const float value = plane[static_cast<size_t>(clamp(y + i, 0, height - 1)) * stride + x];
        sum += value, square = multiply_add(value, value, square);
    }
    const size_t at = static_cast<size_t>(y) * stride + x;
    sums[at] = sum, squares[at] = square;
}

// The core normalised in windows; padded. The floor is read from memory: it differs from frame to frame, and
// a recorded graph keeps its arguments.
extern "C" __global__ void normalise_core(int window, const float* floor, const float* grey,
                                          const float* there_sums, const float* sums, const float* squares,
                                          int width, int height, int margin, float* value, float* scale,
                                          float* part) {
    const PaddedPlace place = padded_place(width, height, margin);
    if (!place.exists) return;
    const NormalSettings settings{window, 0, *floor, 0, 0, 0};
    part_row<float>(there_sums + place.inner, window, 1, part + place.at);
    core_normals_row<float>(settings, grey + place.inner, sums + place.inner, squares + place.inner, 1,
                            {value + place.at, scale + place.at, part + place.at, nullptr});
}

// A view's residuals (4, height, width + 2 margin): r, slope, weight and misfit.
extern "C" __global__ void view_residuals(int window, const float* floor, const float* noise_variance,
                                          const float* model_variance, float* core_value, float* core_scale,
                                          float* part, const float* there, const float* grey,
                                          const float* slope, const float* sums, const float* squares,
                                          int width, int height, int margin, float* out) {
    const PaddedPlace place = padded_place(width, height, margin);
    if (!place.exists) return;
    const NormalSettings settings{window, 0, *floor, *noise_variance, *model_variance, 0};
    const size_t plane = static_cast<size_t>(height) * (width + 2 * margin);
    float* const own = out + place.at;
    residuals_row<float>(settings,
                         {core_value + place.at, core_scale + place.at, part + place.at, there + place.inner},
                         grey + place.inner, slope + place.inner, sums + place.inner, squares + place.inner,
                         1, {own, own + plane, own + 2 * plane, own + 3 * plane});
}

// The sum over views; residuals (views, 4, ...) as above, misfits (views, height, width + 2 margin) sums of
// their columns.
extern "C" __global__ void sum_equations(int residual_window, float gate, float* residuals, float* misfits,
                                         int view_count, const float* there_sums, int width, int height,
                                         int margin, float* information, float* pull, unsigned char* used) {
    const int x = grid_x(), y = grid_y(), stride = width + 2 * margin;
    if (x >= width || y >= height) return;
    const size_t plane = static_cast<size_t>(height) * stride;
    const size_t inner = static_cast<size_t>(y) * stride + margin + x;
    Residuals views[kMostFitViews];
    for (int i = 0; i < view_count; ++i) {
        float* const own = residuals + 4 * i * plane + inner;
        views[i] = {own, own + plane, own + 2 * plane, misfits + i * plane + inner};
    }
    float part = 0;
    part_row<float>(there_sums + inner, residual_window, 1, &part);
    const size_t at = static_cast<size_t>(y) * width + x;
    equations_row<float>({0, residual_window, 0, 0, 0, gate}, views, view_count, &part, 1,
                         {information + at, pull + at, used + at});
}

// The windows of a fit from their radii (count), taps and reaches (count, kMaxRadius + 1); one thread.
extern "C" __global__ void make_windows(const int* radii, const double* taps, const int* reach, int count,
                                        const double* tolerance_and_fourth_power, float confidence_width,
                                        float prior_information, float flatten, unsigned char* out) {
    FitWindows& windows = *reinterpret_cast<FitWindows*>(out);
    const double tolerance = tolerance_and_fourth_power[0], fourth_power = tolerance_and_fourth_power[1];
    windows.zero = 0, windows.count = count, windows.tolerance = static_cast<float>(tolerance);
    windows.settings = {tolerance, confidence_width, prior_information, flatten};
    for (int i = 0; i <= kMaxRadius; ++i) windows.distance[i] = to_float(i);
    for (int k = 0; k < count; ++k)
        fill_window(windows.window[k], radii[k], taps + k * (kMaxRadius + 1), reach + k * (kMaxRadius + 1),
                    fourth_power);
}

// What a fit reads (3, height + 2 margin, width + 2 margin): s, information, pull; 0 beyond the image.
extern "C" __global__ void make_field(const float* information, const float* pull, const float* s,
                                      float prior_information, int width, int height, int margin,
                                      float* out) {
    const int column = grid_x(), row = grid_y(), stride = width + 2 * margin, rows = height + 2 * margin;
    if (column >= stride || row >= rows) return;
    const int x = column - margin, y = row - margin;
    const size_t plane = static_cast<size_t>(rows) * stride, at = static_cast<size_t>(row) * stride + column;
    out[at] = 0, out[plane + at] = 0, out[2 * plane + at] = 0;
    if (x < 0 || x >= width || y < 0 || y >= height) return;
    const size_t from = static_cast<size_t>(y) * width + x;
    field_row<float>(information + from, pull + from, s + from, prior_information, 1, out + plane + at,
                     out + 2 * plane + at, out + at);
}

// The planes; floats (5, height, width): s, slopes, variance and disagreement.
extern "C" __global__ void fit_planes(const unsigned char* windows, const float* field, const float* s,
                                      const float* slope_u, const float* slope_v, int width, int height,
                                      int margin, float* floats, unsigned char* window) {
    const int x = grid_x(), y = grid_y(), stride = width + 2 * margin;
    if (x >= width || y >= height) return;
    const size_t plane = static_cast<size_t>(height + 2 * margin) * stride,
                 pixels = static_cast<size_t>(height) * width, row = static_cast<size_t>(y) * width;
    const float* const own = field + static_cast<size_t>(y + margin) * stride + margin;
    float* const out = floats + row;
    fit_row<float>({own, own + plane, own + 2 * plane, stride}, *reinterpret_cast<const FitWindows*>(windows),
                   {s + row, slope_u + row, slope_v + row, out, out + pixels, out + 2 * pixels,
                    out + 3 * pixels, out + 4 * pixels, window + row},
                   x, x + 1);
}

}  // namespace beltscape
