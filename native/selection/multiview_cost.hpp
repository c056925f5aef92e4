// Samples of an auxiliary at a surface given by its inverse depth, row by row, and the mean dissimilarity of
// several views.
#pragma once

#include "parallel.hpp"
#include "sweep/plane_sweep.hpp"

namespace beltscape {

// An auxiliary: its image, and its buffer of the largest inverse depth (in units of s) in each pixel.
struct Auxiliary {
    View view;
    Image image;
    const float* buffer;
};

#ifndef __CUDACC__
inline std::vector<Auxiliary> auxiliaries_of(const std::vector<Grid<const float>>& images,
                                             const PackedViews& views,
                                             const std::vector<Grid<const float>>& buffers) {
    std::vector<Auxiliary> all;
    for (std::size_t i = 0; i < images.size(); ++i)
        all.push_back({view_of(views.data + kViewFloats * i), image_of(images[i]), buffers[i].data});
    return all;
}
#endif

// Where it sees a point: the footprint of a sample, of whose pixels the upper or lower left one is in the
// nearest row, and the inverse depth to it (NaN: not inside).
template <class F>
struct SampledPoint {
    Spot<F> spot;
    IntOf<F> row;
    F inverse_depth;
};

// The pixel nearest to a spot, or the one left of it where u is above a half.
template <class F>
BELTSCAPE_INLINE IntOf<F> nearest_pixel(const Spot<F>& spot, const Image& image) {
    return spot.index + select(spot.v >= 0.5f, broadcast<IntOf<F>>(image.width), IntOf<F>{});
}

// Columns x of row y at inverse depth s.
template <class F>
BELTSCAPE_INLINE SampledPoint<F> sample_point(const View& view, const Image& image, F x, float y, F s) {
    const float* d = view.direction;
    const float from_x = d[1] * y + d[2], from_y = d[4] * y + d[5], from_z = d[7] * y + d[8];
    const F inverse_depth = 1.0f / multiply_add(s, view.shift[2], multiply_add(x, d[6], from_z));
    const auto [u, v] =
        image_of(view, multiply_add(s, view.shift[0], multiply_add(x, d[0], from_x)) * inverse_depth,
                 multiply_add(s, view.shift[1], multiply_add(x, d[3], from_y)) * inverse_depth);
    const Spot<F> place = spot(image, u, v, inverse_depth > 0.0f);
    return {place, nearest_pixel(place, image),
            select(place.u >= 0.0f, s * inverse_depth, broadcast<F>(kNotANumber))};
}

// 1 where the buffer at the nearest pixel exceeds the point's inverse depth by at most `tolerance`, else 0.
template <class F>
BELTSCAPE_INLINE F unoccluded(const float* buffer, const int* row, F u, F inverse_depth, float tolerance) {
    const auto [left, right] = gather_pair<F>(buffer, row);
    return select(select(u >= 0.5f, right, left) <= inverse_depth + tolerance, broadcast<F>(1.0f), F{});
}

// The dissimilarities of the views that see a point: their mean, from three views on without the worst.
template <class F>
struct MultiviewCost {
    F views{}, sum{}, worst{};

    BELTSCAPE_INLINE void add(F dissimilarity, F seen) {
        views += seen, sum = multiply_add(dissimilarity, seen, sum),
                       worst = greater(worst, dissimilarity * seen);
    }
    BELTSCAPE_INLINE F cost(float unseen) const {
        const MaskOf<F> many = views > 2.5f;
        const F mean =
            select(many, sum - worst, sum) / select(many, views - 1.0f, greater(views, broadcast<F>(1.0f)));
        return select(views > 0.5f, mean, broadcast<F>(unseen));
    }
};

}  // namespace beltscape
