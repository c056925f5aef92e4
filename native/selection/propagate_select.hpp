// The selection among the candidates of a band of rows on the CPU, on eight paths by semi_global.hpp. For
// paths down and up, lanes are columns; along the rows, lanes are rows. A pixel with one candidate passes on
// nothing from before (its toll is always 0), so blocks without an active pixel need no path.
#pragma once

#include "selection/candidate_store.hpp"
#include "selection/semi_global.hpp"
#include "transpose.hpp"

namespace beltscape {

// Each (height, width).
struct PropagationResult {
    float *s, *slope_u, *slope_v, *cost, *margin;
};

// For `fixed` candidates of a pixel, for which its loops are compiled, or for those of the problem (0).
template <int fixed>
class Selector {
public:
    // For bands of which up to `kept` rows are chosen.
    Selector(const PropagationProblem& in, const CandidateStore& store, int kept)
        : in_(in),
          width_(in.surface.width),
          blocks_(store.blocks()),
          store_(store),
          score_(std::make_unique_for_overwrite<float[]>(score_at(kept, 0, 0))),
          lines_{Line(blocks_ * kBlock, candidates()), Line(blocks_ * kBlock, candidates())} {}

    // Chooses in rows keep_first ... keep_end - 1; paths cover rows first ... end - 1.
    void choose(int first, int end, int keep_first, int keep_end, const PropagationResult& out) {
        first_ = first, end_ = end, keep_first_ = keep_first, keep_end_ = keep_end;
        for (int row = first_; row < end_; ++row) {
            pass(row, 1, row > first_);
            if (row < keep_first_ || row >= keep_end_) continue;
            const int lane = (row - keep_first_) % kFloatLanes;
            if (lane == kFloatLanes - 1 || row == keep_end_ - 1) {
                along(row - lane, lane + 1, 1);
                along(row - lane, lane + 1, -1);
            }
        }
        for (int row = end_ - 1; row >= first_; --row) pass(row, -1, row < end_ - 1);
        for (int row = keep_first_; row < keep_end_; ++row) pick(row, out);
    }

private:
    static constexpr int kPaths = 3;  // straight, and to both sides
    static constexpr int kAside[kPaths] = {0, 1, -1};

    // A row's candidates, and its paths' tolls, with a block's room on each side.
    struct Line {
        Line(int width, int candidates)
            : stride(static_cast<std::size_t>(width + 2 * kBlock)),
              size(stride * static_cast<std::size_t>(candidates)),
              all(size * 7) {}
        float* s(int k) { return of(0, k); }
        float* rise(int path, int k) { return of(1 + path, k); }
        float* toll(int path, int k) { return of(4 + path, k); }
        float* of(int which, int k) {
            return all.data() + static_cast<std::size_t>(which) * size +
                   static_cast<std::size_t>(k) * stride + kBlock;
        }
        std::size_t stride, size;
        std::vector<float> all;
    };

    int candidates() const { return fixed > 0 ? fixed : in_.candidates; }
    bool active(int row, int block) const { return store_.active(row, block); }
    std::size_t score_at(int row, int block, int k) const {
        return static_cast<std::size_t>((row * blocks_ + block) * candidates() + k) * kBlock;
    }
    float* score(int row, int block, int k) { return score_.get() + score_at(row - keep_first_, block, k); }

    // One row of the three paths downwards (1) or upwards (-1).
    void pass(int row, int way, bool has_before) {
        Line& line = lines_[row & 1];
        for (int block = 0; block < blocks_; ++block) {
            expand(line, row, block, way);
            for (int path = 0; path < kPaths; ++path)
                if (active(row, block))
                    arrive(line, has_before ? &lines_[~row & 1] : nullptr, row, block, path, way);
                else
                    restart(line, block, path);
        }
    }

    void expand(Line& line, int row, int block, int way) {
        const float half = 0.5f * to_float(way);
        for (int k = 0; k < store_.count(row, block); ++k) {
            const BlockPlace& place = store_.places(row, block)[k];
            for (int i = 0; i < kBlock; i += kFloatLanes) {
                const int x = block * kBlock + i;
                const Floats slope_u = load<Floats>(place.slope_u + i),
                             slope_v = load<Floats>(place.slope_v + i);
                store(line.s(k) + x, load<Floats>(place.s + i));
                store(line.rise(0, k) + x, half * slope_v);
                store(line.rise(1, k) + x, half * (slope_v + slope_u));
                store(line.rise(2, k) + x, half * (slope_v - slope_u));
            }
        }
    }

    void restart(Line& line, int block, int path) {
        for (int k = 0; k < candidates(); ++k)
            std::fill_n(line.toll(path, k) + block * kBlock, kBlock, k == 0 ? 0.0f : kNoCost);
    }

