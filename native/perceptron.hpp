// A small network of rectified layers, at every pixel of a row: planes of evidence in, planes of answers out.
#pragma once

#include "lanes.hpp"

namespace beltscape {

inline constexpr int kMostUnits = 256;  // of a layer, and planes of evidence

// `rows` (units, inputs + 1) end with their constants.
struct Layer {
    const float* rows;
    int inputs, units;
};

// `low` and `high` (inputs of the first layer) clamp what comes in, NaN to `low`.
struct Network {
    const float *low, *high;
    const Layer* layers;
    int layer_count;
};

inline constexpr int kAbreast = 4;  // units whose sums do not wait for each other

// Units k ... k + count - 1.
template <int count, class F>
BELTSCAPE_INLINE void weigh_units(const Layer& layer, const F* in, int k, F* out) {
    const int stride = layer.inputs + 1;
    const float* const row = layer.rows + k * stride;
    F unit[count];
    for (int j = 0; j < count; ++j) unit[j] = broadcast<F>(row[j * stride + layer.inputs]);
    for (int i = 0; i < layer.inputs; ++i)
        for (int j = 0; j < count; ++j) unit[j] = fused(in[i], row[j * stride + i], unit[j]);
    for (int j = 0; j < count; ++j) out[k + j] = unit[j];
}

template <class F>
BELTSCAPE_INLINE void weigh(const Layer& layer, const F* in, F* out) {
    int k = 0;
    for (; k + kAbreast <= layer.units; k += kAbreast) weigh_units<kAbreast>(layer, in, k, out);
    for (; k < layer.units; ++k) weigh_units<1>(layer, in, k, out);
}

// Of all layers, whose last one's units are put; `in` is used up.
template <class F>
BELTSCAPE_INLINE void answer(const Network& net, F* in, F* put) {
    for (int l = 0; l < net.layer_count - 1; ++l) {
        weigh(net.layers[l], in, put);
        for (int k = 0; k < net.layers[l].units; ++k) in[k] = greater(put[k], F{});
    }
    weigh(net.layers[net.layer_count - 1], in, put);
}

inline constexpr int kTogether = 8;  // vectors of a plane that are read in one go

// Pixels `at` ... `at + count - 1` of all planes; sums run in the order of inputs.
template <class F>
BELTSCAPE_INLINE void perceptron_row(const Network& net, const float* const* planes, size_t at, int count,
                                     float* const* out) {
    constexpr int lanes = Lane<F>::count;
    F read[kTogether][kMostUnits], put[kMostUnits];
    for (int from = 0; from < count; from += kTogether * lanes) {
        const int end = lesser(count, from + kTogether * lanes);
        for (int p = 0; p < net.layers[0].inputs; ++p)
            for (int x = from, i = 0; x < end; x += lanes, ++i)
                read[i][p] = clamp(load_first<F>(planes[p] + at + x, count - x), net.low[p], net.high[p]);
        for (int x = from, i = 0; x < end; x += lanes, ++i) {
            answer(net, read[i], put);
            for (int a = 0; a < net.layers[net.layer_count - 1].units; ++a)
                store_first(out[a] + at + x, put[a], count - x);
        }
    }
}

}  // namespace beltscape
