// A small network of rectified layers, at every pixel of a row: planes of evidence in, planes of answers out.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr int kMostUnits = 256;  // of a layer, and planes of evidence

// `rows` (units, inputs + 1) end with their constants.
struct Layer {
    const float* rows;
    int inputs, units;
};

// `low` and `high` (inputs of the first layer) clamp the inputs, NaN to `low`.
struct Network {
    const float *low, *high;
    const Layer* layers;
    int layer_count;
};

// Units whose sums do not wait for each other, and vectors of pixels that share the reading of weights: as
// many sums as 16 registers hold beside what is read. One vector alone: v3 47 instead of 84 GFLOP/s, v4 as
// much.
inline constexpr int kAbreast = 4;
template <class F>
inline constexpr int kBeside = Lane<F>::count > 1 ? 3 : 1;
template <class F>
inline constexpr int kWide = kBeside<F> * Lane<F>::count;

// The inputs of kBeside vectors of pixels, number by number.
template <class F>
using Known = F[kMostUnits][kBeside<F>];

// Units k ... k + count - 1.
template <int count, class F>
BELTSCAPE_INLINE void weigh_units(const Layer& layer, const Known<F>& in, int k, Known<F>& out) {
    const int stride = layer.inputs + 1;
    const float* const row = layer.rows + k * stride;
    F unit[count][kBeside<F>];
    for (int j = 0; j < count; ++j)
        for (F& sum : unit[j]) sum = broadcast<F>(row[j * stride + layer.inputs]);
    for (int i = 0; i < layer.inputs; ++i)
        for (int j = 0; j < count; ++j)
            for (int x = 0; x < kBeside<F>; ++x)
                unit[j][x] = multiply_add(in[i][x], row[j * stride + i], unit[j][x]);
    for (int j = 0; j < count; ++j)
        for (int x = 0; x < kBeside<F>; ++x) out[k + j][x] = unit[j][x];
}

template <class F>
BELTSCAPE_INLINE void weigh(const Layer& layer, const Known<F>& in, Known<F>& out) {
    int k = 0;
    for (; k + kAbreast <= layer.units; k += kAbreast) weigh_units<kAbreast, F>(layer, in, k, out);
    for (; k < layer.units; ++k) weigh_units<1, F>(layer, in, k, out);
}

// Of all layers, whose last one's units are put; `in` is used up.
template <class F>
BELTSCAPE_INLINE void answer(const Network& net, Known<F>& in, Known<F>& put) {
    for (int l = 0; l < net.layer_count - 1; ++l) {
        weigh<F>(net.layers[l], in, put);
        for (int k = 0; k < net.layers[l].units; ++k)
            for (int x = 0; x < kBeside<F>; ++x) in[k][x] = greater(put[k][x], F{});
    }
    weigh<F>(net.layers[net.layer_count - 1], in, put);
}

// Of at most `count` pixels from `at` on.
template <class F>
BELTSCAPE_INLINE void put_answers(const Network& net, const Known<F>& put, size_t at, int count,
                                  float* const* out) {
    constexpr int lanes = Lane<F>::count;
    for (int a = 0; a < net.layers[net.layer_count - 1].units; ++a)
        for (int x = 0; x < kBeside<F> && x * lanes < count; ++x)
            store_first(out[a] + at + x * lanes, put[a][x], count - x * lanes);
}

inline constexpr int kTogether = 4;  // times kBeside vectors of a plane that are read in one go

// Pixels `at` ... `at + count - 1` of all planes; sums run in the order of inputs.
template <class F>
BELTSCAPE_INLINE void perceptron_row(const Network& net, const float* const* planes, size_t at, int count,
                                     float* const* out) {
    constexpr int lanes = Lane<F>::count, wide = kWide<F>;
    Known<F> read[kTogether], put;
    for (int from = 0; from < count; from += kTogether * wide) {
        const int end = lesser(count, from + kTogether * wide);
        for (int p = 0; p < net.layers[0].inputs; ++p)
            for (int x = from; x < end; x += lanes)
                read[(x - from) / wide][p][(x - from) / lanes % kBeside<F>] =
                    clamp(load_first<F>(planes[p] + at + x, count - x), net.low[p], net.high[p]);
        for (int x = from; x < end; x += wide) {
            answer<F>(net, read[(x - from) / wide], put);
            put_answers<F>(net, put, at + x, end - x, out);
        }
    }
}

#ifndef __CUDACC__
inline std::vector<Layer> layers_of(const std::vector<Grid<const float>>& layers) {
    std::vector<Layer> all;
    for (const Grid<const float>& layer : layers)
        all.push_back({layer.data, layer.width() - 1, layer.height()});
    return all;
}

struct NetworkInput {
    std::vector<Grid<const float>> planes;
    Grid<const float> limits;  // (2, planes): low, then high
    std::vector<Grid<const float>> layers;

    void fields(const auto& read) { read("planes", planes), read("limits", limits), read("layers", layers); }
};

inline void evaluate_network(const NetworkInput& in, std::size_t threads,
                             const std::vector<Grid<float>>& out) {
    constexpr int kRowsPerJob = 16;
    const std::vector<Layer> layers = layers_of(in.layers);
    const Network net = {in.limits.data, in.limits.row(1), layers.data(), static_cast<int>(layers.size())};
    std::vector<const float*> from;
    std::vector<float*> to;
    for (const Grid<const float>& plane : in.planes) from.push_back(plane.data);
    for (const Grid<float>& plane : out) to.push_back(plane.data);
    const std::size_t width = in.planes[0].shape[1];
    for_bands(0, in.planes[0].height(), kRowsPerJob, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v)
            perceptron_row<Floats>(net, from.data(), static_cast<std::size_t>(v) * width,
                                   static_cast<int>(width), to.data());
    });
}
#endif

}  // namespace beltscape
