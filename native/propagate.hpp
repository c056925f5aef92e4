// Candidate propagation over a band of rows on the CPU: all candidates of the band and a halo around it, then
// the choice. Paths begin at the halo's edge.
#pragma once

#include "propagate_select.hpp"

namespace beltscape {

// At a width of 2448 and five candidates a workspace takes 25 MB.
inline constexpr int kBandRows = 128;
inline constexpr int kHaloRows = 12;

class Propagator {
public:
    explicit Propagator(const PropagateInput& in)
        : in_(in),
          tile_(in),
          selector_(in, std::min(in.surface.height, kBandRows + 2 * kHaloRows), kBandRows) {}

    void work(int keep_first, int keep_end, const PropagateOut& out) {
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
    const PropagateInput& in_;
    Tile tile_;
    Selector selector_;
};

}  // namespace beltscape
