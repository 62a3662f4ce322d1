// A function of CasADi as a straight line of operations, evaluated at several points at once.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace casadi { class Function; }

namespace trajopt {

constexpr int kLanes = 8;

// Code of a tape: runs of statements of one operation, each run preceded by the operation and its length. Statements
// are (target, operands...), all of them slots; kOther has CasADi's operation as the last one.
enum Operation : std::int32_t {
  kMultiply,      // a b
  kAdd,           // a + b
  kSubtract,      // a - b
  kMultiplyAdd,   // c + a b
  kMultiplyFrom,  // c - a b
  kMultiplyLess,  // a b - c
  kNegate,        // -a
  kOther,         // any of CasADi's operations, point by point
  kOperations
};

constexpr int length(std::int32_t operation) {
  return operation == kNegate ? 2 : operation < kMultiplyAdd ? 3 : 4;
}

// What a tape consists of.
struct TapeParts {
  std::vector<int> in, out;               // numbers of values
  std::vector<double> constants;          // in the slots after the inputs
  std::vector<int> result, row, column;   // slots and places of the values of all outputs
  std::vector<std::int32_t> code;
  int slots = 0;
};

// One value at each of several points.
struct alignas(64) Lanes {
  double at[kLanes];
};

class Tape {
 public:
  // Throws std::invalid_argument where a statement would leave the slots.
  explicit Tape(TapeParts parts);

  // Begins what `bytes` writes, and changes with the statements that a function becomes.
  static const char* version();
  // What `bytes` has written; throws std::invalid_argument for anything else.
  static Tape read(const std::string& bytes);
  std::string bytes() const;

  int n_in() const { return static_cast<int>(parts_.in.size()); }
  int n_out() const { return static_cast<int>(parts_.out.size()); }
  int size_in(int input) const { return parts_.in[input]; }
  int size_out(int output) const { return parts_.out[output]; }
  int inputs() const { return n_inputs_; }  // values of all of them
  int slots() const { return parts_.slots; }
  int statements() const { return statements_; }

  // The work has `slots` entries, the first of them the inputs, one after the other. Constants are in the work
  // from `set_constants` on, and outputs after `run`, element k of an output at `slots_of(output)[k]`.
  void set_constants(Lanes* work) const;
  void run(Lanes* work) const;
  const int* slots_of(int output) const { return parts_.result.data() + first_result_[output]; }

  // Rows and columns of an output's values.
  std::vector<int> rows(int output) const { return of(output, parts_.row); }
  std::vector<int> columns(int output) const { return of(output, parts_.column); }

 private:
  void check() const;
  std::vector<int> of(int output, const std::vector<int>& values) const {
    return {values.begin() + first_result_[output], values.begin() + first_result_[output + 1]};
  }

  TapeParts parts_;
  std::vector<int> first_result_;
  int n_inputs_ = 0, statements_ = 0;
};

// Throws std::invalid_argument where the function is not one of scalar operations (an SX function).
Tape compile(const casadi::Function& function);

}  // namespace trajopt
