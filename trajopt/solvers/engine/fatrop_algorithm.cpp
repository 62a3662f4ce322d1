#pragma GCC visibility push(default)
#include <fatrop/fatrop.hpp>
#include <fatrop/common/printing.hpp>
#include <fatrop/ip_algorithm/ip_convergence_check.hpp>
#include <fatrop/ip_algorithm/ip_convergence_check_resto.hpp>
#include <fatrop/ip_algorithm/ip_eq_mult_initializer.hpp>
#include <fatrop/ip_algorithm/ip_initializer.hpp>
#include <fatrop/ip_algorithm/ip_initializer_resto.hpp>
#include <fatrop/ip_algorithm/ip_iteration_output.hpp>
#include <fatrop/ip_algorithm/ip_iteration_output_resto.hpp>
#include <fatrop/ip_algorithm/ip_linesearch.hpp>
#include <fatrop/ip_algorithm/ip_mu_update.hpp>
#include <fatrop/ip_algorithm/ip_nlp_orig.hpp>
#include <fatrop/ip_algorithm/ip_nlp_resto.hpp>
#include <fatrop/ip_algorithm/ip_resto_phase_min_cl1.hpp>
#include <fatrop/ocp/aug_system_solver.hpp>
#include <fatrop/ocp/pd_solver_orig.hpp>
#include <fatrop/ocp/pd_solver_resto.hpp>
#include <fatrop/ocp/pd_system_orig.hpp>
#include <fatrop/ocp/pd_system_resto.hpp>
#pragma GCC visibility pop

#include "fatrop_algorithm.hpp"

namespace trajopt {

namespace {

using Ocp = fatrop::OcpType;
using Algorithm = fatrop::IpAlgorithm<Ocp>;
using Data = fatrop::IpData<Ocp>;
using Solver = fatrop::PdSolverOrig<Ocp>;
using RestorationSolver = fatrop::PdSolverResto<Ocp>;

// Shared by the algorithm and its restoration phase.
struct Parts {
  fatrop::OptionRegistry& registry;
  const std::function<void()>& look;
  std::shared_ptr<fatrop::IpNlpOrig<Ocp>> nlp;
  std::shared_ptr<Data> data;
  std::shared_ptr<Solver> solver;

  // A part with its options registered.
  template <class Part, class... Arguments>
  std::shared_ptr<Part> make(Arguments&&... arguments) const {
    auto part = std::make_shared<Part>(std::forward<Arguments>(arguments)...);
    part->register_options(registry);
    return part;
  }
};

struct Restoration {
  std::shared_ptr<fatrop::IpRestoPhaseBase> phase;
  std::shared_ptr<fatrop::IpConvergenceCheckResto<Ocp>> check;
};

Restoration build_restoration(const Parts& parts, const fatrop::ProblemInfo<Ocp>& info) {
  const auto nlp = parts.make<fatrop::IpNlpResto<Ocp>>(parts.nlp);
  const auto data = parts.make<Data>(nlp);
  const auto solver = std::make_shared<RestorationSolver>(info, parts.solver);
  const auto search = parts.make<SearchDirection<RestorationSolver>>(data, solver, parts.look);
  const auto line_search = parts.make<fatrop::IpLinesearch<RestorationSolver, Ocp>>(data, solver, nullptr);
  const auto check = parts.make<fatrop::IpConvergenceCheckResto<Ocp>>(parts.data, data);
  const auto barrier = parts.make<fatrop::IpMonotoneMuUpdate<Ocp>>(data, line_search);
  const auto multipliers = parts.make<fatrop::IpEqMultInitializer<Ocp>>(data, parts.solver);
  const auto start = parts.make<fatrop::IpInitializerResto<Ocp>>(parts.data, data);
  const auto output = parts.make<fatrop::IpIterationOutputResto<Ocp>>(parts.data, data);
  const auto algorithm =
      std::make_shared<Algorithm>(search, line_search, start, barrier, multipliers, check, output, data);
  return {parts.make<fatrop::IpRestoPhaseMinCl1<Ocp>>(algorithm, multipliers, parts.data, data, nlp), check};
}

}  // namespace

FatropAlgorithm build_fatrop(const std::shared_ptr<fatrop::Nlp<Ocp>>& given, fatrop::OptionRegistry& registry,
                             const std::function<void()>& look) {
  const auto nlp = std::make_shared<fatrop::IpNlpOrig<Ocp>>(given);
  const auto data = std::make_shared<Data>(nlp);
  data->register_options(registry);
  const fatrop::ProblemInfo<Ocp>& info = data->info();
  const auto linear_algebra = std::make_shared<fatrop::AugSystemSolver<Ocp>>(info);
  linear_algebra->register_options(registry);
  const Parts parts{registry, look, nlp, data, std::make_shared<Solver>(info, linear_algebra)};
  const auto search = parts.make<SearchDirection<Solver>>(data, parts.solver, look);
  const Restoration restoration = build_restoration(parts, info);
  const auto line_search = parts.make<fatrop::IpLinesearch<Solver, Ocp>>(data, parts.solver, restoration.phase);
  const auto multipliers = parts.make<fatrop::IpEqMultInitializer<Ocp>>(data, parts.solver);
  const auto start = parts.make<fatrop::IpInitializer<Ocp>>(data, multipliers);
  const auto barrier = parts.make<fatrop::IpMonotoneMuUpdate<Ocp>>(data, line_search);
  const auto check = parts.make<fatrop::IpConvergenceCheck<Ocp>>(data);
  const auto output = std::make_shared<fatrop::IpIterationOutput<Ocp>>(data);
  nlp->set_timing_statistics(&data->timing_statistics());
  restoration.check->set_line_search_orig(line_search);
  registry.register_option<fatrop::Index>("print_level", [](const fatrop::Index& level) {
    fatrop::PrintLevelManager::set_print_level(level);
  });
  return {data, std::make_shared<Algorithm>(search, line_search, start, barrier, multipliers, check, output, data)};
}

}  // namespace trajopt
