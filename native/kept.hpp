// Memory that a thread keeps for its next call, if it is not much: fresh pages cost as much as what is
// written there.
#pragma once

#include <cstddef>
#include <memory>
#include <utility>

namespace beltscape {

// An array of T, its values left from before; a thread keeps one of each T.
template <class T>
class Kept {
public:
    explicit Kept(std::size_t count) : own_(std::exchange(spare(), Cells{})) {
        if (own_.count < count) own_ = {std::make_unique_for_overwrite<T[]>(count), count};
    }
    Kept(const Kept&) = delete;
    ~Kept() {
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
