#include <fatrop/fatrop.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>

#include "fatrop_stages.hpp"

namespace trajopt {

namespace {

using fatrop::Index;
using fatrop::OcpType;
using fatrop::Scalar;
using fatrop::VecRealView;
using Info = fatrop::ProblemInfo<OcpType>;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Thrown from the iteration callback to leave FATROP at the current iterate.
struct StopRequested {};

fatrop::ProblemDims<OcpType> dimensions(const StageMap& map) {
  Indices nu, nx, ng, nineq;
  for (const StageMap::Stage& stage : map.stages) {
    nu.push_back(stage.n_control);
    nx.push_back(stage.n_state);
    ng.push_back(stage.n_equality());
    nineq.push_back(stage.n_inequality());
  }
  return fatrop::ProblemDims<OcpType>(static_cast<int>(map.stages.size()), nu, nx, ng, nineq);
}

fatrop::NlpDims total(const StageMap& map) {
  int variables = 0, equalities = 0, inequalities = 0;
  for (const StageMap::Stage& stage : map.stages) {
    variables += stage.n_state + stage.n_control;
    equalities += static_cast<int>(stage.gap.size()) + stage.n_equality() + stage.n_inequality();
    inequalities += stage.n_inequality();
  }
  return fatrop::NlpDims(variables, equalities, inequalities);
}

class Adapter : public fatrop::Nlp<OcpType> {
 public:
  Adapter(trajopt::Nlp& nlp, const StageMap& map, const Reals& x0, const Bounds& bounds, const Callback& callback)
      : nlp_(nlp), map_(map), x0_(x0), bounds_(bounds), callback_(callback), dims_(dimensions(map)),
        totals_(total(map)), x_(x0.size()), lambda_(nlp.problem().n_g) {}

  const fatrop::NlpDims& nlp_dims() const override { return totals_; }
  const fatrop::ProblemDims<OcpType>& problem_dims() const override { return dims_; }

  Index eval_lag_hess(const Info& info, const Scalar scale, const VecRealView& x, const VecRealView&,
                      const VecRealView& lambda, fatrop::Hessian<OcpType>& hessian) override {
    read_multipliers(info, lambda, lambda_);
    const Reals& values = nlp_.hessian(read(info, x), scale, lambda_.data());
    for (auto& matrix : hessian.RSQrqt) blasfeo_dgese(matrix.m(), matrix.n(), 0.0, &matrix.mat(), 0, 0);
    for (const StageMap::Place& place : map_.hessian) {
      blasfeo_dmat& matrix = hessian.RSQrqt[place.stage].mat();
      BLASFEO_DMATEL(&matrix, place.row, place.column) = values[place.nonzero];
      BLASFEO_DMATEL(&matrix, place.column, place.row) = values[place.nonzero];
    }
    return 0;
  }

  Index eval_constr_jac(const Info& info, const VecRealView& x, const VecRealView&,
                        fatrop::Jacobian<OcpType>& jacobian) override {
    const Reals& values = nlp_.jacobian(read(info, x));
    for (auto* matrices : {&jacobian.BAbt, &jacobian.Gg_eqt, &jacobian.Gg_ineqt})
      for (auto& matrix : *matrices) blasfeo_dgese(matrix.m(), matrix.n(), 0.0, &matrix.mat(), 0, 0);
    for (const StageMap::Place& place : map_.jacobian) {
      auto& matrices = place.block == StageMap::kDynamics   ? jacobian.BAbt
                       : place.block == StageMap::kEquality ? jacobian.Gg_eqt
                                                            : jacobian.Gg_ineqt;
      BLASFEO_DMATEL(&matrices[place.stage].mat(), place.row, place.column) = place.sign * values[place.nonzero];
    }
    for (std::size_t k = 0; k < map_.stages.size(); ++k) {
      for (const auto& unit : map_.stages[k].fixed)
        BLASFEO_DMATEL(&jacobian.Gg_eqt[k].mat(), unit.row, unit.column) = 1.0;
      for (const auto& unit : map_.stages[k].bounded)
        BLASFEO_DMATEL(&jacobian.Gg_ineqt[k].mat(), unit.row, unit.column) = 1.0;
    }
    return 0;
  }

