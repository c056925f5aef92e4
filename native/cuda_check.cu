// Every header that CUDA shares with the CPU, made into device code with F = float (or double). Nothing runs
// it: tests/kernels/test_cuda_compile.py compiles it with NVRTC, which needs no GPU. A new shared header adds
// its include and one kernel here.
#include "geometry/triangulate.hpp"
#include "geometry/visibility.hpp"
#include "images/gathering.hpp"
#include "images/prefilter.hpp"
#include "images/warp.hpp"
#include "least_squares/local_fit.hpp"
#include "least_squares/normal_equations.hpp"
#include "networks/message_passing.hpp"
#include "networks/network.hpp"
#include "selection/candidate_list.hpp"
#include "selection/candidate_surfaces.hpp"
#include "selection/multiview_cost.hpp"
#include "selection/photo_consistency.hpp"
#include "selection/semi_global.hpp"
#include "simd.hpp"
#include "sweep/aligned_image.hpp"
#include "sweep/plane_sweep.hpp"

namespace beltscape {

__global__ void check_triangulate(TriangulationInput in, double* out) {
    const size_t point = blockIdx.x * blockDim.x + threadIdx.x;
    if (point < in.points()) triangulate_lanes<double>(in, point, 1, out);
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

__global__ void check_lens(View view, const float* s, int width, float* out) {
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    if (x < width)
        out[x] = see_moving<true>(view, to_float(x), 0.0f, s[x]).du +
                 see_moving<false>(view, to_float(x), 0.0f, s[x]).du + arc_tangent(s[x]);
}

// A thread takes a row, then a column.
__global__ void check_prefilter(float* image, int width, int height) {
    const int line = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    const size_t step = static_cast<size_t>(width);
    if (line < height) prefilter_rows<1>(image + line * step, width, kGain * kGain, image + line * step);
    __syncthreads();
    if (line < width) prefilter_columns<float>(image + line, height, step, 1);
}

// A thread takes a pixel.
__global__ void check_warp(View view, Spline spline, const float* s, int width, float* value, float* slope) {
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x), row = static_cast<int>(blockIdx.y);
    const size_t at = row * static_cast<size_t>(width);
    if (x < width) warp_row<float>(view, spline, s + at, row, x, x + 1, value + at, slope + at);
}

// A thread takes a row.
__global__ void check_occlusion(View view, const float* s, int width, int height, float tolerance,
                                float* corners, float* buffer, unsigned char* out) {
    const int row = static_cast<int>(blockIdx.x);
    const size_t at = row * static_cast<size_t>(width);
    splat_row<float>(view, s + at, row, 0, width, width, height, corners);
    spread_row<float>(corners, row, 0, width, width, buffer + at);
    visible_row<float>(view, s + at, row, 0, width, width, height, buffer, tolerance, out + at);
}

// A thread takes a pixel and gathers its window itself.
__global__ void check_sweep(View view, Image core, Image image, PlaneRange range, float floor, float* out) {
    const AlignedShift shift = aligned_shift(view);
    const Field field = aligned_field(shift, range, core.width, core.height);
    const PlanePlace place = shift.place(range.inverse_depth(static_cast<int>(blockIdx.z)));
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x), y = static_cast<int>(blockIdx.y);
    WindowSums<float> sums{}, own{};
    for (int i = 0; i < 9; ++i) {
        const int column = clamp(x + i % 3 - 1, 0, core.width - 1),
                  row = clamp(y + i / 3 - 1, 0, core.height - 1);
        const float a = core.pixels[static_cast<size_t>(row) * core.width + column];
        const float* const aligned = out + static_cast<size_t>(row) * core.width;
        float b = aligned_level<float>(view, image, to_float(field.left + column), to_float(field.top + row));
        resample<float>(aligned, aligned + core.width, 0.5f, place.scale, place.u, core.width, 1, &b);
        own.aux += a, own.aux_squared += a * a;
        sums.aux += b, sums.aux_squared += b * b, sums.product += a * b;
    }
    if (x < core.width)
        out[static_cast<size_t>(y) * core.width + x] =
            dissimilarity(sums, core_window(own.aux, own.aux_squared, floor), floor);
}

