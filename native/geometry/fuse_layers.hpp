// Fusion of layers of one surface (kernels/geometry.py). Sums run in the layers' order, in float32 as the
// reference. For the CPU alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

struct LayersInput {
    Stack<const float> height, sigma, noise;
    float rank, outlier, tolerance;

    void fields(const auto& read) {
        read("height", height), read("sigma", sigma), read("noise", noise);
        read("rank", rank), read("outlier", outlier), read("tolerance", tolerance);
    }
};

inline constexpr float kLeastLayerSigma = 1e-4f, kLeastFreedom = 1e-6f;  // kernels/geometry.py

inline float layer_weight(float sigma) {
    const float floored = std::max(sigma, kLeastLayerSigma);
    return 1.0f / (floored * floored);
}

// The weighted quantile of each cell of a row, always one of its values.
inline void fused_medians(const LayersInput& in, std::size_t row, float* to) {
    const std::size_t layers = in.height.shape[0], width = in.height.shape[2];
    const std::size_t plane = in.height.shape[1] * width;
    struct Ranked {
        float height, weight;
    };
    std::vector<Ranked> ranked(layers);
    for (std::size_t u = 0; u < width; ++u) {
        std::size_t number = 0;
        for (std::size_t k = 0; k < layers; ++k) {
            const std::size_t at = k * plane + row * width + u;
            if (!std::isfinite(in.height[at])) continue;
            const Ranked one{in.height[at], layer_weight(in.sigma[at])};
            std::size_t place = number++;
            for (; place > 0 && ranked[place - 1].height > one.height; --place)
                ranked[place] = ranked[place - 1];
            ranked[place] = one;
        }
        float all = 0.0f, reached = 0.0f;
        for (std::size_t k = 0; k < number; ++k) all += ranked[k].weight;
        to[u] = std::numeric_limits<float>::quiet_NaN();
        for (std::size_t k = 0; k < number; ++k) {
            reached += ranked[k].weight;
            to[u] = ranked[k].height;
            if (reached >= in.rank * all) break;
        }
    }
}

// The rise of the surface per cell; 0 where it is unknown.
inline float fused_slope(const float* middle, std::size_t height, std::size_t width, std::size_t v,
                         std::size_t u) {
    if (height < 2 || width < 2) return 0.0f;
    const auto along = [](const float* at, std::size_t i, std::size_t count, std::size_t stride) {
        if (i == 0) return at[stride] - at[0];
        if (i + 1 == count) return at[0] - *(at - stride);
        return (at[stride] - *(at - stride)) / 2.0f;
    };
    const float* const at = middle + v * width + u;
    const float slope = std::hypot(along(at, v, height, width), along(at, u, width, 1));
    return std::isfinite(slope) ? slope : 0.0f;
}

struct FusedCell {
    float kept = 0, mean = 0, own = 0, shared = 0, squares = 0;
    std::size_t agreeing = 0, outliers = 0;
    bool known = false;
};

// height, sigma, noise: (rows, columns); known: 1 where any layer measured; sums: (rows, 5), see the
// reference.
inline void fuse_layers(const LayersInput& in, std::size_t threads, Grid<float> height, Grid<float> sigma,
                        Grid<float> noise, Grid<std::uint8_t> known, Grid<double> sums) {
    const std::size_t layers = in.height.shape[0], rows = in.height.shape[1], width = in.height.shape[2];
    const std::size_t plane = rows * width;
    std::vector<float> middle(plane);
    const int rows_per_job = std::max(1, (1 << 14) / static_cast<int>(std::max<std::size_t>(width, 1)));
    for_bands(0, static_cast<int>(rows), rows_per_job, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v)
            fused_medians(in, static_cast<std::size_t>(v),
                          middle.data() + static_cast<std::size_t>(v) * width);
    });
    for_bands(0, static_cast<int>(rows), rows_per_job, threads, [&](int first, int end) {
        std::vector<float> kept(layers);
        for (auto v = static_cast<std::size_t>(first); v < static_cast<std::size_t>(end); ++v) {
            double* const row = sums.data + 5 * v;
            std::fill_n(row, 5, 0.0);
            for (std::size_t u = 0; u < width; ++u) {
                const std::size_t cell = v * width + u;
                const float tolerance = in.tolerance * fused_slope(middle.data(), rows, width, v, u);
                FusedCell sum;
                for (std::size_t k = 0; k < layers; ++k) {
                    const std::size_t at = k * plane + cell;
                    const float h = in.height[at], s = in.sigma[at];
                    kept[k] = -1.0f;
                    if (!std::isfinite(h)) continue;
                    sum.known = true;
                    if (!(std::abs(h - middle[cell]) <= in.outlier * s + tolerance)) {
                        ++sum.outliers;
                        continue;
                    }
                    const float w = kept[k] = layer_weight(s), square = w * w;
                    ++sum.agreeing;
                    sum.kept += w, sum.mean += h * w, sum.squares += square;
                    sum.own += square * (s * s), sum.shared += square * (in.noise[at] * in.noise[at]);
                }
                const float mean = sum.mean / sum.kept;  // 0 / 0 is NaN
                height[cell] = mean;
                sigma[cell] = std::sqrt(sum.own) / sum.kept;
                noise[cell] = std::sqrt(sum.shared) / sum.kept;
                known[cell] = sum.known;
                row[4] += static_cast<double>(sum.outliers);
                if (sum.agreeing < 2) continue;
                row[0] += static_cast<double>(sum.agreeing);
                row[3] += static_cast<double>(sum.squares / (sum.kept * sum.kept)) *
                          static_cast<double>(sum.agreeing);
                for (std::size_t k = 0; k < layers; ++k) {
                    if (kept[k] < 0.0f) continue;
                    const std::size_t at = k * plane + cell;
                    const float left = in.height[at] - mean;
                    const float freedom = std::max(1.0f - kept[k] / sum.kept, kLeastFreedom);
                    row[1] += static_cast<double>(left * left / freedom);
                    row[2] += static_cast<double>(in.sigma[at] * in.sigma[at]);
                }
            }
        }
    });
}

}  // namespace beltscape
