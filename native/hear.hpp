// What pixels make of messages: a small network that takes what those about a pixel say and what it keeps
// itself.
#pragma once

#include "perceptron.hpp"

namespace beltscape {

struct Messages {
    const float* said;  // (words, addresses)
    size_t addresses;
    int words;
    const int* near;  // (heard, pixels)
    int heard;
    const float* kept;  // (own, pixels)
    int own;
    size_t pixels;
};

// At most `count` pixels from `at` on; inputs are each word of all heard, then what is kept.
template <class F>
BELTSCAPE_INLINE void hear(const Network& net, const Messages& messages, size_t at, int count,
                           float* const* out) {
    F in[kMostUnits], put[kMostUnits];
    for (int k = 0; k < messages.heard; ++k) {
        const IntOf<F> who = load_first<IntOf<F>>(messages.near + k * messages.pixels + at, count);
        for (int w = 0; w < messages.words; ++w)
            in[w * messages.heard + k] = gather(messages.said + w * messages.addresses, who);
    }
    F* const own = in + messages.words * messages.heard;
    for (int k = 0; k < messages.own; ++k)
        own[k] = load_first<F>(messages.kept + k * messages.pixels + at, count);
    answer(net, in, put);
    for (int a = 0; a < net.layers[net.layer_count - 1].units; ++a) store_first(out[a] + at, put[a], count);
}

}  // namespace beltscape
