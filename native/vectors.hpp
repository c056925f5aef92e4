// The lanes of the CPU: GCC vectors as wide as the level's registers, with the operations of simd.hpp (which
// includes this file; include that one). GCC 12 makes one or two instructions of each but `gather`, where its
// loop is within 20 % of vgatherdps. Intrinsics stand only where it does not: it takes the loop of
// `multiply_add` apart, and lanes out of registers one by one in `any` and where several loads make a vector.
#pragma once

#if defined(__AVX__)
#include <immintrin.h>
#elif defined(__ARM_FEATURE_FMA)
#include <arm_neon.h>
#endif

#include <cstdint>
#include <utility>

#include "simd.hpp"

namespace beltscape {

#if defined(__AVX512F__)
inline constexpr int kVectorBytes = 64;
#elif defined(__AVX__)
inline constexpr int kVectorBytes = 32;
#else
inline constexpr int kVectorBytes = 16;
#endif

#if defined(BELTSCAPE_SCALAR)  // a level of plain numbers, for processors without vectors and as a check of
                               // the others
inline constexpr int kDoubleLanes = 1, kFloatLanes = 1;
using Doubles = double;
using Floats = float;
using Ints = std::int32_t;

}  // namespace beltscape
#else
inline constexpr int kDoubleLanes = kVectorBytes / 8;
inline constexpr int kFloatLanes = kVectorBytes / 4;

typedef double Doubles __attribute__((vector_size(kVectorBytes)));
typedef float Floats __attribute__((vector_size(kVectorBytes)));
typedef std::int32_t Ints __attribute__((vector_size(kVectorBytes)));

template <class V, class T, int lanes>
struct VectorLane {
    using Int = Ints;
    using Mask = Ints;  // -1 where true
    static constexpr int count = lanes;
    static void set(V& vector, int i, T value) { vector[i] = value; }
    static T get(V vector, int i) { return vector[i]; }
};

template <>
struct Lane<Doubles> : VectorLane<Doubles, double, kDoubleLanes> {};
template <>
struct Lane<Floats> : VectorLane<Floats, float, kFloatLanes> {};
template <>
struct Lane<Ints> : VectorLane<Ints, std::int32_t, kFloatLanes> {};

inline Ints negate(Ints mask) { return ~mask; }
inline Ints not_a_number(Floats a) { return a != a; }
inline bool any(Ints mask) {
#if defined(__AVX512F__)
    return _mm512_movepi32_mask(reinterpret_cast<__m512i>(mask)) != 0;
#elif defined(__AVX__)
    return _mm256_movemask_ps(reinterpret_cast<__m256>(mask)) != 0;
#endif
    std::int32_t found = 0;
    for (int i = 0; i < kFloatLanes; ++i) found |= mask[i];
    return found != 0;
}

inline Floats select(Ints mask, Floats a, Floats b) { return mask ? a : b; }
inline Ints select(Ints mask, Ints a, Ints b) { return mask ? a : b; }

inline Floats lesser(Floats a, Floats b) { return a < b ? a : b; }
inline Floats greater(Floats a, Floats b) { return a > b ? a : b; }
inline Floats clamp(Floats a, float low, float high) {
    return lesser(greater(a, low - Floats{}), high - Floats{});
}
inline Ints lesser(Ints a, Ints b) { return a < b ? a : b; }
inline Ints greater(Ints a, Ints b) { return a > b ? a : b; }
inline Ints clamp(Ints a, int low, int high) { return lesser(greater(a, low - Ints{}), high - Ints{}); }

inline Floats to_float(Ints a) { return __builtin_convertvector(a, Floats); }
inline Ints to_int(Floats a) { return __builtin_convertvector(a, Ints); }
inline Ints floor_int(Floats a) { return to_int(a) + (to_float(to_int(a)) > a); }

inline Ints absolute(Ints a) { return a < 0 ? -a : a; }
inline Floats absolute(Floats a) { return reinterpret_cast<Floats>(reinterpret_cast<Ints>(a) & 0x7fffffff); }
inline Floats square_root(Floats a) {
    for (int i = 0; i < kFloatLanes; ++i) a[i] = __builtin_sqrtf(a[i]);
    return a;
}

inline Floats multiply_add(Floats a, Floats b, Floats c) {
#if defined(__AVX512F__)
    return _mm512_fmadd_ps(a, b, c);
#elif defined(__FMA__)
    return _mm256_fmadd_ps(a, b, c);
#elif defined(__ARM_FEATURE_FMA)
    return reinterpret_cast<Floats>(vfmaq_f32(reinterpret_cast<float32x4_t>(c),
                                              reinterpret_cast<float32x4_t>(a),
                                              reinterpret_cast<float32x4_t>(b)));
#else
    return a * b + c;
#endif
}
inline Floats multiply_add(Floats a, float b, Floats c) { return multiply_add(a, b - Floats{}, c); }
inline Floats multiply_add(Floats a, Floats b, float c) { return multiply_add(a, b, c - Floats{}); }
inline Floats multiply_add(Floats a, float b, float c) { return multiply_add(a, b - Floats{}, c - Floats{}); }

