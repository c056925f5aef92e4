// Workspaces for jobs: one for each job that runs at the same time, reused by the next job.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

namespace beltscape {

template <class Workspace>
class Pool {
public:
    // A workspace that returns to the pool at the end of its scope.
    class Taken {
    public:
        Taken(Pool& pool, std::unique_ptr<Workspace> workspace)
            : pool_(pool), workspace_(std::move(workspace)) {}
        Taken(const Taken&) = delete;
        ~Taken() {
            const std::lock_guard lock(pool_.mutex_);
            pool_.free_.push_back(std::move(workspace_));
        }
        Workspace* operator->() const { return workspace_.get(); }
        Workspace& operator*() const { return *workspace_; }

    private:
        Pool& pool_;
        std::unique_ptr<Workspace> workspace_;
    };

    // Returns a free workspace, or a new one from make().
    template <class Make>
    Taken take(const Make& make) {
        std::unique_ptr<Workspace> workspace;
        {
            const std::lock_guard lock(mutex_);
            if (!free_.empty()) workspace = std::move(free_.back()), free_.pop_back();
        }
        return Taken(*this, workspace ? std::move(workspace) : make());
    }

private:
    std::mutex mutex_;
    std::vector<std::unique_ptr<Workspace>> free_;
};

}  // namespace beltscape
