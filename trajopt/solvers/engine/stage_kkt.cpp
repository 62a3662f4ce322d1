#include "stage_kkt.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

namespace trajopt {

namespace {

// Part of the largest entry of its row below which a pivot is rounding.
constexpr double kRounding = 1e-14;
// Least part of its column's entries that a pivot has, at first and at most.
constexpr double kThreshold = 1e-4, kMostThreshold = 1e-1;

double sum(const std::vector<std::int64_t>& sources, const double* values) {
  double total = 0;
  for (const std::int64_t source : sources) total += values[source];
  return total;
}

}  // namespace

StageKkt::StageKkt(const KktSizes& sizes, const std::vector<int>& stage, const std::vector<KktEntry>& entries,
                   int threads)
    : structure_(sizes, stage, entries),
      factors_(structure_.fronts.size()),
      blocks_(sizes.n_unequal),
      slacks_(structure_.alone.size()),
      team_(structure_.independent ? std::min(threads, 2) : 1),
      works_(team_.size()),
      threshold_(kThreshold) {}

bool StageKkt::raise_threshold() {
  if (threshold_ >= kMostThreshold) return false;
  threshold_ = std::min(kMostThreshold, std::pow(threshold_, 0.75));
  return true;
}

// Calls task(first, end, work) for the fronts of the later and of the earlier nodes, which may run at once.
template <class Task>
void StageKkt::for_halves(const Task& task) {
  const int half = structure_.half, last = structure_.last();
  if (team_.size() == 1) {
    task(0, half, works_[0]);
    task(half, last, works_[0]);
  } else {
    team_.run([&](int thread) { thread ? task(half, last, works_[1]) : task(0, half, works_[0]); });
  }
}

bool StageKkt::factorize(const double* values) {
  values_ = values;
  if (!read_rows()) return false;
  std::atomic<bool> regular = true;
  auto eliminate_fronts = [&](int first, int end, Work& work) {
    for (int f = first; f < end && regular; ++f)
      if (!eliminate_front(f, work)) regular = false;
  };
  for_halves(eliminate_fronts);
  eliminate_fronts(structure_.last(), structure_.last() + 1, works_[0]);
  if (!regular) return false;
  for (const Factor& own : factors_) negative_ += own.pivots.negative;
  return true;
}

// The blocks of slacks and multipliers, from which variables that are alone have been eliminated.
bool StageKkt::read_rows() {
  negative_ = structure_.sizes.n_unequal;  // one of each slack and its multiplier
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    const Inequality& own = structure_.inequalities[i];
    blocks_[i] = {sum(own.s, values_), sum(own.d, values_), sum(own.link, values_)};
  }
  for (std::size_t i = 0; i < slacks_.size(); ++i) {
    const Alone& own = structure_.alone[i];
    const int row = own.multiplier - structure_.sizes.inequality();
    slacks_[i] = {sum(own.curvature, values_), sum(own.coefficient, values_)};
    if (slacks_[i].curvature == 0) return false;
    negative_ += slacks_[i].curvature < 0;
    if (row >= 0) blocks_[row].d += slacks_[i].schur();
  }
  return true;
}

// False where the matrix is found to be singular.
bool StageKkt::eliminate_front(int f, Work& work) {
  Factor& own = factors_[f];
  assemble(f, work);
  find_least(f, work);
  eliminate(work.matrix.data(), own.n, work.ld, own.candidates, own.least.data(), threshold_, own.pivots);
  store(f, work);
  return !own.pivots.singular && (structure_.fronts[f].parent >= 0 || own.n_left() == 0);
}

void StageKkt::assemble(int f, Work& work) {
  const Front& front = structure_.fronts[f];
  Factor& own = factors_[f];
  own.late.clear();
  for (const int child : front.children) {
    const Factor& other = factors_[child];
    own.late.insert(own.late.end(), other.unknowns.begin() + other.pivots.count,
                    other.unknowns.begin() + other.candidates);
  }
  const int shift = static_cast<int>(own.late.size());
  own.candidates = shift + static_cast<int>(front.own.size());
  own.n = own.candidates + static_cast<int>(front.border.size());
  work.ld = own.n + kPadding;
  work.matrix.resize(std::max(work.matrix.size(), static_cast<std::size_t>(work.ld) * (own.n + 1)));
  for (int j = 0; j < own.n; ++j) {
    double* column = work.matrix.data() + static_cast<std::size_t>(j) * work.ld;
    std::fill(column + j, column + work.ld, 0.0);
  }
  for (const KktEntry& entry : front.entries)
    work.matrix[static_cast<std::size_t>(entry.column + shift) * work.ld + entry.row + shift] += values_[entry.source];
  for (const auto& [i, place] : front.alone)
    work.matrix[static_cast<std::size_t>(place + shift) * (work.ld + 1)] += slacks_[i].schur();
  condense(f, work);
  add_children(f, work);
}

