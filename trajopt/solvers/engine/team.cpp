#include "team.hpp"

#include <utility>

namespace trajopt {

Team::Team(int threads) : errors_(threads) {
  for (int thread = 1; thread < threads; ++thread) others_.emplace_back([this, thread] { wait_for_work(thread); });
}

Team::~Team() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ended_ = true;
  }
  given_.notify_all();
  for (std::thread& other : others_) other.join();
}

void Team::run(const std::function<void(int)>& task) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    task_ = &task;
    busy_ = static_cast<int>(others_.size());
    ++round_;
  }
  given_.notify_all();
  perform(0);
  std::unique_lock<std::mutex> lock(mutex_);
  finished_.wait(lock, [this] { return busy_ == 0; });
  for (std::exception_ptr& error : errors_)
    if (error) std::rethrow_exception(std::exchange(error, nullptr));
}

void Team::wait_for_work(int thread) {
  for (int seen = 0;;) {
    {
      std::unique_lock<std::mutex> lock(mutex_);
      given_.wait(lock, [&] { return ended_ || round_ != seen; });
      if (ended_) return;
      seen = round_;
    }
    perform(thread);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (--busy_ == 0) finished_.notify_one();
  }
}

void Team::perform(int thread) {
  try {
    (*task_)(thread);
  } catch (...) {  // must not leave a thread
    errors_[thread] = std::current_exception();
  }
}

}  // namespace trajopt
