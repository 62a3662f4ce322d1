// A function of CasADi as a straight line of operations, evaluated at several points at once.
#pragma once

#include <casadi/casadi.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace trajopt {

constexpr int kLanes = 8;

// One value at each of several points.
struct alignas(64) Lanes {
  double at[kLanes];
};

class Tape {
 public:
  // Throws std::invalid_argument where the function is not one of scalar operations (an SX function).
  explicit Tape(const casadi::Function& function);

  // Begins what `bytes` writes, and changes with the statements that a function becomes.
  static const char* version();
  // What `bytes` has written; throws std::invalid_argument for anything else.
  static Tape read(const std::string& bytes);
  std::string bytes() const;

  int n_in() const { return static_cast<int>(in_.size()); }
  int n_out() const { return static_cast<int>(out_.size()); }
  int size_in(int input) const { return in_[input]; }
  int size_out(int output) const { return out_[output]; }
  int inputs() const { return n_inputs_; }  // values of all of them
  int slots() const { return slots_; }
  int statements() const { return statements_; }

  // The work has `slots` entries, the first of them the inputs, one after the other. Constants are in the work
  // from `set_constants` on, and outputs after `run`, element k of an output at `slots_of(output)[k]`.
  void set_constants(Lanes* work) const;
  void run(Lanes* work) const;
  const int* slots_of(int output) const { return result_.data() + first_result_[output]; }

  // Rows and columns of an output's values.
  std::vector<int> rows(int output) const { return of(output, row_); }
  std::vector<int> columns(int output) const { return of(output, column_); }

 private:
  Tape() = default;
  void complete();  // what follows from the rest
  void check() const;
  std::vector<int> of(int output, const std::vector<int>& values) const {
    return {values.begin() + first_result_[output], values.begin() + first_result_[output + 1]};
  }

  std::vector<int> in_, out_;               // numbers of values
  std::vector<double> constants_;           // in the slots after the inputs
  std::vector<int> result_, row_, column_;  // slots and places of the values of all outputs
  std::vector<std::int32_t> code_;
  int slots_ = 0;

  std::vector<int> first_result_;
  int n_inputs_ = 0, statements_ = 0;
};

}  // namespace trajopt
