#pragma once

#include <string>

#include "dynamics.hpp"

namespace trajopt {

// A model, its data after the forward pass, and the symbols they depend on. A level
// that is left out is zero, so its symbols do not appear in the graph.
struct Motion {
  enum Level { position, velocity, acceleration };
  Motion(const Description& description, Level level);

  Model model;
  Data data;
  Symbol q, v, a;
};

// Serialised function of the symbols up to `level`.
std::string function(const std::string& name, const Motion& motion, Motion::Level level,
                     const std::vector<casadi::SX>& outputs,
                     const std::vector<std::string>& output_names);

// Throws std::invalid_argument for another name than those in functions.hpp.
pinocchio::ReferenceFrame reference_frame(const std::string& name);

}  // namespace trajopt
