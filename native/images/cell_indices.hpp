// Cells of a field, and the cut into bands of rows whose cells share summed-area tables
// (kernels/images.py). For the CPU alone.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "array.hpp"

namespace beltscape {

inline constexpr std::int64_t kBandRows = 128;  // kernels/images.py BAND_ROWS

// A field, NaN: not measured; cells of it and odd sides of windows about them.
struct WindowsInput {
    Grid<const double> field;
    List<const std::int64_t> rows, columns, sides;

    std::int64_t height() const { return static_cast<std::int64_t>(field.shape[0]); }
    std::int64_t width() const { return static_cast<std::int64_t>(field.shape[1]); }
    std::size_t count() const { return rows.shape[0]; }
    std::size_t sizes() const { return sides.shape[0]; }
    std::int64_t reach() const { return *std::max_element(sides.data, sides.data + sizes()) / 2; }
    void fields(const auto& read) {
        read("field", field), read("rows", rows), read("columns", columns), read("sides", sides);
    }
};

// Indices of cells, and the rows first ... end - 1 that their windows reach.
struct PlaceBand {
    std::vector<std::size_t> own;
    std::int64_t first = 0, end = 0;
};

inline std::vector<PlaceBand> bands_of(const WindowsInput& in) {
    if (in.count() == 0) return {};
    const auto [low, high] = std::minmax_element(in.rows.data, in.rows.data + in.count());
    std::vector<PlaceBand> bands(static_cast<std::size_t>((*high - *low) / kBandRows + 1));
    for (std::size_t i = 0; i < in.count(); ++i)
        bands[static_cast<std::size_t>((in.rows[i] - *low) / kBandRows)].own.push_back(i);
    std::erase_if(bands, [](const PlaceBand& band) { return band.own.empty(); });
    for (PlaceBand& band : bands) {
        const auto before = [&](std::size_t a, std::size_t b) { return in.rows[a] < in.rows[b]; };
        const auto [top, bottom] = std::minmax_element(band.own.begin(), band.own.end(), before);
        band.first = std::max<std::int64_t>(in.rows[*top] - in.reach(), 0);
        band.end = std::min(in.rows[*bottom] + in.reach() + 1, in.height());
    }
    return bands;
}

}  // namespace beltscape
