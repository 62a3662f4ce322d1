// KKT systems of NLPs in stages: inequality rows are condensed into the Hessian, then each stage and each node is
// eliminated in a front of its own by dense LDL^T, children first (Duff and Reid, "The multifrontal solution of
// indefinite sparse symmetric linear equations", ACM TOMS 9, 1983). Pivots are of one front; unknowns whose pivots
// would be zero or small beside the rest of their columns are left to the parent's front.
#pragma once

#include <vector>

#include "ldlt.hpp"
#include "stage_fronts.hpp"
#include "team.hpp"

namespace trajopt {

class StageKkt {
 public:
  // As StageFronts. The factorisation is the same, bit by bit, with any number of threads.
  StageKkt(const KktSizes& sizes, const std::vector<int>& stage, const std::vector<KktEntry>& entries, int threads);

  // Values of the entries, which must stay where they are for `solve`. False for a matrix that is singular.
  bool factorize(const double* values);
  void solve(double* rhs);
  int negative_eigenvalues() const { return negative_; }
  // Multiplications and additions that the last factorisation needs, and a right side with it: of the entries on and below
  // the diagonal, without those that kernels make beyond them.
  double factor_operations() const;
  double solve_operations() const;
  // Pivots of at least a larger part of the entries of their columns; false where that is as large as is useful.
  bool raise_threshold();

 private:
  // What is left of a front after its elimination. Columns are packed: those of L without the diagonal, those of
  // the Schur complement with it.
  struct Factor {
    std::vector<int> late;        // unknowns left by the children; they come before the front's own
    std::vector<int> unknowns;    // at the places of the matrix after the elimination
    std::vector<double> least;    // pivots that count as zero, of all candidates
    std::vector<double> l, schur;
    std::vector<double> carry;    // of a right side, to the parent: of `unknowns` that are not eliminated here
    Pivots pivots;
    int n = 0;
    int candidates = 0;
    int n_left() const { return candidates - pivots.count; }
  };
  // Memory of one thread.
  struct Work {
    std::vector<double> matrix, left, right, product, z;
    int ld = 0;
  };
  // The block [[s, link], [link, d]] of a slack and its multiplier.
  struct Block {
    double s = 0, d = 0, link = 0;
    double determinant() const { return s * d - link * link; }
    double weight() const { return -s / determinant(); }  // of the row's square in the condensed Hessian
  };

  // Of a variable that is alone.
  struct Slack {
    double curvature = 1, coefficient = 0;
    double schur() const { return -coefficient * coefficient / curvature; }
  };

  bool read_rows();
  template <class Task>
  void for_halves(const Task& task);
  bool eliminate_front(int f, Work& work);
  void assemble(int f, Work& work);
  void condense(int f, Work& work) const;
  void add_children(int f, Work& work) const;
  void find_least(int f, const Work& work);
  void store(int f, const Work& work);
  void forward(int f, double* rhs, Work& work);
  void backward(int f, double* rhs, Work& work) const;

  StageFronts structure_;
  std::vector<Factor> factors_;
  std::vector<Block> blocks_;
  std::vector<Slack> slacks_;
  Team team_;
  std::vector<Work> works_;  // of each thread
  const double* values_ = nullptr;
  double threshold_;
  int negative_ = 0;
};

}  // namespace trajopt
