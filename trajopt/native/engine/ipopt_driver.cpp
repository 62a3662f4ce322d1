#include <IpIpoptApplication.hpp>
#include <IpIpoptCalculatedQuantities.hpp>
#include <IpIpoptData.hpp>
#include <IpTNLP.hpp>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "solve.hpp"

namespace trajopt {

namespace {

using Ipopt::Index;
using Ipopt::Number;

bool finite(const Reals& values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

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
  Adapter(Nlp& nlp, const Reals& x0, const Bounds& bounds, const Callback& callback, const Reals& lambda0)
      : nlp_(nlp), x0_(x0), bounds_(bounds), callback_(callback), lambda0_(lambda0) {
    outcome.x = x0;
    outcome.lambda_g.assign(nlp.problem().n_g, 0.0);
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
    if (init_z) {
      std::fill(zl, zl + n, 0.0);
      std::fill(zu, zu + n, 0.0);
    }
    if (init_lambda && static_cast<Index>(lambda0_.size()) == m) std::copy(lambda0_.begin(), lambda0_.end(), lambda);
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
    if (!callback_ || callback_(info)) return true;
    const Problem& p = nlp_.problem();
    Reals z(p.n_x), g(p.n_g);
    get_curr_iterate(data, quantities, false, p.n_x, outcome.x.data(), z.data(), z.data(), p.n_g, g.data(),
                     outcome.lambda_g.data());
    return false;
  }

  void finalize_solution(Ipopt::SolverReturn status, Index n, const Number* x, const Number*, const Number*, Index m,
                         const Number*, const Number* lambda, Number, const Ipopt::IpoptData*,
                         Ipopt::IpoptCalculatedQuantities*) override {
    if (status == Ipopt::USER_REQUESTED_STOP) return;  // the iterate was taken when it was stopped
    outcome.x.assign(x, x + n);
    outcome.lambda_g.assign(lambda, lambda + m);
  }

  Outcome outcome;

 private:
  static bool give(const Reals& values, Number* out) {
    std::copy(values.begin(), values.end(), out);
    return finite(values);
  }

  Nlp& nlp_;
  const Reals& x0_;
  const Bounds& bounds_;
  const Callback& callback_;
  const Reals& lambda0_;
};

bool set_option(Ipopt::OptionsList& list, const std::string& name, const Option& value) {
  if (const long* integer = std::get_if<long>(&value)) {
    const Ipopt::Index index = static_cast<Ipopt::Index>(*integer);
    return list.SetIntegerValue(name, index, true, true) ||
           list.SetNumericValue(name, static_cast<double>(*integer), true, true);
  }
  if (const double* number = std::get_if<double>(&value)) return list.SetNumericValue(name, *number, true, true);
  return list.SetStringValue(name, std::get<std::string>(value), true, true);
}

}  // namespace

Outcome solve_ipopt(Nlp& nlp, const Reals& x0, const Bounds& bounds, const Options& options, const Callback& callback,
                    const Reals& lambda0) {
  nlp.reset_timings();
  Ipopt::SmartPtr<Ipopt::IpoptApplication> application = new Ipopt::IpoptApplication(false, false);
  for (const auto& [name, value] : options)
    if (!set_option(*application->Options(), name, value))
      throw std::invalid_argument("option '" + name + "' is unknown or its value is not allowed");
  Ipopt::SmartPtr<Adapter> adapter = new Adapter(nlp, x0, bounds, callback, lambda0);
  const auto start = std::chrono::steady_clock::now();
  Ipopt::ApplicationReturnStatus status = application->Initialize("");
  if (status == Ipopt::Solve_Succeeded) status = application->OptimizeTNLP(adapter);
  Outcome outcome = std::move(adapter->outcome);
  outcome.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.function_seconds = nlp.function_seconds();
  outcome.status = status_name(status);
  outcome.objective = nlp.f(outcome.x.data());
  return outcome;
}

}  // namespace trajopt
