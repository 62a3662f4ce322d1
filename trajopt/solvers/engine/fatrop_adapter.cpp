#include "fatrop_adapter.hpp"

#include <algorithm>

namespace trajopt {

namespace {

using fatrop::Index;
using fatrop::OcpType;
using fatrop::Scalar;
using Vector = fatrop::VecRealView;
using Matrices = std::vector<fatrop::MatRealAllocated>;

// The last row of every matrix is FATROP's own right-hand side.
void clear(Matrices& matrices) {
  for (auto& matrix : matrices) blasfeo_dgese(matrix.m() - 1, matrix.n(), 0.0, &matrix.mat(), 0, 0);
}

void put(Matrices& matrices, const std::vector<Entry>& entries, const Reals& nonzeros, double sign) {
  for (const Entry& e : entries)
    BLASFEO_DMATEL(&matrices[e.stage].mat(), e.row, e.column) += sign * nonzeros[e.nonzero];
}

void put_ones(Matrices& matrices, const std::vector<Entry>& entries) {
  for (const Entry& e : entries) BLASFEO_DMATEL(&matrices[e.stage].mat(), e.row, e.column) = 1.0;
}

void residuals(const std::vector<Link>& links, const double* values, Scalar* out) {
  for (const Link& link : links) out[link.position] = link.sign * (values[link.index] - link.constant);
}

fatrop::NlpDims total(const StageInfo& info) {
  return fatrop::NlpDims(info.number_of_primal_variables, info.number_of_eq_constraints,
                         info.number_of_slack_variables);
}

}  // namespace

FatropAdapter::FatropAdapter(trajopt::Nlp& nlp, const StageMap& map, const Reals& x0)
    : nlp_(nlp), map_(map), x0_(x0), totals_(total(map.info)), x_(x0.size()), lambda_(nlp.problem().n_g) {}

const double* FatropAdapter::unknowns(const Vector& x) {
  const Scalar* from = x.data();
  for (std::size_t i = 0; i < x_.size(); ++i) x_[i] = from[map_.position[i]];
  return x_.data();
}

const double* FatropAdapter::point(const Vector& x) {
  if (look) look();
  return unknowns(x);
}

const Reals& FatropAdapter::watch(const Reals& values) {
  finite_derivatives = finite_derivatives && all_finite(values);
  return values;
}

void FatropAdapter::callback(const Data&) {
  called_back_ = true;
  if (tick) tick(false);
}

Index FatropAdapter::eval_lag_hess(const StageInfo&, const Scalar scale, const Vector& x, const Vector&,
                                   const Vector& lambda, fatrop::Hessian<OcpType>& hessian) {
  // Only the outer algorithm calls back: a Hessian without a call before it is restoration's.
  if (!called_back_ && tick) tick(true);
  called_back_ = false;
  read_multipliers(map_.from_rows, lambda.data(), lambda_);
  const Reals& values = watch(nlp_.hessian(point(x), scale * objective_scale, lambda_.data()));
  clear(hessian.RSQrqt);
  put(hessian.RSQrqt, map_.hessian, values, 1.0);
  return 0;
}

Index FatropAdapter::eval_constr_jac(const StageInfo&, const Vector& x, const Vector&,
                                     fatrop::Jacobian<OcpType>& jacobian) {
  const Reals& values = watch(nlp_.jacobian(point(x)));
  for (Matrices* matrices : {&jacobian.BAbt, &jacobian.Gg_eqt, &jacobian.Gg_ineqt}) clear(*matrices);
  put(jacobian.BAbt, map_.dynamics, values, -1.0);
  put(jacobian.Gg_eqt, map_.equality, values, 1.0);
  put(jacobian.Gg_ineqt, map_.inequality, values, 1.0);
  put_ones(jacobian.Gg_eqt, map_.unit_equality);
  put_ones(jacobian.Gg_ineqt, map_.unit_inequality);
  return 0;
}

Index FatropAdapter::eval_constraint_violation(const StageInfo& info, const Vector& x, const Vector& slack,
                                               Vector& result) {
  const double* values = point(x);
  Scalar* out = result.data();
  residuals(map_.from_rows, nlp_.g(values).data(), out);
  residuals(map_.from_unknowns, values, out);
  for (Index i = 0; i < info.number_of_slack_variables; ++i) out[info.offset_g_eq_slack + i] -= slack(i);
  return 0;
}

Index FatropAdapter::eval_objective_gradient(const StageInfo&, const Scalar scale, const Vector& x, const Vector&,
                                             Vector& gradient_x, Vector& gradient_s) {
  const Reals& gradient = watch(nlp_.gradient(point(x)));
  Scalar* out = gradient_x.data();
  for (std::size_t i = 0; i < gradient.size(); ++i) out[map_.position[i]] = scale * objective_scale * gradient[i];
  gradient_s = 0.0;
  return 0;
}

Index FatropAdapter::eval_objective(const StageInfo&, const Scalar scale, const Vector& x, const Vector&,
                                    Scalar& result) {
  result = scale * objective_scale * nlp_.f(point(x));
  return 0;
}

Index FatropAdapter::get_bounds(const StageInfo&, Vector& lower, Vector& upper) {
  std::copy(map_.lower.begin(), map_.lower.end(), lower.data());
  std::copy(map_.upper.begin(), map_.upper.end(), upper.data());
  return 0;
}

Index FatropAdapter::get_initial_primal(const StageInfo&, Vector& x) {
  for (std::size_t i = 0; i < x0_.size(); ++i) x(map_.position[i]) = x0_[i];
  return 0;
}

void FatropAdapter::apply_jacobian_s_transpose(const StageInfo& info, const Vector& lambda, const Scalar alpha,
                                               const Vector& y, Vector& out) {
  for (Index i = 0; i < info.number_of_slack_variables; ++i)
    out(i) = alpha * y(i) - lambda(info.offset_g_eq_slack + i);
}

}  // namespace trajopt
