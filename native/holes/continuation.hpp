// The continuation of a measured surface into holes (kernels/holes.py): planes at the ends of eight lines
// from a cell, and the most probable of their predictions. For the CPU alone.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "holes/hole_field.hpp"

namespace beltscape {

inline constexpr int kContinuedLines = 8, kContinuedCells = 8, kPlaneCells = 2;  // kernels/holes.py
inline constexpr int kContinuedAlong[kContinuedLines][2] = {{0, 1}, {1, 0},  {0, -1}, {-1, 0},
                                                            {1, 1}, {1, -1}, {-1, 1}, {-1, -1}};
inline constexpr double kSteepestRise = 3, kSupportCells = 1.2, kMostCells = 32;
inline constexpr double kLogit[] = {-1.66, -0.204, 0.84, -0.0425, 0.0403};

struct ContinuationInput {
    Grid<const double> field;
    double cell;
    std::int64_t first, end;  // the rows whose holes count

    void fields(const auto& read) {
        read("field", field), read("cell", cell), read("first", first), read("end", end);
    }
};

// Heights in edges of a cell, with the planes at the ends of lines, each fitted when a line first ends there.
class ContinuedField {
public:
    explicit ContinuedField(const ContinuationInput& in)
        : rows_(in.field.height()),
          columns_(in.field.width()),
          from_(std::max(static_cast<int>(in.first) - kContinuedCells - kPlaneCells, 0)),
          heights_(in.field.shape[0] * in.field.shape[1]),
          planes_(heights_.size(), {kNothing, kNothing}) {
        const int to = std::min(static_cast<int>(in.end) + kContinuedCells + kPlaneCells, rows_);
        for (std::size_t at = index(from_, 0); at < index(to, 0); ++at)
            heights_[at] = std::isfinite(in.field[at]) ? in.field[at] / in.cell : kNothing;
    }

    // The height of a cell; NaN of a hole and outside.
    double at(int v, int u) const {
        return v < 0 || u < 0 || v >= rows_ || u >= columns_ ? kNothing : heights_[index(v, u)];
    }

    // The rise per row and per column of the plane through the cells of one surface about a measured cell.
    // Two level cells of weight one, one on either axis, keep it level where too few cells determine it.
    const std::array<double, 2>& plane(int v, int u) {
        std::array<double, 2>& rise = planes_[index(v, u)];
        if (rise[0] == rise[0]) return rise;
        const double centre = heights_[index(v, u)];
        double xx = 1, xy = 0, yy = 1, xh = 0, yh = 0;
        for (int y = -kPlaneCells; y <= kPlaneCells; ++y)
            for (int x = -kPlaneCells; x <= kPlaneCells; ++x) {
                const double height = at(v + y, u + x) - centre;
                if (!(std::abs(height) <= kSteepestRise * std::max(std::abs(x), std::abs(y)))) continue;
                xx += x * x, xy += x * y, yy += y * y;
                xh += x * height, yh += y * height;
            }
        const double determinant = xx * yy - xy * xy;
        return rise = {(yh * xx - xh * xy) / determinant, (xh * yy - yh * xy) / determinant};
    }

private:
    std::size_t index(int v, int u) const {
        return static_cast<std::size_t>(v) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(u);
    }

    int rows_, columns_, from_;
    std::vector<double> heights_;
    std::vector<std::array<double, 2>> planes_;
};

struct ContinuedCell {
    double height = kNothing, logit = -kEndless;
};

// The most probable of the predictions at a hole cell.
inline ContinuedCell continue_cell(ContinuedField& field, int v, int u) {
    double heights[kContinuedLines], distances[kContinuedLines], lowest_end = 0;
    for (int k = 0; k < kContinuedLines; ++k) {
        const auto [down, right] = kContinuedAlong[k];
        heights[k] = kNothing, distances[k] = kEndless;
        for (int step = 1; step <= kContinuedCells; ++step) {
            const double end = field.at(v + step * down, u + step * right);
            if (end != end) continue;
            const auto& rise = field.plane(v + step * down, u + step * right);
            heights[k] = end - step * (down * rise[0] + right * rise[1]);
            distances[k] = step * std::hypot(down, right);
            lowest_end = std::min(lowest_end, end);
            break;
        }
    }
    double lowest = kEndless, highest = -kEndless;
    for (double& height : heights)
        if (height == height) {
            height = std::max(height, lowest_end);
            lowest = std::min(lowest, height), highest = std::max(highest, height);
        }
    ContinuedCell best;
    for (int k = 0; k < kContinuedLines; ++k) {
        if (heights[k] != heights[k]) continue;
        double support = 0;
        for (int other = 0; other < kContinuedLines; ++other)
            if (other != k && std::abs(heights[other] - heights[k]) < kSupportCells)
                support += 1 / distances[other];
        const double logit = kLogit[0] + kLogit[1] * distances[k] + kLogit[2] * support +
                             kLogit[3] * std::min(heights[k] - lowest, kMostCells) +
                             kLogit[4] * std::min(highest - heights[k], kMostCells);
        if (logit > best.logit) best = {heights[k], logit};
    }
    return best;
}

inline void continue_surface(const ContinuationInput& in, std::size_t /* runs on one thread */,
                             List<double> height, List<double> probability) {
    ContinuedField field(in);
    std::size_t number = 0;
    for (int v = static_cast<int>(in.first); v < static_cast<int>(in.end); ++v)
        for (int u = 0; u < in.field.width(); ++u) {
            if (std::isfinite(in.field.row(v)[u])) continue;
            const ContinuedCell found = continue_cell(field, v, u);
            height[number] = in.cell * found.height;
            probability[number++] = 1 / (1 + std::exp(-found.logit));
        }
}

}  // namespace beltscape
