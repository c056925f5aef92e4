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

class Selector {
public:
    // For bands of which up to `kept` rows are chosen.
    Selector(const PropagationProblem& in, const CandidateStore& store, int kept)
        : in_(in),
          width_(in.surface.width),
          blocks_(store.blocks()),
          stride_(store.stride()),
          row_size_(store.row_size()),
          store_(store),
          score_(room(kept)),
          lines_{Line(stride_, in.candidates), Line(stride_, in.candidates)} {}

    // Chooses in rows keep_first ... keep_end - 1; paths cover rows first ... end - 1.
    void choose(int first, int end, int keep_first, int keep_end, const PropagationResult& out) {
        first_ = first, end_ = end, keep_first_ = keep_first, keep_end_ = keep_end;
        std::fill_n(score_.get(), row_size_ * static_cast<std::size_t>(keep_end_ - keep_first_), 0.0f);
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

    using Values = std::unique_ptr<float[]>;
    Values room(int rows) const {
        return std::make_unique_for_overwrite<float[]>(row_size_ * static_cast<std::size_t>(rows));
    }

    // A row's candidates, and its paths' tolls, with a block's room on each side.
    struct Line {
        Line(std::size_t width, int candidates)
            : stride(width + 2 * kBlock),
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

    std::size_t at(int row, int k) const { return store_.at(row, k); }
    float* score(int row, int k) {
        return score_.get() + static_cast<std::size_t>(row - keep_first_) * row_size_ +
               static_cast<std::size_t>(k) * stride_;
    }
    bool active(int row, int block) const { return store_.active(row, block); }

    // One row of the three paths downwards (1) or upwards (-1).
    void pass(int row, int way, bool has_before) {
        Line& line = lines_[row & 1];
        for (int block = 0; block < blocks_; ++block) expand(line, row, block, way);
        for (int path = 0; path < kPaths; ++path)
            for (int block = 0; block < blocks_; ++block)
                if (active(row, block))
                    arrive(line, has_before ? &lines_[~row & 1] : nullptr, row, block, path, way);
                else
                    restart(line, block, path);
    }

    void expand(Line& line, int row, int block, int way) {
        const int places = active(row, block) ? in_.candidates : 1;
        const float half = 0.5f * to_float(way);
        for (int k = 0; k < places; ++k) {
            for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
                const std::size_t place = at(row, k) + static_cast<std::size_t>(x);
                const Floats slope_u = load<Floats>(store_.slope_u() + place),
                             slope_v = load<Floats>(store_.slope_v() + place);
                store(line.s(k) + x, load<Floats>(store_.s() + place));
                store(line.rise(0, k) + x, half * slope_v);
                store(line.rise(1, k) + x, half * (slope_v + slope_u));
                store(line.rise(2, k) + x, half * (slope_v - slope_u));
            }
        }
    }

    void restart(Line& line, int block, int path) {
        for (int k = 0; k < in_.candidates; ++k)
            std::fill_n(line.toll(path, k) + block * kBlock, kBlock, k == 0 ? 0.0f : kNoCost);
    }

    void arrive(Line& line, Line* before, int row, int block, int path, int way) {
        const int dx = kAside[path] * way;
        const bool kept = row >= keep_first_ && row < keep_end_;
        const Jumps jumps{in_.costs.small_jump, in_.costs.large_jump};
        for (int x = block * kBlock; x < (block + 1) * kBlock; x += kFloatLanes) {
            const Ints from = x - dx + lane_numbers<Floats>();
            const Ints comes = (from >= 0) & (from < width_);
            for (int k = 0; k < in_.candidates; ++k) {
                Floats toll{};
                if (before)
                    toll =
                        select(comes,
                               least_path_cost(
                                   PreviousCandidates{before->s(0) + x - dx, before->rise(path, 0) + x - dx,
                                                      before->toll(path, 0) + x - dx, in_.candidates,
                                                      before->stride},
                                   load<Floats>(line.s(k) + x), load<Floats>(line.rise(path, k) + x), jumps),
                               toll);
                if (kept) store(score(row, k) + x, load<Floats>(score(row, k) + x) + toll);
                store(line.toll(path, k) + x, load<Floats>(store_.cost() + at(row, k) + x) + toll);
            }
            level_out<Floats>(line.toll(path, 0) + x, in_.candidates, line.stride);
        }
    }

    // Up to kFloatLanes rows at once, a column at a time.
    struct Column {
        float s[kMostCandidates * kFloatLanes], rise[kMostCandidates * kFloatLanes],
            toll[kMostCandidates * kFloatLanes];
    };

    // A block's columns of as many rows, by candidate.
    struct Columns {
        float s[kMostCandidates][kBlock * kFloatLanes], slope[kMostCandidates][kBlock * kFloatLanes],
            cost[kMostCandidates][kBlock * kFloatLanes], score[kMostCandidates][kBlock * kFloatLanes];
    };

    // `count` rows from `row` on, to the right (1) or to the left (-1).
    void along(int row, int count, int way) {
        Column columns[2];
        bool starts = true;
        for (int i = 0; i < blocks_; ++i) {
            const int block = way > 0 ? i : blocks_ - 1 - i, first = block * kBlock,
                      last = std::min(width_, first + kBlock) - 1;
            Floats chosen{};  // the rows with an active pixel
            for (int lane = 0; lane < count; ++lane)
                Lane<Floats>::set(chosen, lane, active(row + lane, block) ? 1.0f : 0.0f);
            if (any(chosen > 0.5f)) {
                load_columns(row, count, first);
                for (int x = way > 0 ? first : last; x >= first && x <= last; x += way) {
                    step(columns[~x & 1], columns[x & 1], x - first, way, chosen > 0.5f, starts);
                    starts = false;
                }
                for (int k = 0; k < in_.candidates; ++k)
                    from_columns(columns_.score[k], score(row, k) + first, count);
            } else {
                const int x = way > 0 ? last : first;
                Column& column = columns[x & 1];
                store(column.s, load_rows(store_.s() + at(row, 0) + x, count));
                store(column.rise, 0.5f * to_float(way) * load_rows(store_.slope_u() + at(row, 0) + x, count));
                for (int k = 0; k < in_.candidates; ++k)
                    store(column.toll + k * kFloatLanes, (k == 0 ? 0.0f : kNoCost) - Floats{});
                starts = false;
            }
        }
    }

    void load_columns(int row, int count, int x) {
        for (int k = 0; k < in_.candidates; ++k) {
            const std::size_t place = at(row, k) + static_cast<std::size_t>(x);
            to_columns(store_.s() + place, count, columns_.s[k]);
            to_columns(store_.slope_u() + place, count, columns_.slope[k]);
            to_columns(store_.cost() + place, count, columns_.cost[k]);
            to_columns(score(row, k) + x, count, columns_.score[k]);
        }
    }

    // The columns of a block of `count` rows; the last row is repeated.
    void to_columns(const float* from, int count, float* columns) const {
        for (int x = 0; x < kBlock; x += kFloatLanes) {
            Floats lines[kFloatLanes];
            for (int i = 0; i < kFloatLanes; ++i)
                lines[i] = load<Floats>(from + static_cast<std::size_t>(std::min(i, count - 1)) * row_size_ + x);
            transpose(lines);
            for (int i = 0; i < kFloatLanes; ++i) store(columns + (x + i) * kFloatLanes, lines[i]);
        }
    }

    void from_columns(const float* columns, float* to, int count) const {
        for (int x = 0; x < kBlock; x += kFloatLanes) {
            Floats lines[kFloatLanes];
            for (int i = 0; i < kFloatLanes; ++i) lines[i] = load<Floats>(columns + (x + i) * kFloatLanes);
            transpose(lines);
            for (int i = 0; i < count; ++i) store(to + static_cast<std::size_t>(i) * row_size_ + x, lines[i]);
        }
    }

    Floats load_rows(const float* from, int count) const {
        const Ints lane = lane_numbers<Floats>();
        return gather(from, lesser(lane, count - 1 - Ints{}) * static_cast<int>(row_size_));
    }

    // Column x of the block.
    void step(const Column& before, Column& column, int x, int way, Ints chosen, bool starts) {
        const Jumps jumps{in_.costs.small_jump, in_.costs.large_jump};
        for (int k = 0; k < in_.candidates; ++k) {
            const int at = x * kFloatLanes;
            const Floats s = load<Floats>(columns_.s[k] + at);
            const Floats rise = 0.5f * to_float(way) * load<Floats>(columns_.slope[k] + at);
            Floats cost = load<Floats>(columns_.cost[k] + at), toll{};
            if (k > 0) cost = select(chosen, cost, kNoCost - Floats{});
            if (!starts)
                toll = least_path_cost(
                    PreviousCandidates{before.s, before.rise, before.toll, in_.candidates, kFloatLanes}, s,
                    rise, jumps);
            store(columns_.score[k] + at, load<Floats>(columns_.score[k] + at) + toll);
            store(column.s + k * kFloatLanes, s), store(column.rise + k * kFloatLanes, rise);
            store(column.toll + k * kFloatLanes, cost + toll);
        }
        level_out<Floats>(column.toll, in_.candidates, kFloatLanes);
    }

    void pick(int row, const PropagationResult& out) {
        for (int x = 0; x < width_; x += kFloatLanes) {
            const int places = active(row, x / kBlock) ? in_.candidates : 1;
            const Floats nan = broadcast<Floats>(kNotANumber);
            Floats s = nan, cost = nan, slope_u{}, slope_v{}, least = kInfinity - Floats{}, other = least;
            for (int k = 0; k < places; ++k) {
                const std::size_t place = at(row, k) + static_cast<std::size_t>(x);
                const Floats own = load<Floats>(store_.cost() + place);
                const Floats total = own + 0.125f * load<Floats>(score(row, k) + x);
                const Ints better = total < least;
                least = select(better, total, least);
                s = select(better, load<Floats>(store_.s() + place), s), cost = select(better, own, cost);
                slope_u = select(better, load<Floats>(store_.slope_u() + place), slope_u);
                slope_v = select(better, load<Floats>(store_.slope_v() + place), slope_v);
            }
            for (int k = 0; k < places; ++k) {
                const std::size_t place = at(row, k) + static_cast<std::size_t>(x);
                const Floats total =
                    load<Floats>(store_.cost() + place) + 0.125f * load<Floats>(score(row, k) + x);
                const Ints apart = absolute(load<Floats>(store_.s() + place) - s) > kApart;
                other = select(apart, lesser(total, other), other);
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
    std::size_t stride_, row_size_;
    const CandidateStore& store_;
    Values score_;   // sums of the paths' costs, (kept rows, candidates, stride)
    Line lines_[2];
    Columns columns_;
};

}  // namespace beltscape
