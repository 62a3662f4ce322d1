#include "engine.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace trajopt {

namespace {

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double apply(const Csr& map, int row, const double* values) {
  double sum = 0;
  for (int e = map.indptr[row]; e < map.indptr[row + 1]; ++e) sum += map.coefficient[e] * values[map.index[e]];
  return sum;
}

void scatter(const Reals& entries, const Indices& target, Reals& out) {
  for (std::size_t t = 0; t < target.size(); ++t) out[target[t]] += entries[t];
}

}  // namespace

Nlp::Nlp(Problem problem) : problem_(std::move(problem)), team_(problem_.threads) {
  workers_.resize(3);
  outputs_.resize(3);
  for (Kind kind : {kValue, kFirst, kSecond}) prepare(kind);
  g_.resize(problem_.n_g);
  gradient_.resize(problem_.n_x);
  jacobian_.resize(problem_.jac_row.size());
  hessian_.resize(problem_.hess_row.size());
}

void Nlp::prepare(Kind kind) {
  for (const Group& group : problem_.groups) {
    const casadi::Function& function = kind == kValue ? group.value : kind == kFirst ? group.first : group.second;
    Outputs outputs;
    for (casadi_int i = 0; i < function.n_out(); ++i) {
      outputs.offset.push_back(outputs.width);
      outputs.size.push_back(static_cast<int>(function.nnz_out(i)));
      outputs.width += outputs.size.back();
    }
    outputs.data.resize(static_cast<std::size_t>(group.n_stages) * outputs.width);
    if (kind != kValue) outputs.entries.resize((kind == kFirst ? group.jacobian_target : group.hessian_target).size());
    outputs_[kind].push_back(std::move(outputs));
    std::vector<Worker> workers(problem_.threads);
    for (Worker& worker : workers) {
      worker.function = function;
      worker.memory = function.checkout();
      worker.arg.resize(function.sz_arg());
      worker.res.resize(function.sz_res());
      worker.iw.resize(function.sz_iw());
      worker.w.resize(function.sz_w());
      worker.z.resize(group.gather.rows());
      worker.lambda.resize(group.n_phi);
    }
    workers_[kind].push_back(std::move(workers));
  }
}

void Nlp::run_stage(Kind kind, int index, int stage, Worker& worker, const double* x, double sigma,
                    const double* lambda) {
  const Group& group = problem_.groups[index];
  Outputs& outputs = outputs_[kind][index];
  for (int i = 0; i < group.gather.rows(); ++i) worker.z[i] = apply(group.gather, i, x + group.x_offset[stage]);
  worker.arg[0] = worker.z.data();
  worker.arg[1] = group.p.data() + static_cast<std::size_t>(stage) * group.n_p;
  double weighted = sigma * group.cost_weight[stage];
  if (kind == kSecond) {
    const int* row = group.row.data() + static_cast<std::size_t>(stage) * group.n_phi;
    for (int j = 0; j < group.n_phi; ++j) worker.lambda[j] = group.row_scale[j] * lambda[row[j]];
    worker.arg[2] = &weighted;
    worker.arg[3] = worker.lambda.data();
  }
  double* out = outputs.data.data() + static_cast<std::size_t>(stage) * outputs.width;
  for (std::size_t i = 0; i < outputs.size.size(); ++i) worker.res[i] = out + outputs.offset[i];
  const int failed =
      worker.function(worker.arg.data(), worker.res.data(), worker.iw.data(), worker.w.data(), worker.memory);
  if (failed) std::fill_n(out, outputs.width, std::numeric_limits<double>::quiet_NaN());
  if (kind == kValue) return;
  const Csr& map = kind == kFirst ? group.jacobian : group.hessian;
  const double* nonzeros = outputs.at(stage, kind == kFirst ? 3 : 0);
  double* entries = outputs.entries.data() + static_cast<std::size_t>(stage) * map.rows();
  for (int t = 0; t < map.rows(); ++t) entries[t] = apply(map, t, nonzeros);
}

