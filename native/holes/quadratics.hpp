// Least-squares quadratics in windows about hole cells: sums of powers run down the columns from row to row,
// and along a row up to each column. Whole numbers of them are exact in double. For the CPU alone.
#pragma once

#include "holes/rims.hpp"
#include "simd.hpp"

namespace beltscape {

inline constexpr double kFewest = 12, kMostLeverage = 30, kRidge = 1e-6;  // kernels/holes.py
inline constexpr int kTerms = 6, kBatch = 16;  // cells whose equations are solved in step

// The sums of a column: powers 0 ... 4 of y over measured cells, powers 0 ... 2 of y times their heights.
inline constexpr int kColumnSums = 8;
// The sums of a row: the columns', those times x, those times x², and x³, x³y, x⁴ and squared heights.
inline constexpr int kRowSums = 3 * kColumnSums + 4;
// The widest stretch of columns in which x⁴ y⁰ over 101² cells, shifted, stays below 2^53.
inline constexpr int kMostColumns = 768;

// The number of the sum of x^i y^j, and of that of x^i y^j times the heights.
inline constexpr int count_at(int i, int j) { return i < 3 ? kColumnSums * i + j : i == 3 ? 24 + j : 26; }
inline constexpr int height_at(int i, int j) { return kColumnSums * i + 5 + j; }
inline constexpr int kSquares = 27;

// Eight numbers in lanes.
struct Eight {
    static constexpr int kParts = kColumnSums / kDoubleLanes;
    Doubles part[kParts];

    static Eight read(const double* from) {
        Eight eight;
        for (int i = 0; i < kParts; ++i)
            __builtin_memcpy(&eight.part[i], from + i * kDoubleLanes, sizeof(Doubles));
        return eight;
    }
    void write(double* to) const {
        for (int i = 0; i < kParts; ++i) __builtin_memcpy(to + i * kDoubleLanes, &part[i], sizeof(Doubles));
    }
    void add(double factor, const Eight& other) {
        for (int i = 0; i < kParts; ++i) part[i] += factor * other.part[i];
    }
};

// Sums over the rows of a window about a row, column by column; y is counted from `origin`.
class ColumnSums {
public:
    ColumnSums(const HoleField& holes, int side, int row)
        : field(holes),
          half(side / 2),
          origin(row),
          sums(static_cast<std::size_t>(holes.width) * kColumnSums),
          squares(static_cast<std::size_t>(holes.width)) {
        for (int v = row - half; v <= row + half; ++v) add(v, 1.0);
    }

    void move_down(int row) {
        add(row + half, 1.0);
        add(row - half - 1, -1.0);
    }

    const double* column(int u) const { return sums.data() + static_cast<std::ptrdiff_t>(u) * kColumnSums; }
    double square(int u) const { return squares[u]; }

    int origin_row() const { return origin; }

private:
    void add(int v, double sign) {
        if (v < 0 || v >= field.height) return;
        const double y = v - origin;
        const double counts[kColumnSums] = {sign, sign * y, sign * y * y, sign * y * y * y,
                                            sign * y * y * y * y};
        const double heights[kColumnSums] = {0, 0, 0, 0, 0, sign, sign * y, sign * y * y};
        const Eight of_cell = Eight::read(counts), of_height = Eight::read(heights);
        const double *const known = field.measured.row(v), *const height = field.value.row(v);
        double *to = sums.data(), *const to_squares = squares.data();
        const int width = field.width;
        for (int u = 0; u < width; ++u, to += kColumnSums) {
            Eight sum = Eight::read(to);
            sum.add(known[u], of_cell);
            sum.add(height[u], of_height);
            sum.write(to);
        }
#pragma omp simd
        for (int u = 0; u < width; ++u) to_squares[u] += sign * (height[u] * height[u]);
    }

    const HoleField& field;
    int half, origin;
    std::vector<double> sums, squares;
};

// Sums along a row, up to each of the columns `from` ... `to`; x is counted from their middle.
class WindowRowSums {
public:
    WindowRowSums(int first, int last)
        : from(first),
          to(last),
          middle((first + last) / 2),
          sums(static_cast<std::size_t>(last - first + 1) * kRowSums) {}

