// Fronts of a KKT system in stages: which unknowns are eliminated together, and where its entries go.
#pragma once

#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

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

// An entry of a row: a variable, or its place in a front.
struct Term {
  std::int64_t source;
  int variable;
};

// An inequality: sources of the block [[s, link], [link, d]] of its slack and multiplier, and the row's entries.
struct Inequality {
  std::vector<std::int64_t> s, d, link;
  std::vector<Term> terms;
  int front = -1;  // of its first variable to be eliminated
};

// Instead of a stage, of a variable that is in one row only, with positive curvature of its own: a slack.
constexpr int kAlone = std::numeric_limits<int>::min();

// Such a variable: sources of its curvature and of its coefficient in the row of this multiplier.
struct Alone {
  int variable, multiplier = -1;
  std::vector<std::int64_t> curvature, coefficient;
};

// Inequalities with many entries in nearly the same columns, which are condensed by one product of matrices.
struct RowGroup {
  std::vector<int> rows, places;  // places of the front, ascending
};

struct Front {
  std::vector<int> own, border;    // unknowns that are eliminated here, and that these are coupled with
  std::vector<KktEntry> entries;   // at places of the front, on or below the diagonal
  std::vector<int> inequalities;   // condensed here one by one, their terms at places of the front
  std::vector<RowGroup> groups;    // condensed here together, their terms at places of the group
  std::vector<std::pair<int, int>> alone;  // those of its equalities, and the places of the multipliers
  std::vector<int> children;
  int parent = -1;
  std::vector<int> to_parent;      // places of the border in the parent
};

// Each stage and each node has a front. Nodes are eliminated from both ends to the one in the middle, each after
// its stage; children come before their parents.
class StageFronts {
 public:
  // stage: of each variable, k for one of node k, -1 - k for one of stage k, between nodes k and k + 1, or kAlone.
  // Throws std::invalid_argument for entries that a KKT system does not have.
  StageFronts(const KktSizes& sizes, const std::vector<int>& stage, const std::vector<KktEntry>& entries);

  KktSizes sizes;
  std::vector<Front> fronts;
  std::vector<Inequality> inequalities;  // variables of their terms are those of the system
  std::vector<Alone> alone;
  std::vector<std::vector<Term>> condensed;  // the same terms at places of their fronts, or of their groups
  int half = 0;                // fronts of the later nodes come first: [0, half), then [half, last)
  bool independent = true;     // no front of one half has its parent in the other
  int last() const { return static_cast<int>(fronts.size()) - 1; }

 private:
  int of_stage(int k) const { return k >= middle_ ? 2 * (n_stages_ - 1 - k) : half + 2 * k; }
  int of_node(int k) const { return k == middle_ ? last() : (k > middle_ ? of_stage(k - 1) : of_stage(k)) + 1; }
  void sort(const std::vector<int>& stage, const std::vector<KktEntry>& entries, std::vector<KktEntry>& coupled);
  void add_to_alone(Alone& own, const KktEntry& entry);
  std::vector<int> assign(const std::vector<int>& stage, const std::vector<KktEntry>& coupled) const;
  void find_borders(const std::vector<int>& front, const std::vector<KktEntry>& coupled);
  void place_entries(const std::vector<int>& front, const std::vector<KktEntry>& coupled);
  void group_rows(Front& own);

  int n_stages_ = 0, middle_ = 0;
};

}  // namespace trajopt