void Nlp::run_share(Kind kind, int thread, const double* x, double sigma, const double* lambda) {
  for (std::size_t index = 0; index < problem_.groups.size(); ++index) {
    const int n = problem_.groups[index].n_stages;
    const int from = n * thread / problem_.threads, to = n * (thread + 1) / problem_.threads;
    for (int stage = from; stage < to; ++stage)
      run_stage(kind, static_cast<int>(index), stage, workers_[kind][index][thread], x, sigma, lambda);
  }
}

void Nlp::run(Kind kind, const double* x, double sigma, const double* lambda) {
  const auto start = std::chrono::steady_clock::now();
  team_.run([&](int thread) { run_share(kind, thread, x, sigma, lambda); });
  timings_[kind].seconds += seconds_since(start);
  ++timings_[kind].count;
}

bool Nlp::same_point(Kind kind, const double* x) {
  Reals& seen = seen_[kind];
  if (valid_[kind] && std::memcmp(seen.data(), x, seen.size() * sizeof(double)) == 0) return true;
  valid_[kind] = false;
  seen.assign(x, x + problem_.n_x);
  return false;
}

void Nlp::scatter_rows(const Outputs& outputs, const Group& group) {
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
  timings_[kValue].seconds += seconds_since(start);
}

void Nlp::update_first(const double* x) {
  if (same_point(kFirst, x)) return;
  run(kFirst, x, 0, nullptr);
  const auto start = std::chrono::steady_clock::now();
  std::fill(gradient_.begin(), gradient_.end(), 0.0);
  jacobian_ = problem_.jac_constant;
  for (std::size_t index = 0; index < problem_.groups.size(); ++index) {
    const Group& group = problem_.groups[index];
    const Outputs& outputs = outputs_[kFirst][index];
    scatter(outputs.entries, group.jacobian_target, jacobian_);
    scatter_gradient(outputs, group);
  }
  valid_[kFirst] = true;
  timings_[kFirst].seconds += seconds_since(start);
}

void Nlp::scatter_gradient(const Outputs& outputs, const Group& group) {
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

double Nlp::f(const double* x) {
  update_value(x);
  return f_;
}

const Reals& Nlp::g(const double* x) {
  update_value(x);
  return g_;
}

const Reals& Nlp::gradient(const double* x) {
  update_first(x);
  return gradient_;
}

const Reals& Nlp::jacobian(const double* x) {
  update_first(x);
  return jacobian_;
}

const Reals& Nlp::hessian(const double* x, double sigma, const double* lambda) {
  run(kSecond, x, sigma, lambda);
  const auto start = std::chrono::steady_clock::now();
  std::fill(hessian_.begin(), hessian_.end(), 0.0);
  for (std::size_t index = 0; index < problem_.groups.size(); ++index)
    scatter(outputs_[kSecond][index].entries, problem_.groups[index].hessian_target, hessian_);
  timings_[kSecond].seconds += seconds_since(start);
  return hessian_;
}

std::optional<NonFinite> Nlp::first_nonfinite(const double* x) {
  static const char* const names[] = {"cost", "rows", "gradient", "jacobian", "hessian"};
  const Reals ones(problem_.n_g, 1.0);
  for (Kind kind : {kFirst, kSecond}) {
    run(kind, x, 1.0, ones.data());
    for (std::size_t index = 0; index < problem_.groups.size(); ++index) {
      const Outputs& outputs = outputs_[kind][index];
      for (int stage = 0; stage < problem_.groups[index].n_stages; ++stage)
        for (std::size_t o = 0; o < outputs.size.size(); ++o)
          for (int i = 0; i < outputs.size[o]; ++i)
            if (!std::isfinite(outputs.at(stage, static_cast<int>(o))[i]))
              return NonFinite{static_cast<int>(index), stage, i, kind == kSecond ? names[4] : names[o]};
    }
  }
  return std::nullopt;
}

void Nlp::reset_timings() {
  for (Timing& timing : timings_) timing = Timing{};
}

double Nlp::function_seconds() const {
  return timings_[0].seconds + timings_[1].seconds + timings_[2].seconds;
}

}  // namespace trajopt
