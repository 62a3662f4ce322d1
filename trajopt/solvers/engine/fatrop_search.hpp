// FATROP's search direction, made to terminate: its own repeats a factorisation for ever where no
// regularisation helps.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string>

#pragma GCC visibility push(default)
#include <fatrop/fatrop.hpp>
#include <fatrop/ip_algorithm/ip_iterate.hpp>
#include <fatrop/ip_algorithm/ip_search_dir.hpp>
#include <fatrop/linear_algebra/linear_solver.hpp>
#pragma GCC visibility pop

namespace trajopt {

constexpr const char* kNoStep = "ErrorInStepComputation";

// Thrown through FATROP, which has no other way to be stopped inside a step.
struct Stop {
  std::string status;
};

// Inertia correction of an interior point's step, as IPOPT's: Waechter and Biegler, On the implementation of an
// interior-point filter line-search algorithm, Mathematical Programming 106 (2006), algorithm IC. FATROP 1.1.8 has
// no largest delta_w, which then grows until the matrix is NaN and every factorisation fails; and it repeats the
// same system where rows stay dependent with delta_c. Here delta_w grows in both cases, up to a limit.
template <class LinearSolver>
class SearchDirection : public fatrop::IpSearchDirBase {
 public:
  using Scalar = fatrop::Scalar;
  using Data = fatrop::IpData<fatrop::OcpType>;
  using Iterate = fatrop::IpIterate<fatrop::OcpType>;
  using Flag = fatrop::LinsolReturnFlag;

  // `look` is called before every factorisation; it may throw a Stop.
  SearchDirection(std::shared_ptr<Data> data, std::shared_ptr<LinearSolver> solver, std::function<void()> look)
      : data_(std::move(data)),
        solver_(std::move(solver)),
        look_(std::move(look)),
        x_(data_->current_iterate().delta_primal_x().m()),
        s_(data_->current_iterate().delta_primal_s().m()),
        g_(data_->current_iterate().delta_dual_eq().m()),
        lower_(s_.m()),
        upper_(s_.m()) {}

  void reset() override { last_delta_w_ = 0; }

  Flag compute_search_dir() override {
    Iterate& iterate = data_->current_iterate();
    Scalar delta_w = 0, delta_c = 0;
    Flag flag = factorise(iterate, delta_w, delta_c);
    while (!solved(flag)) {
      if (flag == Flag::NOFULL_RANK && delta_c == 0)
        delta_c = delta_c_stripe_ * std::pow(iterate.mu(), kappa_c_);
      else
        delta_w = next_delta_w(delta_w);
      if (!(delta_w <= delta_w_max_)) throw Stop{kNoStep};
      flag = factorise(iterate, delta_w, delta_c);
    }
    if (delta_w > 0) last_delta_w_ = delta_w;
    iterate.set_delta_primal_x(x_);
    iterate.set_delta_primal_s(s_);
    iterate.set_delta_dual_eq(g_);
    iterate.set_delta_dual_bounds_l(lower_);
    iterate.set_delta_dual_bounds_u(upper_);
    iterate.search_dir_info().inertia_correction_primal = delta_w;
    iterate.search_dir_info().inertia_correction_dual = delta_c;
    return flag;
  }

  // Names and values are FATROP's; "delta_wmax" is ours, with the value of the paper.
  void register_options(fatrop::OptionRegistry& registry) override {
    registry.register_option("delta_w0", &SearchDirection::set<&SearchDirection::delta_w0_>, this);
    registry.register_option("delta_wmin", &SearchDirection::set<&SearchDirection::delta_w_min_>, this);
    registry.register_option("delta_wmax", &SearchDirection::set<&SearchDirection::delta_w_max_>, this);
    registry.register_option("kappa_wmin", &SearchDirection::set<&SearchDirection::kappa_w_min_>, this);
    registry.register_option("kappa_wplus", &SearchDirection::set<&SearchDirection::kappa_w_plus_>, this);
    registry.register_option("kappa_wplusem", &SearchDirection::set<&SearchDirection::kappa_w_first_>, this);
    registry.register_option("kappa_c", &SearchDirection::set<&SearchDirection::kappa_c_>, this);
    registry.register_option("delta_c_stripe", &SearchDirection::set<&SearchDirection::delta_c_stripe_>, this);
  }

 private:
  template <Scalar SearchDirection::*member>
  void set(const Scalar& value) {
    this->*member = value;
  }

  static bool solved(Flag flag) {
    return flag == Flag::SUCCESS || flag == Flag::ITREF_MAX_ITER || flag == Flag::ITREF_INCREASE;
  }

  Scalar next_delta_w(Scalar delta_w) const {
    if (delta_w == 0) return last_delta_w_ == 0 ? delta_w0_ : std::max(kappa_w_min_ * last_delta_w_, delta_w_min_);
    return (last_delta_w_ == 0 ? kappa_w_first_ : kappa_w_plus_) * delta_w;
  }

  // Solves in place of the right-hand sides; a step that is not finite counts as an indefinite matrix.
  Flag factorise(Iterate& iterate, Scalar delta_w, Scalar delta_c) {
    look_();
    x_.block(x_.m(), 0) = iterate.dual_infeasibility_x();
    s_.block(s_.m(), 0) = iterate.dual_infeasibility_s();
    g_.block(g_.m(), 0) = iterate.constr_viol();
    lower_.block(lower_.m(), 0) = iterate.relaxed_complementarity_l();
    upper_.block(upper_.m(), 0) = iterate.relaxed_complementarity_u();
    iterate.set_Dx(fatrop::VecRealScalar(iterate.Dx().m(), delta_w) + iterate.primal_damping());
    iterate.set_De(fatrop::VecRealScalar(iterate.De().m(), delta_c));
    iterate.set_De_is_zero(delta_c == 0);
    typename LinearSolver::LinearSystemType system(
        iterate.info(), iterate.jacobian(), iterate.hessian(), iterate.Dx(), iterate.De_is_zero(), iterate.De(),
        iterate.delta_lower(), iterate.delta_upper(), iterate.dual_bounds_l(), iterate.dual_bounds_u(), x_, s_, g_,
        lower_, upper_);
    const Flag flag = solver_->solve_in_place(system);
    const bool finite = x_.is_finite() && s_.is_finite() && g_.is_finite() && lower_.is_finite() && upper_.is_finite();
    return solved(flag) && !finite ? Flag::INDEFINITE : flag;
  }

  std::shared_ptr<Data> data_;
  std::shared_ptr<LinearSolver> solver_;
  std::function<void()> look_;
  fatrop::VecRealAllocated x_, s_, g_, lower_, upper_;  // right-hand sides, then the step
  Scalar last_delta_w_ = 0;
  Scalar delta_w0_ = 1e-4, delta_w_min_ = 1e-20, delta_w_max_ = 1e40;
  Scalar kappa_w_min_ = 1.0 / 3.0, kappa_w_plus_ = 8, kappa_w_first_ = 100;
  Scalar kappa_c_ = 0.25, delta_c_stripe_ = 1e-6;
};

}  // namespace trajopt
