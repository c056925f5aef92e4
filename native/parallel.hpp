// A fixed list of jobs on a few threads. Any thread may take any job. A job writes only its own results and
// the cut into jobs does not depend on the threads, so the result does not depend on them either. Device code
// may include this file; for it the file is empty.
#pragma once

#ifndef __CUDACC__

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace beltscape {

inline constexpr int kPixelsPerJob = 1024;  // of kernels about given pixels

// Calls job(0) ... job(count - 1), each once, on `threads` threads (0 = all cores); jobs may not throw.
template <class Job>
void for_jobs(std::size_t count, std::size_t threads, const Job& job) {
    if (threads == 0) threads = std::max(1u, std::thread::hardware_concurrency());
    std::atomic<std::size_t> next = 0;
    const auto work = [&] {
        for (std::size_t i = next++; i < count; i = next++) job(i);
    };
    std::vector<std::jthread> others;  // joined at the end of the scope
    for (std::size_t t = 1; t < std::min(threads, count); ++t) others.emplace_back(work);
    work();
}

// Calls band(first, last) for the rows start ... end - 1, `per_job` of them at a time.
template <class Band>
void for_bands(int start, int end, int per_job, std::size_t threads, const Band& band) {
    for_jobs(static_cast<std::size_t>((end - start + per_job - 1) / per_job), threads, [&](std::size_t job) {
        const int first = start + static_cast<int>(job) * per_job;
        band(first, std::min(end, first + per_job));
    });
}

}  // namespace beltscape
#endif
