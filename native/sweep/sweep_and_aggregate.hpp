// Sweep and aggregation of an image in bands of rows: a band is aggregated together with a halo on either
// side, and only its middle is kept. The costs of several bands (a slab) are held at once, so that each row
// is swept once; their number does not change the result.
#pragma once

#include <cstring>

#include "parallel.hpp"
#include "pool.hpp"
#include "sweep/aggregate.hpp"
#include "sweep/sweep_band.hpp"

namespace beltscape {

struct SweepAndAggregateInput : PlanesInput {
    int small_jump, large_jump;
    int band_rows, halo_rows, slab_rows;  // slab_rows: a multiple of band_rows

    void fields(const auto& read) {
        PlanesInput::fields(read);
        read("small_jump", small_jump), read("large_jump", large_jump);
        read("band_rows", band_rows), read("halo_rows", halo_rows), read("slab_rows", slab_rows);
    }
};

template <class Cell>
class CoarseSearch {
public:
    CoarseSearch(const SweepAndAggregateInput& input, std::size_t threads)
        : input_(input),
          problem_(input, threads),
          threads_(threads),
          width_(input.core.shape[1]),
          row_size_(width_ * static_cast<std::size_t>(input.planes)),
          costs_(row_size_ * static_cast<std::size_t>(
                                 std::min(input.core.height(), input.slab_rows + 2 * input.halo_rows))) {}

    // index and margin (height, width)
    void search(float* index, float* margin) {
        const int height = input_.core.height(), halo = input_.halo_rows;
        for (int start = 0; start < height; start += input_.slab_rows) {
            const int end = std::min(height, start + input_.slab_rows);
            sweep_to(std::max(0, start - halo), std::min(height, end + halo));
            for_bands(start, end, input_.band_rows, threads_, [&](int first, int last) {
                const auto aggregator = aggregators_.take([&] {
                    return std::make_unique<Aggregator<Cell>>(input_.core.width(), input_.planes,
                                                              input_.small_jump, input_.large_jump);
                });
                const std::size_t at = static_cast<std::size_t>(first) * width_;
                aggregator->aggregate(band(first, last), index + at, margin + at);
            });
        }
    }

private:
    std::uint8_t* row(int y) const {
        return costs_.data() + static_cast<std::size_t>(y - first_) * row_size_;
    }

    // Computes the costs of rows first ... last - 1, and moves those that are already there.
    void sweep_to(int first, int last) {
        std::memmove(costs_.data(), row(first), static_cast<std::size_t>(last_ - first) * row_size_);
        first_ = first;
        for_bands(last_, last, kStripRows, threads_, [&](int start, int end) {
            const auto sweeper = sweepers_.take([&] { return std::make_unique<Sweeper>(problem_); });
            sweeper->sweep(start, end, row(start));
        });
        last_ = last;
    }

    CostBand band(int keep_first, int keep_last) const {
        const int first = std::max(first_, keep_first - input_.halo_rows),
                  last = std::min(last_, keep_last + input_.halo_rows);
        return {row(first), row(last), last - first, keep_first - first, keep_last - first};
    }

    const SweepAndAggregateInput& input_;
    SweepProblem problem_;
    std::size_t threads_, width_, row_size_;
    CellBuffer<std::uint8_t> costs_;
    int first_ = 0, last_ = 0;  // the rows it holds
    Pool<Sweeper> sweepers_;
    Pool<Aggregator<Cell>> aggregators_;
};

inline void sweep_and_aggregate(const SweepAndAggregateInput& in, std::size_t threads, Grid<float> index,
                                Grid<float> margin) {
    if (fits_bytes(in.small_jump, in.large_jump))
        CoarseSearch<std::uint8_t>(in, threads).search(index.data, margin.data);
    else
        CoarseSearch<Word>(in, threads).search(index.data, margin.data);
}

}  // namespace beltscape
