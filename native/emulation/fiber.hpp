// Fibers: functions that one thread runs in turns, each on a stack of its own. A fiber begins by setcontext
// and is left and continued by setjmp and longjmp, which need no system call (as in QEMU's coroutines).
#pragma once

#include <setjmp.h>
#include <sys/mman.h>
#include <ucontext.h>

#include <cstddef>
#include <memory>
#include <new>
#include <vector>

#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/common_interface_defs.h>
#endif

namespace beltscape::emulation {

class Fibers {
public:
    using Body = void (*)(void*);

    struct Fiber {
        jmp_buf here;
        ucontext_t context;
        void* stack;
        void* sanitizer_state = nullptr;
        bool has_started = false, has_ended = false;
    };

    // Every fiber runs body(data) once from its start to its end.
    Fibers(Body body, void* data) : body_(body), data_(data) {}
    Fibers(const Fibers&) = delete;
    ~Fibers() {
        for (const auto& fiber : all_) munmap(fiber->stack, kStackBytes);
    }

    // Returns a fiber that has not started; the stack of one that has ended is used again.
    Fiber* take() {
        if (free_.empty()) return make();
        Fiber* const fiber = free_.back();
        free_.pop_back();
        fiber->has_ended = false;
        return fiber;
    }

    // Runs a fiber until it suspends itself or ends.
    [[gnu::noinline]] void resume(Fiber* fiber) {
        running_ = fiber;
        leave_outside();
        if (!_setjmp(outside_)) {
            if (fiber->has_started) _longjmp(fiber->here, 1);
            fiber->has_started = true;
            starting = this;
            setcontext(&fiber->context);
        }
        return_outside();
        if (fiber->has_ended) free_.push_back(fiber);
    }

    // Called by a fiber: returns when it is resumed.
    [[gnu::noinline]] void suspend() {
        leave_fiber();
        if (!_setjmp(running_->here)) _longjmp(outside_, 1);
        return_to_fiber();
    }

private:
    static constexpr std::size_t kStackBytes = 256 << 10;

    Fiber* make() {
        auto fiber = std::make_unique<Fiber>();
        fiber->stack = mmap(nullptr, kStackBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (fiber->stack == MAP_FAILED) throw std::bad_alloc();
        getcontext(&fiber->context);
        fiber->context.uc_stack.ss_sp = fiber->stack, fiber->context.uc_stack.ss_size = kStackBytes;
        fiber->context.uc_link = nullptr;
        makecontext(&fiber->context, &Fibers::begin, 0);
        all_.push_back(std::move(fiber));
        return all_.back().get();
    }

    // The outermost function of every fiber; a fiber that has ended begins again when it is taken again.
    static void begin() {
        Fibers& own = *starting;
        own.return_to_fiber();
        for (;;) {
            own.body_(own.data_);
            own.running_->has_ended = true;
            own.suspend();
        }
    }

#if defined(__SANITIZE_ADDRESS__)  // which must know the stack at work
    void leave_outside() { __sanitizer_start_switch_fiber(&outside_state_, running_->stack, kStackBytes); }
    void return_outside() { __sanitizer_finish_switch_fiber(outside_state_, nullptr, nullptr); }
    void leave_fiber() {
        __sanitizer_start_switch_fiber(&running_->sanitizer_state, outside_stack_, outside_size_);
    }
    void return_to_fiber() {
        __sanitizer_finish_switch_fiber(running_->sanitizer_state, &outside_stack_, &outside_size_);
    }
    void* outside_state_ = nullptr;
    const void* outside_stack_ = nullptr;
    std::size_t outside_size_ = 0;
#else
    void leave_outside() {}
    void return_outside() {}
    void leave_fiber() {}
    void return_to_fiber() {}
#endif

    static inline thread_local Fibers* starting;
    Body body_;
    void* data_;
    jmp_buf outside_;
    Fiber* running_ = nullptr;
    std::vector<std::unique_ptr<Fiber>> all_;
    std::vector<Fiber*> free_;
};

}  // namespace beltscape::emulation
