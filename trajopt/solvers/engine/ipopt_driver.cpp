#include <IpIpoptApplication.hpp>
#include <IpIpoptCalculatedQuantities.hpp>
#include <IpIpoptData.hpp>
#include <IpSolveStatistics.hpp>
#include <IpTNLP.hpp>
#include <IpTNLPAdapter.hpp>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "solve.hpp"
#include "stage_solver.hpp"

namespace trajopt {

namespace {

using Ipopt::Index;
using Ipopt::Number;

const char* status_name(Ipopt::ApplicationReturnStatus status) {
  switch (status) {
    case Ipopt::Solve_Succeeded: return "Solve_Succeeded";
    case Ipopt::Solved_To_Acceptable_Level: return "Solved_To_Acceptable_Level";
    case Ipopt::Infeasible_Problem_Detected: return "Infeasible_Problem_Detected";
    case Ipopt::Search_Direction_Becomes_Too_Small: return "Search_Direction_Becomes_Too_Small";
    case Ipopt::Diverging_Iterates: return "Diverging_Iterates";
    case Ipopt::User_Requested_Stop: return "User_Requested_Stop";
    case Ipopt::Feasible_Point_Found: return "Feasible_Point_Found";
    case Ipopt::Maximum_Iterations_Exceeded: return "Maximum_Iterations_Exceeded";
    case Ipopt::Restoration_Failed: return "Restoration_Failed";
    case Ipopt::Error_In_Step_Computation: return "Error_In_Step_Computation";
    case Ipopt::Maximum_CpuTime_Exceeded: return "Maximum_CpuTime_Exceeded";
    case Ipopt::Maximum_WallTime_Exceeded: return "Maximum_WallTime_Exceeded";
    case Ipopt::Not_Enough_Degrees_Of_Freedom: return "Not_Enough_Degrees_Of_Freedom";
    case Ipopt::Invalid_Problem_Definition: return "Invalid_Problem_Definition";
    case Ipopt::Invalid_Option: return "Invalid_Option";
    case Ipopt::Invalid_Number_Detected: return "Invalid_Number_Detected";
    case Ipopt::Unrecoverable_Exception: return "Unrecoverable_Exception";
    case Ipopt::NonIpopt_Exception_Thrown: return "NonIpopt_Exception_Thrown";
    case Ipopt::Insufficient_Memory: return "Insufficient_Memory";
    default: return "Internal_Error";
  }
}

class Adapter : public Ipopt::TNLP {
 public:
  Adapter(Nlp& nlp, const Reals& x0, const Bounds& bounds, const Callback& callback, const Multipliers& start)
      : nlp_(nlp), x0_(x0), bounds_(bounds), callback_(callback), start_(start) {
    outcome.x = x0;
    outcome.lambda_g.assign(nlp.problem().n_g, 0.0);
    outcome.lambda_x.assign(nlp.problem().n_x, 0.0);
  }

  bool get_nlp_info(Index& n, Index& m, Index& nnz_jac, Index& nnz_h, IndexStyleEnum& style) override {
    const Problem& p = nlp_.problem();
    n = p.n_x;
    m = p.n_g;
    nnz_jac = static_cast<Index>(p.jac_row.size());
    nnz_h = static_cast<Index>(p.hess_row.size());
    style = TNLP::C_STYLE;
    return true;
  }

  bool get_bounds_info(Index, Number* xl, Number* xu, Index, Number* gl, Number* gu) override {
    std::copy(bounds_.lower_x.begin(), bounds_.lower_x.end(), xl);
    std::copy(bounds_.upper_x.begin(), bounds_.upper_x.end(), xu);
    std::copy(bounds_.lower_g.begin(), bounds_.lower_g.end(), gl);
    std::copy(bounds_.upper_g.begin(), bounds_.upper_g.end(), gu);
    return true;
  }

  bool get_starting_point(Index n, bool, Number* x, bool init_z, Number* zl, Number* zu, Index m, bool init_lambda,
                          Number* lambda) override {
    std::copy(x0_.begin(), x0_.end(), x);
    for (Index i = 0; init_z && i < n; ++i) {
      const double multiplier = start_.x.empty() ? 0.0 : start_.x[i];
      zl[i] = std::max(0.0, -multiplier);
      zu[i] = std::max(0.0, multiplier);
    }
    for (Index i = 0; init_lambda && i < m; ++i) lambda[i] = start_.g.empty() ? 0.0 : start_.g[i];
    return true;
  }

  bool eval_f(Index, const Number* x, bool, Number& value) override {
    value = nlp_.f(x);
    return std::isfinite(value);
  }

  bool eval_grad_f(Index, const Number* x, bool, Number* out) override { return give(nlp_.gradient(x), out); }

  bool eval_g(Index, const Number* x, bool, Index, Number* out) override { return give(nlp_.g(x), out); }

  bool eval_jac_g(Index, const Number* x, bool, Index, Index, Index* row, Index* col, Number* values) override {
    if (values) return give(nlp_.jacobian(x), values);
    std::copy(nlp_.problem().jac_row.begin(), nlp_.problem().jac_row.end(), row);
    std::copy(nlp_.problem().jac_col.begin(), nlp_.problem().jac_col.end(), col);
    return true;
  }

  bool eval_h(Index, const Number* x, bool, Number sigma, Index, const Number* lambda, bool, Index, Index* row,
              Index* col, Number* values) override {
    if (values) return give(nlp_.hessian(x, sigma, lambda), values);
    std::copy(nlp_.problem().hess_row.begin(), nlp_.problem().hess_row.end(), row);
    std::copy(nlp_.problem().hess_col.begin(), nlp_.problem().hess_col.end(), col);
    return true;
  }

