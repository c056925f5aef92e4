// What pixels make of messages: a small network that takes what those about a pixel say and what it keeps
// itself.
#pragma once

#include "perceptron.hpp"

namespace beltscape {

inline constexpr int kFour = 4;

struct Messages {
    const float* said;  // (addresses, kFour * quads): what is said at once lies at once
    int words, quads;
    const int* near;  // (heard, pixels)
    int heard;
    const float* kept;  // (own, pixels)
    int own;
    size_t pixels;
};

// What is said (words, addresses) becomes rows (addresses, kFour * quads), from address `first` to `end`.
BELTSCAPE_INLINE void turn(const float* words, size_t addresses, int count, int quads, size_t first,
                           size_t end, float* said) {
    for (size_t a = first; a < end; ++a)
        for (int w = 0; w < kFour * quads; ++w)
            said[a * static_cast<size_t>(kFour * quads) + static_cast<size_t>(w)] =
                w < count ? words[static_cast<size_t>(w) * addresses + a] : 0.0F;
}

// Vector `x` of inputs, of the pixels from `at` on: each word of all heard, then what is kept.
template <class F>
BELTSCAPE_INLINE void listen(const Messages& messages, size_t at, int count, int x, Known<F>& in) {
    for (int k = 0; k < messages.heard; ++k) {
        const IntOf<F> who = load_first<IntOf<F>>(messages.near + k * messages.pixels + at, count);
        for (int q = 0; q < messages.quads; ++q) {
            F said[kFour];
            gather_four(messages.said + kFour * q, who * (kFour * messages.quads), said);
            for (int w = kFour * q; w < lesser(messages.words, kFour * (q + 1)); ++w)
                in[w * messages.heard + k][x] = said[w - kFour * q];
        }
    }
    F(*const own)[kBeside<F>] = in + messages.words * messages.heard;
    for (int k = 0; k < messages.own; ++k)
        own[k][x] = load_first<F>(messages.kept + k * messages.pixels + at, count);
}

// At most `count` pixels from `at` on, and no more than kWide.
template <class F>
BELTSCAPE_INLINE void hear(const Network& net, const Messages& messages, size_t at, int count,
                           float* const* out) {
    constexpr int lanes = Lane<F>::count;
    Known<F> in, put;
    for (int x = 0; x < kBeside<F>; ++x)
        listen<F>(messages, at + lesser(x * lanes, count), lesser(count - x * lanes, lanes), x, in);
    answer<F>(net, in, put);
    put_answers<F>(net, put, at, count, out);
}

}  // namespace beltscape
