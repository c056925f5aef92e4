// The displacement of a field of heights by robust least squares (kernels/least_squares.py). Sums run in a
// fixed number of lanes, so that every level adds in one order. For the CPU alone.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "array.hpp"

namespace beltscape {

inline constexpr int kFitRounds = 8, kFitReweightings = 3, kFitCells = 100, kFitSamples = 8192;
inline constexpr double kFitSettled = 1e-4, kFitReach = 3, kFitCondition = 1e12;
inline constexpr double kFitBiweight = 4.7 * 1.4826;  // of the median absolute deviation
inline constexpr int kFitLanes = 8;

struct ShiftInput {
    Grid<const double> before, after;
    std::int64_t start, side;

    void fields(const auto& read) {
        read("before", before), read("after", after), read("start", start), read("side", side);
    }
};

using Vector3 = std::array<double, 3>;
using Matrix3 = std::array<Vector3, 3>;

// A symmetric matrix as its eigenvalues and eigenvectors (columns), by Jacobi's rotations.
struct Eigen3 {
    explicit Eigen3(const Matrix3& of) : value(of), vectors{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}} {
        for (int sweep = 0; sweep < 24; ++sweep)
            for (const auto [p, q] : {std::array{0, 1}, std::array{0, 2}, std::array{1, 2}}) rotate(p, q);
    }
    double condition() const {
        const auto [low, high] =
            std::minmax({std::abs(value[0][0]), std::abs(value[1][1]), std::abs(value[2][2])});
        return high / low;
    }
    // The inverse of the matrix times a vector.
    Vector3 solve(const Vector3& by) const {
        Vector3 out{};
        for (std::size_t k = 0; k < 3; ++k) {
            double part = 0;
            for (std::size_t i = 0; i < 3; ++i) part += vectors[i][k] * by[i];
            for (std::size_t i = 0; i < 3; ++i) out[i] += vectors[i][k] * part / value[k][k];
        }
        return out;
    }

    Matrix3 value, vectors;

private:
    void rotate(int one, int other) {
        const auto p = static_cast<std::size_t>(one), q = static_cast<std::size_t>(other);
        if (value[p][q] == 0) return;
        const double theta = (value[q][q] - value[p][p]) / (2 * value[p][q]);
        const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        for (std::size_t k = 0; k < 3; ++k) {
            const double a = value[k][p], b = value[k][q];
            value[k][p] = c * a - s * b, value[k][q] = s * a + c * b;
        }
        for (std::size_t k = 0; k < 3; ++k) {
            const double a = value[p][k], b = value[q][k], x = vectors[k][p], y = vectors[k][q];
            value[p][k] = c * a - s * b, value[q][k] = s * a + c * b;
            vectors[k][p] = c * x - s * y, vectors[k][q] = s * x + c * y;
        }
    }
};

// The equations of the cells that both fields have.
struct ShiftEquations {
    std::vector<double> down, right, residual, left, weight, samples;
    std::vector<std::int32_t> block;

    std::size_t size() const { return residual.size(); }
    void clear() { down.clear(), right.clear(), residual.clear(), block.clear(); }
};

// A field displaced by fractions of cells, and its mean with another; NaN next to unknown cells.
class DisplacedField {
public:
    explicit DisplacedField(const ShiftInput& in)
        : in_(in), row_(in.before.shape[1]), moved_(in.before.shape[0] * row_.size()), mean_(moved_.size()) {}

    void displace(double along, double across) {
        const double down = std::floor(along), right = std::floor(across);
        const double v_part = along - down, u_part = across - right;
        const int height = in_.before.height(), width = in_.before.width();
        const int rows = static_cast<int>(down), columns = static_cast<int>(right);
        constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
        for (int v = 0; v < height; ++v) {
            double *const to = moved(v), *const mean = this->mean(v);
            const double* const own = in_.before.row(v);
            if (v + rows < 0 || v + rows + 1 >= height) {
                std::fill_n(to, width, unknown), std::fill_n(mean, width, unknown);
                continue;
            }
            const double *const above = in_.after.row(v + rows), *const below = in_.after.row(v + rows + 1);
            for (int u = 0; u < width; ++u)
                row_[static_cast<std::size_t>(u)] = (1 - v_part) * above[u] + v_part * below[u];
            const int first = std::clamp(-columns, 0, width);
            const int end = std::clamp(width - 1 - columns, first, width);
            std::fill(to, to + first, unknown), std::fill(to + end, to + width, unknown);
            const double* const from = row_.data();
            for (int u = first; u < end; ++u)
                to[u] = (1 - u_part) * from[u + columns] + u_part * from[u + columns + 1];
            for (int u = 0; u < width; ++u) mean[u] = 0.5 * (own[u] + to[u]);
        }
    }

    void collect(ShiftEquations& to) {
        const int height = in_.before.height(), width = in_.before.width();
        const auto side = static_cast<int>(in_.side);
        to.clear();
        for (int v = 0; v < height; ++v) {
            const int up = std::max(v - 1, 0), low = std::min(v + 1, height - 1);
            const double *const own = in_.before.row(v), *const other = moved(v), *const mean = this->mean(v),
                                *const above = this->mean(up), *const below = this->mean(low);
            for (int u = 0; u < width; ++u) {
                const double residual = other[u] - own[u];
                if (!std::isfinite(residual)) continue;
                const int before = std::max(u - 1, 0), after = std::min(u + 1, width - 1);
                const double down = (below[u] - above[u]) / (low - up);
                const double right = (mean[after] - mean[before]) / (after - before);
                if (!std::isfinite(down) || !std::isfinite(right)) continue;
                to.down.push_back(down), to.right.push_back(right), to.residual.push_back(residual);
                to.block.push_back((v / side) * (width / side + 1) + u / side);
            }
        }
    }

private:
    double* moved(int v) { return moved_.data() + static_cast<std::size_t>(v) * row_.size(); }
    double* mean(int v) { return mean_.data() + static_cast<std::size_t>(v) * row_.size(); }

