// The candidates of a tile of pixels on the CPU. Offsets go outermost; within one, rows stream through all
// views, so that the 3x3 windows need only three sampled rows per view and the tile's candidates stay in the
// second-level cache. Blocks without an active pixel in or beside them are skipped.
#pragma once

#include <array>
#include <bit>

#include "selection/candidate_store.hpp"

namespace beltscape {

inline constexpr int kTileColumns = 128;
inline constexpr int kTileBlocks = kTileColumns / kBlock;
inline constexpr int kTileSpan = kTileColumns + kBlock;  // columns sampled: one more on each side
inline constexpr int kTileRows = 32;

// For `fixed` candidates of a pixel, for which its loops are compiled, or for those of the problem (0).
template <int fixed>
class Tile {
public:
    Tile(const PropagationProblem& in, CandidateStore& store)
        : in_(in),
          store_(store),
          core_((kTileRows + 2) * kTileSpan),
          mean_(kTileRows * kTileSpan),
          energy_(mean_.size()),
          given_(3 * 3 * kTileSpan),
          grey_(kTileSpan),
          sums_(static_cast<std::size_t>(in.auxiliary_count) * 3 * kSums * kTileSpan) {}

    // Finds the candidates of columns left ... left + columns - 1 of rows top ... top + rows - 1, whose
    // active blocks are marked.
    void work(int left, int top, int columns, int rows) {
        left_ = left, top_ = top, columns_ = columns, rows_ = rows;
        prepare_active();
        prepare_core();
        for (int number = 0; number < in_.offset_count; ++number) {
            for (int row = -1; row <= rows_; ++row) {
                shift_candidates(number, row);
                for (int i = 0; i < in_.auxiliary_count; ++i) sample_view(i, row, number == 0);
                if (row > 0) compare_windows(number, row - 1);
            }
            if (number == 0 && !any_active_) break;
        }
    }

private:
    using Blocks = std::uint32_t;    // a set, a bit to a block
    static constexpr int kSums = 4;  // of grey, of grey squared, of grey times the core's; seen

    // Calls job(x) for each F of columns in some blocks.
    static void for_columns(Blocks blocks, const auto& job) {
        for (; blocks; blocks &= blocks - 1) {
            const int first = std::countr_zero(blocks) * kBlock;
            for (int x = first; x < first + kBlock; x += kFloatLanes) job(x);
        }
    }
    // The row in a ring of three.
    static int slot(int row) { return (row + 3) % 3; }
    // The given candidates' s (0), slope_u (1) and slope_v (2).
    float* given(int row, int which) { return given_.data() + (slot(row) * 3 + which) * kTileSpan; }
    float* sums(int auxiliary, int row, int which) {
        return sums_.data() + ((auxiliary * 3 + slot(row)) * kSums + which) * kTileSpan;
    }
    int row_of(int row) const { return clamp(top_ + row, 0, in_.surface.height - 1); }

    void prepare_active() {
        any_active_ = false;
        for (int own = 0; own < 2; ++own) {
            compared_[own].fill(0), wanted_[own].fill(0), sampled_[own].fill(0);
            for (int row = 0; row < rows_; ++row)
                for (int first = 0; first < columns_; first += kBlock) {
                    const int last = std::min(columns_, first + kBlock) - 1;
                    if (own)
                        want(own, row, first), want(own, row, last);
                    else if (store_.active(top_ + row, (left_ + first) / kBlock))
                        for (int x = first; x <= last; ++x)
                            if (!in_.active || *active(row, x)) want(own, row, x), any_active_ = true;
                }
        }
    }

    // Marks the blocks that are needed for a pixel's candidates.
    void want(int own, int row, int x) {
        compared_[own][row] |= 1u << x / kBlock;
        for (int i = row; i < row + 3; ++i)
            wanted_[own][i] |= 1u << x / kBlock,
                sampled_[own][i] |= 1u << x / kBlock | 1u << (x + 2) / kBlock;
    }