  Index eval_constraint_violation(const Info& info, const VecRealView& x, const VecRealView& slack,
                                  VecRealView& result) override {
    const double* unknowns = read(info, x);
    const Reals& g = nlp_.g(unknowns);
    Scalar* out = result.data();
    const Scalar* s = slack.data();
    for (std::size_t k = 0; k < map_.stages.size(); ++k) {
      const StageMap::Stage& stage = map_.stages[k];
      for (std::size_t i = 0; i < stage.gap.size(); ++i)
        out[info.offsets_g_eq_dyn[k] + i] = bounds_.lower_g[stage.gap[i]] - g[stage.gap[i]];
      for (std::size_t i = 0; i < stage.equality.size(); ++i)
        out[info.offsets_g_eq_path[k] + i] = g[stage.equality[i]] - bounds_.lower_g[stage.equality[i]];
      for (const auto& unit : stage.fixed)
        out[info.offsets_g_eq_path[k] + unit.column] = unknowns[unit.unknown] - bounds_.lower_x[unit.unknown];
      const int first = info.offsets_g_eq_slack[k], first_slack = info.offsets_slack[k];
      for (std::size_t i = 0; i < stage.inequality.size(); ++i)
        out[first + i] = g[stage.inequality[i]] - s[first_slack + i];
      for (const auto& unit : stage.bounded)
        out[first + unit.column] = unknowns[unit.unknown] - s[first_slack + unit.column];
    }
    return 0;
  }

  Index eval_objective_gradient(const Info& info, const Scalar scale, const VecRealView& x, const VecRealView&,
                                VecRealView& gradient_x, VecRealView& gradient_s) override {
    const Reals& gradient = nlp_.gradient(read(info, x));
    Reals scaled(gradient);
    for (double& value : scaled) value *= scale;
    write(info, scaled, gradient_x.data());
    gradient_s = 0.0;
    return 0;
  }

  Index eval_objective(const Info& info, const Scalar scale, const VecRealView& x, const VecRealView&,
                       Scalar& result) override {
    result = scale * nlp_.f(read(info, x));
    return 0;
  }

  Index get_bounds(const Info& info, VecRealView& lower, VecRealView& upper) override {
    for (std::size_t k = 0; k < map_.stages.size(); ++k) {
      const StageMap::Stage& stage = map_.stages[k];
      const int first = info.offsets_slack[k];
      for (std::size_t i = 0; i < stage.inequality.size(); ++i) {
        lower(first + i) = bounds_.lower_g[stage.inequality[i]];
        upper(first + i) = bounds_.upper_g[stage.inequality[i]];
      }
      for (const auto& unit : stage.bounded) {
        lower(first + unit.column) = bounds_.lower_x[unit.unknown];
        upper(first + unit.column) = bounds_.upper_x[unit.unknown];
      }
    }
    return 0;
  }

  Index get_initial_primal(const Info& info, VecRealView& x) override {
    write(info, x0_, x.data());
    return 0;
  }

  void get_primal_damping(const Info&, VecRealView& damping) override { damping = 0.0; }

  void apply_jacobian_s_transpose(const Info& info, const VecRealView& multipliers, const Scalar alpha,
                                  const VecRealView& y, VecRealView& out) override {
    out = alpha * y;
    const int n = info.number_of_slack_variables;
    out.block(n, 0) = out.block(n, 0) - multipliers.block(n, info.offset_g_eq_slack);
  }

  void callback(const fatrop::IpData<OcpType>& data) override {
    auto& iterate = const_cast<fatrop::IpData<OcpType>&>(data).current_iterate();
    const auto& step = iterate.step_info();
    Iteration info{data.iteration_number(), step.ls_iter, iterate.obj_value(), iterate.constr_viol_inf(),
                   std::max(iterate.dual_infeasibility_x_inf(), iterate.dual_infeasibility_s_inf()), iterate.mu(),
                   step.alpha_primal, step.inertia_correction_primal, false};
    if (callback_ && !callback_(info)) throw StopRequested{};
  }

  // FATROP's vector of (u_k, x_k) as unknowns in the NLP's order.
  const double* read(const Info& info, const VecRealView& x) {
    const Scalar* values = x.data();
    for (std::size_t k = 0; k < map_.stages.size(); ++k) {
      const StageMap::Stage& stage = map_.stages[k];
      std::copy_n(values + info.offsets_primal_x[k], stage.n_state, x_.begin() + stage.first);
      std::copy_n(values + info.offsets_primal_u[k], stage.n_control, x_.begin() + stage.first + stage.n_state);
    }
    return x_.data();
  }

