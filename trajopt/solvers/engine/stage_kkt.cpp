#include "stage_kkt.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include "require.hpp"

namespace trajopt {

namespace {

// Rows with more entries are condensed together, by a product of matrices.
constexpr int kFew = 12;
// Part of the largest entry of an unknown below which a pivot is rounding.
constexpr double kRounding = 1e-15;
// Least part of its column's entries that a pivot has, at first and at most.
constexpr double kThreshold = 1e-8, kMostThreshold = 1e-2;

double sum(const std::vector<std::int64_t>& sources, const double* values) {
  double total = 0;
  for (const std::int64_t source : sources) total += values[source];
  return total;
}

}  // namespace

StageKkt::StageKkt(const KktSizes& sizes, const std::vector<int>& stage, const std::vector<KktEntry>& entries)
    : sizes_(sizes), inequalities_(sizes.n_unequal), threshold_(kThreshold), least_(sizes.all()) {
  for (const int own : stage) n_stages_ = std::max(n_stages_, own < 0 ? -own : own);
  fronts_.resize(2 * n_stages_ + 1);
  std::vector<KktEntry> coupled;
  sort(entries, coupled);
  const std::vector<int> front = fronts_of(stage, coupled);
  find_borders(front, coupled);
  place_entries(front, coupled);
}

// Entries of inequalities go to these; the others couple variables and multipliers of equalities.
void StageKkt::sort(const std::vector<KktEntry>& entries, std::vector<KktEntry>& coupled) {
  for (const KktEntry& entry : entries) {
    const int i = std::max(entry.row, entry.column), j = std::min(entry.row, entry.column);
    require(j >= 0 && i < sizes_.all(), "an entry is outside of the system");
    if (i >= sizes_.inequality()) {
      const int row = i - sizes_.inequality();
      Inequality& own = inequalities_[row];
      require(j < sizes_.n_x || j == sizes_.slack() + row || j == i, "an inequality has an entry of another kind");
      if (j < sizes_.n_x)
        own.terms.push_back({entry.source, j});
      else
        (j < i ? own.link_sources : own.d_sources).push_back(entry.source);
    } else if (i >= sizes_.slack() && i < sizes_.equality()) {
      require(i == j, "a slack is coupled with a variable");
      inequalities_[i - sizes_.slack()].s_sources.push_back(entry.source);
    } else {
      require(j < sizes_.n_x || i == j, "a multiplier is coupled with another, or with a slack");
      coupled.push_back({entry.source, i, j});
    }
  }
}

// Fronts of stages come first, then those of nodes, the last node first. The multiplier of a row is eliminated
// with its stage if it couples that with the node at its start at most, with the later node if it joins two
// neighbours, and in the last front if it joins others, as in rows of a periodic motion.
std::vector<int> StageKkt::fronts_of(const std::vector<int>& stage, const std::vector<KktEntry>& coupled) const {
  const int last = 2 * n_stages_;
  auto of_node = [&](int node) { return last - node; };
  std::vector<int> front(sizes_.all(), -1);
  for (int i = 0; i < sizes_.n_x; ++i) front[i] = stage[i] < 0 ? -1 - stage[i] : of_node(stage[i]);
  std::vector<std::set<int>> stages(sizes_.n_equal), nodes(sizes_.n_equal);
  for (const KktEntry& entry : coupled) {
    if (entry.row < sizes_.equality() || entry.column >= sizes_.n_x) continue;
    const int row = entry.row - sizes_.equality(), own = stage[entry.column];
    if (own < 0)
      stages[row].insert(-1 - own);
    else
      nodes[row].insert(own);
  }
  for (int row = 0; row < sizes_.n_equal; ++row) {
    const std::set<int>&s = stages[row], &n = nodes[row];
    int own = last;
    if (s.size() == 1 && (n.empty() || (n.size() == 1 && *n.begin() == *s.begin())))
      own = *s.begin();
    else if (s.size() <= 1 && (n.size() == 1 || (n.size() == 2 && *n.rbegin() == *n.begin() + 1)))
      own = of_node(*n.rbegin());
    front[sizes_.equality() + row] = own;
  }
  return front;
}

// Unknowns of each front, those of later fronts that they are coupled with, and the front's parent: that of the
// first of these.
void StageKkt::find_borders(const std::vector<int>& front, const std::vector<KktEntry>& coupled) {
  const int n_fronts = static_cast<int>(fronts_.size());
  std::vector<int> place(front.size());
  for (std::size_t i = 0; i < front.size(); ++i) {
    if (front[i] < 0) continue;
    place[i] = static_cast<int>(fronts_[front[i]].own.size());
    fronts_[front[i]].own.push_back(static_cast<int>(i));
  }
  auto before = [&](int i, int j) { return front[i] != front[j] ? front[i] < front[j] : place[i] < place[j]; };
  std::vector<std::set<int>> border(fronts_.size());
  auto couple = [&](int i, int j) {
    if (front[i] != front[j]) border[std::min(front[i], front[j])].insert(front[i] < front[j] ? j : i);
  };
  for (const KktEntry& entry : coupled) couple(entry.row, entry.column);
  for (Inequality& own : inequalities_) {
    own.front = n_fronts;
    for (const Term& term : own.terms) own.front = std::min(own.front, front[term.variable]);
    for (const Term& term : own.terms)
      if (front[term.variable] != own.front) border[own.front].insert(term.variable);
  }
  for (std::size_t f = 0; f < fronts_.size(); ++f) {
    Front& own = fronts_[f];
    own.border.assign(border[f].begin(), border[f].end());
    if (own.border.empty()) continue;
    std::sort(own.border.begin(), own.border.end(), before);
    const int parent = front[own.border.front()];
    own.is_root = false;
    fronts_[parent].children.push_back(static_cast<int>(f));
    for (const int i : own.border)
      if (front[i] != parent) border[parent].insert(i);
  }
}

// Places of entries, of inequalities and of children's borders in the fronts.
void StageKkt::place_entries(const std::vector<int>& front, const std::vector<KktEntry>& coupled) {
  std::vector<std::vector<KktEntry>> entries(fronts_.size());
  for (const KktEntry& entry : coupled) entries[std::min(front[entry.row], front[entry.column])].push_back(entry);
  std::vector<std::vector<int>> rows(fronts_.size());
  for (int row = 0; row < sizes_.n_unequal; ++row)
    if (!inequalities_[row].terms.empty()) rows[inequalities_[row].front].push_back(row);
  std::vector<int> place(front.size());
  for (std::size_t f = 0; f < fronts_.size(); ++f) {
    Front& own = fronts_[f];
    int count = 0;
    for (const int i : own.own) place[i] = count++;
    for (const int i : own.border) place[i] = count++;
    for (const KktEntry& entry : entries[f]) {
      const int i = place[entry.row], j = place[entry.column];
      own.entries.push_back({entry.source, std::max(i, j), std::min(i, j)});
    }
    for (const int row : rows[f]) {
      Condensed condensed{row, inequalities_[row].terms};
      for (Term& term : condensed.terms) term.variable = place[term.variable];
      own.inequalities.push_back(std::move(condensed));
    }
    for (const int child : own.children)
      for (const int i : fronts_[child].border) fronts_[child].to_parent.push_back(place[i]);
  }
}

bool StageKkt::factorize(const double* values) {
  values_ = values;
  negative_ = sizes_.n_unequal;  // one of each slack and its multiplier
  for (Inequality& own : inequalities_) {
    own.s = sum(own.s_sources, values);
    own.d = sum(own.d_sources, values);
    own.link = sum(own.link_sources, values);
  }
  find_least();
  for (Front& front : fronts_) {
    assemble(front);
    std::vector<int>& unknowns = front.unknowns;
    unknowns = front.late;
    unknowns.insert(unknowns.end(), front.own.begin(), front.own.end());
    floor_.clear();
    for (const int i : unknowns) floor_.push_back(least_[i]);
    eliminate(front.matrix.data(), front.n, front.ld, front.candidates(), floor_.data(), threshold_, front.pivots);
    const std::vector<int> before = unknowns;
    for (std::size_t i = 0; i < before.size(); ++i) unknowns[i] = before[front.pivots.order[i]];
    unknowns.insert(unknowns.end(), front.border.begin(), front.border.end());
    negative_ += front.pivots.negative;
    if (front.is_root && front.pivots.count < front.candidates()) return false;
  }
  return true;
}

bool StageKkt::raise_threshold() {
  if (threshold_ >= kMostThreshold) return false;
  threshold_ = std::min(kMostThreshold, std::pow(threshold_, 0.75));
  return true;
}

void StageKkt::find_least() {
  std::fill(least_.begin(), least_.end(), 0.0);
  for (const Front& front : fronts_)
    for (const KktEntry& entry : front.entries) {
      const double size = kRounding * std::abs(values_[entry.source]);
      double &row = least_[front.initially(entry.row)], &column = least_[front.initially(entry.column)];
      row = std::max(row, size);
      column = std::max(column, size);
    }
}

void StageKkt::assemble(Front& front) {
  front.late.clear();
  for (const int child : front.children) {
    const Front& own = fronts_[child];
    for (int i = own.pivots.count; i < own.candidates(); ++i) front.late.push_back(own.unknowns[i]);
  }
  const int shift = static_cast<int>(front.late.size());
  front.n = front.candidates() + static_cast<int>(front.border.size());
  front.ld = front.n + kPadding;
  front.matrix.assign(static_cast<std::size_t>(front.ld) * (front.n + 1), 0.0);
  for (const KktEntry& entry : front.entries)
    front.matrix[static_cast<std::size_t>(entry.column + shift) * front.ld + entry.row + shift] +=
        values_[entry.source];
  condense(front);
  add_children(front);
}

// Adds weight J^T J of its inequalities.
void StageKkt::condense(Front& front) const {
  static thread_local std::vector<double> left, right;
  const int shift = static_cast<int>(front.late.size()), ld = front.ld;
  double* matrix = front.matrix.data();
  int many = 0;
  left.clear();
  right.clear();
  for (const Condensed& row : front.inequalities) {
    const Inequality& own = inequalities_[row.inequality];
    const double weight = -own.s / own.determinant();
    if (weight == 0) continue;
    if (row.terms.size() > kFew) {
      left.resize(static_cast<std::size_t>(ld) * ++many, 0.0);
      right.resize(left.size(), 0.0);
      const std::size_t column = left.size() - ld;
      for (const Term& term : row.terms) {
        left[column + term.variable + shift] += values_[term.source];
        right[column + term.variable + shift] -= weight * values_[term.source];
      }
      continue;
    }
    for (const Term& one : row.terms)
      for (const Term& other : row.terms)
        if (other.variable >= one.variable)
          matrix[static_cast<std::size_t>(one.variable + shift) * ld + other.variable + shift] +=
              weight * values_[one.source] * values_[other.source];
  }
  if (many) subtract_product(matrix, ld, left.data(), ld, right.data(), ld, front.n, front.n, many);
}

// Adds what children have left: Schur complements of their borders, and of unknowns without a pivot.
void StageKkt::add_children(Front& front) const {
  const int n_late = static_cast<int>(front.late.size());
  int first = 0;
  for (const int child : front.children) {
    const Front& own = fronts_[child];
    const int candidates = own.candidates(), count = own.pivots.count;
    auto target = [&](int i) { return i < candidates ? first + i - count : n_late + own.to_parent[i - candidates]; };
    for (int j = count; j < own.n; ++j) {
      double* to = front.matrix.data() + static_cast<std::size_t>(target(j)) * front.ld;
      const double* from = own.matrix.data() + static_cast<std::size_t>(j) * own.ld;
      for (int i = j; i < own.n; ++i) to[target(i)] += from[i];
    }
    first += candidates - count;
  }
}

void StageKkt::solve(double* rhs) const {
  double *slack = rhs + sizes_.slack(), *dual = rhs + sizes_.inequality();
  for (int i = 0; i < sizes_.n_unequal; ++i) {
    const Inequality& own = inequalities_[i];
    const double known = (own.s * dual[i] - own.link * slack[i]) / own.determinant();  // the multiplier at J x = 0
    for (const Term& term : own.terms) rhs[term.variable] -= known * values_[term.source];
  }
  static thread_local std::vector<double> z;
  auto gather = [&](const Front& front) {
    z.assign(front.n + kPadding, 0.0);
    for (int i = 0; i < front.n; ++i) z[i] = rhs[front.unknowns[i]];
  };
  for (const Front& front : fronts_) {
    gather(front);
    substitute_forward(front.matrix.data(), front.n, front.ld, front.pivots, z.data());
    for (int i = 0; i < front.n; ++i) rhs[front.unknowns[i]] = z[i];
  }
  for (auto front = fronts_.rbegin(); front != fronts_.rend(); ++front) {
    gather(*front);
    substitute_backward(front->matrix.data(), front->n, front->ld, front->pivots, z.data());
    for (int i = 0; i < front->pivots.count; ++i) rhs[front->unknowns[i]] = z[i];
  }
  for (int i = 0; i < sizes_.n_unequal; ++i) {
    const Inequality& own = inequalities_[i];
    double left = dual[i];
    for (const Term& term : own.terms) left -= values_[term.source] * rhs[term.variable];
    const double first = slack[i], determinant = own.determinant();
    slack[i] = (own.d * first - own.link * left) / determinant;
    dual[i] = (own.s * left - own.link * first) / determinant;
  }
}

}  // namespace trajopt