    const std::uint8_t* active(int row, int x) const {
        return in_.active +
               static_cast<std::size_t>(top_ + row) * static_cast<std::size_t>(in_.surface.width) +
               static_cast<std::size_t>(left_ + x);
    }

    void prepare_core() {
        for (int row = -1; row <= rows_; ++row)
            for (int x = 0; x < kTileSpan; ++x) {
                const int column = clamp(left_ - 1 + x, 0, in_.surface.width - 1);
                core_[static_cast<std::size_t>((row + 1) * kTileSpan + x)] =
                    in_.core[static_cast<std::size_t>(row_of(row)) *
                                 static_cast<std::size_t>(in_.surface.width) +
                             static_cast<std::size_t>(column)] -
                    in_.level;
            }
        for (int row = 0; row < rows_; ++row)
            for (int x = 0; x < columns_; ++x) {
                float sum = 0, squares = 0;
                for (int i = 0; i < 9; ++i) {
                    const float grey = core_[static_cast<std::size_t>((row + i / 3) * kTileSpan + x + i % 3)];
                    sum += grey, squares += grey * grey;
                }
                const CoreWindow<float> window = core_window(sum, squares, in_.costs.floor);
                const std::size_t to = static_cast<std::size_t>(row * kTileSpan + x);
                mean_[to] = window.mean, energy_[to] = window.energy;
            }
    }

    void shift_candidates(int number, int row) {
        for_columns(sampled_[number == 0][row + 1], [&](int x) {
            const auto [s, slope_u, slope_v] =
                shifted_candidate<Floats>(in_.surface, in_.offsets[number], left_ - 1 + x, row_of(row));
            store(given(row, 0) + x, s), store(given(row, 1) + x, slope_u), store(given(row, 2) + x, slope_v);
        });
    }

    void sample_view(int auxiliary, int row, bool own) {
        const Auxiliary& by = in_.auxiliaries[auxiliary];
        const Blocks sampled = sampled_[own][row + 1];
        const float y = to_float(row_of(row));
        float* const seen = sums(auxiliary, row, 3);
        for_columns(sampled, [&](int x) {
            const Ints column = clamp(left_ - 1 + x + lane_numbers<Floats>(), 0, in_.surface.width - 1);
            const SampledPoint<Floats> point =
                sample_point(by.view, by.image, to_float(column), y, load<Floats>(given(row, 0) + x));
            store(index_ + x, point.spot.index), store(nearest_ + x, point.row);
            store(u_ + x, point.spot.u), store(v_ + x, point.spot.v), store(seen + x, point.inverse_depth);
            if (!own) return;
            const int below = index_[x] + 3 * by.image.width;  // for the next rows
            prefetch(by.image.pixels + below), prefetch(by.buffer + below);
        });
        for_columns(sampled, [&](int x) {
            const Floats u = load<Floats>(u_ + x);
            store(grey_.data() + x, bilinear(by.image, index_ + x, u, load<Floats>(v_ + x)) - in_.level);
            store(seen + x,
                  unoccluded(by.buffer, nearest_ + x, u, load<Floats>(seen + x), in_.costs.tolerance));
        });
        const float* const core = core_.data() + (row + 1) * kTileSpan;
        float *const sum = sums(auxiliary, row, 0), *const squares = sums(auxiliary, row, 1),
                     *const products = sums(auxiliary, row, 2);
        for_columns(wanted_[own][row + 1], [&](int x) {
            const float* const grey = grey_.data() + x;
            const Floats a = load<Floats>(grey), b = load<Floats>(grey + 1), c = load<Floats>(grey + 2);
            store(sum + x, a + b + c), store(squares + x, three_products(a, b, c, a, b, c));
            store(products + x, three_products(a, b, c, load<Floats>(core + x), load<Floats>(core + x + 1),
                                               load<Floats>(core + x + 2)));
        });
    }

