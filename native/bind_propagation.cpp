// Binds propagate.hpp.
#include "bind_auxiliaries.hpp"
#include "pool.hpp"
#include "propagate.hpp"
#include "sweep_band.hpp"

namespace beltscape {
namespace {

// surface: s, slope_u, slope_v; costs: separation, floor, unseen_cost, tolerance, small_jump, large_jump;
// active: empty where all pixels are; out: s, slope_u, slope_v, cost, margin.
void propagate(std::vector<Grid> surface, Grid core, std::vector<Grid> images, Views views,
               std::vector<Grid> buffers, Offsets offsets, int candidates, std::vector<float> costs,
               std::vector<Flags> active, std::vector<GridOut> out, std::size_t threads) {
    const std::vector<Auxiliary> auxiliaries = auxiliaries_of(images, views, buffers);
    std::vector<Offset> all{{0, 0}};
    for (std::size_t i = 0; i < offsets.shape(0); ++i)
        all.push_back({offsets.data()[2 * i], offsets.data()[2 * i + 1]});
    PropagateInput in{};
    in.surface = {surface[0].data(), surface[1].data(), surface[2].data(), width_of(core), height_of(core)};
    in.core = core.data();
    in.auxiliaries = auxiliaries.data(), in.auxiliary_count = static_cast<int>(auxiliaries.size());
    in.offsets = all.data(), in.offset_count = static_cast<int>(all.size());
    in.candidates = candidates;
    in.separation = costs[0], in.floor = costs[1], in.unseen_cost = costs[2], in.tolerance = costs[3];
    in.small_jump = costs[4], in.large_jump = costs[5];
    in.active = active.empty() ? nullptr : active[0].data();
    const PropagateOut to{out[0].data(), out[1].data(), out[2].data(), out[3].data(), out[4].data()};
    const Image core_image = image_of(core);
    nb::gil_scoped_release release;
    in.level = mean_level(core_image);
    Pool<Propagator> propagators;
    for_bands(0, in.surface.height, kBandRows, threads, [&](int first, int end) {
        const auto propagator = propagators.take([&] { return std::make_unique<Propagator>(in); });
        propagator->work(first, end, to);
    });
}

}  // namespace

void bind_propagation(nb::module_& m) {
    m.def("propagate", &propagate, nb::arg("surface"), nb::arg("core"), nb::arg("images"), nb::arg("views"),
          nb::arg("buffers"), nb::arg("offsets"), nb::arg("candidates"), nb::arg("costs"), nb::arg("active"),
          nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
