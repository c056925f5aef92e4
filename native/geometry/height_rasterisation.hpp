// Orthographic projection of a depth map's triangles, which kernels/geometry.py defines.
// The mesh is not stored: two rows of points at a time are connected square by square, and each triangle
// raises the nodes below it. For the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "array.hpp"

namespace beltscape {

inline constexpr double kEdge = 1e-9;  // kernels/geometry.py EDGE

struct RasterisationInput {
    Grid<const float> depth, sigma;
    Grid<const bool> use;
    Array<const double, 3, 4> grid_from_pixel;
    float step;

    void fields(const auto& read) {
        read("depth", depth), read("sigma", sigma), read("use", use);
        read("grid_from_pixel", grid_from_pixel), read("step", step);
    }
};

// The points of one row of pixels.
struct PointRow {
    explicit PointRow(std::size_t width)
        : x(width),
          y(width),
          z(width),
          variance(width),
          left(width),
          right(width),
          top(width),
          bottom(width),
          good(width) {}

    const float* depth = nullptr;
    std::vector<double> x, y, z, variance;
    std::vector<int> left, right, top, bottom;  // first and last node not before and not after x and y
    std::vector<std::uint8_t> good;
};

// First whole number not below x, in 0 ... end; last one not above x, in -1 ... end - 1. NaN gives any of
// them.
inline int node_from(double x, int end) {
    const double node = std::ceil(x);
    return static_cast<int>(node > 0 ? (node < end ? node : end) : 0);
}
inline int node_to(double x, int end) {
    const double node = std::floor(x);
    return static_cast<int>(node > -1 ? (node < end - 1 ? node : end - 1) : -1);
}

// The first nodes not before, and the last ones not after, of `count` points.
inline void list_nodes(const double* x, int count, int end, int* from, int* to) {
#pragma omp simd
    for (int i = 0; i < count; ++i) from[i] = node_from(x[i], end), to[i] = node_to(x[i], end);
}

// The points of row v over a grid (rows, columns).
inline void place_row(const RasterisationInput& in, int v, int columns, int rows, PointRow& row) {
    const std::size_t at = static_cast<std::size_t>(v) * in.depth.shape[1];
    const double* const m = in.grid_from_pixel.data;
    const double x0 = m[1] * v + m[2], y0 = m[5] * v + m[6], z0 = m[9] * v + m[10];
    const float* const depths = row.depth = in.depth.data + at;
    const float* const sigmas = in.sigma.data + at;
    const bool* const use = in.use.data + at;
    const int width = in.depth.width();
    // in loops that the compiler turns into vectors: bytes, as in `good`, could be any of the other values
    double *const xs = row.x.data(), *const ys = row.y.data(), *const zs = row.z.data();
    double* const variances = row.variance.data();
#pragma omp simd
    for (int u = 0; u < width; ++u) {
        const double depth = depths[u], sigma = sigmas[u];
        xs[u] = (m[0] * u + x0) * depth + m[3];
        ys[u] = (m[4] * u + y0) * depth + m[7];
        zs[u] = (m[8] * u + z0) * depth + m[11];
        variances[u] = sigma * sigma;
    }
    list_nodes(xs, width, columns, row.left.data(), row.right.data());
    list_nodes(ys, width, rows, row.top.data(), row.bottom.data());
    std::uint8_t* const good = row.good.data();
#pragma omp simd
    for (int u = 0; u < width; ++u) {
        // a sum of products with 0 is 0 where all are finite
        const double finite = xs[u] * 0 + ys[u] * 0 + zs[u] * 0 + variances[u] * 0;
        good[u] = static_cast<std::uint8_t>(use[u] & (finite == 0));
    }
}

// Grids (rows, columns) of the highest values so far; -inf where there is none.
struct TopViewOutput {
    double *height, *variance;
    int columns;

