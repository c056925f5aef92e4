// The module of one instruction-set level: all groups of kernels, and what this processor can run.
#include "bind.hpp"
#include "cpu_level.hpp"

#if defined(__GLIBC__)
#include <malloc.h>
#endif

namespace {

// Keeps freed memory for the next frame. By default glibc returns a frame's arrays to the system, which
// zeroes them again, and keeps an arena for each thread: 10 % more time and 25 % more memory; arrays of more
// than 32 MiB, which it maps whatever its threshold is, take another 6 %.
void keep_memory() {
#if defined(__GLIBC__)
    constexpr int kKept = 1 << 30;  // bytes
    mallopt(M_MMAP_MAX, 0);         // a mapped array is returned when it is freed
    mallopt(M_TRIM_THRESHOLD, kKept);
    mallopt(M_ARENA_MAX, 1);
#endif
}

}  // namespace

NB_MODULE(BELTSCAPE_MODULE, m) {
    keep_memory();
    m.def("cpu_level", &beltscape::cpu_level);  // the lowest level's module is asked
    beltscape::bind_sweep(m);
    beltscape::bind_selection(m);
    beltscape::bind_least_squares(m);
    beltscape::bind_images(m);
    beltscape::bind_geometry(m);
    beltscape::bind_networks(m);
    beltscape::bind_holes(m);
    beltscape::bind_photometry(m);
}
