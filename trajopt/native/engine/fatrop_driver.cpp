#include "fatrop_stages.hpp"

// FATROP's print level and banner are inline variables: they must be the library's own.
#pragma GCC visibility push(default)
#include <fatrop/fatrop.hpp>
#pragma GCC visibility pop

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>

namespace trajopt {

namespace {

using fatrop::Index;
using fatrop::OcpType;
using fatrop::Scalar;
using fatrop::VecRealView;
using Matrices = std::vector<fatrop::MatRealAllocated>;
using Data = fatrop::IpData<OcpType>;

// Thrown through FATROP, which has no other way to be stopped between iterations.
struct Stop {
  const char* status;
};

void clear(Matrices& matrices, int n_rows_kept) {
  for (auto& matrix : matrices) blasfeo_dgese(matrix.m() - n_rows_kept, matrix.n(), 0.0, &matrix.mat(), 0, 0);
}

void put(Matrices& matrices, const std::vector<Entry>& entries, const Reals& nonzeros, double sign) {
  for (const Entry& e : entries)
    BLASFEO_DMATEL(&matrices[e.stage].mat(), e.row, e.column) += sign * nonzeros[e.nonzero];
}

void put_ones(Matrices& matrices, const std::vector<Entry>& entries) {
  for (const Entry& e : entries) BLASFEO_DMATEL(&matrices[e.stage].mat(), e.row, e.column) = 1.0;
}

void residuals(const std::vector<Link>& links, const double* values, Scalar* out) {
  for (const Link& link : links) out[link.position] = link.sign * (values[link.index] - link.constant);
}

void multipliers(const std::vector<Link>& links, const Scalar* from, Reals& out) {
  for (const Link& link : links) out[link.index] = link.sign * from[link.position];
}

fatrop::NlpDims total(const StageInfo& info) {
  return fatrop::NlpDims(info.number_of_primal_variables, info.number_of_eq_constraints,
                         info.number_of_slack_variables);
}

// The NLP as FATROP's: whole vectors in, blocks of stages out.
class Adapter : public fatrop::Nlp<OcpType> {
 public:
  using Tick = std::function<void(bool restoration)>;

  Adapter(trajopt::Nlp& nlp, const StageMap& map, const Reals& x0)
      : nlp_(nlp), map_(map), x0_(x0), totals_(total(map.info)), x_(x0.size()), lambda_(nlp.problem().n_g) {}

  Tick tick;
  bool finite_derivatives = true;

  const fatrop::NlpDims& nlp_dims() const override { return totals_; }
  const StageDims& problem_dims() const override { return map_.dims; }

  Index eval_lag_hess(const StageInfo&, const Scalar scale, const VecRealView& x, const VecRealView&,
                      const VecRealView& lambda, fatrop::Hessian<OcpType>& hessian) override {
    // Only the outer algorithm calls back: a Hessian without a call before it is restoration's.
    if (!called_back_ && tick) tick(true);
    called_back_ = false;
    multipliers(map_.from_rows, lambda.data(), lambda_);
    const Reals& values = watch(nlp_.hessian(unknowns(x), scale, lambda_.data()));
    clear(hessian.RSQrqt, kRightHandSide);
    put(hessian.RSQrqt, map_.hessian, values, 1.0);
    return 0;
  }

  Index eval_constr_jac(const StageInfo&, const VecRealView& x, const VecRealView&,
                        fatrop::Jacobian<OcpType>& jacobian) override {
    const Reals& values = watch(nlp_.jacobian(unknowns(x)));
    for (Matrices* matrices : {&jacobian.BAbt, &jacobian.Gg_eqt, &jacobian.Gg_ineqt}) clear(*matrices, kRightHandSide);
    put(jacobian.BAbt, map_.dynamics, values, -1.0);
    put(jacobian.Gg_eqt, map_.equality, values, 1.0);
    put(jacobian.Gg_ineqt, map_.inequality, values, 1.0);
    put_ones(jacobian.Gg_eqt, map_.unit_equality);
    put_ones(jacobian.Gg_ineqt, map_.unit_inequality);
    return 0;
  }

  Index eval_constraint_violation(const StageInfo& info, const VecRealView& x, const VecRealView& slack,
                                  VecRealView& result) override {
    const double* values = unknowns(x);
    Scalar* out = result.data();
    residuals(map_.from_rows, nlp_.g(values).data(), out);
    residuals(map_.from_unknowns, values, out);
    for (Index i = 0; i < info.number_of_slack_variables; ++i) out[info.offset_g_eq_slack + i] -= slack(i);
    return 0;
  }

