// One block of an emulated launch: its threads, which are fibers, its barriers and its shared memory.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <source_location>
#include <stdexcept>
#include <string>
#include <vector>

#include "emulation/fiber.hpp"

namespace beltscape {

struct dim3 {
    unsigned x = 1, y = 1, z = 1;
};
inline thread_local dim3 threadIdx, blockIdx, blockDim, gridDim;

namespace emulation {

using Location = std::source_location;

inline constexpr unsigned kWarpLanes = 32;

inline unsigned count_of(dim3 size) { return size.x * size.y * size.z; }

inline dim3 index_of(unsigned number, dim3 size) {
    return {number % size.x, number / size.x % size.y, number / size.x / size.y};
}

// Numbers that a seed determines (Vigna's SplitMix64).
class Random {
public:
    explicit Random(std::uint64_t seed) : state_(seed) {}
    std::size_t below(std::size_t count) {
        std::uint64_t z = state_ += 0x9e3779b97f4a7c15u;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u, z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return static_cast<std::size_t>((z ^ (z >> 31)) % count);
    }

private:
    std::uint64_t state_;
};

// A shared array, full of kPoison at the block's start and followed by a guard, which no kernel may change.
class SharedArray {
public:
    explicit SharedArray(std::size_t bytes) : bytes_(bytes), values_(bytes + kGuardBytes, kPoison) {
        std::fill(values_.end() - kGuardBytes, values_.end(), kGuard);
    }
    unsigned char* get() { return values_.data(); }
    std::size_t size() const { return bytes_; }
    bool is_intact() const {
        return std::all_of(values_.end() - kGuardBytes, values_.end(),
                           [](unsigned char value) { return value == kGuard; });
    }

private:
    static constexpr unsigned char kPoison = 0xff, kGuard = 0xa5;
    static constexpr int kGuardBytes = 16;
    std::size_t bytes_;
    std::vector<unsigned char> values_;
};

class Block {
public:
    Block(Fibers::Body kernel, void* arguments, std::size_t shared_bytes, std::uint64_t seed)
        : fibers_(kernel, arguments), shared_bytes_(shared_bytes), is_permuted_(seed != 0), random_(seed) {}

    // Runs all threads of a block, or throws what is wrong with the kernel.
    void run(dim3 block) {
        blockIdx = block;
        prepare();
        while (!ready_.empty() && failure_.empty()) {
            Thread& thread = threads_[next()];
            running_ = &thread;
            threadIdx = thread.index;
            if (!thread.fiber) thread.fiber = fibers_.take();
            fibers_.resume(thread.fiber);
            if (thread.fiber->has_ended) --alive_;
            if (alive_ > 0 && waiting_ == alive_) release_all();
        }
        if (failure_.empty() && alive_ > 0) report_deadlock();
        if (failure_.empty() && !is_memory_intact()) failure_ = "a kernel writes past its shared memory";
        if (!failure_.empty()) throw std::runtime_error(failure_);
    }

    void wait_for_all(const Location& where) {
        ++waiting_;
        suspend_at(where, kAllLanes);
    }

    // Waits for the lanes of the mask and returns the value of every lane of the warp.
    const std::uint64_t* exchange(unsigned mask, std::uint64_t value, const Location& where) {
        Thread& own = *running_;
        if (!(mask >> own.lane & 1)) fail("a lane is not in its own mask", where);
        std::uint64_t* const values = own.warp->values[own.exchanges++ % 2];  // a faster lane uses the others
        values[own.lane] = value;
        own.waits_for = mask, own.where = where;
        if (is_complete(mask, own))
            release(mask, own);
        else
            fibers_.suspend();
        return values;
    }

    std::uint64_t lane_value(const std::uint64_t* values, unsigned mask, unsigned lane,
                             const Location& where) {
        if (!(mask >> lane & 1)) fail("a lane outside the mask is read", where);
        return values[lane];
    }

    unsigned lane() const { return running_->lane; }
    unsigned char* dynamic_shared() { return shared(nullptr, shared_bytes_); }

    // The array of this key, the same one for all threads.
    unsigned char* shared(const void* key, std::size_t bytes) {
        return arrays_.try_emplace(key, bytes).first->second.get();
    }

private:
    static constexpr std::uint64_t kAllLanes = std::uint64_t{1} << 32;  // no mask of a warp