    void raise(int u, int v, double z, double other) const {
        const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(v) * columns + u;
        if (z > height[at])
            height[at] = z, variance[at] = other;
        else if (z == height[at] && other > variance[at])
            variance[at] = other;
    }
};

// One point of a row.
struct Corner {
    const PointRow& row;
    std::size_t i;
};

inline void draw_triangle(Corner a, Corner b, Corner c, const TopViewOutput& out) {
    const auto least = [&](auto of) {
        return std::min({(a.row.*of)[a.i], (b.row.*of)[b.i], (c.row.*of)[c.i]});
    };
    const auto most = [&](auto of) {
        return std::max({(a.row.*of)[a.i], (b.row.*of)[b.i], (c.row.*of)[c.i]});
    };
    const int left = least(&PointRow::left), right = most(&PointRow::right);
    const int top = least(&PointRow::top), bottom = most(&PointRow::bottom);
    if (left > right || top > bottom) return;
    const double xa = a.row.x[a.i], ya = a.row.y[a.i], za = a.row.z[a.i], oa = a.row.variance[a.i];
    const double x1 = b.row.x[b.i] - xa, y1 = b.row.y[b.i] - ya, x2 = c.row.x[c.i] - xa,
                 y2 = c.row.y[c.i] - ya;
    const double z1 = b.row.z[b.i] - za, z2 = c.row.z[c.i] - za;
    const double o1 = b.row.variance[b.i] - oa, o2 = c.row.variance[c.i] - oa;
    const double area = x1 * y2 - x2 * y1;
    for (int v = top; v <= bottom; ++v) {
        for (int u = left; u <= right; ++u) {
            const double first = ((u - xa) * y2 - x2 * (v - ya)) / area;  // not finite where there is no area
            const double second = (x1 * (v - ya) - (u - xa) * y1) / area;
            if (first >= -kEdge && second >= -kEdge && first + second <= 1 + kEdge)
                out.raise(u, v, za + first * z1 + second * z2, oa + first * o1 + second * o2);
        }
    }
}

// The triangles between two rows of points.
inline void draw_squares(const PointRow& upper, const PointRow& lower, int width, float step,
                         const TopViewOutput& out) {
    const auto joined = [&](Corner a, Corner b) {
        return a.row.good[a.i] && b.row.good[b.i] && std::abs(a.row.depth[a.i] - b.row.depth[b.i]) <= step;
    };
    for (std::size_t i = 0; i + 1 < static_cast<std::size_t>(width); ++i) {
        const Corner a{upper, i}, b{upper, i + 1}, c{lower, i}, d{lower, i + 1};
        const bool above = joined(a, b), below = joined(c, d), before = joined(a, c), after = joined(b, d);
        if (joined(b, c)) {
            if (above && before) draw_triangle(a, b, c, out);
            if (below && after) draw_triangle(b, d, c, out);
        } else if (joined(a, d)) {
            if (above && after) draw_triangle(a, b, d, out);
            if (below && before) draw_triangle(a, d, c, out);
        }
    }
}

inline void rasterise_heights(const RasterisationInput& in, std::size_t /* runs on one thread */,
                              Grid<double> height, Grid<double> variance) {
    constexpr double kNothing = -std::numeric_limits<double>::infinity();
    const std::size_t nodes = height.shape[0] * height.shape[1];
    std::fill_n(height.data, nodes, kNothing);
    std::fill_n(variance.data, nodes, kNothing);
    const int rows = height.height(), columns = height.width(), width = in.depth.width();
    PointRow upper(in.depth.shape[1]), lower(in.depth.shape[1]);
    place_row(in, 0, columns, rows, upper);
    for (int v = 1; v < in.depth.height(); ++v) {
        place_row(in, v, columns, rows, lower);
        draw_squares(upper, lower, width, in.step, {height.data, variance.data, columns});
        std::swap(upper, lower);
    }
    for (std::size_t i = 0; i < nodes; ++i)
        if (height[i] == kNothing)
            height[i] = variance[i] = std::numeric_limits<double>::quiet_NaN();
        else
            height[i] += 0.0;  // -0 and 0 are equally high: 0
}

}  // namespace beltscape
