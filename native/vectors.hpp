// The lanes of the CPU: GCC vectors as wide as the level's registers, with the operations of lanes.hpp (which
// includes this file; include that one). No intrinsics: GCC 12 makes one or two instructions of each but
// `gather`, where the loop is within 20 % of vgatherdps, and `any`.
#pragma once

#include <cstdint>

#include "lanes.hpp"

namespace beltscape {

#if defined(__AVX512F__)
inline constexpr int kVectorBytes = 64;
#elif defined(__AVX__)
inline constexpr int kVectorBytes = 32;
#else
inline constexpr int kVectorBytes = 16;
#endif

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

template <class T>
inline Floats gather(const T* base, Ints index) {
    Floats lanes;
    for (int i = 0; i < kFloatLanes; ++i) lanes[i] = static_cast<float>(base[index[i]]);
    return lanes;
}

inline void store(float* to, Floats a) { __builtin_memcpy(to, &a, sizeof a); }
inline void store(std::int32_t* to, Ints a) { __builtin_memcpy(to, &a, sizeof a); }

// Pixels widen in steps (8 → 16 → 32 bits → float): three times fewer instructions than at once.
typedef std::uint8_t Bytes __attribute__((vector_size(kFloatLanes)));
typedef std::uint16_t Words __attribute__((vector_size(kFloatLanes * 2)));

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
