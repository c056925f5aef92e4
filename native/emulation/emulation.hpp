// CUDA's execution model on the CPU, so that device code is tested where there is no GPU: blockIdx,
// threadIdx, shared memory, barriers and warp operations (the idea of HIP-CPU). A launch runs on the calling
// thread, block after block; a block's threads are fibers, and one runs until it waits or ends.
//
// Seed 0 runs blocks and threads in the order of their numbers. Any other seed permutes the blocks and draws
// which thread runs next, so that a result which depends on the order differs from seed to seed. A launch
// fails where threads wait at different barriers or for threads that have ended, where a lane outside a mask
// is read, and where shared memory is exceeded. It shows nothing about speed, and no race of two threads
// whose pieces between barriers give the same result in either order.
#pragma once

#include <cstdint>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "emulation/block.hpp"

#define __global__
#define __device__

namespace beltscape {

namespace emulation {

inline constexpr unsigned kMostThreads = 1024, kMostBlocks = 65535;  // of a block; of a grid along y and z
inline constexpr std::size_t kMostSharedBytes = 48 << 10;            // without a driver's leave

inline void check_sizes(dim3 grid, dim3 block, std::size_t shared_bytes) {
    const unsigned threads = block.x * block.y * block.z;
    if (threads < 1 || threads > kMostThreads || block.z > 64)
        throw std::runtime_error("a block has 1 to 1024 threads");
    if (grid.x < 1 || grid.y < 1 || grid.z < 1 || grid.y > kMostBlocks || grid.z > kMostBlocks)
        throw std::runtime_error("a grid has at least one block, and at most 65535 along y and z");
    if (shared_bytes > kMostSharedBytes)
        throw std::runtime_error("a block has at most 48 KB of shared memory");
}

inline std::vector<unsigned> order_of(unsigned count, std::uint64_t seed) {
    std::vector<unsigned> order(count);
    std::iota(order.begin(), order.end(), 0u);
    Random random(seed);
    for (unsigned i = count; seed && i > 1; --i) std::swap(order[i - 1], order[random.below(i)]);
    return order;
}

// Runs a kernel on a grid of blocks, or throws std::runtime_error.
template <class... Parameter>
void launch(void (*kernel)(Parameter...), dim3 grid, dim3 block, std::size_t shared_bytes, std::uint64_t seed,
            const std::tuple<Parameter...>& arguments) {
    check_sizes(grid, block, shared_bytes);
    gridDim = grid, blockDim = block;
    auto call = std::pair{kernel, arguments};
    Block threads(
        [](void* data) {
            std::apply(static_cast<decltype(call)*>(data)->first, static_cast<decltype(call)*>(data)->second);
        },
        &call, shared_bytes, seed);
    current_block = &threads;
    for (const unsigned number : order_of(count_of(grid), seed)) threads.run(index_of(number, grid));
}

template <class T>
std::uint64_t packed(T value) {
    static_assert(sizeof(T) <= sizeof(std::uint64_t));
    std::uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof value);
    return bits;
}
template <class T>
T unpacked(std::uint64_t bits) {
    T value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

// This lane's value of T that lane `from` gives; lanes of the mask meet here.
template <class T>
T shuffle(unsigned mask, T value, unsigned from, const Location& where) {
    const std::uint64_t* const values = current_block->exchange(mask, packed(value), where);
    return unpacked<T>(current_block->lane_value(values, mask, from, where));
}

template <class T, int count, unsigned line>
T* shared_array() {
    static constexpr char key = 0;
    return reinterpret_cast<T*>(current_block->shared(&key, count * sizeof(T)));
}

}  // namespace emulation

#define BELTSCAPE_SHARED(T, name, count) T* const name = emulation::shared_array<T, count, __LINE__>()

template <class T>
T* dynamic_shared() {
    return reinterpret_cast<T*>(emulation::current_block->dynamic_shared());
}

inline float __uint_as_float(unsigned bits) {
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

inline void __syncthreads(const emulation::Location& where = emulation::Location::current()) {
    emulation::current_block->wait_for_all(where);
}
inline void __syncwarp(unsigned mask = ~0u,
                       const emulation::Location& where = emulation::Location::current()) {
    emulation::current_block->exchange(mask, 0, where);
}

// A lane beyond the warp's ends gives its own value, as on the GPU.
template <class T>
T __shfl_sync(unsigned mask, T value, int lane,
              const emulation::Location& where = emulation::Location::current()) {
    return emulation::shuffle(mask, value, static_cast<unsigned>(lane) % 32, where);
}
template <class T>
T __shfl_up_sync(unsigned mask, T value, unsigned by,
                 const emulation::Location& where = emulation::Location::current()) {
    const unsigned own = emulation::current_block->lane();
    return emulation::shuffle(mask, value, own < by ? own : own - by, where);
}
template <class T>
T __shfl_down_sync(unsigned mask, T value, unsigned by,
                   const emulation::Location& where = emulation::Location::current()) {
    const unsigned own = emulation::current_block->lane();
    return emulation::shuffle(mask, value, own + by > 31 ? own : own + by, where);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T value, int by,
                  const emulation::Location& where = emulation::Location::current()) {
    const unsigned own = emulation::current_block->lane();
    return emulation::shuffle(mask, value, own ^ static_cast<unsigned>(by), where);
}

inline unsigned __ballot_sync(unsigned mask, bool value,
                              const emulation::Location& where = emulation::Location::current()) {
    const std::uint64_t* const values = emulation::current_block->exchange(mask, value, where);
    unsigned lanes = 0;
    for (unsigned lane = 0; lane < 32; ++lane)
        if (mask >> lane & 1 && values[lane]) lanes |= 1u << lane;
    return lanes;
}
inline bool __any_sync(unsigned mask, bool value,
                       const emulation::Location& where = emulation::Location::current()) {
    return __ballot_sync(mask, value, where) != 0;
}
inline bool __all_sync(unsigned mask, bool value,
                       const emulation::Location& where = emulation::Location::current()) {
    return __ballot_sync(mask, value, where) == mask;
}

}  // namespace beltscape
