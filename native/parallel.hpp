// Independent strips of an index range on a few threads. Each index is computed by itself, so the result
// does not depend on the number of threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <thread>
#include <vector>

namespace beltscape {

template <class Strip>
void for_strips(std::size_t count, std::size_t threads, std::size_t grain, const Strip& strip) {
    if (threads == 0) threads = std::max(1u, std::thread::hardware_concurrency());
    threads = std::max<std::size_t>(1, std::min(threads, count / grain));
    const std::size_t size = (count + threads - 1) / threads;
    std::vector<std::jthread> others;
    others.reserve(threads - 1);
    for (std::size_t t = 1; t < threads; ++t)
        others.emplace_back([&, t] { strip(std::min(t * size, count), std::min((t + 1) * size, count)); });
    strip(0, std::min(size, count));
}

}  // namespace beltscape
