// Windows over planes on a GPU, a thread for each pixel: means, extremes, the median, the distance to the
// nearest marked pixel, and changes of resolution. They give what OpenCV's functions of the same purpose do.
#pragma once

#include "cuda/device.hpp"

namespace beltscape {

// A sum with what its rounding lost (Knuth's TwoSum): as precise as one in double, which is slow on many
// GPUs.
struct PreciseSum {
    float sum = 0, rest = 0;

    __device__ void add(float value) {
        const float total = sum + value, part = total - sum;
        rest += (sum - (total - part)) + (value - part);
        sum = total;
    }
};

// The index beyond an image's end: the last pixel's, or mirrored without repeating it.
__device__ inline int beyond_end(int i, int size, int is_repeated) {
    if (is_repeated || size == 1) return clamp(i, 0, size - 1);
    const int period = 2 * (size - 1), at = absolute(i) % period;
    return at < size ? at : period - at;
}

// Sums over 2 radius + 1 columns of plane (height, width): sums (2, height, width), the sum and its rest.
extern "C" __global__ void sum_window_rows(const float* plane, int width, int height, int radius,
                                           int is_repeated, float* sums) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const float* const row = plane + static_cast<size_t>(y) * width;
    PreciseSum total;
    for (int i = -radius; i <= radius; ++i) total.add(row[beyond_end(x + i, width, is_repeated)]);
    const size_t at = static_cast<size_t>(y) * width + x;
    sums[at] = total.sum, sums[at + static_cast<size_t>(height) * width] = total.rest;
}

// A pixel's window of 2 radius + 1 rows, of which each has a sum over `columns` pixels.
struct WindowColumn {
    int width, height, x, y, radius, is_repeated, columns;

    // The mean from sums (2, height, width) of rows and their rests.
    __device__ float mean(const float* sums) const {
        const float* const rests = sums + static_cast<size_t>(height) * width;
        PreciseSum total;
        for (int i = -radius; i <= radius; ++i) {
            const size_t at = static_cast<size_t>(beyond_end(y + i, height, is_repeated)) * width + x;
            total.add(sums[at]);
            total.rest += rests[at];
        }
        const double scale = 1.0 / (columns * (2 * radius + 1));
        return static_cast<float>((static_cast<double>(total.sum) + total.rest) * scale);
    }
};

// Means over 2 radius + 1 rows of such sums, each of `columns` pixels.
extern "C" __global__ void average_window_columns(const float* sums, int width, int height, int radius,
                                                  int is_repeated, int columns, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const WindowColumn column = {width, height, x, y, radius, is_repeated, columns};
    out[static_cast<size_t>(y) * width + x] = column.mean(sums);
}

// Sums over 2 radius + 1 columns of plane (height, width) and of its squares: sums (4, height, width), each
// sum and its rest.
extern "C" __global__ void sum_moment_rows(const float* plane, int width, int height, int radius,
                                           int is_repeated, float* sums) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const float* const row = plane + static_cast<size_t>(y) * width;
    PreciseSum total, squares;
    for (int i = -radius; i <= radius; ++i) {
        const float value = row[beyond_end(x + i, width, is_repeated)];
        total.add(value), squares.add(value * value);
    }
    const size_t at = static_cast<size_t>(y) * width + x, size = static_cast<size_t>(height) * width;
    sums[at] = total.sum, sums[at + size] = total.rest;
    sums[at + 2 * size] = squares.sum, sums[at + 3 * size] = squares.rest;
}

// Means and variances over 2 radius + 1 rows of such sums, each of `columns` pixels: the same bytes as from
// means of the plane and of its squares.
extern "C" __global__ void average_moment_columns(const float* sums, int width, int height, int radius,
                                                  int is_repeated, int columns, float* means,
                                                  float* variances) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const WindowColumn column = {width, height, x, y, radius, is_repeated, columns};
    const float mean = column.mean(sums),
                variance = column.mean(sums + 2 * static_cast<size_t>(height) * width) - mean * mean;
    const size_t at = static_cast<size_t>(y) * width + x;
    means[at] = mean, variances[at] = variance >= 0 || variance != variance ? variance : 0.0f;
}

