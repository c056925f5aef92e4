// The candidates of all pixels, as the tiles find them and the selection reads them. A block of pixels
// without an active one keeps only the first place.
#pragma once

#include "selection/propagate_tile.hpp"

namespace beltscape {

// Places are (rows, candidates, stride); a pixel beyond a row's end is never written.
class CandidateStore {
public:
    explicit CandidateStore(const PropagationProblem& in)
        : in_(in),
          blocks_((in.surface.width + kBlock - 1) / kBlock),
          stride_(static_cast<std::size_t>(blocks_ * kBlock)),
          row_size_(stride_ * static_cast<std::size_t>(in.candidates)),
          s_(std::make_unique_for_overwrite<float[]>(size())),
          cost_(std::make_unique_for_overwrite<float[]>(size())),
          slope_u_(std::make_unique_for_overwrite<float[]>(size())),
          slope_v_(std::make_unique_for_overwrite<float[]>(size())),
          active_(static_cast<std::size_t>(in.surface.height * blocks_)) {}

    int blocks() const { return blocks_; }
    std::size_t stride() const { return stride_; }
    std::size_t row_size() const { return row_size_; }
    std::size_t at(int row, int k) const {
        return static_cast<std::size_t>(row) * row_size_ + static_cast<std::size_t>(k) * stride_;
    }
    bool active(int row, int block) const { return active_[static_cast<std::size_t>(row * blocks_ + block)]; }
    const float* s() const { return s_.get(); }
    const float* cost() const { return cost_.get(); }
    const float* slope_u() const { return slope_u_.get(); }
    const float* slope_v() const { return slope_v_.get(); }

    // Computes the candidates of rows first ... end - 1.
    void fill(Tile& tile, int first, int end) {
        for (int row = first; row < end; ++row) mark_active(row);
        for (int top = first; top < end; top += kTileRows)
            for (int left = 0; left < in_.surface.width; left += kTileColumns) {
                const int rows = std::min(kTileRows, end - top),
                          columns = std::min(kTileColumns, in_.surface.width - left);
                tile.work(left, top, columns, rows);
                for (int row = 0; row < rows; ++row) take(tile, row, top + row, left, columns);
            }
    }

private:
    std::size_t size() const { return row_size_ * static_cast<std::size_t>(in_.surface.height); }

    void mark_active(int row) {
        const int width = in_.surface.width;
        const std::size_t from = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
        for (int block = 0; block < blocks_; ++block) {
            bool found = !in_.active;
            for (int x = block * kBlock; !found && x < std::min(width, (block + 1) * kBlock); ++x)
                found = in_.active[from + static_cast<std::size_t>(x)];
            active_[static_cast<std::size_t>(row * blocks_ + block)] = found;
        }
    }

    void take(const Tile& tile, int tile_row, int row, int left, int columns) {
        for (int x = 0, end; x < columns; x = end) {
            const bool is_active = active(row, (left + x) / kBlock);
            end = x;  // of the blocks that are like the first
            while (end < columns && active(row, (left + end) / kBlock) == is_active)
                end += kBlock - (left + end) % kBlock;
            end = std::min(end, columns);
            for (int k = 0; k < (is_active ? in_.candidates : 1); ++k) {
                const std::size_t to = at(row, k) + static_cast<std::size_t>(left + x);
                std::copy(tile.s(tile_row, k) + x, tile.s(tile_row, k) + end, s_.get() + to);
                std::copy(tile.cost(tile_row, k) + x, tile.cost(tile_row, k) + end, cost_.get() + to);
                std::copy(tile.slope_u(tile_row, k) + x, tile.slope_u(tile_row, k) + end, slope_u_.get() + to);
                std::copy(tile.slope_v(tile_row, k) + x, tile.slope_v(tile_row, k) + end, slope_v_.get() + to);
            }
        }
    }

    const PropagationProblem& in_;
    int blocks_;
    std::size_t stride_, row_size_;
    std::unique_ptr<float[]> s_, cost_, slope_u_, slope_v_;
    std::vector<unsigned char> active_;
};

}  // namespace beltscape
