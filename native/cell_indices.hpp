// Places on a field, and the cut into bands of rows whose places share tables of running sums
// (kernels/windows.py). For the CPU alone.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace beltscape {

inline constexpr std::int64_t kBandRows = 128;  // kernels/window_statistics.py BAND_ROWS

// A field (height, width), NaN: not measured; places on it and odd sides of windows about them.
struct WindowsInput {
    const double* field;
    std::int64_t height, width;
    const std::int64_t *rows, *columns;  // (count)
    std::size_t count;
    const std::int64_t* sides;  // (sizes)
    std::size_t sizes;

    std::int64_t reach() const { return *std::max_element(sides, sides + sizes) / 2; }
};

// Places, by number, and the rows first ... end - 1 that their windows reach.
struct PlaceBand {
    std::vector<std::size_t> own;
    std::int64_t first = 0, end = 0;
};

inline std::vector<PlaceBand> bands_of(const WindowsInput& in) {
    if (in.count == 0) return {};
    const auto [low, high] = std::minmax_element(in.rows, in.rows + in.count);
    std::vector<PlaceBand> bands(static_cast<std::size_t>((*high - *low) / kBandRows + 1));
    for (std::size_t i = 0; i < in.count; ++i)
        bands[static_cast<std::size_t>((in.rows[i] - *low) / kBandRows)].own.push_back(i);
    std::erase_if(bands, [](const PlaceBand& band) { return band.own.empty(); });
    for (PlaceBand& band : bands) {
        const auto before = [&](std::size_t a, std::size_t b) { return in.rows[a] < in.rows[b]; };
        const auto [top, bottom] = std::minmax_element(band.own.begin(), band.own.end(), before);
        band.first = std::max<std::int64_t>(in.rows[*top] - in.reach(), 0);
        band.end = std::min(in.rows[*bottom] + in.reach() + 1, in.height);
    }
    return bands;
}

}  // namespace beltscape
