// Binds network.hpp.
#include "bind_network.hpp"

namespace beltscape {
namespace {

constexpr int kRowsPerJob = 16;

void perceptron(const std::vector<Grid>& planes, Grid limits, const std::vector<Grid>& layers,
                const std::vector<GridOut>& out, std::size_t threads) {
    const int height = height_of(planes[0]), width = width_of(planes[0]);
    const std::vector<Layer> weighed = layers_of(layers);
    const Network net = {limits.data(), limits.data() + width_of(limits), weighed.data(),
                         static_cast<int>(weighed.size())};
    std::vector<const float*> from;
    std::vector<float*> to;
    for (const Grid& plane : planes) from.push_back(plane.data());
    for (const GridOut& plane : out) to.push_back(plane.data());
    nb::gil_scoped_release release;
    for_bands(0, height, kRowsPerJob, threads, [&](int first, int end) {
        for (int v = first; v < end; ++v)
            perceptron_row<Floats>(net, from.data(),
                                   static_cast<std::size_t>(v) * static_cast<std::size_t>(width), width,
                                   to.data());
    });
}

}  // namespace

void bind_network(nb::module_& m) {
    m.def("evaluate_network", &perceptron, nb::arg("planes"), nb::arg("limits"), nb::arg("layers"),
          nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