  void read_multipliers(const Info& info, const VecRealView& lambda, Reals& out) const {
    const Scalar* values = lambda.data();
    for (std::size_t k = 0; k < map_.stages.size(); ++k) {
      const StageMap::Stage& stage = map_.stages[k];
      for (std::size_t i = 0; i < stage.gap.size(); ++i) out[stage.gap[i]] = -values[info.offsets_g_eq_dyn[k] + i];
      for (std::size_t i = 0; i < stage.equality.size(); ++i)
        out[stage.equality[i]] = values[info.offsets_g_eq_path[k] + i];
      for (std::size_t i = 0; i < stage.inequality.size(); ++i)
        out[stage.inequality[i]] = values[info.offsets_g_eq_slack[k] + i];
    }
  }

 private:
  void write(const Info& info, const Reals& from, Scalar* to) const {
    for (std::size_t k = 0; k < map_.stages.size(); ++k) {
      const StageMap::Stage& stage = map_.stages[k];
      std::copy_n(from.begin() + stage.first, stage.n_state, to + info.offsets_primal_x[k]);
      std::copy_n(from.begin() + stage.first + stage.n_state, stage.n_control, to + info.offsets_primal_u[k]);
    }
  }

  trajopt::Nlp& nlp_;
  const StageMap& map_;
  const Reals& x0_;
  const Bounds& bounds_;
  const Callback& callback_;
  fatrop::ProblemDims<OcpType> dims_;
  fatrop::NlpDims totals_;
  Reals x_, lambda_;
};

void set_option(fatrop::OptionRegistry& registry, const std::string& name, const Option& value) {
  const auto type = registry.get_option_type(name);
  if (type == fatrop::OptionTypeId::Unknown) throw std::invalid_argument("option '" + name + "' is unknown");
  try {
    if (const long* integer = std::get_if<long>(&value)) {
      if (type == fatrop::OptionTypeId::Scalar)
        registry.set_option(name, static_cast<Scalar>(*integer));
      else
        registry.set_option(name, static_cast<Index>(*integer));
    } else if (const double* number = std::get_if<double>(&value)) {
      registry.set_option(name, *number);
    } else {
      registry.set_option(name, std::get<std::string>(value));
    }
  } catch (const std::runtime_error&) {
    throw std::invalid_argument("the value of option '" + name + "' is not allowed");
  }
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

}  // namespace

Outcome solve_fatrop(trajopt::Nlp& nlp, const Stages& sizes, const Reals& x0, const Bounds& bounds, const Options& options,
                     const Callback& callback) {
  nlp.reset_timings();
  const StageMap map(nlp.problem(), sizes, bounds);
  auto adapter = std::make_shared<Adapter>(nlp, map, x0, bounds, callback);
  fatrop::OptionRegistry registry;
  fatrop::IpAlgBuilder<OcpType> builder(adapter);
  auto algorithm = builder.with_options_registry(&registry).build();
  for (const auto& [name, value] : options) set_option(registry, name, value);
  Outcome outcome;
  const auto start = std::chrono::steady_clock::now();
  try {
    outcome.status = flag_name(algorithm->optimize());
  } catch (const StopRequested&) {
    outcome.status = "UserRequestedStop";
  }
  outcome.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.function_seconds = nlp.function_seconds();
  auto& iterate = builder.get_ipdata()->current_iterate();
  const double* x = adapter->read(algorithm->info(), iterate.primal_x());
  outcome.x.assign(x, x + x0.size());
  outcome.lambda_g.assign(nlp.problem().n_g, 0.0);
  adapter->read_multipliers(algorithm->info(), iterate.dual_eq(), outcome.lambda_g);
  outcome.primal = iterate.constr_viol_inf();
  outcome.dual = std::max(iterate.dual_infeasibility_x_inf(), iterate.dual_infeasibility_s_inf());
  outcome.iterations = builder.get_ipdata()->iteration_number();
  outcome.objective = nlp.f(outcome.x.data());
  return outcome;
}

}  // namespace trajopt