  bool intermediate_callback(Ipopt::AlgorithmMode mode, Index iteration, Number objective, Number primal, Number dual,
                             Number barrier, Number, Number regularization, Number, Number step, Index line_search,
                             const Ipopt::IpoptData* data, Ipopt::IpoptCalculatedQuantities* quantities) override {
    outcome.iterations = iteration;
    outcome.primal = primal;
    outcome.dual = dual;
    Iteration info{iteration, line_search, objective, primal, dual, barrier, step, regularization,
                   mode == Ipopt::RestorationPhaseMode};
    const Problem& p = nlp_.problem();
    const Unknowns unknowns = [&] {
      Reals x(p.n_x);
      const bool known = get_curr_iterate(data, quantities, false, p.n_x, x.data(), nullptr, nullptr, p.n_g, nullptr, nullptr);
      return known ? x : Reals();
    };
    if (!callback_ || callback_(info, unknowns)) return true;
    Reals x(p.n_x), zl(p.n_x), zu(p.n_x), g(p.n_g), lambda(p.n_g);
    taken_ = get_curr_iterate(data, quantities, false, p.n_x, x.data(), zl.data(), zu.data(), p.n_g, g.data(),
                              lambda.data());
    if (taken_) take(x.data(), zl.data(), zu.data(), lambda.data());
    return false;
  }

  void finalize_solution(Ipopt::SolverReturn status, Index, const Number* x, const Number* zl, const Number* zu, Index,
                         const Number*, const Number* lambda, Number, const Ipopt::IpoptData*,
                         Ipopt::IpoptCalculatedQuantities*) override {
    if (status == Ipopt::USER_REQUESTED_STOP && taken_) return;
    take(x, zl, zu, lambda);
  }

  Outcome outcome;

 private:
  static bool give(const Reals& values, Number* out) {
    std::copy(values.begin(), values.end(), out);
    return all_finite(values);
  }

  void take(const Number* x, const Number* zl, const Number* zu, const Number* lambda) {
    const int n = nlp_.problem().n_x;
    outcome.x.assign(x, x + n);
    outcome.lambda_g.assign(lambda, lambda + nlp_.problem().n_g);
    for (int i = 0; i < n; ++i) outcome.lambda_x[i] = zu[i] - zl[i];
  }

  Nlp& nlp_;
  const Reals& x0_;
  const Bounds& bounds_;
  const Callback& callback_;
  const Multipliers& start_;
  bool taken_ = false;  // the iterate was taken when the callback stopped the solver
};

bool set_option(Ipopt::OptionsList& list, const std::string& name, const Option& value) {
  if (const long* integer = std::get_if<long>(&value)) {
    const Index index = static_cast<Index>(*integer);
    return (index == *integer && list.SetIntegerValue(name, index, true, true)) ||
           list.SetNumericValue(name, static_cast<double>(*integer), true, true);
  }
  if (const double* number = std::get_if<double>(&value)) return list.SetNumericValue(name, *number, true, true);
  return list.SetStringValue(name, std::get<std::string>(value), true, true);
}

// Fills in IPOPT's own unscaled measures of the last iterate, where it got so far.
void take_statistics(Outcome& outcome, Ipopt::IpoptApplication& application) {
  const Ipopt::SmartPtr<Ipopt::SolveStatistics> statistics = application.Statistics();
  if (Ipopt::IsNull(statistics)) return;
  Number bounds = 0, total = 0;
  statistics->Infeasibilities(outcome.dual, outcome.primal, bounds, outcome.complementarity, total);
  outcome.iterations = statistics->IterationCount();
}

}  // namespace

Outcome solve_ipopt(Nlp& nlp, const Reals& x0, const Bounds& bounds, const Options& options, const Callback& callback,
                    const Multipliers& multipliers, const Indices& stage) {
  use_one_blas_thread();
  nlp.reset_timings();
  const auto start = std::chrono::steady_clock::now();
  Ipopt::SmartPtr<Ipopt::IpoptApplication> application = new Ipopt::IpoptApplication(false, false);
  Options chosen{{"print_level", 0L}, {"sb", std::string("yes")}};
  if (!multipliers.g.empty() || !multipliers.x.empty()) chosen["warm_start_init_point"] = std::string("yes");
  for (const auto& [name, value] : options) chosen[name] = value;
  for (const auto& [name, value] : chosen)
    if (!set_option(*application->Options(), name, value))
      throw std::invalid_argument("option '" + name + "' is unknown or its value is not allowed");
  Ipopt::SmartPtr<Adapter> adapter = new Adapter(nlp, x0, bounds, callback, multipliers);
  Ipopt::ApplicationReturnStatus status = application->Initialize("");
  if (status == Ipopt::Solve_Succeeded && stage.empty()) {
    status = application->OptimizeTNLP(adapter);
  } else if (status == Ipopt::Solve_Succeeded) {
    Ipopt::SmartPtr<Ipopt::AlgorithmBuilder> builder =
        stage_builder(stage, bounds, nlp.problem().threads, adapter->outcome.kkt);
    const Ipopt::SmartPtr<const Ipopt::Journalist> journalist = GetRawPtr(application->Jnlst());
    status = application->OptimizeNLP(new Ipopt::TNLPAdapter(GetRawPtr(adapter), journalist), builder);
  }
  Outcome outcome = std::move(adapter->outcome);
  outcome.status = status_name(status);
  take_statistics(outcome, *application);
  complete(outcome, nlp, bounds, start);
  return outcome;
}

}  // namespace trajopt
