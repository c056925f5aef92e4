// What a kernel needs beside the shared headers. NVRTC compiles kernels for the GPU, the emulation for the
// CPU; BELTSCAPE_SHARED(T, name, count) is an array of a block, dynamic_shared<T>() the one whose size the
// launch gives.
#pragma once

#ifdef __CUDACC__
#define BELTSCAPE_SHARED(T, name, count) __shared__ T name[count]
#else
#include "emulation/emulation.hpp"
#endif

#include "view.hpp"

namespace beltscape {

inline constexpr unsigned kWholeWarp = 0xffffffffu;
inline constexpr int kWarpSize = 32;

#ifdef __CUDACC__
extern __shared__ __align__(16) unsigned char dynamic_shared_bytes[];
template <class T>
__device__ T* dynamic_shared() {
    return reinterpret_cast<T*>(dynamic_shared_bytes);
}
#endif

// This thread's column, row and layer of the grid.
__device__ inline int grid_x() { return static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); }
__device__ inline int grid_y() { return static_cast<int>(blockIdx.y * blockDim.y + threadIdx.y); }
__device__ inline int grid_z() { return static_cast<int>(blockIdx.z); }

// The i-th of packed projections (n, kViewFloats).
__device__ inline const View& view_at(const float* views, int i) {
    return reinterpret_cast<const View*>(views)[i];
}

// The i-th array of a table of addresses on the device.
template <class T>
__device__ inline const T* array_at(const unsigned long long* addresses, int i) {
    return reinterpret_cast<const T*>(addresses[i]);
}

// The least of all lanes' values, for each of them.
__device__ inline unsigned least_of_warp(unsigned value) {
    for (int by = kWarpSize / 2; by > 0; by /= 2) {
        const unsigned other = __shfl_xor_sync(kWholeWarp, value, by);
        value = other < value ? other : value;
    }
    return value;
}

}  // namespace beltscape
