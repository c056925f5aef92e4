// All kernels of the CUDA back end: what NVRTC compiles for the GPU and the emulation for the CPU.
#pragma once

#include "cuda/aggregate.cuh"
#include "cuda/expression.cuh"
#include "cuda/images.cuh"
#include "cuda/least_squares.cuh"
#include "cuda/networks.cuh"
#include "cuda/photometry.cuh"
#include "cuda/pixels.cuh"
#include "cuda/planes.cuh"
#include "cuda/propagate.cuh"
#include "cuda/selection.cuh"
#include "cuda/statistics.cuh"
#include "cuda/sweep.cuh"
#include "cuda/visibility.cuh"