// The largest (or smallest) of 2 radius + 1 values `step` apart along a line of `count`, from `values` on; no
// value lies beyond its ends.
__device__ inline float extreme_of_line(const float* values, int at, int count, size_t step, int radius,
                                        int is_largest) {
    float found = values[static_cast<size_t>(at) * step];
    for (int i = greater(0, at - radius); i <= lesser(count - 1, at + radius); ++i) {
        const float value = values[static_cast<size_t>(i) * step];
        found = (is_largest ? value > found : value < found) ? value : found;
    }
    return found;
}

extern "C" __global__ void window_row_extremes(const float* plane, int width, int height, int radius,
                                               int is_largest, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const size_t row = static_cast<size_t>(y) * width;
    out[row + x] = extreme_of_line(plane + row, x, width, 1, radius, is_largest);
}

extern "C" __global__ void window_column_extremes(const float* plane, int width, int height, int radius,
                                                  int is_largest, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    out[static_cast<size_t>(y) * width + x] =
        extreme_of_line(plane + x, y, height, static_cast<size_t>(width), radius, is_largest);
}

inline constexpr int kMedianSide = 5, kMedianValues = kMedianSide * kMedianSide;

// The median of 5 x 5 pixels; the outermost ones are repeated.
extern "C" __global__ void median_of_window(const float* plane, int width, int height, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    float values[kMedianValues];
    for (int i = 0; i < kMedianValues; ++i) {
        const int column = clamp(x + i % kMedianSide - kMedianSide / 2, 0, width - 1),
                  row = clamp(y + i / kMedianSide - kMedianSide / 2, 0, height - 1);
        values[i] = plane[static_cast<size_t>(row) * width + column];
    }
    for (int i = 0; i <= kMedianValues / 2; ++i)  // the least of the rest comes to place i
        for (int j = i + 1; j < kMedianValues; ++j) {
            const float a = values[i], b = values[j];
            values[i] = b < a ? b : a, values[j] = b < a ? a : b;
        }
    out[static_cast<size_t>(y) * width + x] = values[kMedianValues / 2];
}

// The distance along its row to the nearest pixel of the mask; most + 1 where there is none within `most`.
extern "C" __global__ void distance_along_row(const unsigned char* mask, int width, int height, int most,
                                              int* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const unsigned char* const row = mask + static_cast<size_t>(y) * width;
    int by = 0;
    while (by <= most && !(x >= by && row[x - by]) && !(x + by < width && row[x + by])) ++by;
    out[static_cast<size_t>(y) * width + x] = by;
}

// The length of the shortest path of steps to a neighbour, along a diagonal and of a knight: by that OpenCV
// approximates the distance (Borgefors, CVGIP 34(3), 1986, doi:10.1016/S0734-189X(86)80047-0).
__device__ inline float path_length(int a, int b) {
    const int far = greater(a, b), near = lesser(a, b);
    constexpr float kDiagonal = 1.4f, kKnight = 2.1969f;
    return 2 * near <= far ? to_float(near) * kKnight + to_float(far - 2 * near)
                           : to_float(far - near) * kKnight + to_float(2 * near - far) * kDiagonal;
}

// The distance to the nearest pixel of the mask, at most `most`.
extern "C" __global__ void distance_to_mask(const int* along_row, int width, int height, int most,
                                            float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    float least = to_float(most);
    for (int by = 0; to_float(by) < least; ++by)
        for (int row = y - by; row <= y + by; row += greater(1, 2 * by)) {
            if (row < 0 || row >= height) continue;
            const int along = along_row[static_cast<size_t>(row) * width + x];
            if (along <= most) least = lesser(least, path_length(along, by));
        }
    out[static_cast<size_t>(y) * width + x] = least;
}

// The pixels out of `from` that pixel i of `size` covers, and how much of it each covers: as OpenCV computes
// and rounds it (INTER_AREA).
struct Cover {
    double first, last, width;
    int begin, end;  // of the pixels that are covered as a whole

