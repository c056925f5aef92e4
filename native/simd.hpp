// Lanes: the number type F over which a kernel is written, and the operations that kernels need. F is a GCC
// vector (Floats, Doubles) on the CPU and a plain float or double in CUDA and at the level `scalar`; one
// template text serves all:
//
//   template <class F>
//   BELTSCAPE_INLINE void lengths(const float* x, const float* y, float* out, int count) {
//       for (int i = 0; i < count; i += Lane<F>::count) {
//           const F a = load_first<F>(x + i, count - i), b = load_first<F>(y + i, count - i);
//           store_first(out + i, square_root(a * a + b * b), count - i);
//       }
//   }
//
// MaskOf<F> is the result of comparing two F; masks join with & and |, and `negate` reverses one.
// Everything is IEEE and nothing is reordered; `multiply_add` alone rounds once for a product and a sum where
// the level can (v3, v4, base on ARM, CUDA), so that these give the same bits as each other, and v2 and
// scalar the same but for rounding.
#pragma once

#ifdef __CUDACC__
#define BELTSCAPE_INLINE __host__ __device__ inline
#else
#define BELTSCAPE_INLINE inline
#endif

namespace beltscape {

using size_t = decltype(sizeof 0);  // NVRTC has no standard headers
inline constexpr float kNotANumber = __builtin_bit_cast(float, 0x7fc00000);
inline constexpr float kInfinity = __builtin_bit_cast(float, 0x7f800000);

// The number of lanes of F, the types of its integers and masks, and access to one lane.
template <class F>
struct Lane;

template <class F>
using IntOf = typename Lane<F>::Int;
template <class F>
using MaskOf = typename Lane<F>::Mask;

template <class T>
struct ScalarLane {
    using Int = int;
    using Mask = bool;
    static constexpr int count = 1;
    BELTSCAPE_INLINE static void set(T& lanes, int, T value) { lanes = value; }
    BELTSCAPE_INLINE static T get(T lanes, int) { return lanes; }
};

template <>
struct Lane<float> : ScalarLane<float> {};
template <>
struct Lane<double> : ScalarLane<double> {};
template <>
struct Lane<int> : ScalarLane<int> {};
template <>
struct Lane<bool> : ScalarLane<bool> {};

BELTSCAPE_INLINE bool is_finite(double a) { return a - a == 0; }

BELTSCAPE_INLINE bool negate(bool mask) { return !mask; }
BELTSCAPE_INLINE bool any(bool mask) { return mask; }
BELTSCAPE_INLINE bool not_a_number(float a) { return a != a; }

BELTSCAPE_INLINE float select(bool mask, float a, float b) { return mask ? a : b; }
BELTSCAPE_INLINE int select(bool mask, int a, int b) { return mask ? a : b; }

// `lesser` and `greater` give b where either is NaN, `clamp` gives `low` for NaN: clean an index before a
// gather.
BELTSCAPE_INLINE float lesser(float a, float b) { return a < b ? a : b; }
BELTSCAPE_INLINE float greater(float a, float b) { return a > b ? a : b; }
BELTSCAPE_INLINE float clamp(float a, float low, float high) { return lesser(greater(a, low), high); }
BELTSCAPE_INLINE int lesser(int a, int b) { return a < b ? a : b; }
BELTSCAPE_INLINE int greater(int a, int b) { return a > b ? a : b; }
BELTSCAPE_INLINE int clamp(int a, int low, int high) { return lesser(greater(a, low), high); }

// From float to int: |a| < 2^31 and not NaN. `to_int` goes towards zero, `floor_int` downwards. (Back again,
// GCC may keep the sign of -0 in a plain float; vectors never do.)
BELTSCAPE_INLINE float to_float(int a) { return static_cast<float>(a); }
BELTSCAPE_INLINE int to_int(float a) { return static_cast<int>(a); }
BELTSCAPE_INLINE int floor_int(float a) { return to_int(a) - (to_float(to_int(a)) > a ? 1 : 0); }

BELTSCAPE_INLINE int absolute(int a) { return a < 0 ? -a : a; }
#ifdef __CUDACC__
BELTSCAPE_INLINE float absolute(float a) { return fabsf(a); }
BELTSCAPE_INLINE float square_root(float a) { return sqrtf(a); }
#else
BELTSCAPE_INLINE float absolute(float a) { return __builtin_fabsf(a); }
BELTSCAPE_INLINE float square_root(float a) { return __builtin_sqrtf(a); }
#endif

// a b + c.
#if defined(__CUDACC__)
BELTSCAPE_INLINE float multiply_add(float a, float b, float c) { return fmaf(a, b, c); }
#elif defined(__FMA__) || defined(__ARM_FEATURE_FMA) || defined(BELTSCAPE_EMULATION)
BELTSCAPE_INLINE float multiply_add(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
#else
BELTSCAPE_INLINE float multiply_add(float a, float b, float c) { return a * b + c; }
#endif

// The same pointer, but not known as such to the compiler. Lanes that were stored there are read from memory:
// GCC would take each out of its vector again, with more instructions.
template <class T>
BELTSCAPE_INLINE T* from_memory(T* pointer) {
#ifndef __CUDACC__
    asm("" : "+r"(pointer));
#endif
    return pointer;
}

// Vectors whose places in an image are computed before the first one is read there: a projection is a long
// chain of operations, and the processor does not look far enough ahead past the loads of single pixels.
template <class F>
inline constexpr int kPlacedAhead = Lane<F>::count > 1 ? 8 : 1;

// Asks for the cache line of a value that is read later, or for `count` values in the second-level cache, up
// to the last one's line. The address may be any. (Always inlined: GCC deletes calls of functions that only
// prefetch.)
#ifdef __CUDACC__
BELTSCAPE_INLINE void prefetch(const float*) {}
template <class T>
BELTSCAPE_INLINE void prefetch(const T*, int) {}
#else
[[gnu::always_inline]] inline void prefetch(const float* from) { __builtin_prefetch(from); }
template <class T>
[[gnu::always_inline]] inline void prefetch(const T* from, int count) {
    constexpr int line = 64 / sizeof(T);
    for (int i = 0; i < count; i += line) __builtin_prefetch(from + lesser(i + line, count) - 1, 0, 2);
}
#endif

// base[index] as float; T is float, unsigned char, unsigned short, ...
template <class T>
BELTSCAPE_INLINE float gather(const T* base, int index) {
    return static_cast<float>(base[index]);
}

// base[index] ... base[index + 3].
BELTSCAPE_INLINE void gather_four(const float* base, int index, float (&taps)[4]) {
    for (int i = 0; i < 4; ++i) taps[i] = base[index + i];
}

BELTSCAPE_INLINE void store(float* to, float a) { *to = a; }
BELTSCAPE_INLINE void store(int* to, int a) { *to = a; }
BELTSCAPE_INLINE void store(unsigned char* to, int a) { *to = static_cast<unsigned char>(a); }

}  // namespace beltscape

#ifndef __CUDACC__
#include "vectors.hpp"
#endif

namespace beltscape {

// Lane<F>::count neighbours from any address, as F (also for unsigned char and unsigned short images).
template <class F, class T>
BELTSCAPE_INLINE F load(const T* from) {
    if constexpr (Lane<F>::count == 1)
        return static_cast<F>(*from);
    else
        return load_vector<F>(from);
}

// The tail of a row: the first `count` lanes (>= 1, may be more than there are) are read, the others are 0.
template <class F, class T>
BELTSCAPE_INLINE F load_first(const T* from, int count) {
    if (count >= Lane<F>::count) return load<F>(from);
    F lanes{};
    for (int i = 0; i < count; ++i) Lane<F>::set(lanes, i, from[i]);
    return lanes;
}

// Writes only the first `count` lanes.
template <class F, class T>
BELTSCAPE_INLINE void store_first(T* to, F lanes, int count) {
    if (count >= Lane<F>::count) return store(to, lanes);
    for (int i = 0; i < count; ++i) to[i] = static_cast<T>(Lane<F>::get(lanes, i));
}

template <class F, class T>
BELTSCAPE_INLINE F broadcast(T value) {
    return value - F{};  // keeps -0; setting lanes one by one costs an instruction each
}

// The angle whose tangent is a >= 0, to 1.1e-7 (S. L. Moshier's atanf of the Cephes library, 1989, with the
// low parts of pi/2 and pi/4).
template <class F>
BELTSCAPE_INLINE F arc_tangent(F a) {
    const MaskOf<F> is_steep = a > 2.41421356f, is_middle = a > 0.414213562f;
    const F turned = select(is_steep, -1.0f / a, (a - 1.0f) / (a + 1.0f));
    const F x = select(is_middle, turned, a), xx = x * x;
    const F series = multiply_add(
        xx, multiply_add(xx, multiply_add(xx, 8.05374449538e-2f, -1.38776856032e-1f), 1.99777106478e-1f),
        -3.33329491539e-1f);
    const F high = select(is_steep, broadcast<F>(1.57079637f), broadcast<F>(0.785398185f));
    const F low = select(is_steep, broadcast<F>(-4.37113883e-8f), broadcast<F>(-2.18556941e-8f));
    const F angle = multiply_add(xx * series, x, x);
    return select(is_middle, high + (angle + low), angle);
}

// 0, 1, 2, ...: the columns of a row's lanes, for `broadcast<IntOf<F>>(x) + lane_numbers<F>()`.
template <class F>
BELTSCAPE_INLINE IntOf<F> lane_numbers() {
    IntOf<F> lanes{};
    for (int i = 0; i < Lane<F>::count; ++i) Lane<IntOf<F>>::set(lanes, i, i);
    return lanes;
}

}  // namespace beltscape
