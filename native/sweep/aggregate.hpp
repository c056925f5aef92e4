// Semi-global aggregation over eight paths (Hirschmueller, TPAMI 2008, doi:10.1109/TPAMI.2007.1166) in two
// passes over a band of rows: from left, upper left, above and upper right, then the same turned by 180
// degrees.
//
// A path keeps, per plane, L = cost + step with step = min(L', min(L'-, L'+) + small, least' + large) -
// least', where ' is the pixel before and 0 <= step <= large. Costs are at most kMaxCost = 120, so L <= 120 +
// large and L + small fits a cell where 120 + small + large does: bytes up to small + large = 135, else 16
// bits. Beside a pixel's planes stands a guard of (largest cell - small), which is never less than an L. The
// sum over eight paths is at most 8 (120 + large) < 65535.
#pragma once

#include <algorithm>
#include <vector>

#include "array.hpp"
#include "sweep/cells.hpp"
#include "sweep/semi_global_cost.hpp"

namespace beltscape {

inline bool fits_bytes(int small_jump, int large_jump) {
    return large_jump <= 127 && kMaxCost + small_jump + large_jump <= 255;
}

using Word = std::uint16_t;
using Words16 = Cells<Word>;

// Rows of costs (rows, width, planes); read up to `end`. Only rows keep_first ... keep_last - 1 of the result
// are kept.
struct CostBand {
    const std::uint8_t *cost, *end;
    int rows, keep_first, keep_last;
};

template <class Cell>
class Aggregator {
public:
    Aggregator(int width, int planes, int small_jump, int large_jump)
        : width_(width),
          planes_(planes),
          vectors_((planes + kCount - 1) / kCount),
          stride_(static_cast<std::size_t>(vectors_ + 1) * kCount),
          small_(static_cast<Cell>(small_jump)),
          large_(static_cast<Cell>(large_jump)),
          guard_(static_cast<Cell>(static_cast<Cell>(-1) - small_)),
          around_(width + kLag),
          slots_(kCount + stride_ * (3 * static_cast<std::size_t>(around_) + 2)),
          leasts_(3 * static_cast<std::size_t>(around_) + 2),
          totals_(static_cast<std::size_t>(vectors_) * kCount),
          numbers_(static_cast<std::size_t>(vectors_) * kCount),
          last_cost_(stride_) {
        std::fill_n(slots_.data(), kCount + stride_ * leasts_.size(), guard_);
        for (int plane = 0; plane < vectors_ * kCount; ++plane)
            numbers_.data()[place(plane)] = static_cast<Word>(plane);
        Cell pad[kCount];
        for (int i = 0; i < kCount; ++i) pad[i] = (vectors_ - 1) * kCount + i < planes ? Cell{0} : guard_;
        pad_ = load_cells<V>(pad);
    }

    // index and margin (keep_last - keep_first, width)
    void aggregate(const CostBand& band, float* index, float* margin) {
        const std::size_t sums =
            static_cast<std::size_t>(vectors_) * kCount * width_ * (band.keep_last - band.keep_first);
        if (sums > sums_size_) sums_ = CellBuffer<Word>(sums), sums_size_ = sums;
        if (vectors_ == 1)
            run_passes<1>(band, index, margin);
        else if (vectors_ == 2)
            run_passes<2>(band, index, margin);
        else if (vectors_ == 3)
            run_passes<3>(band, index, margin);
        else
            run_passes<kAnyVectors>(band, index, margin);
    }

private:
    using V = Cells<Cell>;
    static constexpr int kCount = kCells<Cell>;
    static constexpr int kWords = kCells<Word>;
    static constexpr int kFewVectors = 4;
    static constexpr int kAnyVectors = 0;           // their number is not known to the compiler
    static constexpr int kLag = 2;                  // what the second of two rows stays behind
    static constexpr int kParts = kCount / kWords;  // 2: even and odd planes, 1: all
    enum Mode { Lead, Forward, Backward };

    struct Path {
        Cell *slot, *least;
    };

    // The position of a plane in the sums; for bytes, even and odd planes are apart.
    int place(int plane) const {
        if constexpr (kParts == 1) return plane;
        const int in = plane % kCount;
        return plane - in + in % 2 * kWords + in / 2;
    }

    // Slots 0 ... around - 1 of the directions above, falling and rising; those of the rows at work.
    enum Direction { Above, Falling, Rising, Along };
    Path path(Direction direction, int at) {
        const std::size_t slot = static_cast<std::size_t>(direction) * around_ + at;
        return {slots_.data() + kCount + slot * stride_, leasts_.data() + slot};
    }

    // Starts a path: every step is 0.
    void begin(const Path& path) const {
        std::fill_n(path.slot, vectors_ * kCount, Cell{0});
        *path.least = 0;
    }

    void begin_pass() {
        for (const Direction direction : {Above, Falling, Rising})
            for (int at = 0; at < around_; ++at) begin(path(direction, at));
    }

