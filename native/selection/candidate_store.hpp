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
          source_(std::make_unique_for_overwrite<std::uint8_t[]>(size())),
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
    const std::uint8_t* source() const { return source_.get(); }

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
        int places = 1;  // all, where a block is active that may reach into the next tile: it is read whole
        for (int block = left / kBlock; block <= (left + columns - 1) / kBlock; ++block)
            if (active(row, block)) places = in_.candidates;
        for (int k = 0; k < places; ++k) {
            const std::size_t to = at(row, k) + static_cast<std::size_t>(left);
            std::copy_n(tile.s(tile_row, k), columns, s_.get() + to);
            std::copy_n(tile.cost(tile_row, k), columns, cost_.get() + to);
            const int* const source = tile.source(tile_row, k);
            for (int x = 0; x < columns; ++x)
                source_[to + static_cast<std::size_t>(x)] = static_cast<std::uint8_t>(source[x]);
        }
    }

    const PropagationProblem& in_;
    int blocks_;
    std::size_t stride_, row_size_;
    std::unique_ptr<float[]> s_, cost_;
    std::unique_ptr<std::uint8_t[]> source_;
    std::vector<unsigned char> active_;
};

}  // namespace beltscape
