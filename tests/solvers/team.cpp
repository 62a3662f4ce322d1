// Threads that wait for work: what they throw in a run is thrown by that run, once; see test_engine_solvers.py.
#include "../../trajopt/solvers/engine/team.hpp"

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>

void expect(bool holds, const char* what) {
  if (holds) return;
  std::puts(what);
  std::exit(1);
}

int main() {
  trajopt::Team team(4);
  expect(team.size() == 4, "four threads");
  bool thrown = false;
  try {
    team.run([](int) { throw std::runtime_error("of every thread"); });
  } catch (const std::runtime_error&) {
    thrown = true;
  }
  expect(thrown, "an exception is thrown to the caller");
  std::atomic<int> count{0};
  team.run([&](int) { ++count; });  // throws nothing of the run before
  expect(count == 4, "every thread does its part");
  for (int round = 0; round < 1000; ++round) team.run([&](int) { ++count; });
  expect(count == 4004, "in every run");
}
