// Lanes: the number type a kernel is written over. A GCC vector on the CPU, a plain double elsewhere (CUDA,
// tests).
#pragma once

#include <cstddef>

namespace beltscape {

#if defined(__AVX512F__)
inline constexpr std::size_t kLanes = 8;
#elif defined(__AVX__)
inline constexpr std::size_t kLanes = 4;
#else
inline constexpr std::size_t kLanes = 2;
#endif

typedef double Doubles __attribute__((vector_size(kLanes * sizeof(double))));

// How many points one value of F carries, and how one of them is reached.
template <class F>
struct Lane;

template <>
struct Lane<double> {
    static constexpr std::size_t count = 1;
    static void set(double& lanes, std::size_t, double value) { lanes = value; }
    static double get(const double& lanes, std::size_t) { return lanes; }
};

template <>
struct Lane<Doubles> {
    static constexpr std::size_t count = kLanes;
    static void set(Doubles& lanes, std::size_t i, double value) { lanes[i] = value; }
    static double get(const Doubles& lanes, std::size_t i) { return lanes[i]; }
};

}  // namespace beltscape
