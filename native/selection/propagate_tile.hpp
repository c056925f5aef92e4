// The candidates of a tile of pixels on the CPU. Offsets go outermost; within one, rows stream through all
// views, so that the 3x3 windows need only three sampled rows per view and the tile's candidates stay in the
// second-level cache. Blocks without an active pixel in or beside them are skipped.
#pragma once

#include "selection/candidate_store.hpp"

namespace beltscape {

inline constexpr int kTileColumns = 128;
inline constexpr int kTileBlocks = kTileColumns / kBlock;
inline constexpr int kTileSpan = kTileColumns + kBlock;  // columns that are sampled: one more on each side
inline constexpr int kTileRows = 32;

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
                const bool* const wanted = wanted_[number == 0][row + 1];
                shift_candidates(number, row, wanted);
                for (int i = 0; i < in_.auxiliary_count; ++i) sample_view(i, row, wanted, number == 0);
                if (row > 0) compare_windows(number, row - 1);
            }
            if (number == 0 && !any_active_) break;
        }
    }

private:
    static constexpr int kSums = 4;  // of grey, of grey squared, of grey times the core's; seen

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
        for (int row = 0; row < kTileRows; ++row)
            for (int block = 0; block < kTileBlocks; ++block) {
                const bool within = row < rows_ && block * kBlock < columns_;
                const bool active = within && store_.active(top_ + row, left_ / kBlock + block);
                compared_[0][row][block] = active, compared_[1][row][block] = within;
                any_active_ |= active;
            }
        for (int own = 0; own < 2; ++own)
            for (int row = -1; row <= kTileRows; ++row)
                for (int block = 0; block < kTileBlocks; ++block) {
                    bool& wanted = wanted_[own][row + 1][block] = false;
                    for (int near = std::max(row - 1, 0); near <= std::min(row + 1, kTileRows - 1); ++near)
                        wanted |= compared_[own][near][block];
                }
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

    // Whether column block's samples are wanted: windows reach two columns into the next block's.
    static bool sampled(const bool* wanted, int block) {
        return (block < kTileBlocks && wanted[block]) || (block > 0 && wanted[block - 1]);
    }

    void shift_candidates(int number, int row, const bool* wanted) {
        for (int block = 0; block <= kTileBlocks; ++block)
            if (sampled(wanted, block))
                for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
                    const auto [s, slope_u, slope_v] = shifted_candidate<Floats>(
                        in_.surface, in_.offsets[number], left_ - 1 + x, row_of(row));
                    store(given(row, 0) + x, s);
                    store(given(row, 1) + x, slope_u), store(given(row, 2) + x, slope_v);
                }
    }

    void sample_view(int auxiliary, int row, const bool* wanted, bool is_first) {
        const Auxiliary& by = in_.auxiliaries[auxiliary];
        const float y = to_float(row_of(row));
        for (int block = 0; block <= kTileBlocks; ++block) {
            if (!sampled(wanted, block)) continue;
            for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
                const Ints column = clamp(left_ - 1 + x + lane_numbers<Floats>(), 0, in_.surface.width - 1);
                const SampledPoint<Floats> sampled_point =
                    sample_point(by.view, by.image, to_float(column), y, load<Floats>(given(row, 0) + x));
                store(index_ + x, sampled_point.spot.index), store(nearest_ + x, sampled_point.row);
                store(u_ + x, sampled_point.spot.u), store(v_ + x, sampled_point.spot.v);
                store(sums(auxiliary, row, 3) + x, sampled_point.inverse_depth);
                if (!is_first) continue;
                __builtin_prefetch(by.image.pixels + index_[x] + 3 * by.image.width);
                __builtin_prefetch(by.buffer + index_[x] + 3 * by.image.width);
            }
        }
        for (int block = 0; block <= kTileBlocks; ++block) {
            if (!sampled(wanted, block)) continue;
            for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
                const Floats u = load<Floats>(u_ + x);
                store(grey_.data() + x, bilinear(by.image, index_ + x, u, load<Floats>(v_ + x)) - in_.level);
                float* const seen = sums(auxiliary, row, 3) + x;
                store(seen, unoccluded(by.buffer, nearest_ + x, u, load<Floats>(seen), in_.costs.tolerance));
            }
        }
        const float* const core = core_.data() + (row + 1) * kTileSpan;
        float *const sum = sums(auxiliary, row, 0), *const squares = sums(auxiliary, row, 1),
                     *const products = sums(auxiliary, row, 2);
        for (int block = 0; block < kTileBlocks; ++block) {
            if (!wanted[block]) continue;
            for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
                const float* const grey = grey_.data() + x;
                const Floats a = load<Floats>(grey), b = load<Floats>(grey + 1), c = load<Floats>(grey + 2);
                store(sum + x, a + b + c), store(squares + x, three_products(a, b, c, a, b, c));
                store(products + x, three_products(a, b, c, load<Floats>(core + x),
                                                   load<Floats>(core + x + 1), load<Floats>(core + x + 2)));
            }
        }
    }

    Floats window_sum(int auxiliary, int row, int which, int x) {
        return load<Floats>(sums(auxiliary, row - 1, which) + x) +
               load<Floats>(sums(auxiliary, row, which) + x) +
               load<Floats>(sums(auxiliary, row + 1, which) + x);
    }

    void compare_windows(int number, int row) {
        for (int block = 0; block < kTileBlocks; ++block) {
            if (!compared_[number == 0][row][block]) continue;
            for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
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
                const CandidatePlaces places = places_of(row, block, x - block * kBlock);
                if (number == 0) clear_places(places, candidate);
                insert_candidate(places, candidate, multiview_cost.cost(in_.costs.unseen_cost),
                                 in_.costs.separation,
                                 number == 0 ? finite(candidate.s)
                                             : finite(candidate.s) & active_pixels(row, x));
            }
        }
    }

    CandidatePlaces places_of(int row, int block, int lane) {
        const int store_block = left_ / kBlock + block;
        BlockPlace& first = *store_.places(top_ + row, store_block);
        return {first.s + lane,       first.cost + lane,
                first.slope_u + lane, first.slope_v + lane,
                store_.count(top_ + row, store_block), kPlaceFloats};
    }

    Ints active_pixels(int row, int x) const {
        if (!in_.active) return Ints{} - 1;
        const std::size_t from =
            static_cast<std::size_t>(top_ + row) * static_cast<std::size_t>(in_.surface.width) +
            static_cast<std::size_t>(left_ + x);
        return load_first<Floats>(in_.active + from, columns_ - x) > 0.5f;
    }

    // A pixel without a candidate has the slopes of its own surface.
    static void clear_places(const CandidatePlaces& places, const Candidate<Floats>& own) {
        for (int k = 0; k < places.count; ++k) {
            const std::size_t at = static_cast<std::size_t>(k) * places.stride;
            store(places.s + at, broadcast<Floats>(kNoCandidate));
            store(places.cost + at, broadcast<Floats>(kNoCost));
            store(places.slope_u + at, own.slope_u), store(places.slope_v + at, own.slope_v);
        }
    }

    const PropagationProblem& in_;
    CandidateStore& store_;
    int left_ = 0, top_ = 0, columns_ = 0, rows_ = 0;
    bool any_active_ = false;
    // Blocks whose pixels are compared, and whose window sums are needed for that: [0] for all offsets, [1]
    // for the pixel's own.
    bool compared_[2][kTileRows][kTileBlocks] = {}, wanted_[2][kTileRows + 2][kTileBlocks] = {};
    std::vector<float> core_, mean_, energy_;
    std::vector<float> given_, grey_, sums_;                 // of the present row and the two before it
    alignas(64) int index_[kTileSpan], nearest_[kTileSpan];  // of a row's samples
    alignas(64) float u_[kTileSpan], v_[kTileSpan];
};

}  // namespace beltscape
