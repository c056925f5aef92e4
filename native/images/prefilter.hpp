// The coefficients of the cubic B-spline that passes through an image: two recursive filters along each axis
// (Unser, Aldroubi & Eden, IEEE Trans. Signal Process. 41(2), 1993, doi:10.1109/78.193221). Beyond its edges
// the image is mirrored about the centres of its outermost pixels.
//
// Both axes work in place. `rows` rows are filtered together, because each recursion alone is limited by
// latency; columns are filtered together as whole rows.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr float kPole = -0.26794919243112270647f;            // √3 - 2
inline constexpr float kGain = 6.0f;                                // (1 - pole) (1 - 1/pole)
inline constexpr float kLastGain = kPole / (kPole * kPole - 1.0f);  // of the mirrored end
inline constexpr int kHorizon = 16;                                 // pole^16 < 2^-30

// The index of pixel i >= 0 in a mirrored line of n > 1.
BELTSCAPE_INLINE int mirrored(int i, int n) {
    const int in_period = i % (2 * n - 2);
    return lesser(in_period, 2 * n - 2 - in_period);
}

// out = `gain` times the image, filtered along its rows of n pixels; rows of one pixel are only scaled.
template <int rows>
BELTSCAPE_INLINE void prefilter_rows(const float* image, int n, float gain, float* out) {
    if (n == 1) {
        for (int r = 0; r < rows; ++r) out[r] = image[r] * gain;
        return;
    }
    float state[rows];
    for (int r = 0; r < rows; ++r) {
        float power = gain, sum = 0;
        for (int i = 0; i < kHorizon; ++i, power *= kPole)
            sum += image[static_cast<size_t>(r) * n + mirrored(i, n)] * power;
        state[r] = sum;
    }
    for (int r = 0; r < rows; ++r) out[static_cast<size_t>(r) * n] = state[r];
    for (int i = 1; i < n; ++i)
        for (int r = 0; r < rows; ++r) {
            const size_t at = static_cast<size_t>(r) * n + i;
            out[at] = state[r] = image[at] * gain + state[r] * kPole;
        }
    for (int r = 0; r < rows; ++r) {
        float* const last = out + static_cast<size_t>(r) * n + n - 1;
        *last = state[r] = (last[0] + last[-1] * kPole) * kLastGain;
    }
    for (int i = n - 2; i >= 0; --i)
        for (int r = 0; r < rows; ++r) {
            const size_t at = static_cast<size_t>(r) * n + i;
            out[at] = state[r] = (state[r] - out[at]) * kPole;
        }
}

// Filters `count` columns of an image with n rows, `step` apart.
template <class F>
BELTSCAPE_INLINE void prefilter_columns(float* image, int n, size_t step, int count) {
    if (n == 1) return;
    const auto each = [&](const auto& job) {
        for (int x = 0; x < count; x += Lane<F>::count) job(image + x, count - x);
    };
    each([&](float* top, int left) {
        F sum{};
        float power = 1;
        for (int i = 0; i < kHorizon; ++i, power *= kPole)
            sum += load_first<F>(top + mirrored(i, n) * step, left) * power;
        store_first(top, sum, left);
    });
    for (int i = 1; i < n; ++i)
        each([&](float* top, int left) {
            float* const at = top + i * step;
            store_first(at, load_first<F>(at, left) + load_first<F>(at - step, left) * kPole, left);
        });
    each([&](float* top, int left) {
        float* const last = top + (n - 1) * step;
        const F sum = load_first<F>(last, left) + load_first<F>(last - step, left) * kPole;
        store_first(last, sum * kLastGain, left);
    });
    for (int i = n - 2; i >= 0; --i)
        each([&](float* top, int left) {
            float* const at = top + i * step;
            store_first(at, (load_first<F>(at + step, left) - load_first<F>(at, left)) * kPole, left);
        });
}

#ifndef __CUDACC__
struct SplineInput {
    Grid<const float> image;

    void fields(const auto& read) { read("image", image); }
};

inline void spline_coefficients(const SplineInput& in, std::size_t threads, Grid<float> out) {
    constexpr int kRowsPerJob = 16;
    constexpr int kColumnsPerJob = 256;  // a strip of them stays in the second-level cache
    constexpr int kRowsAtOnce = 8;
    const int height = in.image.height(), width = in.image.width();
    const float gain = (width > 1 ? kGain : 1.0f) * (height > 1 ? kGain : 1.0f);
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        int row = first;
        for (; row + kRowsAtOnce <= end; row += kRowsAtOnce)
            prefilter_rows<kRowsAtOnce>(in.image.row(row), width, gain, out.row(row));
        for (; row < end; ++row) prefilter_rows<1>(in.image.row(row), width, gain, out.row(row));
    });
    for_bands(0, width, kColumnsPerJob, threads, [&](int first, int end) {
        prefilter_columns<Floats>(out.data + first, height, out.shape[1], end - first);
    });
}
#endif

}  // namespace beltscape
