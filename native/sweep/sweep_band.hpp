// The plane sweep over a band of rows on the CPU. Every image is aligned once; then a strip of kStripRows
// rows is swept plane by plane, and within a plane row by row through all views, so that windows need only
// three sampled rows per view (in L1). Costs are computed plane by plane and transposed to plane-innermost in
// blocks.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include "parallel.hpp"
#include "pool.hpp"
#include "sweep/aligned_image.hpp"
#include "sweep/cells.hpp"

namespace beltscape {

inline constexpr int kStripRows = 32;
inline constexpr int kBlockPlanes = 32;

// The fields that `sweep` and `sweep_and_aggregate` have in common.
struct PlanesInput {
    Grid<const float> core;
    std::vector<Grid<const float>> images;
    PackedViews views;
    float first, step;
    int planes;
    float floor;
    int best;  // at most as many as images

    void fields(const auto& read) {
        read("core", core), read("images", images), read("views", views);
        read("first", first), read("step", step), read("planes", planes);
        read("floor", floor), read("best", best);
    }
};

// The mean of the finite pixels.
inline float mean_level(const Image& image) {
    double sum = 0, count = 0;
    const std::size_t pixels = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
    for (std::size_t i = 0; i < pixels; ++i)
        if (is_finite(image.pixels[i])) sum += image.pixels[i], count += 1;
    return count > 0 ? static_cast<float>(sum / count) : 0.0f;
}

// Rows of floats with room for whole lanes and for one vector more.
class Rows {
public:
    Rows(int count, int width)
        : stride_((width / kFloatLanes + 2) * kFloatLanes),
          values_(static_cast<std::size_t>(count) * stride_) {}
    float* operator[](int row) { return values_.data() + static_cast<std::size_t>(row) * stride_; }

private:
    std::size_t stride_;
    CellBuffer<float> values_;
};

// An auxiliary's aligned image less `level`, over the field that the planes take of it; NaN where the
// auxiliary sees nothing.
class AlignedImage {
public:
    AlignedImage(const View& view, const Image& image, const PlaneRange& range, const Image& core,
                 float level, std::size_t threads)
        : shift_(aligned_shift(view)),
          field_(is_wide_enough(image) ? aligned_field(shift_, range, core.width, core.height) : Field{}),
          stride_(field_.width + 3 * kFloatLanes),
          pixels_(static_cast<std::size_t>(stride_) * static_cast<std::size_t>(field_.height)) {
        for_bands(0, field_.height, kStripRows, threads, [&](int start, int end) {
            for (int y = start; y < end; ++y) align_row(view, image, y, level);
        });
    }

    PlanePlace place(float s) const { return shift_.place(s); }

    // `count` pixels of the core's row y on a plane; `out` has room for whole lanes.
    void sample(const PlanePlace& place, int y, int count, float* out) const {
        const float v = multiply_add(place.scale, to_float(y), place.v) - to_float(field_.top);
        const int row = place.seen ? to_int(v) : 0;
        if (!place.seen || row + 1 >= field_.height) {
            for (int x = 0; x < count; x += kFloatLanes) store(out + x, broadcast<Floats>(kNotANumber));
            return;
        }
        const float* const above = pixels_.data() + static_cast<std::size_t>(row) * stride_;
        resample<Floats>(above, above + stride_, v - to_float(row), place.scale,
                         place.u - to_float(field_.left), stride_, count, out);
    }

private:
    static bool is_wide_enough(const Image& image) { return std::min(image.width, image.height) >= 4; }

    void align_row(const View& view, const Image& image, int y, float level) {
        float* const row = pixels_.data() + static_cast<std::size_t>(y) * stride_;
        for (int x = 0; x < stride_; x += kFloatLanes) {
            const Floats column = to_float(broadcast<Ints>(field_.left + x) + lane_numbers<Floats>());
            const Floats seen = aligned_level<Floats>(view, image, column, to_float(field_.top + y));
            store_first(row + x, seen - level, stride_ - x);
        }
    }

    AlignedShift shift_;
    Field field_;
    int stride_;
    CellBuffer<float> pixels_;
};

// The input as the workspaces read it.
struct SweepProblem {
    SweepProblem(const PlanesInput& in, std::size_t threads)
        : core(image_of(in.core)),
          view_count(static_cast<int>(in.images.size())),
          best(in.best),
          range{in.first, in.step, in.planes},
          floor(in.floor),
          level(mean_level(core)) {
        images.reserve(in.images.size());
        for (std::size_t i = 0; i < in.images.size(); ++i)
            images.emplace_back(view_of(in.views.data + kViewFloats * i), image_of(in.images[i]), range, core,
                                level, threads);
    }

