// Kernels that are right and kernels that are wrong, for test_emulation.py: runs the one that is named with a
// seed, and prints its results or what the emulation finds.
#include <cstdio>
#include <cstdlib>
#include <string>

#include "cuda/device.hpp"

namespace beltscape {

constexpr int kThreads = 64;

// Every thread reads the place that another one writes.
__global__ void turned(int* out) {
    BELTSCAPE_SHARED(int, places, kThreads);
    const int own = static_cast<int>(threadIdx.x);
    places[own] = own;
    __syncthreads();
    out[blockIdx.x * kThreads + threadIdx.x] = places[kThreads - 1 - own];
}

__global__ void turned_without_barrier(int* out) {
    BELTSCAPE_SHARED(int, places, kThreads);
    const int own = static_cast<int>(threadIdx.x);
    places[own] = own;
    out[blockIdx.x * kThreads + threadIdx.x] = places[kThreads - 1 - own];
}

__global__ void last_block_wins(int* out) { out[threadIdx.x] = static_cast<int>(blockIdx.x); }

__global__ void warp_operations(int* out) {
    const int own = static_cast<int>(threadIdx.x), lane = own % kWarpSize;
    const int up = __shfl_up_sync(kWholeWarp, own, 1), down = __shfl_down_sync(kWholeWarp, own, 2);
    const int across = __shfl_xor_sync(kWholeWarp, own, 16), third = __shfl_sync(kWholeWarp, own, 3);
    const unsigned odd = __ballot_sync(kWholeWarp, lane % 2 == 1);
    const int any = __any_sync(kWholeWarp, own == 40), all = __all_sync(kWholeWarp, own >= 32);
    const int least = static_cast<int>(least_of_warp(static_cast<unsigned>(own)));
    int half = 0;  // the upper lanes alone
    if (lane >= 16) half = __shfl_sync(0xffff0000u, own, 16);
    const int found[] = {up,  down, across, third, static_cast<int>(odd >> 1 & 0x7fffffff),
                         any, all,  least,  half};
    int code = 0;
    for (const int value : found) code = (code * 31 + value) % 1000003;
    out[blockIdx.x * kThreads + threadIdx.x] = code;
}

// Threads that have ended are not waited for at a barrier of the block.
__global__ void half_ends(int* out) {
    out[blockIdx.x * kThreads + threadIdx.x] = 1;
    if (threadIdx.x >= 32) return;
    __syncthreads();
    out[blockIdx.x * kThreads + threadIdx.x] = 2;
}

__global__ void different_barriers(int* out) {
    if (threadIdx.x % 2)
        __syncthreads();
    else
        __syncthreads();
    out[threadIdx.x] = 1;
}

__global__ void shuffle_with_ended(int* out) {
    if (threadIdx.x == 5) return;
    out[threadIdx.x] = __shfl_xor_sync(kWholeWarp, 1, 1);
}

__global__ void lane_outside_mask(int* out) {
    if (threadIdx.x % 32 < 16) out[threadIdx.x] = __shfl_sync(0xffffu, 1, 20);
}

__global__ void past_shared_memory(int* out) {
    BELTSCAPE_SHARED(int, places, 8);
    places[8] = 1;
    out[0] = places[8];
}

__global__ void past_dynamic_memory(int* out) { dynamic_shared<int>()[2] = out[0]; }

__global__ void unwritten_shared_memory(int* out) {
    BELTSCAPE_SHARED(int, places, kThreads);
    out[blockIdx.x * kThreads + threadIdx.x] = places[threadIdx.x];
    places[threadIdx.x] = 7;
}

}  // namespace beltscape

int main(int, char** arguments) {
    using namespace beltscape;
    const std::string name = arguments[1];
    const std::pair<const char*, void (*)(int*)> kernels[] = {
        {"turned", turned},
        {"turned_without_barrier", turned_without_barrier},
        {"last_block_wins", last_block_wins},
        {"warp_operations", warp_operations},
        {"half_ends", half_ends},
        {"different_barriers", different_barriers},
        {"shuffle_with_ended", shuffle_with_ended},
        {"lane_outside_mask", lane_outside_mask},
        {"past_shared_memory", past_shared_memory},
        {"past_dynamic_memory", past_dynamic_memory},
        {"unwritten_shared_memory", unwritten_shared_memory},
        {"too_many_threads", turned},
        {"too_much_memory", turned}};
    int out[4 * kThreads] = {};
    try {
        for (const auto& [known, kernel] : kernels)
            if (name == known)
                emulation::launch(kernel, {4, 1, 1}, {name == "too_many_threads" ? 1025u : kThreads, 1, 1},
                                  name == "too_much_memory" ? 49153 : 8,
                                  static_cast<std::uint64_t>(std::atoi(arguments[2])), std::tuple<int*>{out});
    } catch (const std::runtime_error& error) {
        std::printf("%s\n", error.what());
        return 1;
    }
    for (const int value : out) std::printf("%d ", value);
}
