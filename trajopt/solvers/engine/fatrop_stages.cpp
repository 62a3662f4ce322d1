#include "fatrop_stages.hpp"

#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "require.hpp"

namespace trajopt {

namespace {

constexpr double kInfinite = 1e19;  // IPOPT's convention: a bound of this size is none

double open_if_infinite(double bound) {
  return std::abs(bound) < kInfinite ? bound : std::copysign(std::numeric_limits<double>::infinity(), bound);
}

void check_sizes(const Problem& problem, const Stages& stages) {
  const std::size_t n = stages.n_state.size();
  require(n > 0 && stages.n_control.size() == n && stages.n_path.size() == n,
          "structure: nx, nu and ng need one entry a stage each");
  int unknowns = 0, rows = 0;
  for (std::size_t k = 0; k < n; ++k) {
    require(stages.n_state[k] >= 0 && stages.n_control[k] >= 0 && stages.n_path[k] >= 0,
            "structure: a size of stage " + std::to_string(k) + " is negative");
    unknowns += stages.n_state[k] + stages.n_control[k];
    rows += stages.n_path[k] + (k > 0 ? stages.n_state[k] : 0);
  }
  require(unknowns == problem.n_x, "structure: the stages have " + std::to_string(unknowns) +
                                       " unknowns, the NLP has " + std::to_string(problem.n_x));
  require(rows == problem.n_g, "structure: the stages have " + std::to_string(rows) + " rows, the NLP has " +
                                   std::to_string(problem.n_g));
}

StageDims make_dims(const Stages& stages, const Indices& n_equality, const Indices& n_inequality) {
  return StageDims(static_cast<int>(stages.n_state.size()), stages.n_control, stages.n_state, n_equality,
                   n_inequality);
}

}  // namespace

void read_multipliers(const std::vector<Link>& links, const double* from, Reals& out) {
  for (const Link& link : links) out[link.index] = link.sign * from[link.position];
}

StageMap::StageMap(const Problem& problem, const Stages& stages, const Bounds& bounds)
    : StageMap(problem, stages, bounds, assign_roles(problem, stages, bounds)) {}

StageMap::StageMap(const Problem& problem, const Stages& stages, const Bounds& bounds, const Roles& roles)
    : dims(make_dims(stages, roles.n_equality, roles.n_inequality)), info(dims) {
  lower.resize(info.number_of_slack_variables);
  upper.resize(info.number_of_slack_variables);
  place_unknowns(stages);
  link(roles.row, bounds.lower_g, bounds.upper_g, from_rows);
  link(roles.unknown, bounds.lower_x, bounds.upper_x, from_unknowns);
  place_jacobian(problem, roles);
  place_hessian(problem);
  place_bounds(roles);
}

StageMap::Role StageMap::role_of(double lower, double upper, int stage, Roles& roles, const std::string& what) {
  lower = open_if_infinite(lower);
  upper = open_if_infinite(upper);
  require(lower <= upper, what + ": its lower bound is above its upper bound");
  if (lower == upper) return {Kind::kEquality, stage, roles.n_equality[stage]++};
  if (std::isinf(lower) && std::isinf(upper)) return {Kind::kFree, stage, 0};
  return {Kind::kInequality, stage, roles.n_inequality[stage]++};
}

StageMap::Roles StageMap::assign_roles(const Problem& problem, const Stages& stages, const Bounds& bounds) {
  check_sizes(problem, stages);
  const int n_stages = static_cast<int>(stages.n_state.size());
  Roles roles{{}, {}, Indices(n_stages, 0), Indices(n_stages, 0)};
  for (int k = 0, row = 0, unknown = 0; k < n_stages; ++k) {
    for (int j = 0; k + 1 < n_stages && j < stages.n_state[k + 1]; ++j, ++row) {
      require(bounds.lower_g[row] == bounds.upper_g[row],
              "row " + std::to_string(row) + " closes a gap: its bounds must be equal");
      roles.row.push_back({Kind::kGap, k, j});
    }
    for (int j = 0; j < stages.n_path[k]; ++j, ++row)
      roles.row.push_back(role_of(bounds.lower_g[row], bounds.upper_g[row], k, roles, "row " + std::to_string(row)));
    for (int j = 0; j < stages.n_state[k] + stages.n_control[k]; ++j, ++unknown)
      roles.unknown.push_back(role_of(bounds.lower_x[unknown], bounds.upper_x[unknown], k, roles,
                                      "unknown " + std::to_string(unknown)));
  }
  return roles;
}

void StageMap::place_unknowns(const Stages& stages) {
  for (int k = 0; k < dims.K; ++k) {
    const int nx = stages.n_state[k], nu = stages.n_control[k];
    for (int j = 0; j < nx + nu; ++j) {
      const int column = j < nx ? nu + j : j - nx;
      stage_of_.push_back(k);
      column_of_.push_back(column);
      position.push_back(j < nx ? info.offsets_primal_x[k] + j : info.offsets_primal_u[k] + j - nx);
    }
  }
}

void StageMap::link(const std::vector<Role>& roles, const Reals& low, const Reals& high, std::vector<Link>& links) {
  for (int index = 0; index < static_cast<int>(roles.size()); ++index) {
    const auto [kind, k, place] = roles[index];
    if (kind == Kind::kGap) links.push_back({index, info.offsets_g_eq_dyn[k] + place, -1.0, low[index]});
    if (kind == Kind::kEquality) links.push_back({index, info.offsets_g_eq_path[k] + place, 1.0, low[index]});
    if (kind != Kind::kInequality) continue;
    links.push_back({index, info.offsets_g_eq_slack[k] + place, 1.0, 0.0});
    lower[info.offsets_slack[k] + place] = open_if_infinite(low[index]);
    upper[info.offsets_slack[k] + place] = open_if_infinite(high[index]);
  }
}

void StageMap::place_jacobian(const Problem& problem, const Roles& roles) {
  for (int e = 0; e < static_cast<int>(problem.jac_row.size()); ++e) {
    const Role& role = roles.row[problem.jac_row[e]];
    const int unknown = problem.jac_col[e], k = stage_of_[unknown], column = column_of_[unknown];
    const Entry entry{e, role.stage, column, role.place};
    const bool next_state = role.kind == Kind::kGap && k == role.stage + 1 &&
                            column == dims.number_of_controls[k] + role.place;
    if (next_state) identity.push_back(entry);
    if (next_state || role.kind == Kind::kFree) continue;
    require(k == role.stage, "row " + std::to_string(problem.jac_row[e]) + " of stage " +
                                 std::to_string(role.stage) + " depends on unknown " + std::to_string(unknown) +
                                 " of stage " + std::to_string(k));
    (role.kind == Kind::kGap ? dynamics : role.kind == Kind::kEquality ? equality : inequality).push_back(entry);
  }
  const int gaps = std::accumulate(dims.number_of_states.begin() + 1, dims.number_of_states.end(), 0);
  require(static_cast<int>(identity.size()) == gaps, "a gap row has not its one nonzero in the next state");
}

void StageMap::place_hessian(const Problem& problem) {
  for (int e = 0; e < static_cast<int>(problem.hess_row.size()); ++e) {
    const int i = problem.hess_row[e], j = problem.hess_col[e], k = stage_of_[i];
    require(k == stage_of_[j], "the Hessian couples unknowns " + std::to_string(i) + " and " + std::to_string(j) +
                                   " of two stages");
    hessian.push_back({e, k, column_of_[i], column_of_[j]});
    if (i != j) hessian.push_back({e, k, column_of_[j], column_of_[i]});
  }
}

void StageMap::place_bounds(const Roles& roles) {
  for (int unknown = 0; unknown < static_cast<int>(roles.unknown.size()); ++unknown) {
    const auto [kind, k, place] = roles.unknown[unknown];
    if (kind == Kind::kEquality) unit_equality.push_back({-1, k, column_of_[unknown], place});
    if (kind == Kind::kInequality) unit_inequality.push_back({-1, k, column_of_[unknown], place});
  }
}

}  // namespace trajopt
