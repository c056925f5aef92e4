"""The CUDA back end: the kernels of matching on a GPU, from the same headers as the native ones.

`backend` runs a plan of launches for each kernel that the device has and calls the native back end for the others. A
plan (`sweep`) gets a `workspace`, with arrays in `memory` that a pool hands out again, and is written once for two
devices (`device`): `cuda_device` compiles native/cuda with NVRTC and runs it on a GPU by cuda-core; `emulated_device`
runs the same kernels on the CPU, which is how they are tested. What the plans launch within a function is recorded
(`recording`, `recorded_values`) and afterwards launched as one graph (`graphs`) with memory of its own (`storage`).
"""
