#include "read.hpp"

#include <nanobind/stl/string.h>

#include <algorithm>
#include <stdexcept>

namespace nb = nanobind;

namespace trajopt {

namespace {

template <class Map>
nb::object item(const Map& given, const char* name) {
  require(given.contains(name), std::string("the engine needs '") + name + "'");
  return nb::borrow<nb::object>(given[name]);
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
              csr.indptr.back() == static_cast<int>(csr.index.size()) && csr.index.size() == csr.coefficient.size(),
          "'" + name + "' does not fit its indices and data");
  require_range(csr.index, columns, index);
  return csr;
}

Source read_source(const nb::dict& given, const char* name) {
  const nb::object value = item(given, name);
  Source source;
  if (nb::isinstance<nb::str>(value)) {
    source.text = nb::cast<std::string>(value);
  } else {
    const nb::tuple pair = nb::cast<nb::tuple>(value);
    require(pair.size() == 2, std::string("'") + name + "' must be a text or (library, name)");
    source.library = nb::cast<std::string>(pair[0]);
    source.name = nb::cast<std::string>(pair[1]);
  }
  return source;
}

void check_functions(const Group& group) {
  const casadi::Function first = group.first.load(), second = group.second.load();
  require(first.n_in() == 2 && first.n_out() == 4 && second.n_in() == 4 && second.n_out() == 1,
          "a group's functions have wrong numbers of inputs or outputs");
  require(first.nnz_in(0) == group.gather.rows(), "'gather' does not fit the function's first input");
  require(first.nnz_in(1) == group.n_p, "'p' does not fit the function's second input");
  require(first.nnz_out(1) == group.n_phi, "'row' does not fit the function's rows");
  require_range(group.jacobian.index, static_cast<int>(first.nnz_out(3)), "jac_src");
  require_range(group.hessian.index, static_cast<int>(second.nnz_out(0)), "hess_src");
}

Group read_group(const nb::dict& given, const Problem& problem) {
  Group group;
  group.value = read_source(given, "value");
  group.first = read_source(given, "first");
  group.second = read_source(given, "second");
  group.n_local = nb::cast<int>(item(given, "nloc"));
  group.x_offset = values<IndexArray>(given, "x_offset");
  group.n_stages = static_cast<int>(group.x_offset.size());
  require(group.n_stages > 0, "a group needs a stage");
  require_range(group.x_offset, problem.n_x - group.n_local + 1, "x_offset");
  group.gather = read_csr(given, "gather_indptr", "gather_indices", "gather_data", group.n_local);
  group.p = values<RealArray>(given, "p");
  group.n_p = static_cast<int>(group.p.size()) / group.n_stages;
  group.cost_weight = values<RealArray>(given, "cost_weight");
  require(static_cast<int>(group.cost_weight.size()) == group.n_stages, "'cost_weight' needs one entry a stage");
  group.row_scale = values<RealArray>(given, "row_scale");
  group.n_phi = static_cast<int>(group.row_scale.size());
  group.row = values<IndexArray>(given, "row");
  require(static_cast<int>(group.row.size()) == group.n_stages * group.n_phi, "'row' needs (stages, rows) entries");
  require_range(group.row, problem.n_g, "row");
  constexpr int kAny = 1 << 30;  // bounded by the functions' own sizes below
  group.jacobian = read_csr(given, "jac_indptr", "jac_src", "jac_coef", kAny);
  group.hessian = read_csr(given, "hess_indptr", "hess_src", "hess_coef", kAny);
  group.jacobian_target = values<IndexArray>(given, "jac_target");
  group.hessian_target = values<IndexArray>(given, "hess_target");
  require(static_cast<int>(group.jacobian_target.size()) == group.n_stages * group.jacobian.rows(),
          "'jac_target' needs (stages, targets) entries");
  require(static_cast<int>(group.hessian_target.size()) == group.n_stages * group.hessian.rows(),
          "'hess_target' needs (stages, targets) entries");
  require_range(group.jacobian_target, static_cast<int>(problem.jac_row.size()), "jac_target");
  require_range(group.hessian_target, static_cast<int>(problem.hess_row.size()), "hess_target");
  check_functions(group);
  return group;
}

}  // namespace

void require(bool condition, const std::string& message) {
  if (!condition) throw std::invalid_argument(message);
}

Reals reals(const RealArray& array) { return Reals(array.data(), array.data() + array.size()); }

Indices indices(const IndexArray& array) { return Indices(array.data(), array.data() + array.size()); }

Problem read_problem(const nb::kwargs& given) {
  Problem problem;
  problem.n_x = nb::cast<int>(item(given, "n_x"));
  problem.n_g = nb::cast<int>(item(given, "n_g"));
  problem.threads = nb::cast<int>(item(given, "threads"));
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
  for (nb::handle group : nb::cast<nb::list>(item(given, "groups")))
    problem.groups.push_back(read_group(nb::cast<nb::dict>(group), problem));
  return problem;
}

}  // namespace trajopt
