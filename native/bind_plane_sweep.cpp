// Binds sweep_band.hpp, aggregate.hpp and sweep_and_aggregate.hpp.
#include <nanobind/stl/vector.h>

#include "bind_grid.hpp"
#include "sweep_and_aggregate.hpp"

namespace beltscape {
namespace {

using Views = nb::ndarray<const float, nb::shape<-1, 21>, nb::c_contig, nb::device::cpu>;
using Costs = nb::ndarray<const std::uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using CostsOut = nb::ndarray<std::uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

Image image_of(const Grid& grid) { return {grid.data(), width_of(grid), height_of(grid)}; }

// Owns the arrays that a SweepInput points to.
struct Sweep {
    std::vector<Image> images;
    std::vector<View> views;
    SweepInput input;

    Sweep(const Grid& core, const std::vector<Grid>& grids, const Views& rows, float first, float step,
          int planes, float floor, int best) {
        for (std::size_t i = 0; i < grids.size(); ++i)
            images.push_back(image_of(grids[i])), views.push_back(view_of(rows.data() + 21 * i));
        input = {image_of(core), images.data(), views.data(), static_cast<int>(grids.size()), best, first,
                 step,           planes,        floor,        mean_level(image_of(core))};
    }
};

void sweep(Grid core, std::vector<Grid> images, Views views, float first, float step, int planes, float floor,
           int best, int first_row, CostsOut out, std::size_t threads) {
    const Sweep given(core, images, views, first, step, planes, floor, best);
    const int rows = static_cast<int>(out.shape(0));
    const std::size_t row_size = out.shape(1) * out.shape(2);
    std::uint8_t* const costs = out.data();
    nb::gil_scoped_release release;
    Pool<Sweeper> sweepers;
    for_bands(0, rows, kStripRows, threads, [&](int start, int end) {
        const auto sweeper = sweepers.take([&] { return std::make_unique<Sweeper>(given.input); });
        sweeper->sweep(first_row + start, first_row + end,
                       costs + static_cast<std::size_t>(start) * row_size);
    });
}

template <class Cell>
void aggregate_as(const CostBand& band, int width, int planes, int small_jump, int large_jump, float* index,
                  float* margin) {
    Aggregator<Cell>(width, planes, small_jump, large_jump).aggregate(band, index, margin);
}

void aggregate(Costs cost, int small_jump, int large_jump, GridOut index, GridOut margin,
               std::size_t /* runs on one thread */) {
    const int rows = static_cast<int>(cost.shape(0)), width = static_cast<int>(cost.shape(1)),
              planes = static_cast<int>(cost.shape(2));
    const CostBand band{cost.data(), cost.data() + cost.size(), rows, 0, rows};
    float *const indices = index.data(), *const margins = margin.data();
    nb::gil_scoped_release release;
    const auto run = fits_bytes(small_jump, large_jump) ? aggregate_as<std::uint8_t> : aggregate_as<Word>;
    run(band, width, planes, small_jump, large_jump, indices, margins);
}

template <class Cell>
void coarse_as(const SweepInput& input, const Cut& cut, int small_jump, int large_jump, float* index,
               float* margin, std::size_t threads) {
    Coarse<Cell>(input, cut, small_jump, large_jump, threads).search(index, margin);
}

void coarse(Grid core, std::vector<Grid> images, Views views, float first, float step, int planes,
            float floor, int best, int small_jump, int large_jump, int band_rows, int halo_rows,
            int slab_rows, GridOut index, GridOut margin, std::size_t threads) {
    const Sweep given(core, images, views, first, step, planes, floor, best);
    const Cut cut{band_rows, halo_rows, slab_rows};
    float *const indices = index.data(), *const margins = margin.data();
    nb::gil_scoped_release release;
    const auto run = fits_bytes(small_jump, large_jump) ? coarse_as<std::uint8_t> : coarse_as<Word>;
    run(given.input, cut, small_jump, large_jump, indices, margins, threads);
}

}  // namespace

void bind_plane_sweep(nb::module_& m) {
    m.def("sweep", &sweep, nb::arg("core"), nb::arg("images"), nb::arg("views"), nb::arg("first"),
          nb::arg("step"), nb::arg("planes"), nb::arg("floor"), nb::arg("best"), nb::arg("first_row"),
          nb::arg("out"), nb::arg("threads"));
    m.def("aggregate", &aggregate, nb::arg("cost"), nb::arg("small_jump"), nb::arg("large_jump"),
          nb::arg("index"), nb::arg("margin"), nb::arg("threads"));
    m.def("sweep_and_aggregate", &coarse, nb::arg("core"), nb::arg("images"), nb::arg("views"),
          nb::arg("first"), nb::arg("step"), nb::arg("planes"), nb::arg("floor"), nb::arg("best"),
          nb::arg("small_jump"), nb::arg("large_jump"), nb::arg("band_rows"), nb::arg("halo_rows"),
          nb::arg("slab_rows"), nb::arg("index"), nb::arg("margin"), nb::arg("threads"));
}

}  // namespace beltscape
