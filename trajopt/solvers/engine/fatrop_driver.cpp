#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>

#include "fatrop_adapter.hpp"
#include "fatrop_algorithm.hpp"

namespace trajopt {

namespace {

using Clock = std::chrono::steady_clock;
using fatrop::Index;
using fatrop::OcpType;
using fatrop::Scalar;
using Data = fatrop::IpData<OcpType>;

constexpr const char* kInvalidNumber = "InvalidNumber";

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

// Removes an option of ours, a positive number, from FATROP's.
double take_number(Options& options, const std::string& name, double otherwise) {
  const auto found = options.find(name);
  if (found == options.end()) return otherwise;
  const Option value = found->second;
  options.erase(found);
  const long* integer = std::get_if<long>(&value);
  const double* real = std::get_if<double>(&value);
  const double number = integer ? static_cast<double>(*integer) : real ? *real : 0.0;
  if (!(number > 0)) throw std::invalid_argument("the value of option '" + name + "' is not allowed");
  return number;
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

bool finite_at(trajopt::Nlp& nlp, const double* x) {
  return std::isfinite(nlp.f(x)) && all_finite(nlp.g(x)) && all_finite(nlp.gradient(x)) && all_finite(nlp.jacobian(x));
}

double dual_infeasibility(fatrop::IpIterate<OcpType>& iterate) {
  return std::max(iterate.dual_infeasibility_x_inf(), iterate.dual_infeasibility_s_inf());
}

Iteration describe(Data& data, bool restoration, double scale) {
  auto& iterate = data.current_iterate();
  const auto& step = iterate.step_info();
  return {data.iteration_number(), step.ls_iter + 1, iterate.obj_value() / scale, iterate.constr_viol_inf(),
          dual_infeasibility(iterate) / scale, iterate.mu() / scale, step.alpha_primal, step.inertia_correction_primal, restoration};
}

void require_identity(const StageMap& map, const Reals& jacobian) {
  constexpr double kRounding = 1e-9;  // the identity results from divisions by scales
  for (const Entry& e : map.identity)
    if (std::abs(jacobian[e.nonzero] - 1.0) > kRounding)
      throw std::invalid_argument("gap row " + std::to_string(e.column) + " of stage " + std::to_string(e.stage) +
                                  " is not x_next - F(x, u): its slope in x_next is " +
                                  std::to_string(jacobian[e.nonzero]));
}

void set_multipliers(const StageMap& map, const Reals& lambda, double scale, Data& data) {
  fatrop::VecRealAllocated dual(map.info.number_of_eq_constraints);
  for (const Link& link : map.from_rows) dual(link.position) = scale * link.sign * lambda[link.index];
  data.current_iterate().set_dual_eq(dual);
}

// FATROP's algorithm on the NLP, built and with its options set.
class Run {
 public:
  Run(trajopt::Nlp& nlp, const StageMap& map, const Reals& x0, double scale, const Options& options)
      : map_(map), scale_(scale), adapter_(std::make_shared<FatropAdapter>(nlp, map, x0)) {
    const FatropAlgorithm built = build_fatrop(adapter_, registry_, [adapter = adapter_.get()] { adapter->look(); });
    algorithm_ = built.algorithm;
    data_ = built.data;
    adapter_->objective_scale = scale;
    for (const auto& [name, value] : options) set_option(registry_, name, value);
  }

  std::string optimize(const Callback& callback, const Reals& lambda_g, Clock::time_point deadline) {
    int reported = -1;
    const Unknowns unknowns = [&] { return this->unknowns(); };
    adapter_->tick = [&](bool restoration) {
      if (reported < 0 && !lambda_g.empty()) set_multipliers(map_, lambda_g, scale_, *data_);
      reported = data_->iteration_number();
      if (callback && !callback(describe(*data_, restoration, scale_), unknowns)) throw Stop{"UserRequestedStop"};
    };
    adapter_->look = [deadline] {
      if (Clock::now() > deadline) throw Stop{"MaxWallTimeExceeded"};
    };
    const std::string status = run();
    adapter_->tick = nullptr;
    adapter_->look = nullptr;
    // FATROP calls back before every step, not after the last.
    if (callback && reported != data_->iteration_number()) callback(describe(*data_, false, scale_), unknowns);
    return status;
  }

  void take_iterate(Outcome& outcome) {
    auto& iterate = data_->current_iterate();
    outcome.x = unknowns();
    read_multipliers(map_.from_rows, iterate.dual_eq().data(), outcome.lambda_g);
    read_multipliers(map_.from_unknowns, iterate.dual_eq().data(), outcome.lambda_x);
    for (Reals* multipliers : {&outcome.lambda_g, &outcome.lambda_x})
      for (double& value : *multipliers) value /= scale_;
    outcome.primal = iterate.constr_viol_inf();
    outcome.dual = dual_infeasibility(iterate) / scale_;
    const double mismatch = std::max(norm_inf(iterate.complementarity_l()), norm_inf(iterate.complementarity_u()));
    outcome.complementarity = mismatch / scale_;
    outcome.iterations = data_->iteration_number();
  }

 private:
  Reals unknowns() {
    const double* x = adapter_->unknowns(data_->current_iterate().primal_x());
    return Reals(x, x + map_.position.size());
  }

  std::string run() {
    std::string status;
    try {
      status = flag_name(algorithm_->optimize());
    } catch (const Stop& stop) {
      if (stop.status != kNoStep) return stop.status;
      status = kNoStep;
    } catch (const FatropException&) {  // an assertion in its restoration phase or linear algebra
      status = kNoStep;
    }
    return status == "Success" || adapter_->finite_derivatives ? status : kInvalidNumber;
  }

  const StageMap& map_;
  const double scale_;  // of the objective, hence of all multipliers
  std::shared_ptr<FatropAdapter> adapter_;
  fatrop::OptionRegistry registry_;
  std::shared_ptr<fatrop::IpAlgorithm<OcpType>> algorithm_;
  std::shared_ptr<Data> data_;
};

}  // namespace

Outcome solve_fatrop(trajopt::Nlp& nlp, const Stages& stages, const Reals& x0, const Bounds& bounds,
                     const Options& options, const Callback& callback, const Reals& lambda_g) {
  use_one_blas_thread();
  nlp.reset_timings();
  const auto start = Clock::now();
  const StageMap map(nlp.problem(), stages, bounds);
  require_identity(map, nlp.jacobian(x0.data()));
  const Silence silence;
  Options own = options;
  const double max_wall_time = std::min(take_number(own, "max_wall_time", HUGE_VAL), 1e9);  // s; what a clock can count
  const double scale = take_number(own, "objective_scale", 1.0);
  const std::chrono::duration<double> allowed(max_wall_time);
  const auto deadline = start + std::chrono::duration_cast<Clock::duration>(allowed);
  Run run(nlp, map, x0, scale, own);
  Outcome outcome;
  outcome.x = x0;
  outcome.lambda_g.resize(nlp.problem().n_g);
  outcome.lambda_x.resize(nlp.problem().n_x);
  outcome.status = kInvalidNumber;
  if (finite_at(nlp, x0.data())) {
    outcome.status = run.optimize(callback, lambda_g, deadline);
    run.take_iterate(outcome);
  }
  complete(outcome, nlp, bounds, start);
  return outcome;
}

}  // namespace trajopt