    Image core;
    std::vector<AlignedImage> images;
    int view_count, best;
    PlaneRange range;
    float floor;
    float level;  // taken off all grey levels, for the digits' sake
};

// One thread's workspace for sweeping bands of one width.
class Sweeper {
public:
    explicit Sweeper(const SweepProblem& in)
        : in_(in),
          width_(in.core.width),
          core_(kStripRows + 2, width_),
          mean_(kStripRows, width_),
          energy_(kStripRows, width_),
          aux_(3 * in.view_count, width_),
          best_(in.best, width_),
          costs_stride_(width_ + std::max(kTile, kFloatLanes)),
          costs_(static_cast<std::size_t>(kBlockPlanes) * kStripRows * costs_stride_) {}

    // Rows first ... last - 1 of the core; out (last - first, width, planes).
    void sweep(int first, int last, std::uint8_t* out) {
        for (int y = first; y < last; y += kStripRows) {
            const int rows = std::min(kStripRows, last - y);
            prepare(y, rows);
            for (int plane = 0; plane < in_.range.planes; plane += kBlockPlanes) {
                const int planes = std::min(kBlockPlanes, in_.range.planes - plane);
                for (int p = 0; p < planes; ++p)
                    sweep_plane(in_.range.inverse_depth(plane + p), y, rows, row_of_costs(p, 0));
                turn(rows, planes, out + plane);
            }
            out += static_cast<std::size_t>(rows) * width_ * in_.range.planes;
        }
    }

private:
    std::uint8_t* row_of_costs(int plane, int row) {
        return costs_.data() + static_cast<std::size_t>(plane * kStripRows + row) * costs_stride_;
    }

    int clamped(int y) const { return clamp(y, 0, in_.core.height - 1); }

    // The core's part of every window of the strip.
    void prepare(int y, int rows) {
        for (int r = 0; r < rows + 2; ++r) {
            const float* from = in_.core.pixels + static_cast<std::size_t>(clamped(y + r - 1)) * width_;
            for (int x = 0; x < width_; ++x) core_[r][x] = from[x] - in_.level;
            core_[r][width_] = core_[r][width_ - 1];
        }
        for (int r = 0; r < rows; ++r) {
            const Three three{core_[r], core_[r + 1], core_[r + 2]};
            for_windows(three, three, [&](int x, const WindowSums<Floats>& sums) {
                const auto [mean, energy] = core_window(sums.aux, sums.aux_squared, in_.floor);
                store(mean_[r] + x, mean), store(energy_[r] + x, energy);
            });
        }
    }

    struct Three {
        const float *above, *here, *below;
    };

    // The sums of three rows of J and of I in each column from x on.
    static WindowSums<Floats> columns(Three aux, Three core, int x) {
        const Floats a = load<Floats>(aux.above + x), b = load<Floats>(aux.here + x),
                     c = load<Floats>(aux.below + x);
        return {a + b + c, three_products(a, b, c, a, b, c),
                three_products(a, b, c, load<Floats>(core.above + x), load<Floats>(core.here + x),
                               load<Floats>(core.below + x))};
    }

    static WindowSums<Floats> window(const WindowSums<Floats>& before, const WindowSums<Floats>& here,
                                     const WindowSums<Floats>& after) {
        return {with_neighbours(before.aux, here.aux, after.aux),
                with_neighbours(before.aux_squared, here.aux_squared, after.aux_squared),
                with_neighbours(before.product, here.product, after.product)};
    }

    // Calls use(x, sums) with the windows' sums from column x on, for all columns. Rows have repeated ends.
    template <class Use>
    void for_windows(Three aux, Three core, const Use& use) {
        WindowSums<Floats> here = columns(aux, core, 0);
        WindowSums<Floats> before = {broadcast<Floats>(Lane<Floats>::get(here.aux, 0)),
                                     broadcast<Floats>(Lane<Floats>::get(here.aux_squared, 0)),
                                     broadcast<Floats>(Lane<Floats>::get(here.product, 0))};
        for (int x = 0; x < width_; x += kFloatLanes) {
            const WindowSums<Floats> after = columns(aux, core, x + kFloatLanes);
            use(x, window(before, here, after));
            before = here, here = after;
        }
    }

