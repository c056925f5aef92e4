// All kernels of the CUDA back end: what NVRTC compiles for the GPU and the emulation for the CPU.
#pragma once

#include "cuda/aggregate.cuh"
#include "cuda/least_squares.cuh"
#include "cuda/networks.cuh"
#include "cuda/sweep.cuh"
