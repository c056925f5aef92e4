// How much of an image's texture is finer than a blur, and how much lies between that and a wider one: the
// variances of the differences of three Gaussian blurs of it. Beyond its edges the image is mirrored.
#pragma once

#include "array.hpp"
#include "images/prefilter.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr int kBlurs = 3, kMostBlurRadius = 24;
inline constexpr int kBlurStride = kMostBlurRadius + 1;
inline constexpr int kRowParts = 16;  // of a row, each of every 16th pixel: the same on every level
inline constexpr int kMoments = 4;    // sum and sum of squares of both differences

// The three blurs' weights (kBlurs, kBlurStride), from the middle outwards, and radii, which grow.
struct BlurWeights {
    const float* weights;
    const int* radii;

    BELTSCAPE_INLINE float at(int blur, int i) const { return weights[blur * kBlurStride + i]; }
};

// The index beyond either end of a mirrored line of n pixels.
BELTSCAPE_INLINE int mirrored_index(int i, int n) { return n == 1 ? 0 : mirrored(absolute(i), n); }

// Three blurs of a line at `count` places: read(k, i) gives the value i pixels on from place k. The pairs are
// added once for all.
template <int count, class F, class Read>
BELTSCAPE_INLINE void blur_down(const BlurWeights& blurs, const Read& read, F (&sums)[kBlurs][count]) {
    for (int k = 0; k < count; ++k)
        for (int blur = 0; blur < kBlurs; ++blur) sums[blur][k] = blurs.at(blur, 0) * read(k, 0);
    int i = 1;
    for (int first = 0; first < kBlurs; ++first)  // beyond a radius only the wider ones
        for (; i <= blurs.radii[first]; ++i) {
            F pairs[count];
            for (int k = 0; k < count; ++k) pairs[k] = read(k, -i) + read(k, i);
            for (int blur = first; blur < kBlurs; ++blur) {
                const F weight = broadcast<F>(blurs.at(blur, i));
                for (int k = 0; k < count; ++k) sums[blur][k] = multiply_add(weight, pairs[k], sums[blur][k]);
            }
        }
}

// Both differences of the three blurs, each blurred along its row too: read(blur, k, i) gives its value i
// columns on from place k.
template <int count, class F, class Read>
BELTSCAPE_INLINE void blur_across(const BlurWeights& blurs, const Read& read, F (&fine)[count],
                                  F (&medium)[count]) {
    F sums[kBlurs][count];
    for (int blur = 0; blur < kBlurs; ++blur) {
        for (int k = 0; k < count; ++k) sums[blur][k] = blurs.at(blur, 0) * read(blur, k, 0);
        for (int i = 1; i <= blurs.radii[blur]; ++i) {
            const F weight = broadcast<F>(blurs.at(blur, i));
            for (int k = 0; k < count; ++k)
                sums[blur][k] = multiply_add(weight, read(blur, k, -i) + read(blur, k, i), sums[blur][k]);
        }
    }
    for (int k = 0; k < count; ++k) fine[k] = sums[0][k] - sums[1][k], medium[k] = sums[1][k] - sums[2][k];
}

// The sum of 16 sums.
BELTSCAPE_INLINE float join_sums(float (&sums)[kRowParts]) {
    for (int step = kRowParts / 2; step > 0; step /= 2)
        for (int i = 0; i < step; ++i) sums[i] += sums[i + step];
    return sums[0];
}

// The variance by the sum and the sum of squares of each row, kMoments numbers from row to row.
BELTSCAPE_INLINE float variance_of_rows(const float* moments, int height, int width) {
    double sum = 0, squares = 0;
    for (int y = 0; y < height; ++y)
        sum += static_cast<double>(moments[y * kMoments]),
            squares += static_cast<double>(moments[y * kMoments + 1]);
    const double count = static_cast<double>(height) * width, mean = sum / count;
    const double variance = squares / count - mean * mean;
    return variance > 0 ? static_cast<float>(variance) : 0.0f;
}

#ifndef __CUDACC__
struct SharpnessInput {
    Grid<const float> image;
    Array<const float, kBlurs, kBlurStride> weights;
    Array<const std::int32_t, kBlurs> radii;

