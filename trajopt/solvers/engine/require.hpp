// Refusals of what callers give.
#pragma once

#include <stdexcept>
#include <string>
#include <string_view>

namespace trajopt {

// Throws std::invalid_argument (Python's ValueError) with this message unless the condition holds.
inline void require(bool condition, std::string_view message) {
  if (!condition) throw std::invalid_argument(std::string(message));
}

}  // namespace trajopt
