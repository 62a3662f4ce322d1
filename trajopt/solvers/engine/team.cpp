#include "team.hpp"

#include <new>
#include <system_error>

namespace trajopt {

Team::Team(int threads) : errors_(threads) {
  try {
    for (int thread = 1; thread < threads; ++thread) others_.emplace_back([this, thread] { wait_for_work(thread); });
  } catch (const std::system_error&) {  // those that have started do the work
  } catch (const std::bad_alloc&) {
  }
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
  std::exception_ptr first;
  for (std::exception_ptr& error : errors_) {
    if (!first) first = error;
    error = nullptr;
  }
  if (first) std::rethrow_exception(first);
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
