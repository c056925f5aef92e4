// Photo-consistency of a small plane: squared differences of the core's and the auxiliaries' levels, after
// the photometric gain, over their variance. Close to a depth step no window lies on one surface, so levels
// are not normalised here.
#pragma once

#include "selection/candidate_list.hpp"
#include "selection/multiview_cost.hpp"

namespace beltscape {

inline constexpr float kMostDissimilar =
    50.0f;                        // upper bound of a difference, and its value where no view sees the point
inline constexpr int kCross = 5;  // the pixel and the four beside it
inline constexpr int kConsistencyRows = 9;

struct PhotoConsistencyProblem {
    const float *core, *variance;  // (height, width)
    int width, height;
    const Auxiliary* auxiliaries;
    const float* const* gains;  // by auxiliary (height, width): its levels times this are the core's
    int auxiliary_count;
    float tolerance;
};

struct Planes {
    const float *s, *slope_u, *slope_v;
};

// Order statistics of the values of the views that see a point.
template <class F>
struct Ordered {
    F least = broadcast<F>(kMostDissimilar), second = broadcast<F>(kMostDissimilar), sum{}, most{};

    BELTSCAPE_INLINE void add(F value, F seen) {
        const F counted = select(seen > 0.5f, value, broadcast<F>(kMostDissimilar));
        second = lesser(second, greater(least, counted)), least = lesser(least, counted);
        sum += value * seen, most = greater(most, value * seen);
    }
    // least, second, mean, most of `views` values into rows `stride` apart.
    BELTSCAPE_INLINE void write(F views, float* out, size_t stride, int count) const {
        const MaskOf<F> none = views < 0.5f;
        const F unlike = broadcast<F>(kMostDissimilar);
        store_first(out, least, count);
        store_first(out + stride, select(views > 1.5f, second, least), count);
        store_first(out + 2 * stride, select(none, unlike, sum / greater(views, broadcast<F>(1.0f))), count);
        store_first(out + 3 * stride, select(none, unlike, most), count);
    }
};

// The projection of points (u, v) at inverse depth s into a view, and their inverse depth from it.
template <class F>
struct Sampled {
    Spot<F> spot;
    F inverse_depth;
};

template <class F>
BELTSCAPE_INLINE Sampled<F> sampled(const Auxiliary& by, F u, F v, F s) {
    const auto [seen_u, seen_v, inverse_depth] = see(by.view, u, v, s);
    return {spot(by.image, seen_u, seen_v, finite(inverse_depth)), inverse_depth};
}

template <class F>
BELTSCAPE_INLINE F level_at(const Auxiliary& by, const Spot<F>& spot) {
    int index[Lane<F>::count];
    store(index, spot.index);
    return bilinear(by.image, index, spot.u, spot.v);
}

template <class F>
BELTSCAPE_INLINE F clear_at(const Auxiliary& by, const Sampled<F>& sample, float tolerance) {
    int nearest[Lane<F>::count];
    store(nearest, nearest_pixel(sample.spot, by.image));
    const F seen = unoccluded(by.buffer, nearest, sample.spot.u, sample.inverse_depth, tolerance);
    return select(sample.spot.u >= 0.0f, seen, F{});
}

// The core's levels at a pixel and the four beside it, one over their variance, and the gains of each
// auxiliary at the pixel.
template <class F>
struct CoreCross {
    F u, v, level[kCross], weight[kCross];
    float* gains;  // Lane<F>::count to an auxiliary
};

BELTSCAPE_INLINE Offset cross_offset(int i) {
    constexpr int across[kCross] = {0, 1, -1, 0, 0}, down[kCross] = {0, 0, 0, 1, -1};
    return {across[i], down[i]};
}

// Reads the cross about at most `count` pixels.
template <class F>
BELTSCAPE_INLINE void read_cross(const PhotoConsistencyProblem& in, const float* u, const float* v, int count,
                                 CoreCross<F>& cross) {
    cross.u = load_first<F>(u, count), cross.v = load_first<F>(v, count);
    const IntOf<F> column = to_int(cross.u), row = to_int(cross.v);
    for (int i = 0; i < kCross; ++i) {
        const auto [dx, dy] = cross_offset(i);
        const IntOf<F> pixel =
            clamp(row + dy, 0, in.height - 1) * in.width + clamp(column + dx, 0, in.width - 1);
        cross.level[i] = gather(in.core, pixel), cross.weight[i] = 1.0f / gather(in.variance, pixel);
    }
    for (int k = 0; k < in.auxiliary_count; ++k)
        store(cross.gains + k * Lane<F>::count, gather(in.gains[k], row * in.width + column));
}

// Evaluates at most `count` planes at the pixels of `at`; out: point least, second, mean, most; cross the
// same; views.
template <class F>
BELTSCAPE_INLINE void photo_consistency_lanes(const PhotoConsistencyProblem& in, const CoreCross<F>& at,
                                              const Planes& planes, int count, float* out, size_t stride) {
    const F s = load_first<F>(planes.s, count);
    const F slope_u = load_first<F>(planes.slope_u, count), slope_v = load_first<F>(planes.slope_v, count);
    Ordered<F> point, cross;
    F views{};
    for (int k = 0; k < in.auxiliary_count; ++k) {
        const Auxiliary& by = in.auxiliaries[k];
        const F gain = load<F>(at.gains + k * Lane<F>::count);
        F middle{}, sum{}, seen{};
        for (int i = 0; i < kCross; ++i) {
            const float du = to_float(cross_offset(i).dx), dv = to_float(cross_offset(i).dy);
            const Sampled<F> sample = sampled(by, at.u + du, at.v + dv, s + slope_u * du + slope_v * dv);
            const F off = at.level[i] - gain * level_at(by, sample.spot);
            const F unlike = lesser(off * off * at.weight[i], broadcast<F>(kMostDissimilar));
            if (i == 0) middle = unlike, seen = clear_at(by, sample, in.tolerance);
            sum += unlike;
        }
        point.add(middle, seen), cross.add(sum * (1.0f / to_float(kCross)), seen), views += seen;
    }
    point.write(views, out, stride, count), cross.write(views, out + 4 * stride, stride, count);
    store_first(out + 8 * stride, views, count);
}

#ifndef __CUDACC__
struct PhotoConsistencyInput {
    List<const float> u, v;                   // columns and rows of the pixels
    std::array<Grid<const float>, 3> planes;  // s, slope_u, slope_v, each (planes, pixels)
    Grid<const float> core, variance;
    std::vector<Grid<const float>> images;
    PackedViews views;
    std::vector<Grid<const float>> buffers, gains;
    float tolerance;

