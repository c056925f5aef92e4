// Every family of kernels has one binding file; module.cpp calls them. Arrays were checked in Python
// (kernels/native/), and a binding releases the GIL for the work.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace beltscape {

namespace nb = nanobind;

void bind_plane_sweep(nb::module_& m);
void bind_message_passing(nb::module_& m);
void bind_gathering(nb::module_& m);
void bind_visibility(nb::module_& m);
void bind_network(nb::module_& m);
void bind_propagation(nb::module_& m);
void bind_least_squares(nb::module_& m);
void bind_candidates(nb::module_& m);
void bind_height_rasterisation(nb::module_& m);
void bind_triangulation(nb::module_& m);
void bind_warping(nb::module_& m);
void bind_window_statistics(nb::module_& m);

}  // namespace beltscape