    __device__ Cover(int i, int from, int size) {
        const double scale = 1.0 / (static_cast<double>(size) / from);
        first = i * scale, last = first + scale;
        width = scale < from - first ? scale : from - first;
        const int above = static_cast<int>(first);
        begin = above < first ? above + 1 : above;
        end = lesser(static_cast<int>(last), from - 1);
        begin = lesser(begin, end);
    }
    // Calls take(pixel, share) in the order of the pixels.
    template <class Take>
    __device__ void for_each(const Take& take) const {
        constexpr double kLeast = 1e-3;
        if (begin - first > kLeast) take(begin - 1, static_cast<float>((begin - first) / width));
        for (int i = begin; i < end; ++i) take(i, static_cast<float>(1.0 / width));
        const double rest = last - end, most = rest < 1 ? rest : 1;
        if (rest > kLeast) take(end, static_cast<float>((most < width ? most : width) / width));
    }
};

// Means of a plane (rows, columns) over the pixels of a smaller one (height, width).
extern "C" __global__ void average_areas(const float* plane, int columns, int rows, int width, int height,
                                         float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    float sum = 0;
    if (columns % width == 0 && rows % height == 0) {  // whole blocks are added up first
        const int across = columns / width, down = rows / height;
        for (int i = 0; i < down; ++i)
            for (int j = 0; j < across; ++j)
                sum += plane[static_cast<size_t>(y * down + i) * columns + x * across + j];
        out[static_cast<size_t>(y) * width + x] = sum * (1.0f / to_float(across * down));
        return;
    }
    const Cover across(x, columns, width), down(y, rows, height);
    down.for_each([&](int row, float of_row) {
        float part = 0;
        across.for_each([&](int column, float of_column) {
            part += plane[static_cast<size_t>(row) * columns + column] * of_column;
        });
        sum += of_row * part;
    });
    out[static_cast<size_t>(y) * width + x] = sum;
}

// Means of whole blocks of side x side pixels.
extern "C" __global__ void average_blocks(const float* plane, int columns, int side, int width, int height,
                                          float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    float sum = 0;
    for (int row = y * side; row < (y + 1) * side; ++row)
        for (int column = x * side; column < (x + 1) * side; ++column)
            sum += plane[static_cast<size_t>(row) * columns + column];
    out[static_cast<size_t>(y) * width + x] = sum / to_float(side * side);
}

// Every value repeated over a block of side x side pixels; the last ones go on to the edges.
extern "C" __global__ void repeat_blocks(const float* plane, int columns, int rows, int side, int width,
                                         int height, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    out[static_cast<size_t>(y) * width + x] =
        plane[static_cast<size_t>(lesser(y / side, rows - 1)) * columns + lesser(x / side, columns - 1)];
}

// Every step-th value of every step-th row, from `first` on in both.
extern "C" __global__ void subsample_plane(const float* plane, int columns, int first, int step, int width,
                                           int height, float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    out[static_cast<size_t>(y) * width + x] =
        plane[static_cast<size_t>(first + y * step) * columns + first + x * step];
}

// The pixels of a smaller line between which pixel i lies, and the share of the second.
struct Between {
    int first, second;
    float share;

    __device__ Between(int i, int from, int size) {
        const float at = static_cast<float>((i + 0.5) * (static_cast<double>(from) / size) - 0.5);
        const int below = floor_int(at);
        share = below < 0 || below >= from - 1 ? 0.0f : at - to_float(below);
        first = clamp(below, 0, from - 1), second = lesser(from - 1, first + 1);
    }
};

// A plane (rows, columns) interpolated linearly to a larger one (height, width).
extern "C" __global__ void interpolate_plane(const float* plane, int columns, int rows, int width, int height,
                                             float* out) {
    const int x = grid_x(), y = grid_y();
    if (x >= width || y >= height) return;
    const Between across(x, columns, width), down(y, rows, height);
    const auto along = [&](int row) {
        const float* const values = plane + static_cast<size_t>(row) * columns;
        return values[across.first] * (1 - across.share) + values[across.second] * across.share;
    };
    out[static_cast<size_t>(y) * width + x] =
        along(down.first) * (1 - down.share) + along(down.second) * down.share;
}

}  // namespace beltscape
