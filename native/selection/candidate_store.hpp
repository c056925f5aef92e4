// What candidate propagation works on, and the candidates of all pixels, as the tiles find them and the
// selection reads them: in blocks of columns. A block without an active pixel has one place, others all.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "selection/candidate_list.hpp"
#include "selection/multiview_cost.hpp"
#include "sweep/cells.hpp"

namespace beltscape {

inline constexpr int kBlock = kFloatLanes > 8 ? kFloatLanes : 8;  // columns; whole lanes at every level

struct PropagationCosts {
    float separation, floor, unseen_cost, tolerance, small_jump, large_jump;

    void fields(const auto& read) {
        read("separation", separation), read("floor", floor), read("unseen_cost", unseen_cost);
        read("tolerance", tolerance), read("small_jump", small_jump), read("large_jump", large_jump);
    }
};

struct PropagationProblem {
    Surface surface;
    const float* core;  // (height, width) grey levels, like the surface
    const Auxiliary* auxiliaries;
    int auxiliary_count;
    const Offset* offsets;  // the first is (0, 0)
    int offset_count;
    int candidates;
    PropagationCosts costs;
    float level;                 // taken off all grey levels, for the digits' sake
    const std::uint8_t* active;  // (height, width), or none: all are
};

// One place of a block's pixels.
struct BlockPlace {
    float s[kBlock], cost[kBlock], slope_u[kBlock], slope_v[kBlock];
};
inline constexpr std::size_t kPlaceFloats = sizeof(BlockPlace) / sizeof(float);

// Places are (rows, blocks, candidates).
class CandidateStore {
public:
    explicit CandidateStore(const PropagationProblem& in)
        : in_(in),
          blocks_((in.surface.width + kBlock - 1) / kBlock),
          places_(at(in.surface.height, 0)),
          active_(static_cast<std::size_t>(in.surface.height * blocks_)) {}

    int blocks() const { return blocks_; }
    bool active(int row, int block) const { return active_[static_cast<std::size_t>(row * blocks_ + block)]; }
    int count(int row, int block) const { return active(row, block) ? in_.candidates : 1; }
    BlockPlace* places(int row, int block) const { return places_.data() + at(row, block); }

    // Finds the blocks with an active pixel.
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

private:
    std::size_t at(int row, int block) const {
        return (static_cast<std::size_t>(row) * static_cast<std::size_t>(blocks_) +
                static_cast<std::size_t>(block)) *
               static_cast<std::size_t>(in_.candidates);
    }

    const PropagationProblem& in_;
    int blocks_;
    CellBuffer<BlockPlace> places_;
    std::vector<unsigned char> active_;
};

}  // namespace beltscape