template <class T>
inline Floats gather(const T* base, Ints index) {
    Floats lanes;
    for (int i = 0; i < kFloatLanes; ++i) lanes[i] = static_cast<float>(base[index[i]]);
    return lanes;
}

typedef float Fours __attribute__((vector_size(16)));

inline Fours four_from(const float* from) {
    Fours four;
    __builtin_memcpy(&four, from, sizeof four);
    return four;
}

// Lane i of the result is lane pick(i) of a and b one after the other; one or two instructions.
template <class Pick, int... i>
inline Floats shuffle_lanes(Floats a, Floats b, std::integer_sequence<int, i...>) {
    return __builtin_shufflevector(a, b, Pick{}(i)...);
}
template <class Pick>
inline Floats shuffle(Floats a, Floats b, Pick) {
    return shuffle_lanes<Pick>(a, b, std::make_integer_sequence<int, kFloatLanes>{});
}

// base[index] ... base[index + 3] as four Floats: one load a lane, then each 4x4 is transposed where it lies.
// A spline's warp takes 6 ms so and 9 with gathers (16 lanes), 8 and 9 (8 lanes).
inline void gather_four(const float* base, Ints indices, Floats (&taps)[4]) {
    std::int32_t index[kFloatLanes];
    __builtin_memcpy(index, &indices, sizeof indices);
    Floats rows[4];  // lane 4q + k of row r: neighbour k of point 4q + r
    for (int r = 0; r < 4; ++r) {
#if defined(__AVX512F__)
        const auto four = [&](int q) { return _mm_loadu_ps(base + index[r + 4 * q]); };
        rows[r] = _mm512_castps128_ps512(four(0));
        rows[r] = _mm512_insertf32x4(rows[r], four(1), 1);
        rows[r] = _mm512_insertf32x4(rows[r], four(2), 2);
        rows[r] = _mm512_insertf32x4(rows[r], four(3), 3);
#elif defined(__AVX__)
        rows[r] = __builtin_shufflevector(four_from(base + index[r]), four_from(base + index[r + 4]), 0, 1, 2,
                                          3, 4, 5, 6, 7);
#else
        rows[r] = four_from(base + index[r]);
#endif
    }
    // of two rows: lanes 0, 1 and lanes 2, 3 of each quad in turn; then even and odd neighbours of each
    constexpr auto low = [](int i) { return i / 4 * 4 + i % 4 / 2 + i % 2 * kFloatLanes; };
    constexpr auto high = [](int i) { return i / 4 * 4 + i % 4 / 2 + 2 + i % 2 * kFloatLanes; };
    constexpr auto first = [](int i) { return i / 4 * 4 + i % 2 + i % 4 / 2 * kFloatLanes; };
    constexpr auto last = [](int i) { return i / 4 * 4 + i % 2 + i % 4 / 2 * kFloatLanes + 2; };
    const Floats a = shuffle(rows[0], rows[1], low), b = shuffle(rows[2], rows[3], low);
    const Floats c = shuffle(rows[0], rows[1], high), d = shuffle(rows[2], rows[3], high);
    taps[0] = shuffle(a, b, first), taps[1] = shuffle(a, b, last);
    taps[2] = shuffle(c, d, first), taps[3] = shuffle(c, d, last);
}

inline void store(float* to, Floats a) { __builtin_memcpy(to, &a, sizeof a); }
inline void store(std::int32_t* to, Ints a) { __builtin_memcpy(to, &a, sizeof a); }

// Pixels widen in steps (8 → 16 → 32 bits → float): three times fewer instructions than at once.
typedef std::uint8_t Bytes __attribute__((vector_size(kFloatLanes)));
typedef std::uint16_t Words __attribute__((vector_size(kFloatLanes * 2)));

inline void store(std::uint8_t* to, Ints a) {
    const Bytes bytes = __builtin_convertvector(__builtin_convertvector(a, Words), Bytes);
    __builtin_memcpy(to, &bytes, sizeof bytes);
}

template <class V, class T>
inline V load_vector(const T* from) {
    if constexpr (sizeof(T) == 1) {
        Bytes bytes;
        __builtin_memcpy(&bytes, from, sizeof bytes);
        return to_float(__builtin_convertvector(__builtin_convertvector(bytes, Words), Ints));
    } else if constexpr (sizeof(T) == 2) {
        Words words;
        __builtin_memcpy(&words, from, sizeof words);
        return to_float(__builtin_convertvector(words, Ints));
    } else {
        V lanes;
        __builtin_memcpy(&lanes, from, sizeof lanes);
        return lanes;
    }
}

}  // namespace beltscape
#endif  // BELTSCAPE_SCALAR
