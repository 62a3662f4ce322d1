#include "stage_fronts.hpp"

#include <algorithm>
#include <limits>

#include "require.hpp"

namespace trajopt {

namespace {

// Rows with more entries are condensed together, by a product of matrices.
constexpr std::size_t kFew = 12;
// Adding such a product to a front takes as long as this many rows of it.
constexpr double kScatter = 16;

struct Range {
  int first = std::numeric_limits<int>::max(), last = -1;
  void add(int i) {
    first = std::min(first, i);
    last = std::max(last, i);
  }
  int width() const { return std::max(last - first + 1, 0); }
};

}  // namespace

StageFronts::StageFronts(const KktSizes& sizes, const std::vector<int>& stage, const std::vector<KktEntry>& entries)
    : sizes(sizes), inequalities(sizes.n_unequal), condensed(sizes.n_unequal) {
  for (const int own : stage)
    if (own != kAlone) n_stages_ = std::max(n_stages_, own < 0 ? -own : own);
  middle_ = n_stages_ / 2;
  half = 2 * (n_stages_ - middle_);
  fronts.resize(2 * n_stages_ + 1);
  std::vector<KktEntry> coupled;
  sort(stage, entries, coupled);
  const std::vector<int> front = assign(stage, coupled);
  find_borders(front, coupled);
  place_entries(front, coupled);
}

// Entries of inequalities and of variables that are alone go to these; the others couple variables and multipliers
// of equalities.
void StageFronts::sort(const std::vector<int>& stage, const std::vector<KktEntry>& entries,
                       std::vector<KktEntry>& coupled) {
  std::vector<int> place(sizes.n_x, -1);
  for (int i = 0; i < sizes.n_x; ++i) {
    if (stage[i] != kAlone) continue;
    place[i] = static_cast<int>(alone.size());
    alone.push_back({i, -1, {}, {}});
  }
  for (const KktEntry& entry : entries) {
    const int i = std::max(entry.row, entry.column), j = std::min(entry.row, entry.column);
    require(j >= 0 && i < sizes.all(), "an entry is outside of the system");
    if (j < sizes.n_x && place[j] >= 0) {
      add_to_alone(alone[place[j]], {entry.source, i, j});
    } else if (i >= sizes.inequality()) {
      const int row = i - sizes.inequality();
      Inequality& own = inequalities[row];
      require(j < sizes.n_x || j == sizes.slack() + row || j == i, "an inequality has an entry of another kind");
      if (j < sizes.n_x)
        own.terms.push_back({entry.source, j});
      else
        (j < i ? own.link : own.d).push_back(entry.source);
    } else if (i >= sizes.slack() && i < sizes.equality()) {
      require(i == j, "a slack is coupled with a variable");
      inequalities[i - sizes.slack()].s.push_back(entry.source);
    } else {
      require(j < sizes.n_x || i == j, "a multiplier is coupled with another, or with a slack");
      require(i >= sizes.n_x || place[i] < 0, "a variable that is alone is coupled with another");
      coupled.push_back({entry.source, i, j});
    }
  }
}

void StageFronts::add_to_alone(Alone& own, const KktEntry& entry) {
  if (entry.row == entry.column) {
    own.curvature.push_back(entry.source);
    return;
  }
  require(entry.row >= sizes.equality(), "a variable that is alone is coupled with another");
  require(own.multiplier < 0 || own.multiplier == entry.row, "a variable that is alone is in two rows");
  own.multiplier = entry.row;
  own.coefficient.push_back(entry.source);
}

// The front of each unknown. The multiplier of a row is eliminated with its stage if it couples that with the node
// at its start at most, with the first node to be eliminated if it joins two neighbours, and in the last front if
// it joins others, as in rows of a periodic motion.
std::vector<int> StageFronts::assign(const std::vector<int>& stage, const std::vector<KktEntry>& coupled) const {
  std::vector<int> front(sizes.all(), -1);
  for (int i = 0; i < sizes.n_x; ++i)
    if (stage[i] != kAlone) front[i] = stage[i] < 0 ? of_stage(-1 - stage[i]) : of_node(stage[i]);
  std::vector<Range> stages(sizes.n_equal), nodes(sizes.n_equal);
  for (const KktEntry& entry : coupled) {
    if (entry.row < sizes.equality() || entry.column >= sizes.n_x) continue;
    const int row = entry.row - sizes.equality(), own = stage[entry.column];
    if (own < 0)
      stages[row].add(-1 - own);
    else
      nodes[row].add(own);
  }
  for (int row = 0; row < sizes.n_equal; ++row) {
    const Range &s = stages[row], &n = nodes[row];
    int own = last();
    if (s.width() == 1 && (n.width() == 0 || (n.width() == 1 && n.first == s.first)))
      own = of_stage(s.first);
    else if (s.width() <= 1 && (n.width() == 1 || n.width() == 2))
      own = std::min(of_node(n.first), of_node(n.last));
    front[sizes.equality() + row] = own;
  }
  return front;
}

// Unknowns of each front, those of later fronts that they are coupled with, and the front's parent: that of the
// first of these.
void StageFronts::find_borders(const std::vector<int>& front, const std::vector<KktEntry>& coupled) {
  std::vector<int> place(front.size()), seen(front.size(), -1);
  for (std::size_t i = 0; i < front.size(); ++i) {
    if (front[i] < 0) continue;
    place[i] = static_cast<int>(fronts[front[i]].own.size());
    fronts[front[i]].own.push_back(static_cast<int>(i));
  }
  auto before = [&](int i, int j) { return front[i] != front[j] ? front[i] < front[j] : place[i] < place[j]; };
  auto couple = [&](int i, int j) {
    if (front[i] != front[j]) fronts[std::min(front[i], front[j])].border.push_back(front[i] < front[j] ? j : i);
  };
  for (const KktEntry& entry : coupled) couple(entry.row, entry.column);
  for (Inequality& own : inequalities) {
    for (const Term& term : own.terms)
      if (own.front < 0 || front[term.variable] < own.front) own.front = front[term.variable];
    for (const Term& term : own.terms)
      if (front[term.variable] != own.front) fronts[own.front].border.push_back(term.variable);
  }
  for (std::size_t f = 0; f < fronts.size(); ++f) {
    Front& own = fronts[f];
    if (own.border.empty()) continue;
    auto repeated = [&](int i) { return std::exchange(seen[i], static_cast<int>(f)) == static_cast<int>(f); };
    own.border.erase(std::remove_if(own.border.begin(), own.border.end(), repeated), own.border.end());
    std::sort(own.border.begin(), own.border.end(), before);
    own.parent = front[own.border.front()];
    fronts[own.parent].children.push_back(static_cast<int>(f));
    if (static_cast<int>(f) < half && own.parent >= half && own.parent < last()) independent = false;
    for (const int i : own.border)
      if (front[i] != own.parent) fronts[own.parent].border.push_back(i);
  }
}

// Places of entries, of terms of inequalities and of children's borders in the fronts.
void StageFronts::place_entries(const std::vector<int>& front, const std::vector<KktEntry>& coupled) {
  std::vector<std::vector<KktEntry>> entries(fronts.size());
  for (const KktEntry& entry : coupled) entries[std::min(front[entry.row], front[entry.column])].push_back(entry);
  for (int row = 0; row < sizes.n_unequal; ++row)
    if (inequalities[row].front >= 0) fronts[inequalities[row].front].inequalities.push_back(row);
  std::vector<std::vector<int>> slacks(fronts.size());
  for (std::size_t i = 0; i < alone.size(); ++i)
    if (alone[i].multiplier >= 0 && alone[i].multiplier < sizes.inequality())
      slacks[front[alone[i].multiplier]].push_back(static_cast<int>(i));
  std::vector<int> place(front.size());
  for (std::size_t f = 0; f < fronts.size(); ++f) {
    Front& own = fronts[f];
    int count = 0;
    for (const int i : own.own) place[i] = count++;
    for (const int i : own.border) place[i] = count++;
    for (const KktEntry& entry : entries[f]) {
      const int i = place[entry.row], j = place[entry.column];
      own.entries.push_back({entry.source, std::max(i, j), std::min(i, j)});
    }
    for (const int i : slacks[f]) own.alone.push_back({i, place[alone[i].multiplier]});
    for (const int row : own.inequalities) {
      condensed[row] = inequalities[row].terms;
      for (Term& term : condensed[row]) term.variable = place[term.variable];
    }
    group_rows(own);
    for (const int child : own.children)
      for (const int i : fronts[child].border) fronts[child].to_parent.push_back(place[i]);
  }
}

// Takes rows with many entries from the front's inequalities into groups: each row to the one to whose product it
// adds least, which may be a new one.
void StageFronts::group_rows(Front& own) {
  const std::size_t size = own.own.size() + own.border.size();
  auto cost = [](double columns, std::size_t rows) { return columns * columns * (static_cast<double>(rows) + kScatter); };
  std::vector<int> few;
  std::vector<std::vector<char>> held;  // whether a group has a place
  for (const int row : own.inequalities) {
    const std::vector<Term>& terms = condensed[row];
    if (terms.size() <= kFew) {
      few.push_back(row);
      continue;
    }
    std::size_t chosen = own.groups.size();
    double least = cost(static_cast<double>(terms.size()), 1);
    for (std::size_t g = 0; g < own.groups.size(); ++g) {
      const RowGroup& group = own.groups[g];
      std::size_t wider = group.places.size();
      for (const Term& term : terms) wider += !held[g][term.variable];
      const double more = cost(static_cast<double>(wider), group.rows.size() + 1) -
                          cost(static_cast<double>(group.places.size()), group.rows.size());
      if (more < least) {
        least = more;
        chosen = g;
      }
    }
    if (chosen == own.groups.size()) {
      own.groups.emplace_back();
      held.emplace_back(size);
    }
    RowGroup& group = own.groups[chosen];
    group.rows.push_back(row);
    for (const Term& term : terms)
      if (!std::exchange(held[chosen][term.variable], 1)) group.places.push_back(term.variable);
  }
  own.inequalities = std::move(few);
  std::vector<int> column(size);
  for (RowGroup& group : own.groups) {
    std::sort(group.places.begin(), group.places.end());
    for (std::size_t i = 0; i < group.places.size(); ++i) column[group.places[i]] = static_cast<int>(i);
    for (const int row : group.rows)
      for (Term& term : condensed[row]) term.variable = column[term.variable];
  }
}

}  // namespace trajopt