// A thread takes a pixel.
__global__ void check_fit(FitField field, FitWindows windows, FitRow all, int width) {
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x), row = static_cast<int>(blockIdx.y);
    const size_t at = row * static_cast<size_t>(width);
    const FitField here = {field.s + row * field.stride, field.information + row * field.stride,
                           field.pull + row * field.stride, field.stride};
    if (x < width) fit_row<float>(here, windows, row_of(all, at), x, x + 1);
}

__global__ void check_field(const float* information, const float* pull, const float* s, float prior,
                            int width, float* out) {
    field_row<float>(information, pull, s, prior, width, out, out + width, out + 2 * width);
}

// A thread takes a row.
__global__ void check_normal_equations(NormalSettings settings, const float* core, const float* const* rows,
                                       CoreNormals normals, float* there, float* grey, float* slope,
                                       float* sums, Residuals view, Equations out, int width) {
    const int margin = settings.window, count = 2 * margin + 1;
    core_row<float>(core, width, grey, there);
    repeat_ends(grey, width, margin);
    column_sums<float>(rows, count, width, margin, sums);
    part_row<float>(sums, margin, width, normals.part);
    column_sums<float>(rows, count, width, margin, sums, sums + width);
    core_normals_row<float>(settings, grey, sums, sums + width, width, normals);
    complete_row<float>(grey, there, width, view.value, slope);
    residuals_row<float>(settings, normals, grey, slope, sums, sums + width, width, view);
    equations_row<float>(settings, &view, 1, normals.part, width, out);
}

// A thread takes a pixel: a candidate from an offset, its cost in one view, its place, and one path's step.
__global__ void check_propagate(Surface surface, Offset offset, View view, Image image, const float* buffer,
                                float tolerance, CandidatePlaces places, PreviousCandidates before,
                                Jumps jumps, float* tolls) {
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x), y = static_cast<int>(blockIdx.y);
    const Candidate<float> given = shifted_candidate<float>(surface, offset, x, y);
    const SampledPoint<float> seen = sample_point(view, image, to_float(x), to_float(y), given.s);
    const float clear = unoccluded(buffer, &seen.row, seen.spot.u, seen.inverse_depth, tolerance);
    MultiviewCost<float> multiview_cost;
    multiview_cost.add(bilinear(image, &seen.spot.index, seen.spot.u, seen.spot.v), clear);
    insert_candidate(places, given, multiview_cost.cost(0.35f), 0.4f, finite(given.s));
    tolls[x] = least_path_cost(before, given.s, given.slope_u, jumps);
    level_out<float>(tolls, places.count, places.stride);
}

// A thread takes a pixel.
__global__ void check_perceptron(Network net, const float* const* planes, float* const* out) {
    evaluate_network_pixels<float>(net, planes, blockIdx.x * blockDim.x + threadIdx.x, 1, out);
}

// A thread takes a pixel.
__global__ void check_message_passing(Network net, Messages messages, float* const* out) {
    pass_messages_lanes<float>(net, messages, blockIdx.x * blockDim.x + threadIdx.x, 1, out);
}

__global__ void check_neighbours(const float* plane, int width, int height, const float* u, const float* v,
                                 const Offset* offsets, float* out) {
    const size_t pixel = blockIdx.x * blockDim.x + threadIdx.x;
    neighbours<float>(plane, width, height, u + pixel, v + pixel, offsets->dx, offsets->dy, 1, out + pixel);
}

// A thread takes a pixel: all its candidates, then the photo-consistency of each.
__global__ void check_candidates(CandidateSearch search, PhotoConsistencyProblem in, const float* u,
                                 const float* v, Planes at, float* gains, CandidateRows candidates,
                                 float* out) {
    const size_t pixel = blockIdx.x * blockDim.x + threadIdx.x;
    find_candidates(search, static_cast<int>(u[pixel]), static_cast<int>(v[pixel]), candidates, pixel);
    CoreCross<float> cross;
    cross.gains = gains + pixel * static_cast<size_t>(in.auxiliary_count);
    read_cross(in, u + pixel, v + pixel, 1, cross);
    photo_consistency_lanes(in, cross, {at.s + pixel, at.slope_u + pixel, at.slope_v + pixel}, 1, out + pixel,
                            candidates.stride);
}

}  // namespace beltscape