    // The candidates of kFloatLanes pixels, and a path's tolls.
    struct alignas(kVectorBytes) Pixels {
        float s[kMostCandidates * kFloatLanes], rise[kMostCandidates * kFloatLanes],
            toll[kMostCandidates * kFloatLanes];
    };

    Floats path_cost(const Pixels& before, Floats s, Floats rise) const {
        return least_path_cost(
            PreviousCandidates{before.s, before.rise, before.toll, candidates(), kFloatLanes}, s, rise,
            Jumps{in_.costs.small_jump, in_.costs.large_jump});
    }

    void arrive(Line& line, Line* before, int row, int block, int path, int way) {
        const int dx = kAside[path] * way;
        const bool kept = row >= keep_first_ && row < keep_end_, is_first = way > 0 && path == 0;
        for (int i = 0; i < kBlock; i += kFloatLanes) {
            const int x = block * kBlock + i;
            const Ints from = x - dx + lane_numbers<Floats>();
            const Ints comes = (from >= 0) & (from < width_);
            Pixels come;
            for (int k = 0; before && k < candidates(); ++k) {
                store(come.s + k * kFloatLanes, load<Floats>(before->s(k) + x - dx));
                store(come.rise + k * kFloatLanes, load<Floats>(before->rise(path, k) + x - dx));
                store(come.toll + k * kFloatLanes, load<Floats>(before->toll(path, k) + x - dx));
            }
            for (int k = 0; k < candidates(); ++k) {
                Floats toll{};
                if (before)
                    toll = select(
                        comes,
                        path_cost(come, load<Floats>(line.s(k) + x), load<Floats>(line.rise(path, k) + x)),
                        toll);
                if (kept) {
                    float* const sum = score(row, block, k) + i;
                    store(sum, is_first ? toll : load<Floats>(sum) + toll);
                }
                store(line.toll(path, k) + x, load<Floats>(store_.places(row, block)[k].cost + i) + toll);
            }
            level_out<Floats>(line.toll(path, 0) + x, candidates(), line.stride);
        }
    }

    // A block's columns of as many rows, by candidate.
    struct alignas(kVectorBytes) Columns {
        float s[kMostCandidates][kBlock * kFloatLanes], slope[kMostCandidates][kBlock * kFloatLanes],
            cost[kMostCandidates][kBlock * kFloatLanes], score[kMostCandidates][kBlock * kFloatLanes];
    };

    // `count` rows from `row` on, to the right (1) or to the left (-1).
    void along(int row, int count, int way) {
        Pixels columns[2];
        bool starts = true;
        for (int i = 0; i < blocks_; ++i) {
            const int block = way > 0 ? i : blocks_ - 1 - i, first = block * kBlock,
                      last = std::min(width_, first + kBlock) - 1;
            Floats chosen{};  // the rows with an active pixel
            for (int lane = 0; lane < count; ++lane)
                Lane<Floats>::set(chosen, lane, active(row + lane, block) ? 1.0f : 0.0f);
            if (any(chosen > 0.5f)) {
                load_columns(row, count, block);
                for (int x = way > 0 ? first : last; x >= first && x <= last; x += way) {
                    step(columns[~x & 1], columns[x & 1], x - first, way, chosen > 0.5f, starts);
                    starts = false;
                }
                for (int k = 0; k < candidates(); ++k)
                    from_columns(columns_.score[k], score(row, block, k), count);
            } else {
                const int x = way > 0 ? last : first;
                const BlockPlace& place = *store_.places(row, block);
                Pixels& column = columns[x & 1];
                store(column.s, load_rows(place.s + x - first, count));
                store(column.rise, 0.5f * to_float(way) * load_rows(place.slope_u + x - first, count));
                for (int k = 0; k < candidates(); ++k)
                    store(column.toll + k * kFloatLanes, (k == 0 ? 0.0f : kNoCost) - Floats{});
                starts = false;
            }
        }
    }

    std::size_t store_row() const { return score_at(1, 0, 0) / kBlock * kPlaceFloats; }

    Floats load_rows(const float* from, int count) const {
        const Ints lane = lane_numbers<Floats>();
        return gather(from, lesser(lane, count - 1 - Ints{}) * static_cast<int>(store_row()));
    }

    void load_columns(int row, int count, int block) {
        for (int k = 0; k < candidates(); ++k) {
            const BlockPlace& place = store_.places(row, block)[k];
            to_columns(place.s, store_row(), count, columns_.s[k]);
            to_columns(place.slope_u, store_row(), count, columns_.slope[k]);
            to_columns(place.cost, store_row(), count, columns_.cost[k]);
            to_columns(score(row, block, k), score_at(1, 0, 0), count, columns_.score[k]);
        }
    }

