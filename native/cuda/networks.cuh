// Networks on a GPU: a thread takes a pixel. Weights lie one layer after the other, each (units, inputs + 1).
#pragma once

#include "cuda/device.hpp"
#include "cuda/expression.cuh"
#include "networks/message_passing.hpp"
#include "networks/network.hpp"

namespace beltscape {

inline constexpr int kMostLayers = 8;

// The layers of a network from their packed weights; units (layer_count) of each.
struct PackedLayers {
    Layer layers[kMostLayers];

    __device__ PackedLayers(const float* weights, int inputs, const int* units, int layer_count) {
        for (int i = 0; i < layer_count; ++i) {
            layers[i] = {weights, inputs, units[i], i + 1 < layer_count};
            weights += units[i] * (inputs + 1), inputs = units[i];
        }
    }
};

__device__ inline void write_outputs(const Units<float>& outputs, int units, size_t pixels, size_t pixel,
                                     float* out) {
    for (int unit = 0; unit < units; ++unit) out[unit * pixels + pixel] = outputs[unit][0];
}

// planes holds the addresses of `inputs` arrays of pixels, limits (2, inputs), out (units of the last layer,
// pixels).
extern "C" __global__ void network_outputs(const unsigned long long* planes, int inputs, int pixels,
                                           const float* limits, const float* weights, const int* units,
                                           int layer_count, float* out) {
    const int pixel = grid_x();
    if (pixel >= pixels) return;
    const PackedLayers packed(weights, inputs, units, layer_count);
    Units<float> in, spare;
    for (int p = 0; p < inputs; ++p)
        in[p][0] = clamp(array_at<float>(planes, p)[pixel], limits[p], limits[inputs + p]);
    const Network net = {limits, limits + inputs, packed.layers, layer_count};
    write_outputs(evaluate_layers<float>(net, in, spare), units[layer_count - 1], pixels, pixel, out);
}

// The same for features that are expressions (expression.cuh) over width x height pixels: the programs of
// all, one after the other, and where each ends. Of features only those are written to memory, after the
// outputs, whose row (stored_rows) is not negative.
extern "C" __global__ void network_of_programs(const int* program, const int* ends, const int* stored_rows,
                                               int features, const unsigned long long* addresses,
                                               const int* inputs, const float* constants, int width,
                                               int height, const float* limits, const float* weights,
                                               const int* units, int layer_count, float* out) {
    const int pixel = grid_x(), pixels = width * height;
    if (pixel >= pixels) return;
    const int x = pixel % width, y = pixel / width, outputs = units[layer_count - 1];
    const PackedLayers packed(weights, features, units, layer_count);
    Units<float> in, spare;
    for (int p = 0, first = 0; p < features; first = ends[p++]) {
        const float value =
            evaluate_element(program + 2 * first, ends[p] - first, addresses, inputs, constants, x, y);
        if (stored_rows[p] >= 0) out[static_cast<size_t>(outputs + stored_rows[p]) * pixels + pixel] = value;
        in[p][0] = clamp(value, limits[p], limits[features + p]);
    }
    const Network net = {limits, limits + features, packed.layers, layer_count};
    write_outputs(evaluate_layers<float>(net, in, spare), outputs, pixels, pixel, out);
}

// A thread takes a sender: messages (length, senders) to rows (senders, kFour quads).
extern "C" __global__ void message_rows(const float* messages, int senders, int length, int quads,
                                        float* rows) {
    const int sender = grid_x();
    if (sender < senders)
        transpose_messages(messages, senders, length, quads, sender, static_cast<size_t>(sender) + 1, rows);
}

// senders (received, pixels), state (own, pixels), out (units of the last layer, pixels).
extern "C" __global__ void message_outputs(const float* rows, int length, int quads, const int* senders,
                                           int received, const float* state, int own, int pixels,
                                           const float* weights, const int* units, int layer_count,
                                           float* out) {
    const int pixel = grid_x();
    if (pixel >= pixels) return;
    const Messages messages = {rows,     length, quads, senders,
                               received, state,  own,   static_cast<size_t>(pixels)};
    const PackedLayers packed(weights, length * received + own, units, layer_count);
    Units<float> in, spare;
    gather_inputs<float>(messages, pixel, 1, 0, in);
    const Network net = {nullptr, nullptr, packed.layers, layer_count};
    write_outputs(evaluate_layers<float>(net, in, spare), units[layer_count - 1], pixels, pixel, out);
}

// The messages (length + 2, kSenders + pixels) and the rest of the states (own, pixels) of `pixels` pixels
// from the addresses of length + own numbers (pixels). The first senders have no state: their messages are 0
// but for the last two numbers, which name them. A row of the grid takes a row of both.
inline constexpr int kSenders = 2;
extern "C" __global__ void place_states(const unsigned long long* states, int length, int pixels,
                                        float* messages, float* rest) {
    const int column = grid_x(), row = grid_y(), columns = kSenders + pixels;
    if (column >= columns) return;
    const int pixel = column - kSenders;
    const bool is_message = row < length + kSenders;
    const int state = row < length ? row : row - kSenders;
    float value = row - length == column ? 1.0f : 0.0f;
    if (row < length || !is_message) value = pixel < 0 ? 0.0f : array_at<float>(states, state)[pixel];
    if (is_message)
        messages[static_cast<size_t>(row) * columns + column] = value;
    else if (pixel >= 0)
        rest[static_cast<size_t>(state - length) * pixels + pixel] = value;
}

// Adds a round's changes (length + own, pixels) to the states.
extern "C" __global__ void add_changes(const float* changes, int length, int pixels, float* messages,
                                       float* rest) {
    const int pixel = grid_x(), row = grid_y();
    if (pixel >= pixels) return;
    const float change = changes[static_cast<size_t>(row) * pixels + pixel];
    if (row < length)
        messages[static_cast<size_t>(row) * (kSenders + pixels) + kSenders + pixel] += change;
    else
        rest[static_cast<size_t>(row - length) * pixels + pixel] += change;
}

}  // namespace beltscape
