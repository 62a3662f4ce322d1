// IPOPT's linear systems by `StageKkt`.
#pragma once

#include <IpAlgBuilder.hpp>

#include <vector>

#include "solve.hpp"

namespace trajopt {

// Builds IPOPT's algorithm with it. stage: of each variable, as in `StageFronts`. Figures are added up.
Ipopt::SmartPtr<Ipopt::AlgorithmBuilder> stage_builder(const std::vector<int>& stage, const Bounds& bounds,
                                                       int threads, KktFigures& figures);

}  // namespace trajopt