    struct Warp {
        unsigned first, lanes;  // the numbers of its threads
        std::uint64_t values[2][kWarpLanes];
    };

    struct Thread {
        unsigned number, lane;
        dim3 index;
        Warp* warp;
        Fibers::Fiber* fiber = nullptr;
        std::uint64_t waits_for = 0;  // lanes, kAllLanes or nothing
        unsigned exchanges = 0;
        Location where{};
    };

    void prepare() {
        const unsigned count = count_of(blockDim);
        arrays_.clear(), threads_.clear(), warps_.clear(), ready_.clear();
        for (unsigned first = 0; first < count; first += kWarpLanes)
            warps_.push_back({first, std::min(kWarpLanes, count - first), {}});
        for (unsigned i = 0; i < count; ++i) {
            threads_.push_back({i, i % kWarpLanes, index_of(i, blockDim), &warps_[i / kWarpLanes]});
            ready_.push_back(i);
        }
        alive_ = count, waiting_ = 0;
    }

    // Takes the number of the next thread that can run: the first, or any where the order is permuted.
    unsigned next() {
        const auto taken =
            ready_.begin() + static_cast<std::ptrdiff_t>(is_permuted_ ? random_.below(ready_.size()) : 0);
        const unsigned number = *taken;
        ready_.erase(taken);
        return number;
    }

    void suspend_at(const Location& where, std::uint64_t waits_for) {
        running_->waits_for = waits_for, running_->where = where;
        fibers_.suspend();
    }

    void release_all() {
        const Location* const first = &threads_[first_waiting()].where;
        for (Thread& thread : threads_) {
            if (thread.waits_for != kAllLanes) continue;
            if (!is_same(thread.where, *first))
                failure_ = "threads of a block wait at different barriers, at " + text_of(*first) + " and " +
                           text_of(thread.where);
            thread.waits_for = 0;
            ready_.push_back(thread.number);
        }
        waiting_ = 0;
    }

    // Whether all lanes of the mask wait for each other, `own` among them.
    bool is_complete(unsigned mask, const Thread& own) {
        for (unsigned lane = 0; lane < kWarpLanes; ++lane) {
            if (!(mask >> lane & 1)) continue;
            if (lane >= own.warp->lanes) fail("the mask holds lanes that the warp lacks", own.where);
            const Thread& other = threads_[own.warp->first + lane];
            if (other.waits_for != mask) return false;
            if (!is_same(other.where, own.where))
                fail("lanes of a warp meet in different operations, also at " + text_of(other.where),
                     own.where);
        }
        return true;
    }

    void release(unsigned mask, Thread& own) {
        for (unsigned lane = 0; lane < own.warp->lanes; ++lane) {
            if (!(mask >> lane & 1)) continue;
            Thread& other = threads_[own.warp->first + lane];
            other.waits_for = 0;
            if (&other != &own) ready_.push_back(other.number);
        }
    }

    unsigned first_waiting() const {
        unsigned number = 0;
        while (!threads_[number].waits_for) ++number;
        return number;
    }

    void report_deadlock() {
        failure_ = "threads of a block wait for others that have ended or wait elsewhere, at " +
                   text_of(threads_[first_waiting()].where);
    }

    // Called by a thread, which does not go on.
    void fail(const std::string& what, const Location& where) {
        failure_ = what + ", at " + text_of(where);
        for (;;) fibers_.suspend();
    }

    bool is_memory_intact() const {
        return std::all_of(arrays_.begin(), arrays_.end(),
                           [](const auto& array) { return array.second.is_intact(); });
    }

    static bool is_same(const Location& one, const Location& other) {
        return one.line() == other.line() && one.column() == other.column();
    }

    static std::string text_of(const Location& where) {
        const std::string path = where.file_name();
        return path.substr(path.rfind('/') + 1) + ":" + std::to_string(where.line());
    }

    Fibers fibers_;
    std::size_t shared_bytes_;
    bool is_permuted_;
    Random random_;
    std::map<const void*, SharedArray> arrays_;
    std::vector<Thread> threads_;
    std::vector<Warp> warps_;
    std::vector<unsigned> ready_;
    Thread* running_ = nullptr;
    unsigned alive_ = 0, waiting_ = 0;
    std::string failure_;
};

inline thread_local Block* current_block;

}  // namespace emulation
}  // namespace beltscape