    void fields(const auto& read) {
        read("u", u), read("v", v), read("planes", planes), read("core", core), read("variance", variance);
        read("images", images), read("views", views), read("buffers", buffers), read("gains", gains);
        read("tolerance", tolerance);
    }
};

// out (9 planes, pixels): the fields of PhotoConsistency one below another.
inline void photo_consistency(const PhotoConsistencyInput& in, std::size_t threads, Grid<float> out) {
    const std::vector<Auxiliary> auxiliaries = auxiliaries_of(in.images, in.views, in.buffers);
    std::vector<const float*> gains;
    for (const Grid<const float>& gain : in.gains) gains.push_back(gain.data);
    const PhotoConsistencyProblem problem{in.core.data,
                                          in.variance.data,
                                          in.core.width(),
                                          in.core.height(),
                                          auxiliaries.data(),
                                          gains.data(),
                                          static_cast<int>(auxiliaries.size()),
                                          in.tolerance};
    const auto& [s, slope_u, slope_v] = in.planes;
    const std::size_t count = in.u.shape[0], rows = s.shape[0];
    for_bands(0, static_cast<int>(count), kPixelsPerJob, threads, [&](int first, int end) {
        const std::size_t vectors = static_cast<std::size_t>((end - first + kFloatLanes - 1) / kFloatLanes);
        const std::size_t gain_floats = auxiliaries.size() * kFloatLanes;
        std::vector<CoreCross<Floats>> crosses(vectors);
        std::vector<float> cross_gains(vectors * gain_floats);
        for (std::size_t k = 0; k < vectors; ++k) {
            const int i = first + static_cast<int>(k) * kFloatLanes;
            crosses[k].gains = cross_gains.data() + k * gain_floats;
            read_cross(problem, in.u.data + i, in.v.data + i, end - i, crosses[k]);
        }
        for (std::size_t row = 0; row < rows; ++row)
            for (std::size_t k = 0; k < vectors; ++k) {
                const int i = first + static_cast<int>(k) * kFloatLanes;
                const std::size_t at = row * count + static_cast<std::size_t>(i);
                photo_consistency_lanes(problem, crosses[k],
                                        {s.data + at, slope_u.data + at, slope_v.data + at}, end - i,
                                        out.data + at, rows * count);
            }
    });
}
#endif

}  // namespace beltscape
