// Inputs and outputs of every driver.
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

// Multipliers to start from; empty where there are none.
struct Multipliers {
  Reals g, x;
};

// One iteration, for a progress line.
struct Iteration {
  int iteration = 0, line_search = 0;
  double objective = 0, primal = 0, dual = 0, barrier = 0, step = 0, regularization = 0;
  bool restoration = false;
};

// The variables of the current iterate; empty where the solver does not provide them. Valid during the
// callback only.
using Unknowns = std::function<Reals()>;

// Returns false to stop at the current iterate.
using Callback = std::function<bool(const Iteration&, const Unknowns&)>;

// Of the linear systems that are solved stage by stage; `operations` are those that all of them need.
struct KktFigures {
  Timing factorization, substitution;
  double operations = 0;
};

// The iterate a solver ended at. The Lagrangian is f + lambda_g . g + lambda_x . x.
struct Outcome {
  Reals x, g, lambda_g, lambda_x;
  double objective = 0, primal = 0, dual = 0, complementarity = 0, max_violation = 0;
  int iterations = 0;
  std::string status;
  double wall_seconds = 0, function_seconds = 0;
  KktFigures kkt;
};

// Fills in what is recomputed from x alone, and the times since `start`.
void complete(Outcome& outcome, Nlp& nlp, const Bounds& bounds, std::chrono::steady_clock::time_point start);

// Fronts are small: BLAS with two threads is no faster, waits where another process runs, and rounds otherwise.
void use_one_blas_thread();

bool all_finite(const Reals& values);

// stage: of each variable, for the linear systems, as in `StageKkt`; empty for IPOPT's own linear solver.
Outcome solve_ipopt(Nlp& nlp, const Reals& x0, const Bounds& bounds, const Options& options, const Callback& callback,
                    const Multipliers& multipliers, const Indices& stage);

}  // namespace trajopt