// Adds weight J^T J of its inequalities.
void StageKkt::condense(int f, Work& work) const {
  const Front& front = structure_.fronts[f];
  const std::size_t shift = factors_[f].late.size(), ld = work.ld;
  double* matrix = work.matrix.data() + shift * (ld + 1);
  for (const int row : front.inequalities) {
    const std::vector<Term>& terms = structure_.condensed[row];
    const double weight = blocks_[row].weight();
    if (weight == 0) continue;
    for (const Term& one : terms)
      for (const Term& other : terms)
        if (other.variable >= one.variable)
          matrix[one.variable * ld + other.variable] += weight * values_[one.source] * values_[other.source];
  }
  for (const RowGroup& group : front.groups) {
    const std::size_t size = group.places.size(), ldg = size + kPadding, depth = group.rows.size();
    work.left.assign(ldg * depth, 0.0);
    work.right.assign(ldg * depth, 0.0);
    work.product.assign(ldg * (size + 1), 0.0);
    for (std::size_t i = 0; i < depth; ++i) {
      const double weight = blocks_[group.rows[i]].weight();
      if (weight == 0) continue;
      for (const Term& term : structure_.condensed[group.rows[i]]) {
        work.left[i * ldg + term.variable] += values_[term.source];
        work.right[i * ldg + term.variable] -= weight * values_[term.source];
      }
    }
    const int n = static_cast<int>(size), stride = static_cast<int>(ldg);
    subtract_product(work.product.data(), stride, work.left.data(), stride, work.right.data(), stride, n, n,
                     static_cast<int>(depth));
    for (std::size_t j = 0; j < size; ++j) {
      const double* from = work.product.data() + j * ldg;
      double* to = matrix + group.places[j] * ld;
      for (std::size_t i = j; i < size; ++i) to[group.places[i]] += from[i];
    }
  }
}

// Adds what children have left: Schur complements of their borders, and of unknowns without a pivot.
void StageKkt::add_children(int f, Work& work) const {
  const int n_late = static_cast<int>(factors_[f].late.size());
  int first = 0;
  for (const int child : structure_.fronts[f].children) {
    const Factor& own = factors_[child];
    const std::vector<int>& to_parent = structure_.fronts[child].to_parent;
    const int n_left = own.n_left(), n = own.n - own.pivots.count;
    auto target = [&](int i) { return i < n_left ? first + i : n_late + to_parent[i - n_left]; };
    const double* from = own.schur.data();
    for (int j = 0; j < n; ++j) {
      double* to = work.matrix.data() + static_cast<std::size_t>(target(j)) * work.ld;
      for (int i = j; i < n_left; ++i) to[first + i] += *from++;
      for (int i = std::max(j, n_left); i < n; ++i) to[n_late + to_parent[i - n_left]] += *from++;
    }
    first += n_left;
  }
}

// Unknowns that are late keep what counts as zero in the front that they come from.
void StageKkt::find_least(int f, const Work& work) {
  Factor& own = factors_[f];
  own.least.assign(own.n + kPadding, 0.0);
  row_magnitudes(work.matrix.data(), own.n, work.ld, own.candidates, own.least.data());
  for (double& least : own.least) least *= kRounding;
  std::size_t i = 0;
  for (const int child : structure_.fronts[f].children) {
    const Factor& other = factors_[child];
    for (int k = other.pivots.count; k < other.candidates; ++k) own.least[i++] = other.least[other.pivots.order[k]];
  }
}

void StageKkt::store(int f, const Work& work) {
  const Front& front = structure_.fronts[f];
  Factor& own = factors_[f];
  const int n_late = static_cast<int>(own.late.size()), count = own.pivots.count;
  own.unknowns.clear();
  for (const int at : own.pivots.order) own.unknowns.push_back(at < n_late ? own.late[at] : front.own[at - n_late]);
  own.unknowns.insert(own.unknowns.end(), front.border.begin(), front.border.end());
  auto pack = [&](std::vector<double>& to, int first, int end, int below) {
    to.clear();
    for (int j = first; j < end; ++j) {
      const double* column = work.matrix.data() + static_cast<std::size_t>(j) * work.ld;
      to.insert(to.end(), column + j + below, column + own.n);
    }
  };
  pack(own.l, 0, count, 1);
  own.l.resize(own.l.size() + kPadding);
  pack(own.schur, count, own.n, 0);
  own.carry.resize(own.n - count);
}

