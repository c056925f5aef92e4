// The plane sweep over a band of rows on the CPU. A strip of kStripRows rows is swept plane by plane, and
// within a plane row by row through all views, so that windows need only three sampled rows per view (in L1).
// Costs are computed plane by plane and transposed to plane-innermost in blocks.
#pragma once

#include <cstdint>
#include <vector>

#include "parallel.hpp"
#include "pool.hpp"
#include "sweep/plane_sweep.hpp"

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

// Rows of floats with room for whole lanes and for one column (and more) to the left.
class Rows {
public:
    Rows(int count, int width) : stride_(kFloatLanes + (width / kFloatLanes + 2) * kFloatLanes) {
        values_.resize(static_cast<std::size_t>(count) * stride_ + kFloatLanes);
    }
    float* operator[](int row) {
        return values_.data() + static_cast<std::size_t>(row) * stride_ + kFloatLanes;
    }

private:
    std::size_t stride_;
    std::vector<float> values_;
};

// The input as the workspaces read it.
struct SweepProblem {
    explicit SweepProblem(const PlanesInput& in)
        : core(image_of(in.core)),
          view_count(static_cast<int>(in.images.size())),
          best(in.best),
          planes(in.planes),
          first(in.first),
          step(in.step),
          floor(in.floor),
          level(mean_level(core)) {
        for (std::size_t i = 0; i < in.images.size(); ++i)
            images.push_back(image_of(in.images[i])),
                views.push_back(view_of(in.views.data + kViewFloats * i));
    }

    Image core;
    std::vector<Image> images;
    std::vector<View> views;
    int view_count, best, planes;
    float first, step, floor;
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
          sums_(3, width_),
          spots_(2, width_),
          best_(in.best, width_),
          indices_(static_cast<std::size_t>(width_ + kFloatLanes)),
          costs_(static_cast<std::size_t>(kBlockPlanes) * kStripRows * (width_ + kFloatLanes)) {}

    // Rows first ... last - 1 of the core; out (last - first, width, planes).
    void sweep(int first, int last, std::uint8_t* out) {
        for (int y = first; y < last; y += kStripRows) {
            const int rows = std::min(kStripRows, last - y);
            prepare(y, rows);
            for (int plane = 0; plane < in_.planes; plane += kBlockPlanes) {
                const int planes = std::min(kBlockPlanes, in_.planes - plane);
                for (int p = 0; p < planes; ++p)
                    sweep_plane(in_.first + in_.step * static_cast<float>(plane + p), y, rows,
                                row_of_costs(p, 0));
                turn(rows, planes, out + plane);
            }
            out += static_cast<std::size_t>(rows) * width_ * in_.planes;
        }
    }

private:
    std::uint8_t* row_of_costs(int plane, int row) {
        return costs_.data() + static_cast<std::size_t>(plane * kStripRows + row) * (width_ + kFloatLanes);
    }

    int clamped(int y) const { return clamp(y, 0, in_.core.height - 1); }

    // The core's part of every window of the strip.
    void prepare(int y, int rows) {
        for (int r = 0; r < rows + 2; ++r) {
            const float* from = in_.core.pixels + static_cast<std::size_t>(clamped(y + r - 1)) * width_;
            for (int x = 0; x < width_; ++x) core_[r][x] = from[x] - in_.level;
        }
        for (int r = 0; r < rows; ++r) {
            sum_rows({core_[r], core_[r + 1], core_[r + 2]}, {core_[r], core_[r + 1], core_[r + 2]});
            for (int x = 0; x < width_; x += kFloatLanes) {
                const WindowSums<Floats> sums = window(x);
                const auto [mean, energy] = core_window(sums.aux, sums.aux_squared, in_.floor);
                store(mean_[r] + x, mean), store(energy_[r] + x, energy);
            }
        }
    }

    struct Three {
        const float *above, *here, *below;
    };

