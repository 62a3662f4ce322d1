#include "stage_solver.hpp"

#include <IpSparseSymLinearSolverInterface.hpp>
#include <IpTSymLinearSolver.hpp>

#include <memory>
#include <utility>

#include "stage_kkt.hpp"

namespace trajopt {

namespace {

using Ipopt::Index;
using Ipopt::Number;

class StageSolver : public Ipopt::SparseSymLinearSolverInterface {
 public:
  StageSolver(std::vector<int> stage, const Bounds& bounds, int threads, KktFigures& figures)
      : all_(std::move(stage)), threads_(threads), figures_(figures) {
    for (std::size_t i = 0; i < all_.size(); ++i)
      if (bounds.lower_x[i] != bounds.upper_x[i]) free_.push_back(all_[i]);
    for (std::size_t i = 0; i < bounds.lower_g.size(); ++i)
      ++(bounds.lower_g[i] == bounds.upper_g[i] ? sizes_.n_equal : sizes_.n_unequal);
  }

  bool InitializeImpl(const Ipopt::OptionsList&, const std::string&) override { return true; }

  Ipopt::ESymSolverStatus InitializeStructure(Index dim, Index nonzeros, const Index* row,
                                              const Index* column) override {
    // IPOPT leaves out variables that are fixed, unless more rows than variables are left
    sizes_.n_x = dim - 2 * sizes_.n_unequal - sizes_.n_equal;
    const bool all = sizes_.n_x == static_cast<int>(all_.size());
    if (!all && sizes_.n_x != static_cast<int>(free_.size())) return Ipopt::SYMSOLVER_FATAL_ERROR;
    std::vector<KktEntry> entries(nonzeros);
    for (Index e = 0; e < nonzeros; ++e) entries[e] = {e, row[e] - 1, column[e] - 1};
    values_.assign(nonzeros, 0.0);
    kkt_ = std::make_unique<StageKkt>(sizes_, all ? all_ : free_, entries, threads_);
    return Ipopt::SYMSOLVER_SUCCESS;
  }

  Number* GetValuesArrayPtr() override { return values_.data(); }

  Ipopt::ESymSolverStatus MultiSolve(bool changed, const Index*, const Index*, Index count, Number* rhs,
                                     bool check_inertia, Index negative) override {
    if (changed || std::exchange(changed_, false)) {
      const auto start = std::chrono::steady_clock::now();
      const bool regular = kkt_->factorize(values_.data());
      figures_.factorization.add(start);
      ++figures_.factorization.count;
      figures_.operations += kkt_->factor_operations();
      if (!regular) return Ipopt::SYMSOLVER_SINGULAR;
      if (check_inertia && kkt_->negative_eigenvalues() != negative) return Ipopt::SYMSOLVER_WRONG_INERTIA;
    }
    const auto start = std::chrono::steady_clock::now();
    for (Index k = 0; k < count; ++k) kkt_->solve(rhs + static_cast<std::ptrdiff_t>(k) * sizes_.all());
    figures_.substitution.add(start);
    figures_.substitution.count += count;
    figures_.operations += count * kkt_->solve_operations();
    return Ipopt::SYMSOLVER_SUCCESS;
  }

  Index NumberOfNegEVals() const override { return kkt_->negative_eigenvalues(); }
  bool IncreaseQuality() override {
    changed_ = kkt_->raise_threshold();
    return changed_;
  }
  bool ProvidesInertia() const override { return true; }
  EMatrixFormat MatrixFormat() const override { return Triplet_Format; }

 private:
  std::vector<int> all_, free_;  // stages of all variables, and of those that are not fixed
  int threads_;
  KktFigures& figures_;
  KktSizes sizes_;
  std::vector<double> values_;
  std::unique_ptr<StageKkt> kkt_;
  bool changed_ = false;  // pivots are chosen with another threshold than those of the last factorisation
};

class Builder : public Ipopt::AlgorithmBuilder {
 public:
  Builder(const std::vector<int>& stage, const Bounds& bounds, int threads, KktFigures& figures)
      : stage_(stage), bounds_(bounds), threads_(threads), figures_(figures) {}

  Ipopt::SmartPtr<Ipopt::SymLinearSolver> SymLinearSolverFactory(const Ipopt::Journalist&, const Ipopt::OptionsList&,
                                                                 const std::string&) override {
    Ipopt::SmartPtr<Ipopt::SparseSymLinearSolverInterface> own =
        new StageSolver(stage_, bounds_, threads_, figures_);
    return new Ipopt::TSymLinearSolver(own, nullptr);
  }

 private:
  const std::vector<int>& stage_;
  const Bounds& bounds_;
  int threads_;
  KktFigures& figures_;
};

}  // namespace

Ipopt::SmartPtr<Ipopt::AlgorithmBuilder> stage_builder(const std::vector<int>& stage, const Bounds& bounds, int threads,
                                                       KktFigures& figures) {
  return new Builder(stage, bounds, threads, figures);
}

}  // namespace trajopt