    void fill(const ColumnSums& columns) {
        double* next = sums.data();
        Eight even{}, odd{}, square{};
        double rest[4] = {};
        const auto store = [&] {
            even.write(next), odd.write(next + kColumnSums), square.write(next + 2 * kColumnSums);
            std::copy_n(rest, 4, next + 3 * kColumnSums);
            next += kRowSums;
        };
        for (int u = from; u < to; ++u) {
            store();
            const Eight own = Eight::read(columns.column(u));
            const double x = u - middle, xx = x * x, number = columns.column(u)[0];
            even.add(1.0, own), odd.add(x, own), square.add(xx, own);
            rest[0] += xx * x * number, rest[1] += xx * x * columns.column(u)[1];
            rest[2] += xx * xx * number, rest[3] += columns.square(u);
        }
        store();
    }

    // The sums of the columns first ... end - 1.
    void take(int first, int end, double (&of)[kRowSums]) const {
        const double *const low = at(first), *const high = at(end);
        for (int k = 0; k < kRowSums; ++k) of[k] = high[k] - low[k];
    }

    int first_column() const { return from; }
    int end_column() const { return to; }
    int origin() const { return middle; }

private:
    const double* at(int u) const { return sums.data() + static_cast<std::ptrdiff_t>(u - from) * kRowSums; }

