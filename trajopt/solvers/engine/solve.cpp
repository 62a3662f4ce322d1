#include "solve.hpp"

#include <algorithm>
#include <cmath>

// Of the BLAS that the solvers' wheels bring along, where that is OpenBLAS.
extern "C" [[gnu::weak]] void openblas_set_num_threads(int);

namespace trajopt {

namespace {

double violation(const Reals& values, const Reals& lower, const Reals& upper) {
  double worst = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const double miss = std::max(lower[i] - values[i], values[i] - upper[i]);
    if (!(miss <= worst)) worst = miss;  // written this way, a NaN is the worst
  }
  return worst;
}

}  // namespace

bool all_finite(const Reals& values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

void use_one_blas_thread() {
  if (openblas_set_num_threads) openblas_set_num_threads(1);
}

void complete(Outcome& outcome, Nlp& nlp, const Bounds& bounds, std::chrono::steady_clock::time_point start) {
  outcome.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.function_seconds = nlp.function_seconds();
  outcome.objective = nlp.f(outcome.x.data());
  outcome.g = nlp.g(outcome.x.data());
  const double rows = violation(outcome.g, bounds.lower_g, bounds.upper_g);
  const double unknowns = violation(outcome.x, bounds.lower_x, bounds.upper_x);
  outcome.max_violation = std::isnan(rows) || rows > unknowns ? rows : unknowns;
}

}  // namespace trajopt
