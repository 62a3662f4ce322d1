// Threads that wait for work.
#pragma once

#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace trajopt {

class Team {
 public:
  // Fewer where the system does not let that many start.
  explicit Team(int threads);
  ~Team();
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;

  int size() const { return static_cast<int>(others_.size()) + 1; }
  // Calls task(thread) in all threads, 0 in the caller's own, and waits. Throws what one of them has thrown in this
  // run. One run at a time.
  void run(const std::function<void(int)>& task);

 private:
  void wait_for_work(int thread);
  void perform(int thread);

  std::mutex mutex_;
  std::condition_variable given_, finished_;
  const std::function<void(int)>* task_ = nullptr;
  int round_ = 0, busy_ = 0;
  bool ended_ = false;
  std::vector<std::exception_ptr> errors_;
  std::vector<std::thread> others_;
};

}  // namespace trajopt
