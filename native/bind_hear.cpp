// Binds hear.hpp.
#include "bind_network.hpp"
#include "bind_pixels.hpp"
#include "hear.hpp"

namespace beltscape {
namespace {

using Addresses = nb::ndarray<const std::int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void hear_all(Grid said, Addresses near, Grid kept, const std::vector<Grid>& layers, GridOut out,
              std::size_t threads) {
    const int words = height_of(said), quads = (words + kFour - 1) / kFour;
    std::vector<float> turned(said.shape(1) * static_cast<std::size_t>(kFour * quads));
    const Messages messages = {turned.data(),   words,       quads,           near.data(),
                               height_of(near), kept.data(), height_of(kept), near.shape(1)};
    const std::vector<Layer> weighed = layers_of(layers);
    const Network net = {nullptr, nullptr, weighed.data(), static_cast<int>(weighed.size())};
    std::vector<float*> to;
    for (std::size_t a = 0; a < out.shape(0); ++a) to.push_back(out.data() + a * out.shape(1));
    nb::gil_scoped_release release;
    for_bands(0, width_of(said), kPixelsPerJob, threads, [&](int first, int end) {
        turn(said.data(), said.shape(1), words, quads, static_cast<std::size_t>(first),
             static_cast<std::size_t>(end), turned.data());
    });
    for_bands(0, width_of(near), kPixelsPerJob, threads, [&](int first, int end) {
        for (int i = first; i < end; i += kWide<Floats>)
            hear<Floats>(net, messages, static_cast<std::size_t>(i), end - i, to.data());
    });
}

}  // namespace

void bind_hear(nb::module_& m) {
    m.def("pass_messages", &hear_all, nb::arg("said"), nb::arg("near"), nb::arg("kept"), nb::arg("layers"),
          nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