  Index eval_objective_gradient(const StageInfo&, const Scalar scale, const VecRealView& x, const VecRealView&,
                                VecRealView& gradient_x, VecRealView& gradient_s) override {
    const Reals& gradient = watch(nlp_.gradient(unknowns(x)));
    Scalar* out = gradient_x.data();
    for (std::size_t i = 0; i < gradient.size(); ++i) out[map_.position[i]] = scale * gradient[i];
    gradient_s = 0.0;
    return 0;
  }

  Index eval_objective(const StageInfo&, const Scalar scale, const VecRealView& x, const VecRealView&,
                       Scalar& result) override {
    result = scale * nlp_.f(unknowns(x));
    return 0;
  }

  Index get_bounds(const StageInfo&, VecRealView& lower, VecRealView& upper) override {
    std::copy(map_.lower.begin(), map_.lower.end(), lower.data());
    std::copy(map_.upper.begin(), map_.upper.end(), upper.data());
    return 0;
  }

  Index get_initial_primal(const StageInfo&, VecRealView& x) override {
    for (std::size_t i = 0; i < x0_.size(); ++i) x(map_.position[i]) = x0_[i];
    return 0;
  }

  void get_primal_damping(const StageInfo&, VecRealView& damping) override { damping = 0.0; }

  void apply_jacobian_s_transpose(const StageInfo& info, const VecRealView& lambda, const Scalar alpha,
                                  const VecRealView& y, VecRealView& out) override {
    for (Index i = 0; i < info.number_of_slack_variables; ++i)
      out(i) = alpha * y(i) - lambda(info.offset_g_eq_slack + i);
  }

  void callback(const Data&) override {
    called_back_ = true;
    if (tick) tick(false);
  }

  // FATROP's vector in the NLP's order.
  const double* unknowns(const VecRealView& x) {
    const Scalar* from = x.data();
    for (std::size_t i = 0; i < x_.size(); ++i) x_[i] = from[map_.position[i]];
    return x_.data();
  }

 private:
  static constexpr int kRightHandSide = 1;  // the last row of every matrix is FATROP's own

  const Reals& watch(const Reals& values) {
    finite_derivatives = finite_derivatives && all_finite(values);
    return values;
  }

  trajopt::Nlp& nlp_;
  const StageMap& map_;
  const Reals& x0_;
  fatrop::NlpDims totals_;
  Reals x_, lambda_;
  bool called_back_ = false;
};

// FATROP writes to a stream of the process: silent while this lives.
class Silence {
 public:
  Silence() {
    while (level_ < 10 && fatrop::PrintLevelManager::is_enabled(static_cast<fatrop::PrintLevel>(level_ + 1))) ++level_;
    fatrop::PrintLevelManager::set_print_level(0);
    fatrop::Banner::set_suppress(true);
  }
  ~Silence() {
    fatrop::PrintLevelManager::set_print_level(level_);
    fatrop::Banner::set_suppress(false);
  }
  Silence(const Silence&) = delete;

