// Binds triangulate.hpp.
#include "bind.hpp"
#include "parallel.hpp"
#include "triangulate.hpp"

namespace beltscape {
namespace {

constexpr std::size_t kPointsPerJob = 4096;

using Projections = nb::ndarray<const double, nb::shape<-1, 3, 4>, nb::c_contig, nb::device::cpu>;
using Pixels = nb::ndarray<const double, nb::shape<-1, -1, 2>, nb::c_contig, nb::device::cpu>;
using Points = nb::ndarray<double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

void triangulate(Projections projections, Pixels pixels, Points out, std::size_t threads) {
    const TriangulateInput in{projections.data(), pixels.data(), pixels.shape(0), pixels.shape(1)};
    double* const target = out.data();
    nb::gil_scoped_release release;
    for_jobs((in.points + kPointsPerJob - 1) / kPointsPerJob, threads, [&](std::size_t job) {
        const std::size_t end = std::min(in.points, (job + 1) * kPointsPerJob);
        for (std::size_t first = job * kPointsPerJob; first < end; first += kDoubleLanes)
            triangulate_lanes<Doubles>(
                in, first, static_cast<int>(std::min<std::size_t>(kDoubleLanes, end - first)), target);
    });
}

}  // namespace

void bind_triangulation(nb::module_& m) {
    m.def("triangulate", &triangulate, nb::arg("projections"), nb::arg("pixels"), nb::arg("out"),
          nb::arg("threads"));
}

}  // namespace beltscape
