// A small network with one hidden layer, at every pixel of a row: planes of evidence in, planes of answers
// out.
#pragma once

#include "lanes.hpp"

namespace beltscape {

inline constexpr int kMostPlanes = 64, kMostAnswers = 8;

// `low` and `high` (planes) clamp what comes in, NaN to `low`; `hidden` (units, planes + 1) and `output`
// (answers, units + 1) end each row with their constant.
struct Network {
    const float *low, *high, *hidden, *output;
    int planes, units, answers;
};

inline constexpr int kAbreast = 4;  // units whose sums do not wait for each other

// Units k ... k + count - 1 into the answers, in their order.
template <int count, class F>
BELTSCAPE_INLINE void add_units(const Network& net, const F* in, int k, F* answers) {
    const int stride = net.planes + 1;
    const float* const row = net.hidden + k * stride;
    F unit[count];
    for (int j = 0; j < count; ++j) unit[j] = broadcast<F>(row[j * stride + net.planes]);
    for (int p = 0; p < net.planes; ++p)
        for (int j = 0; j < count; ++j) unit[j] += in[p] * row[j * stride + p];
    for (int j = 0; j < count; ++j) {
        const F active = greater(unit[j], F{});
        for (int a = 0; a < net.answers; ++a) answers[a] += active * net.output[a * (net.units + 1) + k + j];
    }
}

// Pixels `at` ... `at + count - 1` of all planes; sums run in the order of planes, then of units.
template <class F>
BELTSCAPE_INLINE void perceptron_row(const Network& net, const float* const* planes, size_t at, int count,
                                     float* const* out) {
    for (int x = 0; x < count; x += Lane<F>::count) {
        F in[kMostPlanes], answers[kMostAnswers];
        for (int p = 0; p < net.planes; ++p)
            in[p] = clamp(load_first<F>(planes[p] + at + x, count - x), net.low[p], net.high[p]);
        for (int a = 0; a < net.answers; ++a)
            answers[a] = broadcast<F>(net.output[a * (net.units + 1) + net.units]);
        int k = 0;
        for (; k + kAbreast <= net.units; k += kAbreast) add_units<kAbreast>(net, in, k, answers);
        for (; k < net.units; ++k) add_units<1>(net, in, k, answers);
        for (int a = 0; a < net.answers; ++a) store_first(out[a] + at + x, answers[a], count - x);
    }
}

}  // namespace beltscape