    // Rows first ... last - 1 of a pass, which counts them (and their pixels) from the end where it is
    // turned.
    struct Rows {
        int first, last;
        bool turned;
    };

    // A row of a pass at its pixel x. A path's slot moves with it, so that a pixel overwrites what it came
    // from: the slot of paths from above is x, of slanting ones x - y and x + y, round `around`.
    struct Line {
        int x, falling, rising;
        Path along;
        std::size_t at;  // of the pixel in the band
        std::ptrdiff_t step;
    };

    Line line(const CostBand& band, int y, bool turned, int which) {
        const std::size_t pixels = static_cast<std::size_t>(band.rows) * width_,
                          first = static_cast<std::size_t>(y) * width_;
        const Line line{0,
                        (around_ - y % around_) % around_,
                        y % around_,
                        path(Along, which),
                        turned ? pixels - 1 - first : first,
                        turned ? -1 : 1};
        begin(line.along);
        begin(path(Falling, line.falling));
        return line;
    }

    // The loops are compiled for one to three vectors to a pixel, which saves a fifth of their time.
    template <int fixed>
    int vectors() const {
        return fixed == kAnyVectors ? vectors_ : fixed;
    }

    template <int fixed>
    void run_passes(const CostBand& band, float* index, float* margin) {
        begin_pass();
        run<Lead, fixed>(band, {0, band.keep_first, false});
        run<Forward, fixed>(band, {band.keep_first, band.keep_last, false});
        begin_pass();
        const int below = band.rows - band.keep_last;
        run<Lead, fixed>(band, {0, below, true});
        run<Backward, fixed>(band, {below, band.rows - band.keep_first, true}, index, margin);
    }

    // Processes two rows at a time where a pixel has few vectors, because a path along one row is then
    // limited by latency.
    template <Mode mode, int fixed>
    void run(const CostBand& band, const Rows& rows, float* index = nullptr, float* margin = nullptr) {
        const int at_once = vectors<fixed>() <= kFewVectors ? 2 : 1;
        for (int y = rows.first; y < rows.last; y += at_once) {
            const bool two = y + at_once <= rows.last && at_once == 2;
            Line one = line(band, y, rows.turned, 0), other = one;
            for (int t = 0; t < width_ + (two ? kLag : 0); ++t) {
                if (t == kLag && two) other = line(band, y + 1, rows.turned, 1);
                if (t < width_) advance<mode, fixed>(band, one, index, margin);
                if (t >= kLag && two) advance<mode, fixed>(band, other, index, margin);
            }
        }
    }

    template <Mode mode, int fixed>
    void advance(const CostBand& band, Line& line, float* index, float* margin) {
        if (line.x == width_ - 1) begin(path(Rising, line.rising));
        const Path paths[kPaths] = {line.along, path(Above, line.x), path(Falling, line.falling),
                                    path(Rising, line.rising)};
        const std::size_t kept = line.at - static_cast<std::size_t>(band.keep_first) * width_;
        Word* const sums = mode == Lead ? nullptr : sums_.data() + kept * (vectors<fixed>() * kCount);
        pixel<mode, fixed>(cost_of(band, line.at), paths, sums);
        if constexpr (mode == Backward) decide<fixed>(index + kept, margin + kept);
        ++line.x, line.at += static_cast<std::size_t>(line.step);
        line.falling = line.falling + 1 == around_ ? 0 : line.falling + 1;
        line.rising = line.rising + 1 == around_ ? 0 : line.rising + 1;
    }

    // The planes' costs, readable to the end of the last vector.
    const std::uint8_t* cost_of(const CostBand& band, std::size_t pixel) {
        const std::uint8_t* const cost = band.cost + pixel * static_cast<std::size_t>(planes_);
        if (band.end - cost >= vectors_ * kCount) return cost;
        std::copy(cost, band.end, last_cost_.data());
        return last_cost_.data();
    }

    static V load_cost(const std::uint8_t* from) {
        const auto bytes = load_cells<typename CellVector<std::uint8_t, kCount>::Type>(from);
        return __builtin_convertvector(least_cells(bytes, bytes * 0 + kMaxCost), V);
    }

