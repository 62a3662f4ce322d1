#pragma once

#include <string>
#include <vector>

#include "description.hpp"

// Each function returns casadi::Function::serialize() of a graph in Pinocchio's conventions.
namespace trajopt {

std::string fused(const Description& description, const std::vector<Frame>& frames);

}  // namespace trajopt
