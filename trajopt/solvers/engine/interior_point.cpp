#include "interior_point.hpp"

#include <algorithm>
#include <cmath>

#include "require.hpp"

namespace trajopt {

namespace {

// Added to the Hessian's diagonal where the inertia is wrong: first value, growth, decay at the next step, least, most.
constexpr double kFirst = 1e-4, kGrowth = 8, kDecay = 1.0 / 3, kLeast = 1e-9, kMost = 1e8;
// Multipliers of bounds stay within this factor of barrier / distance (IPOPT's kappa_sigma).
constexpr double kNear = 1e10;
// A step after which rows are missed by more than so many times, and so much more, is halved, so often at most.
constexpr double kWorse = 2, kMore = 0.1;
constexpr int kHalvings = 3;
// Steps shorter than this raise the barrier by a factor, others lower it by one.
constexpr double kShort = 0.4, kRaise = 5, kLower = 0.2;

bool bounded(double bound) { return std::isfinite(bound); }

// Largest step that keeps `fraction` of the distance away from zero.
double longest(const Reals& at, const Reals& step, double fraction, double most) {
  for (std::size_t i = 0; i < at.size(); ++i)
    if (step[i] < 0 && -fraction * at[i] > most * step[i]) most = -fraction * at[i] / step[i];
  return most;
}

}  // namespace

InteriorPoint::InteriorPoint(std::shared_ptr<Nlp> nlp, const Bounds& bounds, const Indices& stage)
    : nlp_(std::move(nlp)) {
  const Problem& problem = nlp_->problem();
  Indices at_x(problem.n_x, -1), at_row(problem.n_g, -1), stages;
  for (int i = 0; i < problem.n_x; ++i) {
    if (bounds.lower_x[i] == bounds.upper_x[i]) continue;
    at_x[i] = static_cast<int>(free_.size());
    free_.push_back(i);
    stages.push_back(stage[i]);
  }
  slack_of_.assign(problem.n_g, -1);
  for (int i = 0; i < problem.n_g; ++i) {
    if (bounds.lower_g[i] == bounds.upper_g[i]) {
      equal_.push_back(i);
    } else {
      slack_of_[i] = static_cast<int>(unequal_.size());
      unequal_.push_back(i);
    }
  }
  const KktSizes sizes{static_cast<int>(free_.size()), static_cast<int>(equal_.size()), n_s()};
  for (std::size_t i = 0; i < equal_.size(); ++i) at_row[equal_[i]] = sizes.equality() + static_cast<int>(i);
  for (int i = 0; i < n_s(); ++i) at_row[unequal_[i]] = sizes.inequality() + i;
  std::vector<KktEntry> entries;
  auto add = [&entries](int row, int column) {
    entries.push_back({static_cast<std::int64_t>(entries.size()), row, column});
    return static_cast<int>(entries.size()) - 1;
  };
  for (std::size_t e = 0; e < problem.hess_row.size(); ++e) {
    const int row = at_x[problem.hess_row[e]], column = at_x[problem.hess_col[e]];
    if (row >= 0 && column >= 0) hessian_.emplace_back(static_cast<int>(e), add(row, column));
  }
  for (std::size_t e = 0; e < problem.jac_row.size(); ++e) {
    const int column = at_x[problem.jac_col[e]];
    if (column >= 0) jacobian_.emplace_back(static_cast<int>(e), add(at_row[problem.jac_row[e]], column));
  }
  diagonal_x_ = entries.size();
  for (int i = 0; i < sizes.n_x; ++i) add(i, i);
  diagonal_s_ = entries.size();
  for (int i = 0; i < n_s(); ++i) add(sizes.slack() + i, sizes.slack() + i);
  link_ = entries.size();
  for (int i = 0; i < n_s(); ++i) add(sizes.inequality() + i, sizes.slack() + i);
  compliance_ = entries.size();
  for (int i = 0; i < problem.n_g; ++i) add(at_row[i], at_row[i]);
  values_.assign(entries.size(), 0.0);
  shifted_.assign(entries.size(), 0.0);
  rhs_.assign(sizes.all(), 0.0);
  kkt_ = std::make_unique<StageKkt>(sizes, stages, entries, 1);
  use_one_blas_thread();
}

void InteriorPoint::require_structure(const Bounds& bounds) const {
  const std::size_t fixed = bounds.lower_x.size() - free_.size();
  std::size_t same = 0;
  for (std::size_t i = 0; i < bounds.lower_x.size(); ++i) same += bounds.lower_x[i] == bounds.upper_x[i];
  bool fits = same == fixed;
  for (const int i : free_) fits = fits && bounds.lower_x[i] < bounds.upper_x[i];
  for (const int i : equal_) fits = fits && bounds.lower_g[i] == bounds.upper_g[i];
  for (const int i : unequal_) fits = fits && bounds.lower_g[i] < bounds.upper_g[i];
  require(fits, "bounds fix other variables or rows than those that the solver was made for");
}

void InteriorPoint::complete(Iterate& it, const Bounds& bounds, double barrier, double push) const {
  const Reals g = nlp_->g(it.x.data());
  it.barrier = barrier;
  it.regularization = 0;
  // strictly between two bounds: half of what is between them where that is less than twice the push
  auto inside = [push](double value, double low, double high) {
    const double room = std::min(push, bounded(low) && bounded(high) ? (high - low) / 4 : push);
    if (bounded(low)) value = std::max(value, low + room);
    if (bounded(high)) value = std::min(value, high - room);
    return value;
  };
  auto dual = [barrier](double distance) { return bounded(distance) ? barrier / distance : 0.0; };
  const int n = n_x();
  it.s.resize(n_s());
  it.lower_s.resize(n_s());
  it.upper_s.resize(n_s());
  it.lower_x.assign(n, 0.0);
  it.upper_x.assign(n, 0.0);
  for (int i = 0; i < n; ++i) {
    if (bounds.lower_x[i] == bounds.upper_x[i]) {
      it.x[i] = bounds.lower_x[i];
      continue;
    }
    it.x[i] = inside(it.x[i], bounds.lower_x[i], bounds.upper_x[i]);
    it.lower_x[i] = dual(it.x[i] - bounds.lower_x[i]);
    it.upper_x[i] = dual(bounds.upper_x[i] - it.x[i]);
  }
  for (int i = 0; i < n_s(); ++i) {
    const double low = bounds.lower_g[unequal_[i]], high = bounds.upper_g[unequal_[i]];
    it.s[i] = inside(g[unequal_[i]], low, high);
    it.lower_s[i] = dual(it.s[i] - low);
    it.upper_s[i] = dual(high - it.s[i]);
  }
}

void InteriorPoint::set_values(const Iterate& it, const Bounds& bounds, const Reals& compliance) {
  const double* x = it.x.data();
  g_ = nlp_->g(x);
  gradient_ = nlp_->gradient(x);
  jacobian_values_ = nlp_->jacobian(x);
  const Reals hessian = nlp_->hessian(x, 1.0, it.y.data());
  for (const auto& [from, to] : hessian_) values_[to] = hessian[from];
  for (const auto& [from, to] : jacobian_) values_[to] = jacobian_values_[from];
  auto sigma = [](double at, double low, double high, double below, double above) {
    return (bounded(low) ? below / (at - low) : 0.0) + (bounded(high) ? above / (high - at) : 0.0);
  };
  for (std::size_t i = 0; i < free_.size(); ++i) {
    const int v = free_[i];
    values_[diagonal_x_ + i] = sigma(x[v], bounds.lower_x[v], bounds.upper_x[v], it.lower_x[v], it.upper_x[v]);
  }
  for (int i = 0; i < n_s(); ++i) {
    const int r = unequal_[i];
    values_[diagonal_s_ + i] = sigma(it.s[i], bounds.lower_g[r], bounds.upper_g[r], it.lower_s[i], it.upper_s[i]);
    values_[link_ + i] = -1.0;
  }
  for (std::size_t i = 0; i < compliance.size(); ++i) values_[compliance_ + i] = -compliance[i];
}

// Minus the residuals, those of the bounds' multipliers eliminated.
void InteriorPoint::set_rhs(const Iterate& it, const Bounds& bounds, const Reals& compliance, double barrier,
                            StepReport& report) {
  const Problem& problem = nlp_->problem();
  Reals lagrangian = gradient_;
  for (std::size_t e = 0; e < problem.jac_row.size(); ++e)
    lagrangian[problem.jac_col[e]] += jacobian_values_[e] * it.y[problem.jac_row[e]];
  auto worst = [](double& so_far, double value) {
    if (!(std::abs(value) <= so_far)) so_far = std::abs(value);
  };
  auto pull = [&](double at, double low, double high, double below, double above, double slope) {
    worst(report.dual, slope - below + above);
    double value = slope;
    if (bounded(low)) {
      value -= barrier / (at - low);
      worst(report.complementarity, below * (at - low) - barrier);
    }
    if (bounded(high)) {
      value += barrier / (high - at);
      worst(report.complementarity, above * (high - at) - barrier);
    }
    return -value;
  };
  double* to = rhs_.data();
  for (const int v : free_)
    *to++ = pull(it.x[v], bounds.lower_x[v], bounds.upper_x[v], it.lower_x[v], it.upper_x[v], lagrangian[v]);
  for (int i = 0; i < n_s(); ++i) {
    const int r = unequal_[i];
    *to++ = pull(it.s[i], bounds.lower_g[r], bounds.upper_g[r], it.lower_s[i], it.upper_s[i], -it.y[r]);
  }
  for (const int r : equal_) {
    *to++ = -(g_[r] - bounds.lower_g[r] - compliance[r] * it.y[r]);
    worst(report.primal, to[-1]);
  }
  for (int i = 0; i < n_s(); ++i) {
    const int r = unequal_[i];
    *to++ = -(g_[r] - it.s[i] - compliance[r] * it.y[r]);
    worst(report.primal, to[-1]);
  }
}

// With as much on the Hessian's diagonal as the inertia of a minimum needs.
bool InteriorPoint::factorize(double& regularization, StepReport& report) {
  const int negative = static_cast<int>(equal_.size()) + n_s();
  double added = regularization * kDecay < kLeast ? 0.0 : regularization * kDecay;
  for (; added <= kMost; added = std::max(kFirst, added * kGrowth)) {
    shifted_ = values_;
    for (std::size_t i = 0; i < free_.size(); ++i) shifted_[diagonal_x_ + i] += added;
    ++report.factorizations;
    if (kkt_->factorize(shifted_.data()) && kkt_->negative_eigenvalues() == negative) {
      report.regularization = regularization = added;
      return true;
    }
  }
  regularization = 0;
  return false;
}

// Largest residual of the rows.
double InteriorPoint::primal(const Iterate& it, const Bounds& bounds, const Reals& compliance) const {
  const Reals g = nlp_->g(it.x.data());
  double worst = 0;
  for (std::size_t r = 0; r < g.size(); ++r) {
    const double wanted = slack_of_[r] < 0 ? bounds.lower_g[r] : it.s[slack_of_[r]];
    const double miss = std::abs(g[r] - wanted - compliance[r] * it.y[r]);
    if (!(miss <= worst)) worst = miss;  // written this way, a NaN is the worst
  }
  return worst;
}

void InteriorPoint::advance(Iterate& it, const Bounds& bounds, const Reals& compliance, const StepSettings& settings,
                            StepReport& report) {
  const double barrier = it.barrier;
  const KktSizes sizes{static_cast<int>(free_.size()), static_cast<int>(equal_.size()), n_s()};
  double primal = 1, dual = 1;
  // the step of a bounded quantity's two multipliers, and how far both and the distances let the steps be
  auto limit = [&](double at, double step, double low, double high, double below, double above, double& to_below,
                   double& to_above) {
    to_below = to_above = 0;
    if (bounded(low)) {
      const double distance = at - low;
      to_below = barrier / distance - below - below / distance * step;
      primal = longest({distance}, {step}, settings.fraction, primal);
      dual = longest({below}, {to_below}, settings.fraction, dual);
    }
    if (bounded(high)) {
      const double distance = high - at;
      to_above = barrier / distance - above + above / distance * step;
      primal = longest({distance}, {-step}, settings.fraction, primal);
      dual = longest({above}, {to_above}, settings.fraction, dual);
    }
  };
  Step step{Reals(free_.size()), Reals(free_.size()), Reals(n_s()), Reals(n_s())};
  for (std::size_t i = 0; i < free_.size(); ++i) {
    const int v = free_[i];
    limit(it.x[v], rhs_[i], bounds.lower_x[v], bounds.upper_x[v], it.lower_x[v], it.upper_x[v], step.lower_x[i],
          step.upper_x[i]);
  }
  for (int i = 0; i < n_s(); ++i) {
    const int r = unequal_[i];
    limit(it.s[i], rhs_[sizes.slack() + i], bounds.lower_g[r], bounds.upper_g[r], it.lower_s[i], it.upper_s[i],
          step.lower_s[i], step.upper_s[i]);
  }
  const Iterate start = it;
  auto move = [&](double by) {
    for (std::size_t i = 0; i < free_.size(); ++i) it.x[free_[i]] = start.x[free_[i]] + by * rhs_[i];
    for (std::size_t i = 0; i < equal_.size(); ++i)
      it.y[equal_[i]] = start.y[equal_[i]] + by * rhs_[sizes.equality() + i];
    for (int i = 0; i < n_s(); ++i) {
      it.s[i] = start.s[i] + by * rhs_[sizes.slack() + i];
      it.y[unequal_[i]] = start.y[unequal_[i]] + by * rhs_[sizes.inequality() + i];
    }
    report.after = this->primal(it, bounds, compliance);
  };
  move(primal);
  for (int k = 0; k < kHalvings && !(report.after <= kWorse * report.primal + kMore); ++k) move(primal /= 2);
  auto near = [barrier](double multiplier, double distance) {
    return std::clamp(multiplier, barrier / distance / kNear, barrier / distance * kNear);
  };
  for (std::size_t i = 0; i < free_.size(); ++i) {
    const int v = free_[i];
    if (bounded(bounds.lower_x[v]))
      it.lower_x[v] = near(it.lower_x[v] + dual * step.lower_x[i], it.x[v] - bounds.lower_x[v]);
    if (bounded(bounds.upper_x[v]))
      it.upper_x[v] = near(it.upper_x[v] + dual * step.upper_x[i], bounds.upper_x[v] - it.x[v]);
  }
  for (int i = 0; i < n_s(); ++i) {
    const int r = unequal_[i];
    if (bounded(bounds.lower_g[r]))
      it.lower_s[i] = near(it.lower_s[i] + dual * step.lower_s[i], it.s[i] - bounds.lower_g[r]);
    if (bounded(bounds.upper_g[r]))
      it.upper_s[i] = near(it.upper_s[i] + dual * step.upper_s[i], bounds.upper_g[r] - it.s[i]);
  }
  report.primal_step = primal;
  report.dual_step = dual;
  const double next = it.barrier * (std::min(primal, dual) < kShort ? kRaise : kLower);
  it.barrier = std::clamp(next, settings.barrier, std::max(settings.barrier, settings.most_barrier));
}

std::vector<StepReport> InteriorPoint::steps(Iterate& it, const Bounds& bounds, const Reals& compliance,
                                             const StepSettings& settings) {
  require_structure(bounds);
  const auto start = std::chrono::steady_clock::now();
  std::vector<StepReport> reports;
  for (int k = 0; k < settings.steps; ++k) {
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - start;
    if (k > 0 && settings.seconds > 0 && passed.count() > settings.seconds) break;
    StepReport report;
    report.barrier = it.barrier;
    set_values(it, bounds, compliance);
    set_rhs(it, bounds, compliance, it.barrier, report);
    if (k >= settings.least_steps && std::max({report.primal, report.dual, report.complementarity}) < settings.tolerance)
      break;
    if (factorize(it.regularization, report)) {
      kkt_->solve(rhs_.data());
      if (!all_finite(rhs_)) report.factorizations = 0;
      else advance(it, bounds, compliance, settings, report);
    }
    reports.push_back(report);
    if (report.primal_step == 0) break;
  }
  return reports;
}

}  // namespace trajopt
