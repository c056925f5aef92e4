// Binds message_passing.hpp.
#include "bind_network.hpp"
#include "bind_pixels.hpp"
#include "message_passing.hpp"

namespace beltscape {
namespace {

using Addresses = nb::ndarray<const std::int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void pass_messages_all(Grid messages, Addresses senders, Grid state, const std::vector<Grid>& layers,
                       GridOut out, std::size_t threads) {
    const int length = height_of(messages), quads = (length + kFour - 1) / kFour;
    std::vector<float> rows(messages.shape(1) * static_cast<std::size_t>(kFour * quads));
    const Messages round = {
        rows.data(),  length,           quads,           senders.data(), height_of(senders),
        state.data(), height_of(state), senders.shape(1)};
    const std::vector<Layer> checked = layers_of(layers);
    const Network net = {nullptr, nullptr, checked.data(), static_cast<int>(checked.size())};
    std::vector<float*> to;
    for (std::size_t a = 0; a < out.shape(0); ++a) to.push_back(out.data() + a * out.shape(1));
    nb::gil_scoped_release release;
    for_bands(0, width_of(messages), kPixelsPerJob, threads, [&](int first, int end) {
        transpose_messages(messages.data(), messages.shape(1), length, quads, static_cast<std::size_t>(first),
                           static_cast<std::size_t>(end), rows.data());
    });
    for_bands(0, width_of(senders), kPixelsPerJob, threads, [&](int first, int end) {
        for (int i = first; i < end; i += kWide<Floats>)
            pass_messages<Floats>(net, round, static_cast<std::size_t>(i), end - i, to.data());
    });
}

}  // namespace

void bind_message_passing(nb::module_& m) {
    m.def("pass_messages", &pass_messages_all, nb::arg("messages"), nb::arg("senders"), nb::arg("state"),
          nb::arg("layers"), nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
