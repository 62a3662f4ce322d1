#include "engine.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>

#include "dispatch.hpp"
#include "require.hpp"

namespace trajopt {

namespace {


double apply(const Csr& map, int row, const double* values) {
  double sum = 0;
  for (int e = map.indptr[row]; e < map.indptr[row + 1]; ++e) sum += map.coefficient[e] * values[map.index[e]];
  return sum;
}

const Tape& of(const Group& group, int kind) {
  return kind == 0 ? *group.value : kind == 1 ? *group.first : *group.second;
}

const Csr& map_of(const Group& group, int kind) { return kind == 1 ? group.jacobian : group.hessian; }

// The derivative among the outputs of a tape, which is only needed times the map to the NLP's nonzeros.
int derivative(int kind) { return kind == 1 ? 3 : 0; }

// Not more than there are batches of any kind.
int useful_threads(const Problem& problem) {
  std::size_t batches = 1;
  for (const Group& group : problem.groups) batches += static_cast<std::size_t>(group.n_stages) / kLanes + 1;
  return static_cast<int>(std::min(batches, static_cast<std::size_t>(problem.threads)));
}

// entries = map * nonzeros, in all lanes.
template <int kBytes>
TRAJOPT_INLINE void combine_by(const int* indptr, const int* index, const double* coefficient, int rows, const int* slot,
                               const Lanes* work, Lanes* entries) {
  const auto* w = reinterpret_cast<const Eight<kBytes>*>(work);
  auto* out = reinterpret_cast<Eight<kBytes>*>(entries);
  for (int row = 0; row < rows; ++row) {
    Eight<kBytes> sum = {};
    for (int e = indptr[row]; e < indptr[row + 1]; ++e) sum += w[slot[index[e]]] * coefficient[e];
    out[row] = sum;
  }
}

TRAJOPT_DISPATCHED(void, combine,
                   (const int* indptr, const int* index, const double* coefficient, int rows, const int* slot,
                    const Lanes* work, Lanes* entries),
                   (indptr, index, coefficient, rows, slot, work, entries))

}  // namespace

Nlp::Nlp(Problem problem) : problem_(std::move(problem)), team_(useful_threads(problem_)) {
  for (Kind kind : {kValue, kFirst, kSecond}) prepare(kind);
  int slots = 0;
  for (const auto& batches : batches_)
    for (const Batch& batch : batches) slots = std::max(slots, batch.tape->slots());
  work_.assign(team_.size(), std::vector<Lanes>(slots));
  g_.resize(problem_.n_g);
  gradient_.resize(problem_.n_x);
  jacobian_.resize(problem_.jac_row.size());
  hessian_.resize(problem_.hess_row.size());
}

void Nlp::prepare(Kind kind) {
  std::vector<const Tape*> tapes;
  std::map<const Tape*, std::vector<int>> groups;
  for (std::size_t index = 0; index < problem_.groups.size(); ++index) {
    const Tape& tape = of(problem_.groups[index], kind);
    if (groups[&tape].empty()) tapes.push_back(&tape);
    groups[&tape].push_back(static_cast<int>(index));
    Outputs outputs;
    for (int i = 0; i < tape.n_out(); ++i) {
      outputs.offset.push_back(outputs.width);
      outputs.size.push_back(tape.size_out(i));
      outputs.width += outputs.size.back();
    }
    outputs_[kind].push_back(std::move(outputs));
  }
  for (const Tape* tape : tapes) add_batches(kind, tape, groups[tape]);
  // The longest first: threads then end at about the same time.
  std::stable_sort(batches_[kind].begin(), batches_[kind].end(), [](const Batch& one, const Batch& other) {
    return one.tape->statements() > other.tape->statements();
  });
}

void Nlp::add_batches(Kind kind, const Tape* tape, const std::vector<int>& groups) {
  int lane = kLanes;
  for (int index : groups) {
    const Group& group = problem_.groups[index];
    const std::size_t targets = kind == kValue ? 0 : map_of(group, kind).rows();
    for (int stage = 0; stage < group.n_stages;) {
      if (lane == kLanes) {
        batches_[kind].push_back({tape, {}});
        lane = 0;
      }
      Part part{index, lane, 0, {}, entries_[kind].size()};
      for (; lane < kLanes && stage < group.n_stages; ++lane, ++stage) part.stage[part.n++] = stage;
      batches_[kind].back().parts.push_back(part);
      entries_[kind].resize(entries_[kind].size() + targets);
    }
  }
}

void Nlp::set_inputs(Kind kind, const Part& part, Lanes* work, const double* x, double sigma,
                     const double* lambda) const {
  const Group& group = problem_.groups[part.group];
  const int n_z = group.gather.rows();
  for (int k = 0; k < part.n; ++k) {
    const int stage = part.stage[k], lane = part.lane + k;
    for (int i = 0; i < n_z; ++i) work[i].at[lane] = apply(group.gather, i, x + group.x_offset[stage]);
    const double* p = group.p.data() + static_cast<std::size_t>(stage) * group.n_p;
    for (int i = 0; i < group.n_p; ++i) work[n_z + i].at[lane] = p[i];
    if (kind != kSecond) continue;
    Lanes* multipliers = work + n_z + group.n_p;
    multipliers[0].at[lane] = sigma * group.cost_weight[stage];
    const int* row = group.row.data() + static_cast<std::size_t>(stage) * group.n_phi;
    for (int j = 0; j < group.n_phi; ++j) multipliers[1 + j].at[lane] = group.row_scale[j] * lambda[row[j]];
  }
}

void Nlp::keep_outputs(Kind kind, const Part& part, const Tape& tape, const Lanes* work) {
  Outputs& outputs = outputs_[kind][part.group];
  for (int output = 0; output < tape.n_out(); ++output) {
    if (kind != kValue && output == derivative(kind) && !keep_all_) continue;
    const int* slot = tape.slots_of(output);
    for (int k = 0; k < part.n; ++k) {
      double* out = outputs.at(part.stage[k], output);
      for (int i = 0; i < outputs.size[output]; ++i) out[i] = work[slot[i]].at[part.lane + k];
    }
  }
}

void Nlp::run_batch(Kind kind, const Batch& batch, Lanes* work, const double* x, double sigma,
                    const double* lambda) {
  const Tape& tape = *batch.tape;
  tape.set_constants(work);
  for (const Part& part : batch.parts) set_inputs(kind, part, work, x, sigma, lambda);
  const Part& last = batch.parts.back();
  for (int lane = last.lane + last.n; lane < kLanes; ++lane)  // any point will do
    for (int i = 0; i < tape.inputs(); ++i) work[i].at[lane] = work[i].at[0];
  tape.run(work);
  for (const Part& part : batch.parts) {
    keep_outputs(kind, part, tape, work);
    if (kind == kValue) continue;
    const Csr& map = map_of(problem_.groups[part.group], kind);
    combine(map.indptr.data(), map.index.data(), map.coefficient.data(), map.rows(), tape.slots_of(derivative(kind)),
            work, entries_[kind].data() + part.entries);
  }
}

void Nlp::run(Kind kind, const double* x, double sigma, const double* lambda) {
  const auto start = std::chrono::steady_clock::now();
  for (std::size_t index = 0; index < problem_.groups.size(); ++index) {
    Outputs& outputs = outputs_[kind][index];
    if (keep_all_ || kind != kSecond)
      outputs.data.resize(static_cast<std::size_t>(problem_.groups[index].n_stages) * outputs.width);
  }
  next_ = 0;
  team_.run([&](int thread) {
    for (std::size_t i = next_++; i < batches_[kind].size(); i = next_++)
      run_batch(kind, batches_[kind][i], work_[thread].data(), x, sigma, lambda);
  });
  timings_[kind].add(start);
  ++timings_[kind].count;
}

bool Nlp::same_point(Kind kind, const double* x) {
  Reals& seen = seen_[kind];
  if (valid_[kind] && std::memcmp(seen.data(), x, seen.size() * sizeof(double)) == 0) return true;
  valid_[kind] = false;
  seen.assign(x, x + problem_.n_x);
  return false;
}

void Nlp::scatter_rows(Outputs& outputs, const Group& group) {
  for (int stage = 0; stage < group.n_stages; ++stage) {
    const double* phi = outputs.at(stage, 1);
    const int* row = group.row.data() + static_cast<std::size_t>(stage) * group.n_phi;
    for (int j = 0; j < group.n_phi; ++j) g_[row[j]] += group.row_scale[j] * phi[j];
    if (outputs.has(0) && group.cost_weight[stage] != 0) f_ += group.cost_weight[stage] * outputs.at(stage, 0)[0];
  }
}

void Nlp::update_value(const double* x) {
  if (same_point(kValue, x)) return;
  run(kValue, x, 0, nullptr);
  const auto start = std::chrono::steady_clock::now();
  f_ = 0;
  for (int row = 0; row < problem_.n_g; ++row) g_[row] = apply(problem_.linear, row, x);
  for (std::size_t i = 0; i < problem_.groups.size(); ++i) scatter_rows(outputs_[kValue][i], problem_.groups[i]);
  valid_[kValue] = true;
  timings_[kValue].add(start);
}

void Nlp::update_first(const double* x) {
  if (same_point(kFirst, x)) return;
  run(kFirst, x, 0, nullptr);
  const auto start = std::chrono::steady_clock::now();
  std::fill(gradient_.begin(), gradient_.end(), 0.0);
  for (std::size_t index = 0; index < problem_.groups.size(); ++index)
    scatter_gradient(outputs_[kFirst][index], problem_.groups[index]);
  jacobian_ = problem_.jac_constant;
  scatter_entries(kFirst, jacobian_);
  valid_[kFirst] = true;
  timings_[kFirst].add(start);
}

void Nlp::scatter_gradient(Outputs& outputs, const Group& group) {
  if (!outputs.has(2)) return;
  const Csr& gather = group.gather;
  for (int stage = 0; stage < group.n_stages; ++stage) {
    const double weight = group.cost_weight[stage], *slope = outputs.at(stage, 2);
    double* out = gradient_.data() + group.x_offset[stage];
    for (int i = 0; weight != 0 && i < gather.rows(); ++i)
      for (int e = gather.indptr[i]; e < gather.indptr[i + 1]; ++e)
        out[gather.index[e]] += weight * gather.coefficient[e] * slope[i];
  }
}

void Nlp::scatter_entries(Kind kind, Reals& out) const {
  for (const Batch& batch : batches_[kind]) {
    for (const Part& part : batch.parts) {
      const Group& group = problem_.groups[part.group];
      const int n = map_of(group, kind).rows();
      const int* first = (kind == kFirst ? group.jacobian_target : group.hessian_target).data();
      const Lanes* entries = entries_[kind].data() + part.entries;
      for (int k = 0; k < part.n; ++k) {
        const int* target = first + static_cast<std::size_t>(part.stage[k]) * n;
        for (int t = 0; t < n; ++t) out[target[t]] += entries[t].at[part.lane + k];
      }
    }
  }
}

void Nlp::set_group(int index, GroupNumbers numbers) {
  const Lock lock(mutex_);
  require(0 <= index && index < static_cast<int>(problem_.groups.size()), "there is no such group");
  Group& group = problem_.groups[index];
  const std::pair<Reals*, Reals*> pairs[] = {{&numbers.gather, &group.gather.coefficient},
                                             {&numbers.p, &group.p},
                                             {&numbers.cost_weight, &group.cost_weight},
                                             {&numbers.jacobian, &group.jacobian.coefficient},
                                             {&numbers.hessian, &group.hessian.coefficient}};
  for (const auto& [from, to] : pairs)
    require(from->size() == to->size(), "the numbers of a group have other sizes than those that it was made with");
  for (const auto& [from, to] : pairs) to->swap(*from);
  valid_[kValue] = valid_[kFirst] = false;
}

void Nlp::set_linear(Reals coefficient, Reals jac_constant) {
  const Lock lock(mutex_);
  require(coefficient.size() == problem_.linear.coefficient.size() && jac_constant.size() == problem_.jac_constant.size(),
          "the numbers of linear rows have other sizes than those that they were made with");
  problem_.linear.coefficient = std::move(coefficient);
  problem_.jac_constant = std::move(jac_constant);
  valid_[kValue] = valid_[kFirst] = false;
}

double Nlp::f(const double* x) {
  const Lock lock(mutex_);
  update_value(x);
  return f_;
}

Reals Nlp::g(const double* x) {
  const Lock lock(mutex_);
  update_value(x);
  return g_;
}

Reals Nlp::gradient(const double* x) {
  const Lock lock(mutex_);
  update_first(x);
  return gradient_;
}

Reals Nlp::jacobian(const double* x) {
  const Lock lock(mutex_);
  update_first(x);
  return jacobian_;
}

Reals Nlp::hessian(const double* x, double sigma, const double* lambda) {
  const Lock lock(mutex_);
  run(kSecond, x, sigma, lambda);
  const auto start = std::chrono::steady_clock::now();
  std::fill(hessian_.begin(), hessian_.end(), 0.0);
  scatter_entries(kSecond, hessian_);
  timings_[kSecond].add(start);
  return hessian_;
}

std::optional<NonFinite> Nlp::first_nonfinite(const double* x) {
  const Lock lock(mutex_);
  const Reals ones(problem_.n_g, 1.0);
  std::optional<NonFinite> found;
  keep_all_ = true;
  for (Kind kind : {kFirst, kSecond}) {
    if (found) break;
    run(kind, x, 1.0, ones.data());
    found = nonfinite_output(kind);
  }
  keep_all_ = false;
  return found;
}

std::optional<NonFinite> Nlp::nonfinite_output(Kind kind) {
  static const char* const names[] = {"cost", "rows", "gradient", "jacobian", "hessian"};
  for (std::size_t index = 0; index < problem_.groups.size(); ++index) {
    Outputs& outputs = outputs_[kind][index];
    for (int stage = 0; stage < problem_.groups[index].n_stages; ++stage)
      for (std::size_t o = 0; o < outputs.size.size(); ++o)
        for (int i = 0; i < outputs.size[o]; ++i)
          if (!std::isfinite(outputs.at(stage, static_cast<int>(o))[i]))
            return NonFinite{static_cast<int>(index), stage, i, kind == kSecond ? names[4] : names[o]};
  }
  return std::nullopt;
}

void Nlp::reset_timings() {
  const Lock lock(mutex_);
  for (Timing& timing : timings_) timing = Timing{};
}

double Nlp::function_seconds() const {
  const Lock lock(mutex_);
  return timings_[0].seconds + timings_[1].seconds + timings_[2].seconds;
}

Timing Nlp::timing(int kind) const {
  const Lock lock(mutex_);
  return timings_[kind];
}

}  // namespace trajopt
