// Every header that CUDA shares with the CPU, made into device code with F = float (or double). Nothing runs
// it: tests/kernels/test_cuda_compile.py compiles it with NVRTC, which needs no GPU. A new shared header adds
// its include and one kernel here.
#include "lanes.hpp"
#include "triangulate.hpp"

namespace beltscape {

__global__ void check_triangulate(TriangulateInput in, double* out) {
    const size_t point = blockIdx.x * blockDim.x + threadIdx.x;
    if (point < in.points) triangulate_lanes<double>(in, point, 1, out);
}

template <class F>
__device__ void every_operation(const float* in, const unsigned char* bytes, const unsigned short* words,
                                int count, int x, float* out) {
    const F a = load_first<F>(in + x, count - x), b = load<F>(bytes + x), c = load<F>(words + x);
    const IntOf<F> column = broadcast<IntOf<F>>(x) + lane_numbers<F>();
    const IntOf<F> index = clamp(greater(lesser(floor_int(a), absolute(column)), to_int(b)), 0, count - 1);
    const MaskOf<F> mask = (lesser(a, b) < greater(b, c)) & negate(not_a_number(a));
    const F sum = square_root(absolute(a)) + clamp(b, 0.0f, 1.0f) + to_float(select(mask, index, column));
    if (any(mask)) store(out + x, sum);
    store_first(out + x, select(mask, gather(in, index), gather(bytes, index) + gather(words, index)),
                count - x);
}

__global__ void check_lanes(const float* in, const unsigned char* bytes, const unsigned short* words,
                            int count, float* out) {
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (x < count) every_operation<float>(in, bytes, words, count, x, out);
}

}  // namespace beltscape
