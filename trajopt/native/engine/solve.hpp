// What every driver takes and gives.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <variant>

#include "engine.hpp"

namespace trajopt {

using Option = std::variant<long, double, std::string>;
using Options = std::map<std::string, Option>;

struct Bounds {
  Reals lower_x, upper_x, lower_g, upper_g;
};

// One iteration, for a progress line.
struct Iteration {
  int iteration = 0, line_search = 0;
  double objective = 0, primal = 0, dual = 0, barrier = 0, step = 0, regularization = 0;
  bool restoration = false;
};

// Returns false to stop at the current iterate.
using Callback = std::function<bool(const Iteration&)>;

struct Outcome {
  Reals x, lambda_g;
  double objective = 0, primal = 0, dual = 0;
  int iterations = 0;
  std::string status;
  double wall_seconds = 0, function_seconds = 0;
};

Outcome solve_ipopt(Nlp& nlp, const Reals& x0, const Bounds& bounds, const Options& options, const Callback& callback,
                    const Reals& lambda0);

// Sizes of the stages: states, controls, path rows; gap rows come first in each stage.
struct Stages {
  Indices n_state, n_control, n_path;
};

Outcome solve_fatrop(Nlp& nlp, const Stages& stages, const Reals& x0, const Bounds& bounds, const Options& options,
                     const Callback& callback);

}  // namespace trajopt
