// A small network of rectified layers, evaluated at every pixel of a row: planes of features in, planes of
// outputs out.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr int kMostUnits = 256;  // of a layer, and planes of evidence

// `rows` (units, inputs + 1): weights, and in the last column the biases. All layers but the last are
// rectified.
struct Layer {
    const float* rows;
    int inputs, units;
    bool rectified;
};

// `low` and `high` (inputs of the first layer) clamp the inputs, NaN to `low`.
struct Network {
    const float *low, *high;
    const Layer* layers;
    int layer_count;
};

// Vectors of pixels that share the loads of weights, and units that are summed at a time: as many sums as fit
// the registers beside the operands, of which AVX-512 has 32 and other levels 16. With one vector, v3 reaches
// 47 instead of 84 GFLOP/s; with four units, v4 takes 6 % longer.
template <class F>
inline constexpr int kBeside = Lane<F>::count > 1 ? 3 : 1;
template <class F>
inline constexpr int kWide = kBeside<F> * Lane<F>::count;
template <class F>
inline constexpr int kAbreast = Lane<F>::count >= 16 ? 8 : 4;

// The inputs or outputs of a layer for kBeside vectors of pixels.
template <class F>
using Units = F[kMostUnits][kBeside<F>];

// Evaluates units k ... k + count - 1.
template <int count, class F>
BELTSCAPE_INLINE void apply_units(const Layer& layer, const Units<F>& in, int k, Units<F>& out) {
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
        for (int x = 0; x < kBeside<F>; ++x)
            out[k + j][x] = layer.rectified ? greater(unit[j][x], F{}) : unit[j][x];
}

// Evaluates the units from k on, `count` at a time, and the rest in halves of that.
template <int count, class F>
BELTSCAPE_INLINE void apply_layer(const Layer& layer, const Units<F>& in, int k, Units<F>& out) {
    for (; k + count <= layer.units; k += count) apply_units<count, F>(layer, in, k, out);
    if constexpr (count > 1) apply_layer<count / 2, F>(layer, in, k, out);
}

// Evaluates all layers and returns the outputs, which lie in `in` or in `spare`.
template <class F>
BELTSCAPE_INLINE const Units<F>& evaluate_layers(const Network& net, Units<F>& in, Units<F>& spare) {
    Units<F>*from = &in, *to = &spare;
    for (int l = 0; l < net.layer_count; ++l) {
        apply_layer<kAbreast<F>, F>(net.layers[l], *from, 0, *to);
        Units<F>* const read = from;
        from = to, to = read;
    }
    return *from;
}

// Stores the outputs of at most `count` pixels from `at` on.
template <class F>
BELTSCAPE_INLINE void store_outputs(const Network& net, const Units<F>& outputs, size_t at, int count,
                                    float* const* out) {
    constexpr int lanes = Lane<F>::count;
    for (int a = 0; a < net.layers[net.layer_count - 1].units; ++a)
        for (int x = 0; x < kBeside<F> && x * lanes < count; ++x)
            store_first(out[a] + at + x * lanes, outputs[a][x], count - x * lanes);
}

inline constexpr int kTogether = 4;  // times kBeside vectors of a plane that are read in one go

// Reads at most `count` pixels of plane p, and at most kTogether * kWide.
template <class F>
BELTSCAPE_INLINE void read_plane(const Network& net, int p, const float* from, int count, Units<F>* to) {
    constexpr int lanes = Lane<F>::count;
    for (int b = 0; b < kTogether; ++b)
        for (int x = 0; x < kBeside<F>; ++x) {
            const int at = lesser((b * kBeside<F> + x) * lanes, count);
            to[b][p][x] = clamp(load_first<F>(from + at, count - at), net.low[p], net.high[p]);
        }
}

// Evaluates the network at pixels `at` ... `at + count - 1`; sums run in the order of the inputs.
template <class F>
BELTSCAPE_INLINE void evaluate_network_pixels(const Network& net, const float* const* planes, size_t at,
                                              int count, float* const* out) {
    constexpr int wide = kWide<F>, ahead = kTogether * wide;
    Units<F> read[kTogether], spare;
    for (int from = 0; from < count; from += ahead) {
        const int end = lesser(count, from + ahead);
        for (int p = 0; p < net.layers[0].inputs; ++p)
            read_plane<F>(net, p, planes[p] + at + from, end - from, read);
        for (int x = from; x < end; x += wide) {
            for (int p = 0; p < net.layers[0].inputs; ++p) prefetch(planes[p] + at + x + ahead, wide);
            const Units<F>& outputs = evaluate_layers<F>(net, read[(x - from) / wide], spare);
            store_outputs<F>(net, outputs, at + x, end - x, out);
        }
    }
}

#ifndef __CUDACC__
inline std::vector<Layer> layers_of(const std::vector<Grid<const float>>& layers) {
    std::vector<Layer> all;
    for (const Grid<const float>& layer : layers)
        all.push_back({layer.data, layer.width() - 1, layer.height(), true});
    all.back().rectified = false;
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
        evaluate_network_pixels<Floats>(net, from.data(), static_cast<std::size_t>(first) * width,
                                        (end - first) * static_cast<int>(width), to.data());
    });
}
#endif

}  // namespace beltscape