    Floats window_sum(int auxiliary, int row, int which, int x) {
        return load<Floats>(sums(auxiliary, row - 1, which) + x) +
               load<Floats>(sums(auxiliary, row, which) + x) +
               load<Floats>(sums(auxiliary, row + 1, which) + x);
    }

    void compare_windows(int number, int row) {
        for_columns(compared_[number == 0][row], [&](int x) {
            const std::size_t pixel = static_cast<std::size_t>(row * kTileSpan + x);
            const CoreWindow<Floats> core{load<Floats>(mean_.data() + pixel),
                                          load<Floats>(energy_.data() + pixel)};
            MultiviewCost<Floats> multiview_cost;
            for (int i = 0; i < in_.auxiliary_count; ++i)
                multiview_cost.add(
                    dissimilarity(WindowSums<Floats>{window_sum(i, row, 0, x), window_sum(i, row, 1, x),
                                                     window_sum(i, row, 2, x)},
                                  core, in_.costs.floor),
                    load<Floats>(sums(i, row, 3) + x + 1));
            const Candidate<Floats> candidate{load<Floats>(given(row, 0) + x + 1),
                                              load<Floats>(given(row, 1) + x + 1),
                                              load<Floats>(given(row, 2) + x + 1)};
            const Floats cost = multiview_cost.cost(in_.costs.unseen_cost);
            if (number == 0)
                begin_places(row, x, candidate, cost);
            else
                insert_candidate(places_of(row, x), candidate, cost, in_.costs.separation,
                                 finite(candidate.s) & active_pixels(row, x));
        });
    }

    // Those of a pixel of an active block; of others there is the first alone.
    CandidatePlaces places_of(int row, int x) {
        const int lane = x % kBlock;
        BlockPlace& first = *store_.places(top_ + row, (left_ + x) / kBlock);
        return {first.s + lane,
                first.cost + lane,
                first.slope_u + lane,
                first.slope_v + lane,
                fixed > 0 ? fixed : in_.candidates,
                kPlaceFloats};
    }

    Ints active_pixels(int row, int x) const {
        if (!in_.active) return Ints{} - 1;
        return load_first<Floats>(active(row, x), columns_ - x) > 0.5f;
    }

    // The pixels' own surfaces in the first place, where they have a cost, and none in the others of an
    // active block. A pixel without a candidate has the slopes of its own surface.
    void begin_places(int row, int x, const Candidate<Floats>& own, Floats cost) {
        const CandidatePlaces places = places_of(row, x);
        const Floats none = broadcast<Floats>(kNoCandidate), dear = broadcast<Floats>(kNoCost);
        const Ints known = finite(own.s) & (cost < dear);
        const int count = store_.count(top_ + row, (left_ + x) / kBlock);
        for (int k = 0; k < count; ++k) {
            const std::size_t at = static_cast<std::size_t>(k) * places.stride;
            store(places.s + at, k == 0 ? select(known, own.s, none) : none);
            store(places.cost + at, k == 0 ? select(known, cost, dear) : dear);
            store(places.slope_u + at, own.slope_u), store(places.slope_v + at, own.slope_v);
        }
    }

    const PropagationProblem& in_;
    CandidateStore& store_;
    int left_ = 0, top_ = 0, columns_ = 0, rows_ = 0;
    bool any_active_ = false;
    // Blocks whose pixels are compared, and those whose window sums and samples are needed for that, from
    // the row above on: [0] for all offsets, [1] for the pixel's own.
    std::array<Blocks, kTileRows> compared_[2];
    std::array<Blocks, kTileRows + 2> wanted_[2], sampled_[2];
    std::vector<float> core_, mean_, energy_;
    std::vector<float> given_, grey_, sums_;                 // of the present row and the two before it
    alignas(64) int index_[kTileSpan], nearest_[kTileSpan];  // of a row's samples
    alignas(64) float u_[kTileSpan], v_[kTileSpan];
};

}  // namespace beltscape
