// KKT systems of NLPs in stages: inequality rows are condensed into the Hessian, then each stage and each node is
// eliminated in a front of its own by dense LDL^T, children first (Duff and Reid, "The multifrontal solution of
// indefinite sparse symmetric linear equations", ACM TOMS 9, 1983). Pivots are of one stage or one node; those
// that are zero there are left to the parent's front.
#pragma once

#include <cstdint>
#include <vector>

#include "ldlt.hpp"

namespace trajopt {

// Unknowns in IPOPT's order: variables, slacks of inequalities, multipliers of equalities and of inequalities.
struct KktSizes {
  int n_x = 0, n_equal = 0, n_unequal = 0;
  int slack() const { return n_x; }
  int equality() const { return n_x + n_unequal; }
  int inequality() const { return n_x + n_unequal + n_equal; }
  int all() const { return n_x + 2 * n_unequal + n_equal; }
};

// An entry of either triangle; entries at one place add up.
struct KktEntry {
  std::int64_t source;  // place of its value
  int row, column;
};

class StageKkt {
 public:
  // stage: of each variable, k for one of node k, -1 - k for one of stage k, between nodes k and k + 1. Throws
  // std::invalid_argument for entries that a KKT system does not have.
  StageKkt(const KktSizes& sizes, const std::vector<int>& stage, const std::vector<KktEntry>& entries);

  // Values of the entries, which must stay where they are for `solve`. False for a matrix that is singular.
  bool factorize(const double* values);
  void solve(double* rhs) const;
  // Pivots of at least a larger part of the entries of their columns; false where that is as large as is useful.
  bool raise_threshold();
  int negative_eigenvalues() const { return negative_; }

 private:
  struct Term {
    std::int64_t source;
    int variable;
  };
  // The block [[s, link], [link, d]] of a slack and its multiplier, and the row's entries.
  struct Inequality {
    std::vector<std::int64_t> s_sources, d_sources, link_sources;
    std::vector<Term> terms;
    int front = 0;  // of its first variable to be eliminated
    double s = 0, d = 0, link = 0;
    double determinant() const { return s * d - link * link; }
  };
  // Terms of an inequality at places of its front.
  struct Condensed {
    int inequality;
    std::vector<Term> terms;
  };
  struct Front {
    std::vector<int> own, border;         // unknowns that are eliminated here, and that these are coupled with
    std::vector<KktEntry> entries;        // at places of the front, on or below the diagonal
    std::vector<Condensed> inequalities;
    std::vector<int> children, to_parent;  // places of the border in the parent
    std::vector<int> late;                // unknowns left by the children, before its own
    bool is_root = true;
    int n = 0, ld = 0;
    std::vector<double> matrix;
    Pivots pivots;
    std::vector<int> unknowns;            // at the places of the matrix after the elimination
    int initially(int place) const {  // the unknown at this place, if the children leave none
      const int n_own = static_cast<int>(own.size());
      return place < n_own ? own[place] : border[place - n_own];
    }
    int candidates() const { return static_cast<int>(late.size() + own.size()); }
  };

  void sort(const std::vector<KktEntry>& entries, std::vector<KktEntry>& coupled);
  std::vector<int> fronts_of(const std::vector<int>& stage, const std::vector<KktEntry>& coupled) const;
  void find_borders(const std::vector<int>& front, const std::vector<KktEntry>& coupled);
  void place_entries(const std::vector<int>& front, const std::vector<KktEntry>& coupled);
  void find_least();
  void assemble(Front& front);
  void condense(Front& front) const;
  void add_children(Front& front) const;

  KktSizes sizes_;
  int n_stages_ = 0;
  std::vector<Front> fronts_;
  std::vector<Inequality> inequalities_;
  const double* values_ = nullptr;
  double threshold_;
  std::vector<double> least_, floor_;  // pivots that count as zero: of all unknowns, and of a front's candidates
  int negative_ = 0;
};

}  // namespace trajopt
