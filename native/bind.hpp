// Every family of kernels has one binding file; module.cpp calls them. Arrays were checked in Python
// (kernels/native/), and a binding releases the GIL for the work.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace beltscape {

namespace nb = nanobind;

void bind_coarse(nb::module_& m);
void bind_hear(nb::module_& m);
void bind_neighbours(nb::module_& m);
void bind_occlusion(nb::module_& m);
void bind_perceptron(nb::module_& m);
void bind_propagate(nb::module_& m);
void bind_refine(nb::module_& m);
void bind_rivals(nb::module_& m);
void bind_top_view(nb::module_& m);
void bind_triangulate(nb::module_& m);
void bind_warp(nb::module_& m);
void bind_windows(nb::module_& m);

}  // namespace beltscape
