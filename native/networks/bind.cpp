// The kernels of this folder by name; bind.hpp reads their records.
#include "bind.hpp"

#include "networks/message_passing.hpp"

void beltscape::bind_networks(nb::module_& m) {
    bind(m, "evaluate_network", &evaluate_network);
    bind(m, "pass_messages", &pass_messages);
}
