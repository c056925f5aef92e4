// Candidate propagation over a band of rows on the CPU: all candidates of the band and a halo around it, then
// the selection. Paths begin at the halo's edge.
#pragma once

#include <optional>

#include "parallel.hpp"
#include "pool.hpp"
#include "selection/propagate_select.hpp"
#include "sweep/sweep_band.hpp"

namespace beltscape {

// At a width of 2448 and five candidates a workspace takes 25 MB.
inline constexpr int kBandRows = 128;
inline constexpr int kHaloRows = 12;

class Propagator {
public:
    explicit Propagator(const PropagationProblem& in)
        : in_(in),
          tile_(in),
          selector_(in, std::min(in.surface.height, kBandRows + 2 * kHaloRows), kBandRows) {}

    void work(int keep_first, int keep_end, const PropagationResult& out) {
        const int first = std::max(0, keep_first - kHaloRows),
                  end = std::min(in_.surface.height, keep_end + kHaloRows);
        selector_.begin(first, end, keep_first, keep_end);
        for (int top = first; top < end; top += kTileRows)
            for (int left = 0; left < in_.surface.width; left += kTileColumns) {
                const int rows = std::min(kTileRows, end - top),
                          columns = std::min(kTileColumns, in_.surface.width - left);
                tile_.work(left, top, columns, rows);
                for (int row = 0; row < rows; ++row) selector_.take(tile_, row, top + row, left, columns);
            }
        selector_.choose(out);
    }

private:
    const PropagationProblem& in_;
    Tile tile_;
    Selector selector_;
};

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
    Pool<Propagator> propagators;
    for_bands(0, problem.surface.height, kBandRows, threads, [&](int first, int end) {
        const auto propagator = propagators.take([&] { return std::make_unique<Propagator>(problem); });
        propagator->work(first, end, to);
    });
}

}  // namespace beltscape
