// The code of a tape: runs of statements of one operation, each run preceded by the operation and its length.
#pragma once

#include <cstdint>

namespace trajopt {

// Statements are (target, operands...), all of them slots; kOther has CasADi's operation as the last one.
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

}  // namespace trajopt