    // The columns of a block of `count` rows; the last row is repeated.
    static void to_columns(const float* from, std::size_t stride, int count, float* columns) {
        for (int x = 0; x < kBlock; x += kFloatLanes) {
            Floats rows[kFloatLanes];
            for (int i = 0; i < kFloatLanes; ++i)
                rows[i] = load<Floats>(from + static_cast<std::size_t>(std::min(i, count - 1)) * stride + x);
            transpose(rows);
            for (int i = 0; i < kFloatLanes; ++i) store(columns + (x + i) * kFloatLanes, rows[i]);
        }
    }

    void from_columns(const float* columns, float* to, int count) const {
        for (int x = 0; x < kBlock; x += kFloatLanes) {
            Floats rows[kFloatLanes];
            for (int i = 0; i < kFloatLanes; ++i) rows[i] = load<Floats>(columns + (x + i) * kFloatLanes);
            transpose(rows);
            for (int i = 0; i < count; ++i)
                store(to + static_cast<std::size_t>(i) * score_at(1, 0, 0) + x, rows[i]);
        }
    }

    // Column x of the block.
    void step(const Pixels& before, Pixels& column, int x, int way, Ints chosen, bool starts) {
        for (int k = 0; k < candidates(); ++k) {
            const int at = x * kFloatLanes;
            const Floats rise = 0.5f * to_float(way) * load<Floats>(columns_.slope[k] + at);
            Floats s = load<Floats>(columns_.s[k] + at), cost = load<Floats>(columns_.cost[k] + at), toll{};
            if (k > 0)  // rows whose block has one place
                s = select(chosen, s, kNoCandidate - Floats{}),
                cost = select(chosen, cost, kNoCost - Floats{});
            if (!starts) toll = path_cost(before, s, rise);
            store(columns_.score[k] + at, load<Floats>(columns_.score[k] + at) + toll);
            store(column.s + k * kFloatLanes, s), store(column.rise + k * kFloatLanes, rise);
            store(column.toll + k * kFloatLanes, cost + toll);
        }
        level_out<Floats>(column.toll, candidates(), kFloatLanes);
    }

    // A place's cost with those of the paths, of which a block without an active pixel has none.
    Floats total(int row, int block, int k, int i) {
        const Floats own = load<Floats>(store_.places(row, block)[k].cost + i);
        return active(row, block) ? own + 0.125f * load<Floats>(score(row, block, k) + i) : own;
    }

    void pick(int row, const PropagationResult& out) {
        for (int x = 0; x < width_; x += kFloatLanes) {
            const int block = x / kBlock, i = x % kBlock, places = store_.count(row, block);
            const BlockPlace* const place = store_.places(row, block);
            const Floats nan = broadcast<Floats>(kNotANumber);
            Floats s = nan, cost = nan, slope_u{}, slope_v{}, least = kInfinity - Floats{}, other = least;
            for (int k = 0; k < places; ++k) {
                const Floats cost_here = total(row, block, k, i);
                const Ints better = cost_here < least;
                least = select(better, cost_here, least);
                s = select(better, load<Floats>(place[k].s + i), s);
                cost = select(better, load<Floats>(place[k].cost + i), cost);
                slope_u = select(better, load<Floats>(place[k].slope_u + i), slope_u);
                slope_v = select(better, load<Floats>(place[k].slope_v + i), slope_v);
            }
            for (int k = 0; k < places; ++k) {
                const Ints apart = absolute(load<Floats>(place[k].s + i) - s) > kApart;
                other = select(apart, lesser(total(row, block, k, i), other), other);
            }
            const Ints found = s < kNoCandidate;
            const std::size_t to = static_cast<std::size_t>(row) * static_cast<std::size_t>(width_) +
                                   static_cast<std::size_t>(x);
            const int count = width_ - x;
            store_first(out.s + to, select(found, s, nan), count);
            store_first(out.cost + to, select(found, cost, nan), count);
            store_first(out.margin + to, select(found, lesser(other - least, 1.0f - Floats{}), nan), count);
            store_first(out.slope_u + to, slope_u, count), store_first(out.slope_v + to, slope_v, count);
        }
    }

    const PropagationProblem& in_;
    int width_, blocks_, first_ = 0, end_ = 0, keep_first_ = 0, keep_end_ = 0;
    const CandidateStore& store_;
    std::unique_ptr<float[]> score_;  // sums of the paths' costs, (kept rows, blocks, candidates, kBlock)
    Line lines_[2];
    Columns columns_;
};

}  // namespace beltscape