double StageKkt::factor_operations() const {
  auto whole = [](double n) { return (n - 1) * n * (n + 1) / 3; };  // of all n pivots: the sum of k (k - 1)
  double count = 0;
  for (const Factor& own : factors_) count += whole(own.n) - whole(own.n - own.pivots.count);
  for (const Inequality& own : structure_.inequalities)
    count += static_cast<double>(own.terms.size()) * (own.terms.size() + 1);
  return count;
}

double StageKkt::solve_operations() const {
  double count = 0;
  for (const Factor& own : factors_) count += own.pivots.count * (4.0 * own.n - 2.0 * own.pivots.count - 1);
  for (const Inequality& own : structure_.inequalities) count += 4.0 * own.terms.size();
  return count;
}

void StageKkt::solve(double* rhs) {
  const KktSizes& sizes = structure_.sizes;
  double *slack = rhs + sizes.slack(), *dual = rhs + sizes.inequality();
  for (std::size_t i = 0; i < slacks_.size(); ++i)
    if (const Alone& own = structure_.alone[i]; own.multiplier >= 0)
      rhs[own.multiplier] -= slacks_[i].coefficient / slacks_[i].curvature * rhs[own.variable];
  for (int i = 0; i < sizes.n_unequal; ++i) {
    const Block& own = blocks_[i];
    const double known = (own.s * dual[i] - own.link * slack[i]) / own.determinant();  // the multiplier at J x = 0
    for (const Term& term : structure_.inequalities[i].terms) rhs[term.variable] -= known * values_[term.source];
  }
  for_halves([&](int first, int end, Work& work) {
    for (int f = first; f < end; ++f) forward(f, rhs, work);
  });
  forward(structure_.last(), rhs, works_[0]);
  backward(structure_.last(), rhs, works_[0]);
  for_halves([&](int first, int end, Work& work) {
    for (int f = end; f-- > first;) backward(f, rhs, work);
  });
  for (int i = 0; i < sizes.n_unequal; ++i) {
    const Block& own = blocks_[i];
    double left = dual[i];
    for (const Term& term : structure_.inequalities[i].terms) left -= values_[term.source] * rhs[term.variable];
    const double first = slack[i], determinant = own.determinant();
    slack[i] = (own.d * first - own.link * left) / determinant;
    dual[i] = (own.s * left - own.link * first) / determinant;
  }
  for (std::size_t i = 0; i < slacks_.size(); ++i) {
    const Alone& own = structure_.alone[i];
    const double known = own.multiplier >= 0 ? slacks_[i].coefficient * rhs[own.multiplier] : 0.0;
    rhs[own.variable] = (rhs[own.variable] - known) / slacks_[i].curvature;
  }
}

void StageKkt::forward(int f, double* rhs, Work& work) {
  const Front& front = structure_.fronts[f];
  Factor& own = factors_[f];
  const int n_late = static_cast<int>(own.late.size()), count = own.pivots.count;
  // in the order of the assembly first, where the children's parts belong
  std::vector<double>&before = work.left, &z = work.z;
  before.assign(own.n, 0.0);
  for (int i = n_late; i < own.candidates; ++i) before[i] = rhs[front.own[i - n_late]];
  int first = 0;
  for (const int child : front.children) {
    const Factor& other = factors_[child];
    const std::vector<int>& to_parent = structure_.fronts[child].to_parent;
    const int n_left = other.n_left();
    for (int i = 0; i < n_left; ++i) before[first + i] += other.carry[i];
    for (std::size_t i = 0; i < to_parent.size(); ++i) before[n_late + to_parent[i]] += other.carry[n_left + i];
    first += n_left;
  }
  z.assign(own.n + kPadding, 0.0);
  for (int i = 0; i < own.candidates; ++i) z[i] = before[own.pivots.order[i]];
  std::copy(before.begin() + own.candidates, before.end(), z.begin() + own.candidates);
  substitute_forward(own.l.data(), own.n, own.pivots, z.data());
  for (int i = 0; i < count; ++i) rhs[own.unknowns[i]] = z[i];
  std::copy(z.begin() + count, z.begin() + own.n, own.carry.begin());
}

void StageKkt::backward(int f, double* rhs, Work& work) const {
  const Factor& own = factors_[f];
  std::vector<double>& z = work.z;
  z.assign(own.n + kPadding, 0.0);
  for (int i = 0; i < own.n; ++i) z[i] = rhs[own.unknowns[i]];
  substitute_backward(own.l.data(), own.n, own.pivots, z.data());
  for (int i = 0; i < own.pivots.count; ++i) rhs[own.unknowns[i]] = z[i];
}

}  // namespace trajopt