    int from, to, middle;
    std::vector<double> sums;
};

using Batch = std::array<double, kBatch>;

template <class Each>
inline void for_each_in_batch(const Each& each) {
#pragma omp simd
    for (int n = 0; n < kBatch; ++n) each(n);
}

// Sums over windows about several cells, and the place of their fits.
struct QuadraticBatch {
    std::array<Batch, kRowSums> sums;
    std::array<Batch, 5> x, y;  // powers of the negated place of the cell
    std::array<QuadraticFits*, kBatch> to;
    int count = 0;
};

// Turns the sums of a power series about the origin into those about the cells, by the binomial theorem,
// first for x, then for y. `at(i, j)` is the number of x^i y^j, of a degree up to `degree`.
template <int degree, class At>
inline void shift_sums(QuadraticBatch& batch, const At& at) {
    constexpr int choose[5][5] = {
        {1, 0, 0, 0, 0}, {1, 1, 0, 0, 0}, {1, 2, 1, 0, 0}, {1, 3, 3, 1, 0}, {1, 4, 6, 4, 1}};
    for (int j = 0; j <= degree; ++j)
        for (int i = degree - j; i > 0; --i)
            for (int a = 0; a < i; ++a) {
                const double ways = choose[i][a];
                const Batch &from = batch.sums[at(a, j)], &x = batch.x[i - a];
                Batch& to = batch.sums[at(i, j)];
                for_each_in_batch([&](int n) { to[n] += ways * x[n] * from[n]; });
            }
    for (int i = 0; i <= degree; ++i)
        for (int j = degree - i; j > 0; --j)
            for (int b = 0; b < j; ++b) {
                const double ways = choose[j][b];
                const Batch &from = batch.sums[at(i, b)], &y = batch.y[j - b];
                Batch& to = batch.sums[at(i, j)];
                for_each_in_batch([&](int n) { to[n] += ways * y[n] * from[n]; });
            }
}

inline constexpr int kTerm[kTerms][2] = {{0, 0}, {1, 0}, {0, 1},
                                         {2, 0}, {1, 1}, {0, 2}};  // powers of x and y
using Column = std::array<Batch, kTerms>;

inline void subtract_product(Batch& from, const Batch& a, const Batch& b) {
    for_each_in_batch([&](int n) { from[n] -= a[n] * b[n]; });
}
inline void multiply(Batch& by, const Batch& a) {
    for_each_in_batch([&](int n) { by[n] *= a[n]; });
}

// A symmetric positive definite matrix's lower triangle becomes its Cholesky factor, with inverse diagonal.
inline void factorise(std::array<Column, kTerms>& a) {
    for (int j = 0; j < kTerms; ++j) {
        Batch& pivot = a[j][j];
        for (int k = 0; k < j; ++k) subtract_product(pivot, a[j][k], a[j][k]);
        for_each_in_batch([&](int n) { pivot[n] = 1 / std::sqrt(pivot[n] > 1e-30 ? pivot[n] : 1e-30); });
        for (int i = j + 1; i < kTerms; ++i) {
            for (int k = 0; k < j; ++k) subtract_product(a[i][j], a[i][k], a[j][k]);
            multiply(a[i][j], pivot);
        }
    }
}

// Solves L x = x for a lower triangle L with inverse diagonal.
inline void solve(const std::array<Column, kTerms>& lower, Column& x) {
    for (int j = 0; j < kTerms; ++j) {
        for (int i = 0; i < j; ++i) subtract_product(x[j], lower[j][i], x[i]);
        multiply(x[j], lower[j][j]);
    }
}

// Writes the fits of window `k` for the batch's cells, and empties it.
inline void fit_quadratics(QuadraticBatch& batch, int k, double middle) {
    if (batch.count == 0) return;
    shift_sums<4>(batch, count_at);
    shift_sums<2>(batch, height_at);
    double scale[5] = {1};
    for (int i = 1; i < 5; ++i) scale[i] = scale[i - 1] / (0.5 * kWindow[k]);
    const Batch& number = batch.sums[0];
    std::array<Column, kTerms> normal;
    Column right, unit{};
    for (int a = 0; a < kTerms; ++a) {
        const double of_right = scale[kTerm[a][0] + kTerm[a][1]];
        const Batch& height = batch.sums[height_at(kTerm[a][0], kTerm[a][1])];
        for_each_in_batch([&](int n) { right[a][n] = height[n] * of_right; });
        for (int b = 0; b <= a; ++b) {
            const int i = kTerm[a][0] + kTerm[b][0], j = kTerm[a][1] + kTerm[b][1];
            const double of = scale[i + j];
            const Batch& count = batch.sums[count_at(i, j)];
            for_each_in_batch([&](int n) { normal[a][b][n] = count[n] * of; });
        }
        for_each_in_batch([&](int n) { normal[a][a][n] += kRidge * std::max(number[n], 1.0); });
    }
    factorise(normal);
    unit[0].fill(1.0);
    solve(normal, right);
    solve(normal, unit);
    // (L Lᵀ)⁻¹ of two vectors is the product of both by L⁻¹: value, leverage and explained squares
    Batch value{}, leverage{}, rest = batch.sums[kSquares];
    for (int t = 0; t < kTerms; ++t) {
        const Batch &of_right = right[t], &of_unit = unit[t];
        for_each_in_batch([&](int n) {
            value[n] += of_unit[n] * of_right[n];
            leverage[n] += of_unit[n] * of_unit[n];
        });
        subtract_product(rest, of_right, of_right);
    }
    for_each_in_batch([&](int n) {
        const double most = rest[n] > 0 ? rest[n] : 0.0, cells = number[n] > 1 ? number[n] : 1.0;
        rest[n] = std::sqrt(most / cells);
        leverage[n] *= number[n];
    });
    for (int n = 0; n < batch.count; ++n) {
        const bool sound = number[n] > kFewest - 0.5 && leverage[n] > 0 && leverage[n] < kMostLeverage;
        QuadraticFits& fits = *batch.to[n];
        fits.value[k] = sound ? value[n] + middle : kNothing;
        fits.miss[k] = sound ? rest[n] : kNothing;
        fits.leverage[k] = sound ? leverage[n] : kNothing;
    }
    batch.count = 0;
}

// Adds the window about a cell to a batch, and fits it when it is full.
inline void add_window(const HoleField& field, const WindowRowSums& row, int v, int u, int k, int origin,
                       QuadraticFits* to, QuadraticBatch& batch) {
    const int half = kWindow[k] / 2, n = batch.count++;
    double of[kRowSums];
    row.take(std::max(u - half, row.first_column()), std::min(u + half + 1, row.end_column()), of);
    for (int i = 0; i < kRowSums; ++i) batch.sums[i][n] = of[i];
    batch.x[0][n] = batch.y[0][n] = 1;
    for (int i = 1; i < 5; ++i) {
        batch.x[i][n] = batch.x[i - 1][n] * (row.origin() - u);
        batch.y[i][n] = batch.y[i - 1][n] * (origin - v);
    }
    batch.to[n] = to;
    if (batch.count == kBatch) fit_quadratics(batch, k, field.middle);
}

}  // namespace beltscape
