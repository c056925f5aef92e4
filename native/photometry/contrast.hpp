// Levels of an image in counts of 8 bits, and their standard deviation in the order of NumPy's sums: halves
// of a line are added up apart (Higham, SIAM J. Sci. Comput. 14(4), 1993, doi:10.1137/0914050), down to
// stretches of at most 128 numbers that eight sums share. So the gain of a camera has the bits that NumPy's
// has.
#pragma once

#ifndef __CUDACC__
#include <optional>
#endif

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

inline constexpr int kStretch = 128, kSums = 8;

// The factor from a pixel to its level.
template <class T>
inline constexpr float kLevelScale = sizeof(T) == 1 ? 1.0f : static_cast<float>(255.0 / 65535.0);

// What is added up: a pixel's level, or its squared deviation from `mean`.
template <class T>
struct LevelTerms {
    const T* pixels;
    float mean;
    bool are_squares;

    BELTSCAPE_INLINE float at(size_t i) const {
        const float level = static_cast<float>(pixels[i]) * kLevelScale<T>, deviation = level - mean;
        return are_squares ? deviation * deviation : level;
    }
};

#if defined(__CUDACC__) || defined(BELTSCAPE_SCALAR)
struct SharedSums {
    float lanes[kSums];
    BELTSCAPE_INLINE float operator[](int i) const { return lanes[i]; }
    BELTSCAPE_INLINE void operator+=(const SharedSums& other) {
        for (int i = 0; i < kSums; ++i) lanes[i] += other.lanes[i];
    }
};
template <class T>
BELTSCAPE_INLINE SharedSums eight_terms(const LevelTerms<T>& terms, size_t first) {
    SharedSums found;
    for (int i = 0; i < kSums; ++i) found.lanes[i] = terms.at(first + static_cast<size_t>(i));
    return found;
}
#else
typedef float SharedSums __attribute__((vector_size(4 * kSums)));
template <class T>
BELTSCAPE_INLINE SharedSums eight_terms(const LevelTerms<T>& terms, size_t first) {
    typedef T Pixels __attribute__((vector_size(sizeof(T) * kSums)));
    typedef std::uint16_t Shorts __attribute__((vector_size(2 * kSums)));  // widening in steps is faster
    typedef std::int32_t Whole __attribute__((vector_size(4 * kSums)));
    Pixels pixels;
    __builtin_memcpy(&pixels, terms.pixels + first, sizeof pixels);
    const Whole whole = __builtin_convertvector(__builtin_convertvector(pixels, Shorts), Whole);
    const SharedSums level = __builtin_convertvector(whole, SharedSums) * kLevelScale<T>,
                     deviation = level - terms.mean;
    return terms.are_squares ? deviation * deviation : level;
}
#endif

// The sum of a stretch of `count` terms. (A sum of 128 bytes is exact in any order.)
template <class T>
BELTSCAPE_INLINE float sum_stretch(const LevelTerms<T>& terms, size_t first, size_t count) {
    if (sizeof(T) == 1 && !terms.are_squares) {
        int sum = 0;
        for (size_t i = first; i < first + count; ++i) sum += static_cast<int>(terms.pixels[i]);
        return to_float(sum);
    }
    float sum = 0;
    size_t i = 0;
    if (count >= kSums) {
        SharedSums sums = eight_terms(terms, first);
        for (i = kSums; i + kSums <= count; i += kSums) sums += eight_terms(terms, first + i);
        sum = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]));
    }
    for (; i < count; ++i) sum += terms.at(first + i);
    return sum;
}

// How many of `count` terms are added up as the first half.
BELTSCAPE_INLINE size_t first_half(size_t count) { return count / 2 - count / 2 % kSums; }

// A sum divided by a number of pixels, as NumPy does: in double precision.
BELTSCAPE_INLINE float mean_of(float sum, double count) {
    return static_cast<float>(static_cast<double>(sum) / count);
}

#ifndef __CUDACC__
struct ImageInput {
    std::optional<Grid<const std::uint8_t>> bytes;  // one of both
    std::optional<Grid<const std::uint16_t>> words;

    void fields(const auto& read) { read("bytes", bytes), read("words", words); }
};

template <class T>
float sum_terms(const LevelTerms<T>& terms, size_t first, size_t count) {
    if (count <= kStretch) return sum_stretch(terms, first, count);
    const size_t half = first_half(count);
    return sum_terms(terms, first, half) + sum_terms(terms, first + half, count - half);
}

template <class T>
float standard_deviation(const Grid<const T>& image) {
    const size_t count = image.shape[0] * image.shape[1];
    const auto pixels = static_cast<double>(count);
    const float mean = mean_of(sum_terms<T>({image.data, 0, false}, 0, count), pixels);
    return square_root(mean_of(sum_terms<T>({image.data, mean, true}, 0, count), pixels));
}

// out (1): the standard deviation of the levels.
inline void measure_contrast(const ImageInput& in, std::size_t, List<float> out) {
    out[0] = in.bytes ? standard_deviation(*in.bytes) : standard_deviation(*in.words);
}

struct LevelsInput {
    std::optional<Grid<const std::uint8_t>> bytes;
    std::optional<Grid<const std::uint16_t>> words;
    float gain;

    void fields(const auto& read) { read("bytes", bytes), read("words", words), read("gain", gain); }
};

// The levels times the gain.
inline void make_levels(const LevelsInput& in, std::size_t threads, Grid<float> out) {
    constexpr int kRowsPerJob = 64;
    const auto fill = [&]<class T>(const Grid<const T>& image) {
        for_bands(0, image.height(), kRowsPerJob, threads, [&](int first, int end) {
            const size_t begin = static_cast<size_t>(first) * image.shape[1],
                         stop = static_cast<size_t>(end) * image.shape[1];
            for (size_t i = begin; i < stop; ++i)
                out[i] = static_cast<float>(image[i]) * kLevelScale<T> * in.gain;
        });
    };
    in.bytes ? fill(*in.bytes) : fill(*in.words);
}
#endif

}  // namespace beltscape
