// One round of message passing between pixels: a small network takes the messages that a pixel receives from
// its neighbours, and its own state.
#pragma once

#include "networks/network.hpp"
#include "workspace.hpp"

namespace beltscape {

inline constexpr int kFour = 4;

struct Messages {
    const float* values;  // (senders, kFour * quads): a sender's message lies in one piece
    int length, quads;    // numbers of a message
    const int* senders;   // (received, pixels)
    int received;
    const float* state;  // (own, pixels)
    int own;
    size_t pixels;
};

// Transposes messages (length, senders) to rows (senders, kFour * quads), from sender `first` to `end`.
BELTSCAPE_INLINE void transpose_messages(const float* from, size_t senders, int length, int quads,
                                         size_t first, size_t end, float* to) {
    for (size_t a = first; a < end; ++a)
        for (int w = 0; w < kFour * quads; ++w)
            to[a * static_cast<size_t>(kFour * quads) + static_cast<size_t>(w)] =
                w < length ? from[static_cast<size_t>(w) * senders + a] : 0.0F;
}

// Fills vector `x` of the network's inputs for the pixels from `at` on: the received messages, component by
// component, then the state.
template <class F>
BELTSCAPE_INLINE void gather_inputs(const Messages& messages, size_t at, int count, int x, Units<F>& in) {
    for (int k = 0; k < messages.received; ++k) {
        const IntOf<F> sender = load_first<IntOf<F>>(messages.senders + k * messages.pixels + at, count);
        for (int q = 0; q < messages.quads; ++q) {
            F message[kFour];
            gather_four(messages.values + kFour * q, sender * (kFour * messages.quads), message);
            for (int w = kFour * q; w < lesser(messages.length, kFour * (q + 1)); ++w)
                in[w * messages.received + k][x] = message[w - kFour * q];
        }
    }
    F(*const own)[kBeside<F>] = in + messages.length * messages.received;
    for (int k = 0; k < messages.own; ++k)
        own[k][x] = load_first<F>(messages.state + k * messages.pixels + at, count);
}

// Evaluates at most `count` pixels from `at` on, and at most kWide.
template <class F>
BELTSCAPE_INLINE void pass_messages_lanes(const Network& net, const Messages& messages, size_t at, int count,
                                          float* const* out) {
    constexpr int lanes = Lane<F>::count;
    Units<F> in, spare;
    const size_t next = at + static_cast<size_t>(kTogether * kWide<F>);
    for (int k = 0; k < messages.received; ++k)
        prefetch(messages.senders + k * messages.pixels + next, kWide<F>);
    for (int k = 0; k < messages.own; ++k) prefetch(messages.state + k * messages.pixels + next, kWide<F>);
    for (int k = 0; k < net.layers[net.layer_count - 1].units; ++k) prefetch(out[k] + next, kWide<F>);
    for (int x = 0; x < kBeside<F>; ++x)
        gather_inputs<F>(messages, at + lesser(x * lanes, count), lesser(count - x * lanes, lanes), x, in);
    store_outputs<F>(net, evaluate_layers<F>(net, in, spare), at, count, out);
}

#ifndef __CUDACC__
struct MessagePassingInput {
    Grid<const float> messages;        // (length, senders)
    Grid<const std::int32_t> senders;  // (received, pixels)
    Grid<const float> state;           // (own, pixels)
    std::vector<Grid<const float>> layers;

    void fields(const auto& read) {
        read("messages", messages), read("senders", senders), read("state", state), read("layers", layers);
    }
};

inline void pass_messages(const MessagePassingInput& in, std::size_t threads, Grid<float> out) {
    const int length = in.messages.height(), quads = (length + kFour - 1) / kFour;
    const Workspace<float> rows(in.messages.shape[1] * static_cast<std::size_t>(kFour * quads));
    const Messages round = {rows.get(),
                            length,
                            quads,
                            in.senders.data,
                            in.senders.height(),
                            in.state.data,
                            in.state.height(),
                            in.senders.shape[1]};
    const std::vector<Layer> layers = layers_of(in.layers);
    const Network net = {nullptr, nullptr, layers.data(), static_cast<int>(layers.size())};
    std::vector<float*> to;
    for (int unit = 0; unit < out.height(); ++unit) to.push_back(out.row(unit));
    for_bands(0, in.messages.width(), kPixelsPerJob, threads, [&](int first, int end) {
        transpose_messages(in.messages.data, in.messages.shape[1], length, quads,
                           static_cast<std::size_t>(first), static_cast<std::size_t>(end), rows.get());
    });
    for_bands(0, in.senders.width(), kPixelsPerJob, threads, [&](int first, int end) {
        for (int i = first; i < end; i += kWide<Floats>)
            pass_messages_lanes<Floats>(net, round, static_cast<std::size_t>(i), end - i, to.data());
    });
}
#endif

}  // namespace beltscape
