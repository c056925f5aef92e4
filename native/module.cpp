// The one binding file: arrays were checked in Python (kernels/native.py), the GIL is released for the work.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <string>

#include "parallel.hpp"
#include "triangulate.hpp"

namespace nb = nanobind;

namespace {

using Projections = nb::ndarray<const double, nb::shape<-1, 3, 4>, nb::c_contig, nb::device::cpu>;
using Pixels = nb::ndarray<const double, nb::shape<-1, -1, 2>, nb::c_contig, nb::device::cpu>;
using Points = nb::ndarray<double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

void triangulate(Projections projections, Pixels pixels, Points out, std::size_t threads) {
    const beltscape::TriangulateInput in{projections.data(), pixels.data(), pixels.shape(0), pixels.shape(1)};
    double* const target = out.data();
    nb::gil_scoped_release release;
    beltscape::for_strips(in.points, threads, 4096, [&](std::size_t begin, std::size_t end) {
        beltscape::triangulate_strip(in, begin, end, target);
    });
}

// The best instruction-set level this processor runs: asked of the lowest module before another is loaded.
const char* cpu_level() {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("x86-64-v4")) return "v4";
    if (__builtin_cpu_supports("x86-64-v3")) return "v3";
    return "v2";
#else
    return "base";
#endif
}

}  // namespace

NB_MODULE(BELTSCAPE_MODULE, m) {
    m.def("triangulate", &triangulate, nb::arg("projections"), nb::arg("pixels"), nb::arg("out"),
          nb::arg("threads"));
    m.def("cpu_level", &cpu_level);
}
