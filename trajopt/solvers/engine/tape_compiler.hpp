// From a function of CasADi to a tape.
#pragma once

#include <casadi/casadi.hpp>

#include "tape.hpp"

namespace trajopt {

// Throws std::invalid_argument where the function is not one of scalar operations (an SX function).
Tape compile(const casadi::Function& function);

}  // namespace trajopt
