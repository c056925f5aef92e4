// A fixed list of jobs on a few threads. Which thread takes which job is left to chance, so a job may write
// only what is its own and the cut into jobs may not depend on the threads: then neither does the result.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace beltscape {

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

}  // namespace beltscape
