// The module of one instruction-set level: all families of kernels, and what this processor can run.
#include "bind.hpp"

namespace {

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
    m.def("cpu_level", &cpu_level);
    beltscape::bind_coarse(m);
    beltscape::bind_hear(m);
    beltscape::bind_neighbours(m);
    beltscape::bind_occlusion(m);
    beltscape::bind_perceptron(m);
    beltscape::bind_propagate(m);
    beltscape::bind_refine(m);
    beltscape::bind_rivals(m);
    beltscape::bind_top_view(m);
    beltscape::bind_triangulate(m);
    beltscape::bind_warp(m);
    beltscape::bind_windows(m);
}