    // costs: row_of_costs(plane, 0) of a plane.
    void sweep_plane(float s, int y, int rows, std::uint8_t* costs) {
        int sampled = y - 2;  // the last core row that is sampled
        for (int r = 0; r < rows; ++r, costs += costs_stride_) {
            const int last = clamped(y + r + 1);
            for (int row = std::max(sampled + 1, clamped(y + r - 1)); row <= last; ++row) sample(s, row);
            sampled = last;
            for (int i = 0; i < in_.best; ++i)
                for (int x = 0; x < width_; x += kFloatLanes) store(best_[i] + x, broadcast<Floats>(1.0f));
            for (int view = 0; view < in_.view_count; ++view) compare(view, y + r, r);
            finish(costs);
        }
    }

    float* aux_row(int view, int y) { return aux_[3 * view + clamped(y) % 3]; }

    void sample(float s, int y) {
        for (int view = 0; view < in_.view_count; ++view) {
            const AlignedImage& image = in_.images[static_cast<std::size_t>(view)];
            float* const row = aux_row(view, y);
            image.sample(image.place(s), y, width_, row);
            row[width_] = row[width_ - 1];
        }
    }

    void compare(int view, int y, int r) {
        const float *mean = mean_[r], *energy = energy_[r], floor = in_.floor;
        float* const least = best_[0];
        const std::size_t next = static_cast<std::size_t>(best_[1] - least);
        const int best = in_.best;
        for_windows({aux_row(view, y - 1), aux_row(view, y), aux_row(view, y + 1)},
                    {core_[r], core_[r + 1], core_[r + 2]}, [&](int x, const WindowSums<Floats>& sums) {
                        const CoreWindow<Floats> core{load<Floats>(mean + x), load<Floats>(energy + x)};
                        Floats value = dissimilarity(sums, core, floor);
                        float* held = least + x;
                        for (int i = 0; i < best; ++i, held += next) {
                            const Floats before = load<Floats>(held);
                            store(held, lesser(before, value));
                            value = greater(before, value);
                        }
                    });
    }

    void finish(std::uint8_t* costs) {
        const float scale = kWorst / static_cast<float>(in_.best);
        for (int x = 0; x < width_; x += kFloatLanes) {
            Floats sum = load<Floats>(best_[0] + x);
            for (int i = 1; i < in_.best; ++i) sum += load<Floats>(best_[i] + x);
            store(costs + x, to_int(sum * scale + 0.5f));
        }
    }

    // (planes, rows, width) → (rows, width, planes).
    void turn(int rows, int planes, std::uint8_t* out) {
        const std::size_t pixel = static_cast<std::size_t>(in_.range.planes);
        for (int r = 0; r < rows; ++r, out += pixel * static_cast<std::size_t>(width_))
            for (int plane = 0; plane < planes; plane += kTile)
                for (int x = 0; x < width_; x += kTile) {
                    TileRow tile[kTile];
                    for (int p = 0; p < kTile; ++p)
                        tile[p] = load_cells<TileRow>(row_of_costs(plane + p, r) + x);
                    transpose_tile(tile);
                    std::uint8_t* to = out + pixel * static_cast<std::size_t>(x) + plane;
                    for (int i = 0; i < std::min(kTile, width_ - x); ++i, to += pixel)
                        std::memcpy(to, tile + i, static_cast<std::size_t>(std::min(kTile, planes - plane)));
                }
    }

    const SweepProblem& in_;
    int width_;
    Rows core_, mean_, energy_, aux_, best_;
    std::size_t costs_stride_;
    std::vector<std::uint8_t> costs_;
};

struct SweepInput : PlanesInput {
    int first_row;  // of the core, in the first row of the costs

    void fields(const auto& read) { PlanesInput::fields(read), read("first_row", first_row); }
};

inline void sweep(const SweepInput& in, std::size_t threads, Stack<std::uint8_t> costs) {
    const SweepProblem problem(in, threads);
    const std::size_t row_size = costs.shape[1] * costs.shape[2];
    Pool<Sweeper> sweepers;
    for_bands(0, costs.height(), kStripRows, threads, [&](int start, int end) {
        const auto sweeper = sweepers.take([&] { return std::make_unique<Sweeper>(problem); });
        sweeper->sweep(in.first_row + start, in.first_row + end,
                       costs.data + static_cast<std::size_t>(start) * row_size);
    });
}

}  // namespace beltscape
