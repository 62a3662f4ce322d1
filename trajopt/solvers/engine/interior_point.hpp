// Steps of a primal-dual interior-point method from iterates that are near a solution: one problem of fixed structure after the other, with other bounds and numbers, as a receding horizon has them.
//
//   minimise  f(x) - mu sum log(bounds of x and of s) + sum |y|^2 compliance / 2
//   with      g_E(x) - b = compliance y_E        g_I(x) - s = compliance y_I
//
// A compliance is one over the weight of a quadratic penalty on the violation of its row; zero for a hard row
// (Nocedal and Wright, Numerical Optimization, 2006, ch. 19; Friedlander and Orban, Math. Prog. Comp. 4, 2012).
#pragma once

#include <memory>

#include "engine.hpp"
#include "solve.hpp"
#include "stage_kkt.hpp"

namespace trajopt {

// Variables, slacks and multipliers of rows; multipliers of the bounds of variables and of slacks; the barrier of the
// next step, and what the last one added to the Hessian's diagonal.
struct Iterate {
  Reals x, s, y, lower_x, upper_x, lower_s, upper_s;
  double barrier = 0, regularization = 0;
};

// Residuals before a step: of the rows, of the Lagrangian's gradient and of complementarity, largest entries; what the
// step did, and the residual of the rows after it. Zero steps where the matrix could not be factorised.
struct StepReport {
  double primal = 0, dual = 0, complementarity = 0, primal_step = 0, dual_step = 0, regularization = 0, barrier = 0,
         after = 0;
  int factorizations = 0;
};

// barrier: the least, to which steps that are long return; short ones raise it, up to `most_barrier`, which leads away
// from the bounds that made them short. fraction: of the distance to a bound that a step may take. tolerance: no step
// after `least_steps` where all residuals are below it. seconds: begin no step after so many; 0: no limit.
struct StepSettings {
  double barrier = 1e-4, most_barrier = 1e-4, fraction = 0.995, tolerance = 0, seconds = 0;
  int steps = 1, least_steps = 1;
};

class InteriorPoint {
 public:
  // stage: of each variable, as in `StageKkt`. lower_x == upper_x fixes a variable, lower_g == upper_g makes an
  // equality, in `bounds` and in all that follow.
  InteriorPoint(std::shared_ptr<Nlp> nlp, const Bounds& bounds, const Indices& stage);

  // Slacks and multipliers of bounds for variables and multipliers of rows: at least `push` inside.
  void complete(Iterate& iterate, const Bounds& bounds, double barrier, double push) const;
  std::vector<StepReport> steps(Iterate& iterate, const Bounds& bounds, const Reals& compliance,
                                const StepSettings& settings);

  const Nlp& nlp() const { return *nlp_; }
  int n_x() const { return nlp_->problem().n_x; }
  int n_g() const { return nlp_->problem().n_g; }
  int n_s() const { return static_cast<int>(unequal_.size()); }

 private:
  // Steps of the multipliers of bounds.
  struct Step {
    Reals lower_x, upper_x, lower_s, upper_s;
  };

  void require_structure(const Bounds& bounds) const;
  void set_values(const Iterate& it, const Bounds& bounds, const Reals& compliance);
  void set_rhs(const Iterate& it, const Bounds& bounds, const Reals& compliance, double barrier, StepReport& report);
  bool factorize(double& regularization, StepReport& report);
  double primal(const Iterate& it, const Bounds& bounds, const Reals& compliance) const;
  void advance(Iterate& it, const Bounds& bounds, const Reals& compliance, const StepSettings& settings,
               StepReport& report);

  std::shared_ptr<Nlp> nlp_;
  Indices free_, equal_, unequal_;              // variables and rows by kind
  Indices slack_of_;                            // of each row, or -1
  std::vector<std::pair<int, int>> hessian_;    // (nonzero of the NLP, place of its value) of free variables
  std::vector<std::pair<int, int>> jacobian_;
  std::size_t diagonal_x_ = 0, diagonal_s_ = 0, link_ = 0, compliance_ = 0;
  Reals values_, shifted_, rhs_, gradient_, g_, jacobian_values_;
  std::unique_ptr<StageKkt> kkt_;
};

}  // namespace trajopt