    const ShiftInput& in_;
    std::vector<double> row_, moved_, mean_;
};

// The median of every k-th value of f(value).
template <class Function>
inline double sampled_median(ShiftEquations& of, const std::vector<double>& values, const Function& f) {
    const std::size_t step = (values.size() + kFitSamples - 1) / kFitSamples;
    auto& samples = of.samples;
    samples.clear();
    for (std::size_t i = 0; i < values.size(); i += step) samples.push_back(f(values[i]));
    const auto middle = samples.begin() + static_cast<std::ptrdiff_t>(samples.size() / 2);
    std::nth_element(samples.begin(), middle, samples.end());
    if (samples.size() % 2) return *middle;
    return 0.5 * (*middle + *std::max_element(samples.begin(), middle));
}

struct ShiftSolution {
    Vector3 change;
    Eigen3 normal;
};

// One weighted solution; the weights follow from `left`, which becomes what the solution leaves.
inline std::optional<ShiftSolution> solve_weighted(ShiftEquations& of) {
    const double reach =
        kFitBiweight * sampled_median(of, of.left, [](double x) { return std::abs(x); }) + 1e-9;
    enum { xx, xy, x1, yy, y1, one, xr, yr, r1, kSums };
    double sums[kSums][kFitLanes] = {};
    const std::size_t count = of.size();
    const auto add = [&](std::size_t i, std::size_t lane) {
        const double ratio = of.left[i] / reach, inside = std::max(1 - ratio * ratio, 0.0);
        const double w = of.weight[i] = inside * inside;
        const double x = of.down[i], y = of.right[i], r = of.residual[i], wx = w * x, wy = w * y;
        sums[xx][lane] += wx * x, sums[xy][lane] += wx * y, sums[x1][lane] += wx;
        sums[yy][lane] += wy * y, sums[y1][lane] += wy, sums[one][lane] += w;
        sums[xr][lane] += wx * r, sums[yr][lane] += wy * r, sums[r1][lane] += w * r;
    };
    std::size_t i = 0;
    for (; i + kFitLanes <= count; i += kFitLanes)
        for (std::size_t lane = 0; lane < kFitLanes; ++lane) add(i + lane, lane);
    for (; i < count; ++i) add(i, 0);
    double sum[kSums];
    for (int k = 0; k < kSums; ++k) {
        sum[k] = 0;
        for (const double part : sums[k]) sum[k] += part;
    }
    const Eigen3 normal(
        {{{sum[xx], sum[xy], sum[x1]}, {sum[xy], sum[yy], sum[y1]}, {sum[x1], sum[y1], sum[one]}}});
    if (!(normal.condition() <= kFitCondition)) return std::nullopt;
    Vector3 change = normal.solve({sum[xr], sum[yr], sum[r1]});
    for (double& part : change) part = -part;
    for (std::size_t k = 0; k < count; ++k)
        of.left[k] = of.residual[k] + (change[0] * of.down[k] + change[1] * of.right[k] + change[2]);
    return ShiftSolution{change, normal};
}

inline std::optional<ShiftSolution> solve_robustly(ShiftEquations& of) {
    const double middle = sampled_median(of, of.residual, [](double x) { return x; });
    of.left.resize(of.size()), of.weight.resize(of.size());
    for (std::size_t i = 0; i < of.size(); ++i) of.left[i] = of.residual[i] - middle;
    std::optional<ShiftSolution> solved;
    for (int k = 0; k < kFitReweightings; ++k)
        if (!(solved = solve_weighted(of))) break;
    return solved;
}

// The variance of the change along rows, from the sums of the weighted residuals over blocks.
inline double estimate_variance(const ShiftEquations& of, const Eigen3& normal) {
    std::vector<Vector3> scores(of.block.empty() ? 0 : static_cast<std::size_t>(of.block.back()) + 1);
    for (std::size_t i = 0; i < of.size(); ++i) {
        const auto block = static_cast<std::size_t>(of.block[i]);
        if (block >= scores.size()) scores.resize(block + 1);
        const double pull = of.weight[i] * of.left[i];
        scores[block][0] += of.down[i] * pull, scores[block][1] += of.right[i] * pull,
            scores[block][2] += pull;
    }
    double variance = 0;
    for (const Vector3& score : scores) {
        const double part = normal.solve(score)[0];
        variance += part * part;
    }
    return variance;
}

inline void fit_shift(const ShiftInput& in, std::size_t /* runs on one thread */, List<double> shift,
                      List<double> variance) {
    shift[0] = shift[1] = variance[0] = std::numeric_limits<double>::quiet_NaN();
    const double start = static_cast<double>(in.start);
    double along = start, across = 0, spread = 0;
    DisplacedField field(in);
    ShiftEquations equations;
    for (int round = 0; round < kFitRounds; ++round) {
        field.displace(along, across);
        field.collect(equations);
        if (equations.size() < kFitCells) return;
        const auto solved = solve_robustly(equations);
        if (!solved) return;
        along += solved->change[0], across += solved->change[1];
        if (!(std::hypot(along - start, across) <= kFitReach)) return;
        spread = estimate_variance(equations, solved->normal);
        if (std::max(std::abs(solved->change[0]), std::abs(solved->change[1])) < kFitSettled) break;
    }
    shift[0] = along, shift[1] = across, variance[0] = spread;
}

}  // namespace beltscape
