// Binds candidate_surfaces.hpp and photo_consistency.hpp.
#include "bind_auxiliaries.hpp"
#include "bind_pixels.hpp"
#include "candidate_surfaces.hpp"
#include "photo_consistency.hpp"

namespace beltscape {
namespace {

// surface: s, slope_u, slope_v; out: s, slope_u, slope_v, distance, support, each (9, N).
void candidates_all(const std::vector<Grid>& surface, Flags reliable, Numbers u, Numbers v, int reach,
                    float separation, const std::vector<GridOut>& out, std::size_t threads) {
    const CandidateSearch search{
        {surface[0].data(), surface[1].data(), surface[2].data(), width_of(reliable), height_of(reliable)},
        reliable.data(),
        reach,
        separation};
    const std::size_t count = u.shape(0);
    const CandidateRows to{out[0].data(), out[1].data(), out[2].data(), out[3].data(), out[4].data(), count};
    const float *const us = u.data(), *const vs = v.data();
    nb::gil_scoped_release release;
    for_bands(0, static_cast<int>(count), kPixelsPerJob, threads, [&](int first, int end) {
        for (int i = first; i < end; ++i)
            find_candidates(search, static_cast<int>(us[i]), static_cast<int>(vs[i]), to,
                            static_cast<std::size_t>(i));
    });
}

// planes: s, slope_u, slope_v, each (C, N); out (9 C, N): the fields of PhotoConsistency one below another.
void photo_consistency_all(Numbers u, Numbers v, const std::vector<Grid>& planes, Grid core, Grid variance,
                           const std::vector<Grid>& images, Views views, const std::vector<Grid>& buffers,
                           const std::vector<Grid>& gains, float tolerance, GridOut out,
                           std::size_t threads) {
    const std::vector<Auxiliary> auxiliaries = auxiliaries_of(images, views, buffers);
    std::vector<const float*> levels;
    for (const Grid& gain : gains) levels.push_back(gain.data());
    const PhotoConsistencyInput in{core.data(),
                                   variance.data(),
                                   width_of(core),
                                   height_of(core),
                                   auxiliaries.data(),
                                   levels.data(),
                                   static_cast<int>(images.size()),
                                   tolerance};
    const std::size_t count = u.shape(0), rows = planes[0].shape(0);
    const float *const us = u.data(), *const vs = v.data(), *const s = planes[0].data(),
                       *const slope_u = planes[1].data(), *const slope_v = planes[2].data();
    float* const to = out.data();
    nb::gil_scoped_release release;
    for_bands(0, static_cast<int>(count), kPixelsPerJob, threads, [&](int first, int end) {
        for (std::size_t row = 0; row < rows; ++row)
            for (int i = first; i < end; i += kFloatLanes) {
                const std::size_t pixel = static_cast<std::size_t>(i), at = row * count + pixel;
                photo_consistency<Floats>(in, {us + pixel, vs + pixel, s + at, slope_u + at, slope_v + at},
                                          end - i, to + at, rows * count);
            }
    });
}

}  // namespace

void bind_candidates(nb::module_& m) {
    m.def("candidate_surfaces", &candidates_all, nb::arg("surface"), nb::arg("reliable"), nb::arg("u"),
          nb::arg("v"), nb::arg("reach"), nb::arg("separation"), nb::arg("out"), nb::arg("threads"));
    m.def("photo_consistency", &photo_consistency_all, nb::arg("u"), nb::arg("v"), nb::arg("planes"),
          nb::arg("core"), nb::arg("variance"), nb::arg("images"), nb::arg("views"), nb::arg("buffers"),
          nb::arg("gains"), nb::arg("tolerance"), nb::arg("out"), nb::arg("threads"));
}

}  // namespace beltscape