    void fields(const auto& read) { read("image", image), read("weights", weights), read("radii", radii); }
};

// A row's three blurs along columns, continued beyond its ends.
class BlurredRow {
public:
    static constexpr int kAtOnce = 4;  // vectors: they share the weights, and their sums do not wait

    explicit BlurredRow(int width)
        : width_(width),
          stride_(static_cast<size_t>(width + 2 * kMostBlurRadius + kAtOnce * kFloatLanes)),
          values_(stride_ * kBlurs) {}

    void fill(const Grid<const float>& image, const BlurWeights& blurs, int y) {
        const float* rows[2 * kMostBlurRadius + 1];
        const int reach = blurs.radii[kBlurs - 1];
        for (int by = -reach; by <= reach; ++by)
            rows[kMostBlurRadius + by] = image.row(mirrored_index(y + by, image.height()));
        for (int x = 0; x < width_; x += kAtOnce * kFloatLanes) {
            const auto read = [&](int k, int by) {
                const int first = x + k * kFloatLanes;
                return first < width_ ? load_first<Floats>(rows[kMostBlurRadius + by] + first, width_ - first)
                                      : Floats{};
            };
            Floats sums[kBlurs][kAtOnce];
            blur_down(blurs, read, sums);
            for (int blur = 0; blur < kBlurs; ++blur)
                for (int k = 0; k < kAtOnce; ++k) store(line(blur) + x + k * kFloatLanes, sums[blur][k]);
        }
        for (int i = 1; i <= reach; ++i) {
            const int before = mirrored_index(-i, width_), beyond = mirrored_index(width_ - 1 + i, width_);
            for (int blur = 0; blur < kBlurs; ++blur)
                line(blur)[-i] = line(blur)[before], line(blur)[width_ - 1 + i] = line(blur)[beyond];
        }
    }

    // The sums and sums of squares of both differences over the row.
    void add_up(const BlurWeights& blurs, float* moments) {
        constexpr int kParts = kRowParts / kFloatLanes;
        Floats sums[kMoments][kParts] = {};
        for (int x = 0; x < width_; x += kAtOnce * kFloatLanes) {
            const auto read = [&](int blur, int k, int by) {
                return load<Floats>(line(blur) + x + k * kFloatLanes + by);
            };
            Floats fine[kAtOnce], medium[kAtOnce];
            blur_across(blurs, read, fine, medium);
            for (int k = 0; k < kAtOnce; ++k) {
                const MaskOf<Floats> is_inside = lane_numbers<Floats>() < width_ - x - k * kFloatLanes;
                const Floats one = select(is_inside, fine[k], Floats{}),
                             other = select(is_inside, medium[k], Floats{});
                const int part = (x / kFloatLanes + k) % kParts;
                sums[0][part] += one, sums[1][part] += one * one;
                sums[2][part] += other, sums[3][part] += other * other;
            }
        }
        for (int i = 0; i < kMoments; ++i) {
            float parts[kRowParts];
            for (int part = 0; part < kParts; ++part) store(parts + part * kFloatLanes, sums[i][part]);
            moments[i] = join_sums(parts);
        }
    }

private:
    int width_;
    size_t stride_;
    std::vector<float> values_;

    float* line(int blur) { return values_.data() + static_cast<size_t>(blur) * stride_ + kMostBlurRadius; }
};

// out (2): the variances of both differences.
inline void measure_sharpness(const SharpnessInput& in, std::size_t threads, List<float> out) {
    constexpr int kRowsPerJob = 16;
    const int height = in.image.height(), width = in.image.width();
    const BlurWeights blurs{in.weights.data, in.radii.data};
    std::vector<float> moments(static_cast<size_t>(height) * kMoments);
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        BlurredRow row(width);
        for (int y = first; y < end; ++y) {
            row.fill(in.image, blurs, y);
            row.add_up(blurs, moments.data() + static_cast<size_t>(y) * kMoments);
        }
    });
    for (int i = 0; i < 2; ++i) out[i] = variance_of_rows(moments.data() + 2 * i, height, width);
}
#endif

}  // namespace beltscape
