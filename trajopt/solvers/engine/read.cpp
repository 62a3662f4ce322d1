#include "read.hpp"

#include <nanobind/stl/shared_ptr.h>

#include <algorithm>
#include <memory>
#include <stdexcept>

namespace nb = nanobind;

namespace trajopt {

namespace {

constexpr int kMost = 1 << 30;

template <class Map>
nb::object item(const Map& given, const char* name) {
  require(given.contains(name), std::string("the engine needs '") + name + "'");
  return nb::borrow<nb::object>(given[name]);
}

int whole(const nb::object& value, const char* name) {
  int result = 0;
  require(nb::try_cast(value, result), std::string("'") + name + "' must be an int");
  return result;
}

template <class Array, class Map>
auto values(const Map& given, const char* name) {
  Array array;
  require(nb::try_cast(item(given, name), array),
          std::string("'") + name + "' must be a contiguous array of float64 or int32");
  if constexpr (std::is_same_v<Array, RealArray>)
    return reals(array);
  else
    return indices(array);
}

void require_range(const Indices& index, int bound, const std::string& name) {
  require(std::all_of(index.begin(), index.end(), [bound](int i) { return 0 <= i && i < bound; }),
          "'" + name + "' has an index out of range 0 to " + std::to_string(bound - 1));
}

template <class Map>
Csr read_csr(const Map& given, const char* indptr, const char* index, const char* data, int columns) {
  Csr csr{values<IndexArray>(given, indptr), values<IndexArray>(given, index), values<RealArray>(given, data)};
  const std::string name = indptr;
  require(!csr.indptr.empty() && csr.indptr.front() == 0 && std::is_sorted(csr.indptr.begin(), csr.indptr.end()) &&
              static_cast<std::size_t>(csr.indptr.back()) == csr.index.size() && csr.index.size() == csr.coefficient.size(),
          "'" + name + "', '" + index + "' and '" + data + "' do not fit each other");
  require_range(csr.index, columns, index);
  return csr;
}

std::shared_ptr<const Tape> read_tape(const nb::dict& given, const char* name) {
  std::shared_ptr<Tape> tape;
  require(nb::try_cast(item(given, name), tape) && tape, std::string("'") + name + "' must be a Tape");
  return tape;
}

void require_sizes(const Tape& function, const char* name, const std::vector<int>& in,
                   const std::vector<int>& out) {
  const std::string which = std::string("'") + name + "' has ";
  require(function.n_in() == static_cast<int>(in.size()) && function.n_out() == static_cast<int>(out.size()),
          which + std::to_string(function.n_in()) + " inputs and " + std::to_string(function.n_out()) + " outputs");
  for (int i = 0; i < function.n_in(); ++i)
    require(function.size_in(i) == in[i], which + std::to_string(function.size_in(i)) + " values as input " +
                                             std::to_string(i) + ", the group gives " + std::to_string(in[i]));
  constexpr int kAny = -1;
  for (int i = 0; i < function.n_out(); ++i)
    require(out[i] == kAny || function.size_out(i) == out[i],
            which + std::to_string(function.size_out(i)) + " values as output " + std::to_string(i) +
                ", the group wants " + std::to_string(out[i]));
}

void check_functions(const Group& group) {
  const int nz = group.gather.rows(), np = group.n_p, n = group.n_phi;
  // A group may have no cost.
  const int cost = group.value->n_out() > 0 && group.value->size_out(0) == 0 ? 0 : 1;
  const int slope = group.first->n_out() > 2 && group.first->size_out(2) == 0 ? 0 : nz;
  require_sizes(*group.value, "value", {nz, np}, {cost, n});
  require_sizes(*group.first, "first", {nz, np}, {cost, n, slope, -1});
  require_sizes(*group.second, "second", {nz, np, 1, n}, {-1});
  require_range(group.jacobian.index, group.first->size_out(3), "jac_src");
  require_range(group.hessian.index, group.second->size_out(0), "hess_src");
}

// Where the group's functions are evaluated, with which parameters, and where their rows go.
void read_stages(const nb::dict& given, const Problem& problem, Group& group) {
  group.n_local = whole(item(given, "nloc"), "nloc");
  group.x_offset = values<IndexArray>(given, "x_offset");
  require(0 <= group.n_local && group.n_local <= problem.n_x, "'nloc' must be between 0 and n_x");
  require(!group.x_offset.empty() && group.x_offset.size() <= kMost, "a group needs a stage, and 2^30 at most");
  group.n_stages = static_cast<int>(group.x_offset.size());
  require_range(group.x_offset, problem.n_x - group.n_local + 1, "x_offset");
  group.gather = read_csr(given, "gather_indptr", "gather_indices", "gather_data", group.n_local);
  group.p = values<RealArray>(given, "p");
  group.n_p = static_cast<int>(group.p.size() / group.x_offset.size());
  require(group.p.size() < kMost && group.p.size() % group.x_offset.size() == 0, "'p' needs (stages, parameters) entries");
  group.cost_weight = values<RealArray>(given, "cost_weight");
  require(group.cost_weight.size() == group.x_offset.size(), "'cost_weight' needs one entry a stage");
  group.row_scale = values<RealArray>(given, "row_scale");
  group.n_phi = static_cast<int>(group.row_scale.size());
  group.row = values<IndexArray>(given, "row");
  require(group.row.size() == group.x_offset.size() * group.row_scale.size(),
          "'row' needs (stages, rows) entries, 'row_scale' one a row");
  require_range(group.row, problem.n_g, "row");
}

Group read_group(const nb::dict& given, const Problem& problem) {
  Group group;
  group.value = read_tape(given, "value");
  group.first = read_tape(given, "first");
  group.second = read_tape(given, "second");
  read_stages(given, problem, group);
  group.jacobian = read_csr(given, "jac_indptr", "jac_src", "jac_coef", kMost);  // see check_functions
  group.hessian = read_csr(given, "hess_indptr", "hess_src", "hess_coef", kMost);
  group.jacobian_target = values<IndexArray>(given, "jac_target");
  group.hessian_target = values<IndexArray>(given, "hess_target");
  require(group.jacobian_target.size() == group.x_offset.size() * group.jacobian.rows(),
          "'jac_target' needs (stages, targets) entries");
  require(group.hessian_target.size() == group.x_offset.size() * group.hessian.rows(),
          "'hess_target' needs (stages, targets) entries");
  require_range(group.jacobian_target, static_cast<int>(problem.jac_row.size()), "jac_target");
  require_range(group.hessian_target, static_cast<int>(problem.hess_row.size()), "hess_target");
  check_functions(group);
  return group;
}

void read_groups(const nb::kwargs& given, Problem& problem) {
  nb::list groups;
  require(nb::try_cast(item(given, "groups"), groups), "'groups' must be a list");
  for (std::size_t index = 0; index < groups.size(); ++index) {
    const std::string which = "group " + std::to_string(index) + ": ";
    nb::dict group;
    require(nb::try_cast(groups[index], group), which + "must be a dict");
    try {
      problem.groups.push_back(read_group(group, problem));
    } catch (const std::invalid_argument& error) {
      throw std::invalid_argument(which + error.what());
    }
  }
}

}  // namespace

Reals reals(const RealArray& array) { return Reals(array.data(), array.data() + array.size()); }

Indices indices(const IndexArray& array) { return Indices(array.data(), array.data() + array.size()); }

Problem read_problem(const nb::kwargs& given) {
  Problem problem;
  problem.n_x = whole(item(given, "n_x"), "n_x");
  problem.n_g = whole(item(given, "n_g"), "n_g");
  if (given.contains("threads")) problem.threads = whole(item(given, "threads"), "threads");
  require(problem.n_x > 0 && problem.n_g >= 0, "n_x must be positive and n_g not negative");
  require(problem.threads >= 1, "threads must be at least 1");
  problem.linear = read_csr(given, "a_indptr", "a_indices", "a_data", problem.n_x);
  require(problem.linear.rows() == problem.n_g, "'a_indptr' needs n_g + 1 entries");
  problem.jac_row = values<IndexArray>(given, "jac_row");
  problem.jac_col = values<IndexArray>(given, "jac_col");
  problem.jac_constant = values<RealArray>(given, "jac_const");
  require(problem.jac_row.size() == problem.jac_col.size() && problem.jac_row.size() == problem.jac_constant.size(),
          "'jac_row', 'jac_col' and 'jac_const' must have one length");
  require_range(problem.jac_row, problem.n_g, "jac_row");
  require_range(problem.jac_col, problem.n_x, "jac_col");
  problem.hess_row = values<IndexArray>(given, "hess_row");
  problem.hess_col = values<IndexArray>(given, "hess_col");
  require(problem.hess_row.size() == problem.hess_col.size(), "'hess_row' and 'hess_col' must have one length");
  require_range(problem.hess_row, problem.n_x, "hess_row");
  require_range(problem.hess_col, problem.n_x, "hess_col");
  for (std::size_t e = 0; e < problem.hess_row.size(); ++e)
    require(problem.hess_row[e] >= problem.hess_col[e], "'hess_row' and 'hess_col' must be a lower triangle");
  read_groups(given, problem);
  return problem;
}

}  // namespace trajopt
