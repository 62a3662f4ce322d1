// Where variables, rows and nonzeros of the sparse NLP lie in FATROP's stages.
#pragma once

// FATROP's classes carry no visibility of their own; hidden ones would not be the library's.
#pragma GCC visibility push(default)
#include <fatrop/ocp/dims.hpp>
#include <fatrop/ocp/problem_info.hpp>
#include <fatrop/ocp/type.hpp>
#pragma GCC visibility pop

#include "solve.hpp"

namespace trajopt {

using StageDims = fatrop::ProblemDims<fatrop::OcpType>;
using StageInfo = fatrop::ProblemInfo<fatrop::OcpType>;

// Entry (row, column) of the matrix of a stage, from a nonzero of the NLP.
struct Entry {
  int nonzero, stage, row, column;
};

// FATROP's constraint at `position` is sign * (value[index] - constant); so are the multipliers related.
struct Link {
  int index, position;
  double sign, constant;
};

// Multipliers of the NLP from FATROP's.
void read_multipliers(const std::vector<Link>& links, const double* from, Reals& out);

// FATROP orders a stage's variables controls first, and needs for each stage: dynamics F(x, u) - x_next,
// equalities, inequalities; bounds on variables are rows like the others.
class StageMap {
 public:
  // Throws std::invalid_argument where the NLP does not have the stages' structure.
  StageMap(const Problem& problem, const Stages& stages, const Bounds& bounds);

  StageDims dims;
  StageInfo info;
  Indices position;                                    // of every variable
  std::vector<Link> from_rows, from_unknowns;          // constraints
  std::vector<Entry> dynamics, equality, inequality;   // from nonzeros of the Jacobian, transposed
  std::vector<Entry> identity;                         // nonzeros that must be 1, nowhere stored
  std::vector<Entry> unit_equality, unit_inequality;   // bounds on variables, transposed
  std::vector<Entry> hessian;                          // both triangles
  Reals lower, upper;                                  // of the inequalities, FATROP's order

 private:
  enum class Kind { kGap, kEquality, kInequality, kFree };

  // What a row, or the bounds of an unknown, is: the place among its kind in the stage.
  struct Role {
    Kind kind;
    int stage, place;
  };

  struct Roles {
    std::vector<Role> unknown, row;
    Indices n_equality, n_inequality;
  };

  StageMap(const Problem& problem, const Stages& stages, const Bounds& bounds, const Roles& roles);

  static Roles assign_roles(const Problem& problem, const Stages& stages, const Bounds& bounds);
  static Role role_of(double lower, double upper, int stage, Roles& roles, const std::string& what);
  void place_unknowns(const Stages& stages);
  void link(const std::vector<Role>& roles, const Reals& lower, const Reals& upper, std::vector<Link>& links);
  void place_jacobian(const Problem& problem, const Roles& roles);
  void place_hessian(const Problem& problem);
  void place_bounds(const Roles& roles);

  Indices stage_of_, column_of_;  // of every variable: its stage, its column there
};

}  // namespace trajopt