    // Sums three rows of J and of I into one row of each sum, and repeats its ends for the windows there.
    void sum_rows(Three aux, Three core) {
        for (int x = 0; x < width_; x += kFloatLanes) {
            const Floats a = load<Floats>(aux.above + x), b = load<Floats>(aux.here + x),
                         c = load<Floats>(aux.below + x);
            store(sums_[0] + x, a + b + c);
            store(sums_[1] + x, three_products(a, b, c, a, b, c));
            store(sums_[2] + x, three_products(a, b, c, load<Floats>(core.above + x),
                                               load<Floats>(core.here + x), load<Floats>(core.below + x)));
        }
        for (int i = 0; i < 3; ++i) {
            float* const row = sums_[i];
            row[-1] = row[0], row[width_] = row[width_ - 1];
        }
    }

    Floats across(const float* row) {
        return load<Floats>(row - 1) + load<Floats>(row) + load<Floats>(row + 1);
    }
    WindowSums<Floats> window(int x) {
        return {across(sums_[0] + x), across(sums_[1] + x), across(sums_[2] + x)};
    }

    // costs: row_of_costs(plane, 0) of a plane.
    void sweep_plane(float s, int y, int rows, std::uint8_t* costs) {
        int sampled = y - 2;  // the last core row that is sampled
        for (int r = 0; r < rows; ++r, costs += width_ + kFloatLanes) {
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
            const View one = in_.views[static_cast<std::size_t>(view)];
            const Image image = in_.images[static_cast<std::size_t>(view)];
            float *const u = spots_[0], *const v = spots_[1], *const row = aux_row(view, y);
            std::int32_t* const index = indices_.data();
            for (int x = 0; x < width_; x += kFloatLanes) {
                const Floats column = to_float(broadcast<Ints>(x) + lane_numbers<Floats>());
                const Spot<Floats> spot = swept(one, image, column, static_cast<float>(y), s);
                store(index + x, spot.index), store(u + x, spot.u), store(v + x, spot.v);
            }
            for (int x = 0; x < width_; x += kFloatLanes)
                store(row + x, bilinear<Floats>(image, index + x, load<Floats>(u + x), load<Floats>(v + x)) -
                                   in_.level);
        }
    }

    void compare(int view, int y, int r) {
        sum_rows({aux_row(view, y - 1), aux_row(view, y), aux_row(view, y + 1)},
                 {core_[r], core_[r + 1], core_[r + 2]});
        const float *mean = mean_[r], *energy = energy_[r];
        for (int x = 0; x < width_; x += kFloatLanes) {
            const CoreWindow<Floats> core{load<Floats>(mean + x), load<Floats>(energy + x)};
            Floats value = dissimilarity(window(x), core, in_.floor);
            for (int i = 0; i < in_.best; ++i) {
                const Floats held = load<Floats>(best_[i] + x);
                store(best_[i] + x, lesser(held, value));
                value = greater(held, value);
            }
        }
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
        for (int r = 0; r < rows; ++r)
            for (int x = 0; x < width_; ++x, out += in_.planes)
                for (int p = 0; p < planes; ++p) out[p] = row_of_costs(p, r)[x];
    }

    const SweepProblem& in_;
    int width_;
    Rows core_, mean_, energy_, aux_, sums_, spots_, best_;
    std::vector<std::int32_t> indices_;
    std::vector<std::uint8_t> costs_;
};

struct SweepInput : PlanesInput {
    int first_row;  // of the core, in the first row of the costs

    void fields(const auto& read) { PlanesInput::fields(read), read("first_row", first_row); }
};

inline void sweep(const SweepInput& in, std::size_t threads, Stack<std::uint8_t> costs) {
    const SweepProblem problem(in);
    const std::size_t row_size = costs.shape[1] * costs.shape[2];
    Pool<Sweeper> sweepers;
    for_bands(0, costs.height(), kStripRows, threads, [&](int start, int end) {
        const auto sweeper = sweepers.take([&] { return std::make_unique<Sweeper>(problem); });
        sweeper->sweep(in.first_row + start, in.first_row + end,
                       costs.data + static_cast<std::size_t>(start) * row_size);
    });
}

}  // namespace beltscape
