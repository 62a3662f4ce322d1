// From the instructions of a function of CasADi to the statements of a tape.
#pragma once

#include <casadi/casadi.hpp>

#include <cstdint>
#include <vector>

#include "tape_code.hpp"

namespace trajopt {

// An operation on earlier values, an input, or a constant.
struct Value {
  enum Kind { kInput, kConstant, kStatement };
  Kind kind;
  std::int32_t operation;  // of a statement; input: which
  int a, b, c;             // operands, -1 where there is none; input: a is the element
  double constant;
  int other;  // CasADi's operation
};

struct TapeGraph {
  std::vector<Value> values;  // operands before what they are used for
  std::vector<int> results;   // values of all outputs, one after the other; -1 for zero

  // Each expression once; throws std::invalid_argument for what is not a scalar operation.
  explicit TapeGraph(const casadi::Function& function);

  // Products that are used once, in a sum or a difference, become part of it; what no result needs is dropped.
  void fuse();

  // Statements in an order with long runs of one operation: those that are ready, from a window that moves
  // through their first order, so that few values are alive at any time.
  std::vector<int> scheduled() const;
};

}  // namespace trajopt