    // Advances all paths by one pixel: `paths` hold the previous pixel, then this one.
    template <Mode mode, int fixed>
    void pixel(const std::uint8_t* cost, const Path (&paths)[kPaths], Word* sums) {
        V left[kPaths], before[kPaths], limit[kPaths], least[kPaths], step[kPaths];
        for (int p = 0; p < kPaths; ++p) {
            left[p] = load_cells<V>(paths[p].slot - 1);
            before[p] = V{} + *paths[p].least, limit[p] = before[p] + large_, least[p] = V{} + guard_;
        }
        const int count = vectors<fixed>();
        for (int i = 0; i < count; ++i) {
            const V here = load_cost(cost + i * kCount);
            for (int p = 0; p < kPaths; ++p) {
                Cell* const cells = paths[p].slot + i * kCount;
                const V nearest = least_cells(left[p], load_cells<V>(cells + 1)) + small_;
                left[p] = load_cells<V>(cells + kCount - 1);  // before it is overwritten
                step[p] = least_cells(least_cells(load_cells<V>(cells), nearest), limit[p]) - before[p];
                V now = step[p] + here;
                if (i == count - 1) now = now > pad_ ? now : pad_;
                store_cells(cells, now);
                least[p] = least_cells(least[p], now);
            }
            if constexpr (mode != Lead) add<mode>(step, here, i, sums + i * kCount);
        }
        for (int p = 0; p < kPaths; ++p) *paths[p].least = least_cell<Cell>(least[p]);
    }

    // Sums of steps (forward), and of both passes with the costs (backward).
    template <Mode mode>
    void add(const V (&step)[kPaths], V cost, int vector, Word* sums) {
        Words16 parts[kParts], costs[kParts];
        if constexpr (kParts == 1) {
            parts[0] = step[0] + step[1] + step[2] + step[3], costs[0] = cost;
        } else {
            const Words16 one = reinterpret_cast<Words16>(step[0] + step[1]),  // at most 254
                other = reinterpret_cast<Words16>(step[2] + step[3]), both = reinterpret_cast<Words16>(cost);
            parts[0] = (one & 255) + (other & 255), costs[0] = both & 255;
            parts[1] = (one >> 8) + (other >> 8), costs[1] = both >> 8;
        }
        for (int part = 0; part < kParts; ++part) {
            if constexpr (mode == Forward) {
                store_cells(sums + part * kWords, parts[part]);
            } else {
                const int at = vector * kCount + part * kWords;
                const Words16 total =
                    load_cells<Words16>(sums + part * kWords) + parts[part] + 8 * costs[part];
                const Words16 beyond =
                    load_cells<Words16>(numbers_.data() + at) >= static_cast<Word>(planes_);
                store_cells(totals_.data() + at, total | beyond);
            }
        }
    }

    // Finds the plane of the least total, interpolated by two lines of equal slope, and the margin to the
    // next other plane.
    template <int fixed>
    void decide(float* index, float* margin) const {
        const int words = vectors<fixed>() * kCount;
        const Words16 none = Words16{} + 65535;
        Words16 least = none;
        for (int i = 0; i < words; i += kWords) least = least_cells(least, total(i));
        const Word best = least_cell<Word>(least);
        Words16 first = none;
        for (int i = 0; i < words; i += kWords)
            first = least_cells(first, total(i) == best ? number(i) : none);
        const int plane = least_cell<Word>(first);
        Words16 other = none;
        for (int i = 0; i < words; i += kWords)
            other = least_cells(other, number(i) - static_cast<Word>(plane - 1) > 2 ? total(i) : none);
        *margin = static_cast<float>(least_cell<Word>(other) - best) / kWholeMargin;
        *index = static_cast<float>(plane);
        if (plane == 0 || plane == planes_ - 1) return;
        *index = interpolated_plane(plane, totals_.data()[place(plane - 1)], best,
                                    totals_.data()[place(plane + 1)]);
    }

    Words16 total(int i) const { return load_cells<Words16>(totals_.data() + i); }
    Words16 number(int i) const { return load_cells<Words16>(numbers_.data() + i); }

    int width_, planes_, vectors_;
    std::size_t stride_;
    Cell small_, large_, guard_;
    V pad_;
    int around_;
    CellBuffer<Cell> slots_;
    std::vector<Cell> leasts_;
    CellBuffer<Word> totals_, numbers_, sums_{0};
    std::size_t sums_size_ = 0;
    std::vector<std::uint8_t> last_cost_;
};

struct AggregateInput {
    Stack<const std::uint8_t> cost;  // (rows, width, planes)
    int small_jump, large_jump;

    void fields(const auto& read) {
        read("cost", cost), read("small_jump", small_jump), read("large_jump", large_jump);
    }
};

template <class Cell>
void aggregate_as(const AggregateInput& in, float* index, float* margin) {
    const int rows = in.cost.height(), width = in.cost.width(), planes = static_cast<int>(in.cost.shape[2]);
    const std::size_t size = in.cost.shape[0] * in.cost.shape[1] * in.cost.shape[2];
    Aggregator<Cell>(width, planes, in.small_jump, in.large_jump)
        .aggregate({in.cost.data, in.cost.data + size, rows, 0, rows}, index, margin);
}

inline void aggregate(const AggregateInput& in, std::size_t /* runs on one thread */, Grid<float> index,
                      Grid<float> margin) {
    const auto run =
        fits_bytes(in.small_jump, in.large_jump) ? aggregate_as<std::uint8_t> : aggregate_as<Word>;
    run(in, index.data, margin.data);
}

}  // namespace beltscape
