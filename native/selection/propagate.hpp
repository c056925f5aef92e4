// Candidate propagation on the CPU: all candidates, in strips of a tile's height, then the selection in bands
// of rows. Paths begin at the edge of a halo around the band.
#pragma once

#include <optional>

#include "parallel.hpp"
#include "pool.hpp"
#include "selection/propagate_select.hpp"
#include "selection/propagate_tile.hpp"
#include "sweep/sweep_band.hpp"

namespace beltscape {

struct PropagationInput {
    SurfaceInput surface;
    Grid<const float> core;
    std::vector<Grid<const float>> images;
    PackedViews views;
    std::vector<Grid<const float>> buffers;
    Array<const std::int32_t, kAny, 2> offsets;
    int candidates;
    PropagationCosts costs;
    std::optional<Grid<const std::uint8_t>> active;  // none: all pixels are

    void fields(const auto& read) {
        read("surface", surface), read("core", core), read("images", images), read("views", views);
        read("buffers", buffers), read("offsets", offsets), read("candidates", candidates);
        read("costs", costs), read("active", active);
    }
};

// The candidates of every match, by the Python signature. With loops for them a call takes 7 % less time.
inline constexpr int kUsualCandidates = 5;

// See `Tile` for `fixed`.
template <int fixed>
void select_candidates(const PropagationProblem& problem, std::size_t threads, const PropagationResult& out) {
    const int width = problem.surface.width, height = problem.surface.height;
    CandidateStore store{problem};
    Pool<Tile<fixed>> tiles;
    for_bands(0, height, kTileRows, threads, [&](int first, int end) {
        const auto tile = tiles.take([&] { return std::make_unique<Tile<fixed>>(problem, store); });
        for (int row = first; row < end; ++row) store.mark_active(row);
        for (int left = 0; left < width; left += kTileColumns)
            tile->work(left, first, std::min(kTileColumns, width - left), end - first);
    });
    Pool<Selector<fixed>> selectors;
    for_bands(0, height, kBandRows, threads, [&](int first, int end) {
        const auto selector =
            selectors.take([&] { return std::make_unique<Selector<fixed>>(problem, store, kBandRows); });
        selector->choose(std::max(0, first - kHaloRows), std::min(height, end + kHaloRows), first, end, out);
    });
}

// out: s, slope_u, slope_v, cost, margin.
inline void propagate(const PropagationInput& in, std::size_t threads, const std::vector<Grid<float>>& out) {
    const std::vector<Auxiliary> auxiliaries = auxiliaries_of(in.images, in.views, in.buffers);
    std::vector<Offset> offsets{{0, 0}};
    for (std::size_t i = 0; i < in.offsets.shape[0]; ++i)
        offsets.push_back({in.offsets[2 * i], in.offsets[2 * i + 1]});
    const PropagationProblem problem{surface_of(in.surface),
                                     in.core.data,
                                     auxiliaries.data(),
                                     static_cast<int>(auxiliaries.size()),
                                     offsets.data(),
                                     static_cast<int>(offsets.size()),
                                     in.candidates,
                                     in.costs,
                                     mean_level(image_of(in.core)),
                                     in.active ? in.active->data : nullptr};
    const PropagationResult to{out[0].data, out[1].data, out[2].data, out[3].data, out[4].data};
    if (in.candidates == kUsualCandidates)
        select_candidates<kUsualCandidates>(problem, threads, to);
    else
        select_candidates<0>(problem, threads, to);
}

}  // namespace beltscape