 private:
  int level_ = 0;
};

void set_option(fatrop::OptionRegistry& registry, const std::string& name, const Option& value) {
  const auto type = registry.get_option_type(name);
  if (type == fatrop::OptionTypeId::Unknown) throw std::invalid_argument("option '" + name + "' is unknown");
  const long* integer = std::get_if<long>(&value);
  try {
    if (integer && type == fatrop::OptionTypeId::Scalar)
      registry.set_option(name, static_cast<Scalar>(*integer));
    else
      std::visit([&](const auto& given) {
        if constexpr (std::is_same_v<std::decay_t<decltype(given)>, long>)
          registry.set_option(name, static_cast<Index>(given));
        else
          registry.set_option(name, given);
      }, value);
  } catch (const std::runtime_error&) {
    throw std::invalid_argument("the value of option '" + name + "' is not allowed");
  }
}

// Takes the option that is ours out of FATROP's; infinite when it is not given.
double take_max_wall_time(Options& options) {
  const auto found = options.find("max_wall_time");
  if (found == options.end()) return HUGE_VAL;
  const Option value = found->second;
  options.erase(found);
  if (const long* integer = std::get_if<long>(&value)) return static_cast<double>(*integer);
  if (const double* number = std::get_if<double>(&value)) return *number;
  throw std::invalid_argument("the value of option 'max_wall_time' is not allowed");
}

const char* flag_name(fatrop::IpSolverReturnFlag flag) {
  switch (flag) {
    case fatrop::IpSolverReturnFlag::Success: return "Success";
    case fatrop::IpSolverReturnFlag::MaxIterExceeded: return "MaxIterExceeded";
    case fatrop::IpSolverReturnFlag::StopAtAcceptablePoint: return "StopAtAcceptablePoint";
    case fatrop::IpSolverReturnFlag::LocalInfeasibility: return "LocalInfeasibility";
    case fatrop::IpSolverReturnFlag::LineSearchFailed: return "LineSearchFailed";
    case fatrop::IpSolverReturnFlag::ErrorInStepComputation: return "ErrorInStepComputation";
    default: return "Unknown";
  }
}

double dual_infeasibility(fatrop::IpIterate<OcpType>& iterate) {
  return std::max(iterate.dual_infeasibility_x_inf(), iterate.dual_infeasibility_s_inf());
}

Iteration describe(Data& data, bool restoration) {
  auto& iterate = data.current_iterate();
  const auto& step = iterate.step_info();
  return {data.iteration_number(), step.ls_iter + 1, iterate.obj_value(), iterate.constr_viol_inf(),
          dual_infeasibility(iterate), iterate.mu(), step.alpha_primal, step.inertia_correction_primal, restoration};
}

void require_identity(const StageMap& map, const Reals& jacobian) {
  constexpr double kRounding = 1e-9;  // the identity comes out of divisions by scales
  for (const Entry& e : map.identity)
    if (std::abs(jacobian[e.nonzero] - 1.0) > kRounding)
      throw std::invalid_argument("gap row " + std::to_string(e.column) + " of stage " + std::to_string(e.stage) +
                                  " is not x_next - F(x, u): its slope in x_next is " +
                                  std::to_string(jacobian[e.nonzero]));
}

void set_multipliers(const StageMap& map, const Reals& lambda, Data& data) {
  fatrop::VecRealAllocated dual(map.info.number_of_eq_constraints);
  for (const Link& link : map.from_rows) dual(link.position) = link.sign * lambda[link.index];
  data.current_iterate().set_dual_eq(dual);
}

void take_iterate(Outcome& outcome, const StageMap& map, Adapter& adapter, Data& data) {
  auto& iterate = data.current_iterate();
  const double* x = adapter.unknowns(iterate.primal_x());
  outcome.x.assign(x, x + map.position.size());
  outcome.lambda_x.assign(outcome.x.size(), 0.0);
  multipliers(map.from_rows, iterate.dual_eq().data(), outcome.lambda_g);
  multipliers(map.from_unknowns, iterate.dual_eq().data(), outcome.lambda_x);
  outcome.primal = iterate.constr_viol_inf();
  outcome.dual = dual_infeasibility(iterate);
  outcome.complementarity =
      std::max(norm_inf(iterate.complementarity_l()), norm_inf(iterate.complementarity_u()));
  outcome.iterations = data.iteration_number();
}

}  // namespace

Outcome solve_fatrop(trajopt::Nlp& nlp, const Stages& stages, const Reals& x0, const Bounds& bounds,
                     const Options& options, const Callback& callback, const Reals& lambda_g) {
  using Clock = std::chrono::steady_clock;
  nlp.reset_timings();
  const auto start = Clock::now();
  const StageMap map(nlp.problem(), stages, bounds);
  require_identity(map, nlp.jacobian(x0.data()));
  const Silence silence;
  const auto adapter = std::make_shared<Adapter>(nlp, map, x0);
  fatrop::OptionRegistry registry;
  fatrop::IpAlgBuilder<OcpType> builder(adapter);
  const auto algorithm = builder.with_options_registry(&registry).build();
  const std::shared_ptr<Data> data = builder.get_ipdata();
  Options own = options;
  const double max_wall_time = take_max_wall_time(own);
  for (const auto& [name, value] : own) set_option(registry, name, value);
  adapter->tick = [&](bool restoration) {
    if (data->iteration_number() == 0 && !restoration && !lambda_g.empty()) set_multipliers(map, lambda_g, *data);
    if (callback && !callback(describe(*data, restoration))) throw Stop{"UserRequestedStop"};
    if (std::chrono::duration<double>(Clock::now() - start).count() > max_wall_time)
      throw Stop{"MaxWallTimeExceeded"};
  };
  Outcome outcome;
  outcome.lambda_g.resize(nlp.problem().n_g);
  try {
    outcome.status = flag_name(algorithm->optimize());
  } catch (const Stop& stop) {
    outcome.status = stop.status;
  }
  if (!adapter->finite_derivatives && outcome.status != "Success") outcome.status = "InvalidNumber";
  take_iterate(outcome, map, *adapter, *data);
  complete(outcome, nlp, bounds, start);
  return outcome;
}

}  // namespace trajopt
