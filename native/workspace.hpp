// Workspace of up to kMostBytes that a thread reuses in its next call, because new pages cost as much time as
// writing to them.
#pragma once

#ifndef __CUDACC__
#include <cstddef>
#include <memory>
#include <utility>

namespace beltscape {

// An array of T with arbitrary values; each thread holds one for each T.
template <class T>
class Workspace {
public:
    explicit Workspace(std::size_t count) : own_(std::exchange(spare(), Cells{})) {
        if (own_.count < count) own_ = {std::make_unique_for_overwrite<T[]>(count), count};
    }
    Workspace(const Workspace&) = delete;
    ~Workspace() {
        if (own_.count * sizeof(T) <= kMostBytes) spare() = std::move(own_);
    }
    T* get() const { return own_.values.get(); }

private:
    static constexpr std::size_t kMostBytes = 1 << 25;

    struct Cells {
        std::unique_ptr<T[]> values;
        std::size_t count = 0;
    };
    static Cells& spare() {
        thread_local Cells cells;
        return cells;
    }

    Cells own_;
};

}  // namespace beltscape
#endif
