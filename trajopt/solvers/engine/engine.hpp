// A sparse NLP made of small functions evaluated at many stages; see docs/architecture.md.
#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "tape.hpp"
#include "team.hpp"

namespace trajopt {

using Reals = std::vector<double>;
using Indices = std::vector<int>;

// Rows of entries (index, coefficient).
struct Csr {
  Indices indptr, index;
  Reals coefficient;
  int rows() const { return static_cast<int>(indptr.size()) - 1; }
};

// One point function at the same place of n stages.
struct Group {
  std::shared_ptr<const Tape> value, first, second;
  int n_local = 0, n_stages = 0, n_p = 0, n_phi = 0;
  Indices x_offset;        // (n_stages)
  Csr gather;              // z = gather * window
  Reals p;                 // (n_stages, n_p)
  Reals cost_weight;       // (n_stages)
  Indices row;             // (n_stages, n_phi)
  Reals row_scale;         // (n_phi)
  Csr jacobian, hessian;   // targets from nonzeros of the function's derivatives
  Indices jacobian_target, hessian_target;  // (n_stages, targets)
};

struct Problem {
  int n_x = 0, n_g = 0, threads = 1;
  Csr linear;
  Indices jac_row, jac_col, hess_row, hess_col;
  Reals jac_constant;
  std::vector<Group> groups;
};

// What may change in a group without its structure.
struct GroupNumbers {
  Reals gather, p, cost_weight, jacobian, hessian;
};

// Where a function value or derivative is not finite.
struct NonFinite {
  int group, stage, index;
  std::string output;
};

struct Timing {
  double seconds = 0;
  int count = 0;
  void add(std::chrono::steady_clock::time_point start) {
    seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
};

// Evaluates f, g and their derivatives; each distinct x is evaluated once per kind. Several threads may use it at
// once: one evaluates, the others wait.
class Nlp {
 public:
  explicit Nlp(Problem problem);

  double f(const double* x);
  Reals g(const double* x);
  Reals gradient(const double* x);
  Reals jacobian(const double* x);
  Reals hessian(const double* x, double sigma, const double* lambda);
  std::optional<NonFinite> first_nonfinite(const double* x);

  const Problem& problem() const { return problem_; }
  // Other numbers at the same places: of the maps and functions of a group, and of the linear rows. Throws
  // std::invalid_argument for other sizes.
  void set_group(int group, GroupNumbers numbers);
  void set_linear(Reals coefficient, Reals jac_constant);
  void reset_timings();
  double function_seconds() const;
  Timing timing(int kind) const;

 private:
  enum Kind { kValue = 0, kFirst = 1, kSecond = 2 };

  // Stages of one group in consecutive lanes of a batch.
  struct Part {
    int group, lane, n;
    int stage[kLanes];
    std::size_t entries;  // where those of the derivative begin
  };

  // Points at which one tape is run at once.
  struct Batch {
    const Tape* tape;
    std::vector<Part> parts;
  };

  // Outputs of a group's function at all its stages, contiguous.
  struct Outputs {
    Indices size, offset;
    int width = 0;
    Reals data;
    bool has(int output) const { return size[output] > 0; }
    double* at(int stage, int output) {
      return data.data() + static_cast<std::size_t>(stage) * width + offset[output];
    }
  };

  void prepare(Kind kind);
  void add_batches(Kind kind, const Tape* tape, const std::vector<int>& groups);
  void run(Kind kind, const double* x, double sigma, const double* lambda);
  void run_batch(Kind kind, const Batch& batch, Lanes* work, const double* x, double sigma, const double* lambda);
  void set_inputs(Kind kind, const Part& part, Lanes* work, const double* x, double sigma, const double* lambda) const;
  void keep_outputs(Kind kind, const Part& part, const Tape& tape, const Lanes* work);
  std::optional<NonFinite> nonfinite_output(Kind kind);
  bool same_point(Kind kind, const double* x);
  void update_value(const double* x);
  void update_first(const double* x);
  void scatter_rows(Outputs& outputs, const Group& group);
  void scatter_gradient(Outputs& outputs, const Group& group);
  void scatter_entries(Kind kind, Reals& out) const;

  using Lock = std::lock_guard<std::mutex>;

  Problem problem_;
  mutable std::mutex mutex_;  // of all below
  Team team_;
  std::vector<Batch> batches_[3];
  std::vector<Outputs> outputs_[3];       // of each group
  std::vector<Lanes> entries_[3];         // of the Jacobian and the Hessian, targets of one part after the other
  std::vector<std::vector<Lanes>> work_;  // of each thread
  std::atomic<std::size_t> next_{0};      // batch that no thread has begun
  bool keep_all_ = false;                 // outputs besides those that are added up stage by stage
  Reals seen_[2];
  bool valid_[2] = {false, false};
  double f_ = 0;
  Reals g_, gradient_, jacobian_, hessian_;
  Timing timings_[3];
};

}  // namespace trajopt
