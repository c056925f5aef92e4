// The normal equations of a band of rows: one pass over the rows, in which every stage is a few rows behind
// the previous one, so that a row's intermediate results are still in the cache when they are used.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "images/warp.hpp"
#include "least_squares/normal_equations.hpp"

namespace beltscape {

struct SeenView {
    View view;
    Spline spline;
};

struct NormalProblem {
    NormalSettings settings;
    const float *s, *core;  // (height, width)
    int height, width;
    std::vector<SeenView> views;
    Equations out;
};

// A ring buffer of rows, with the margins of box_sums.hpp.
class Ring {
public:
    Ring(int rows, int width, int margin)
        : rows_(rows),
          stride_(width + 2 * margin + kFloatLanes),
          margin_(margin),
          data_(static_cast<std::size_t>(rows) * static_cast<std::size_t>(stride_)) {}
    float* row(int y) {
        return data_.data() + static_cast<std::size_t>(y % rows_) * static_cast<std::size_t>(stride_) +
               margin_;
    }

private:
    int rows_, stride_, margin_;
    std::vector<float> data_;
};

class NormalBand {
public:
    explicit NormalBand(const NormalProblem& problem)
        : problem_(problem),
          window_(problem.settings.window),
          residual_(problem.settings.residual_window),
          margin_(std::max(window_, residual_)),
          core_(ring(window_)),
          there_(window_ + std::max(window_, 2 * residual_) + 1, problem.width, margin_),
          core_value_(ring(0)),
          core_scale_(ring(0)),
          part_(ring(0)),
          residual_part_(ring(0)),
          sums_(ring(0)),
          squares_(ring(0)) {
        for (std::size_t k = 0; k < problem.views.size(); ++k)
            views_.push_back({ring(window_), ring(window_), ring(residual_), ring(residual_), ring(residual_),
                              ring(residual_), ring(0)});
    }

    void run(int first, int end) {
        const int height = problem_.height;
        for (int row = std::max(0, first - window_ - residual_); row < end + window_ + residual_; ++row) {
            if (row < height) warp(row);
            const int centre = row - window_, done = centre - residual_;
            if (centre >= std::max(0, first - residual_) && centre < std::min(height, end + residual_))
                normalise(centre);
            if (done >= first && done < end) combine(done);
        }
    }

private:
    struct ViewRows {
        Ring grey, slope, value, change, weight, misfit, misfit_sums;
    };

    Ring ring(int radius) const { return {2 * radius + 1, problem_.width, margin_}; }

    std::size_t at(int row) const {
        return static_cast<std::size_t>(row) * static_cast<std::size_t>(problem_.width);
    }

    // The rows of a window about a row; beyond the image its outermost rows are repeated.
    std::vector<const float*> about(Ring& rows, int centre, int radius) const {
        std::vector<const float*> found;
        for (int y = centre - radius; y <= centre + radius; ++y)
            found.push_back(rows.row(std::clamp(y, 0, problem_.height - 1)));
        return found;
    }

    void warp(int row) {
        const int width = problem_.width;
        core_row<Floats>(problem_.core + at(row), width, core_.row(row), there_.row(row));
        for (std::size_t k = 0; k < views_.size(); ++k) {
            float *const grey = views_[k].grey.row(row), *const slope = views_[k].slope.row(row);
            const SeenView& seen = problem_.views[k];
            warp_row<Floats>(seen.view, seen.spline, problem_.s + at(row), row, 0, width, grey, slope);
            complete_row<Floats>(core_.row(row), there_.row(row), width, grey, slope);
            repeat_ends(grey, width, window_);
        }
        repeat_ends(core_.row(row), width, window_);
        repeat_ends(there_.row(row), width, margin_);
    }

    void normalise(int row) {
        const NormalSettings& settings = problem_.settings;
        const int width = problem_.width, rows = 2 * window_ + 1;
        float *const sums = sums_.row(0), *const squares = squares_.row(0);
        const CoreNormals core{core_value_.row(0), core_scale_.row(0), part_.row(0), there_.row(row)};
        column_sums<Floats>(about(there_, row, window_).data(), rows, width, window_, sums);
        part_row<Floats>(sums, window_, width, core.part);
        column_sums<Floats>(about(core_, row, window_).data(), rows, width, window_, sums, squares);
        core_normals_row<Floats>(settings, core_.row(row), sums, squares, width, core);
        for (ViewRows& view : views_) {
            const Residuals out{view.value.row(row), view.change.row(row), view.weight.row(row),
                                view.misfit.row(row)};
            column_sums<Floats>(about(view.grey, row, window_).data(), rows, width, window_, sums, squares);
            residuals_row<Floats>(settings, core, view.grey.row(row), view.slope.row(row), sums, squares,
                                  width, out);
            repeat_ends(out.misfit, width, residual_);
        }
    }

    void combine(int row) {
        const int width = problem_.width, rows = 2 * residual_ + 1;
        float* const part = residual_part_.row(0);
        column_sums<Floats>(about(there_, row, residual_).data(), rows, width, residual_, sums_.row(0));
        part_row<Floats>(sums_.row(0), residual_, width, part);
        std::vector<Residuals> residuals;
        for (ViewRows& view : views_) {
            float* const sums = view.misfit_sums.row(0);
            column_sums<Floats>(about(view.misfit, row, residual_).data(), rows, width, residual_, sums);
            residuals.push_back({view.value.row(row), view.change.row(row), view.weight.row(row), sums});
        }
        const Equations& out = problem_.out;
        equations_row<Floats>(problem_.settings, residuals.data(), static_cast<int>(residuals.size()), part,
                              width, {out.information + at(row), out.pull + at(row), out.used + at(row)});
    }

    const NormalProblem& problem_;
    int window_, residual_, margin_;
    Ring core_, there_, core_value_, core_scale_, part_, residual_part_, sums_, squares_;
    std::vector<ViewRows> views_;
};

struct NormalEquationsInput {
    Grid<const float> s, core;
    std::vector<Grid<const float>> coefficients;
    PackedViews views;
    NormalSettings settings;

    void fields(const auto& read) {
        read("s", s), read("core", core), read("coefficients", coefficients), read("views", views);
        settings.fields(read);
    }
};

inline void normal_equations(const NormalEquationsInput& in, std::size_t threads, Grid<float> information,
                             Grid<float> pull, Grid<std::uint8_t> used) {
    constexpr int kRowsPerJob = 64;  // which warps 9 more on both sides
    NormalProblem problem{in.settings,
                          in.s.data,
                          in.core.data,
                          in.s.height(),
                          in.s.width(),
                          {},
                          {information.data, pull.data, used.data}};
    for (std::size_t k = 0; k < in.coefficients.size(); ++k) {
        const Grid<const float>& image = in.coefficients[k];
        problem.views.push_back(
            {view_of(in.views.data + kViewFloats * k), {image.data, image.width(), image.height()}});
    }
    for_bands(0, problem.height, kRowsPerJob, threads,
              [&](int first, int end) { NormalBand(problem).run(first, end); });
}

}  // namespace beltscape
