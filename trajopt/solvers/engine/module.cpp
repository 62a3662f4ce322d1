#include <casadi/casadi.hpp>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <stdexcept>

#include "dispatch.hpp"
#include "interior_point.hpp"
#include "read.hpp"
#include "require.hpp"
#include "solve.hpp"
#include "stage_kkt.hpp"
#include "tape.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace trajopt;

namespace {

template <class Number>
using Array = nb::ndarray<nb::numpy, Number, nb::ndim<1>>;
using Output = Array<double>;

template <class Number>
Array<Number> to_numpy(std::vector<Number> values) {
  auto* kept = new std::vector<Number>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<Number>*>(p); });
  return Array<Number>(kept->data(), {kept->size()}, owner);
}

const double* point(const Nlp& nlp, const RealArray& x) {
  require(x.size() == static_cast<std::size_t>(nlp.problem().n_x), "x has a wrong size");
  return x.data();
}

// Python's callback, given the figures and a function that returns the variables. An exception in it stops the
// solver and is raised after it has returned; an interrupt from the keyboard asks for the current iterate, as
// returning False does.
class PythonCallback {
 public:
  explicit PythonCallback(nb::object function) : function_(std::move(function)) {}

  bool operator()(const Iteration& info, const Unknowns& unknowns) {
    nb::gil_scoped_acquire lock;
    nb::dict given;
    given["iteration"] = info.iteration;
    given["objective"] = info.objective;
    given["primal"] = info.primal;
    given["dual"] = info.dual;
    given["barrier"] = info.barrier;
    given["step"] = info.step;
    given["regularization"] = info.regularization;
    given["line_search"] = info.line_search;
    given["restoration"] = info.restoration;
    const auto valid = std::make_shared<bool>(true);
    const nb::object iterate = nb::cpp_function([&unknowns, valid] {
      if (!*valid) throw std::runtime_error("the unknowns of an iteration are known during its callback only");
      return to_numpy(unknowns());
    });
    const bool go_on = ask(given, iterate);
    *valid = false;
    return go_on;
  }

  void raise() const {
    if (error_) std::rethrow_exception(error_);
  }

 private:
  bool ask(const nb::dict& given, const nb::object& iterate) {
    try {
      if (PyErr_CheckSignals() != 0) throw nb::python_error();
      if (function_.is_none()) return true;
      const nb::object answer = function_(given, iterate);
      return answer.is_none() || nb::cast<bool>(answer);
    } catch (nb::python_error& error) {
      if (!error.matches(PyExc_KeyboardInterrupt)) error_ = std::current_exception();
      return false;
    } catch (...) {
      error_ = std::current_exception();
      return false;
    }
  }

  nb::object function_;
  std::exception_ptr error_;
};

std::map<std::string, std::pair<double, int>> timings(const Nlp& nlp) {
  return {{"value", {nlp.timing(0).seconds, nlp.timing(0).count}},
          {"first", {nlp.timing(1).seconds, nlp.timing(1).count}},
          {"second", {nlp.timing(2).seconds, nlp.timing(2).count}}};
}

nb::dict to_dict(const Outcome& outcome, const Nlp& nlp) {
  nb::dict result;
  result["x"] = to_numpy(outcome.x);
  result["g"] = to_numpy(outcome.g);
  result["lam_g"] = to_numpy(outcome.lambda_g);
  result["lam_x"] = to_numpy(outcome.lambda_x);
  result["f"] = outcome.objective;
  result["primal"] = outcome.primal;
  result["dual"] = outcome.dual;
  result["complementarity"] = outcome.complementarity;
  result["max_violation"] = outcome.max_violation;
  result["iterations"] = outcome.iterations;
  result["status"] = outcome.status;
  result["wall_time"] = outcome.wall_seconds;
  result["function_time"] = outcome.function_seconds;
  std::map<std::string, std::pair<double, int>> times = timings(nlp);
  times["factorization"] = {outcome.kkt.factorization.seconds, outcome.kkt.factorization.count};
  times["substitution"] = {outcome.kkt.substitution.seconds, outcome.kkt.substitution.count};
  result["timings"] = times;
  result["operations"] = outcome.kkt.operations;
  return result;
}

template <class Solve>
nb::dict solve(const Nlp& nlp, nb::object callback, Solve&& run) {
  PythonCallback python(std::move(callback));
  Outcome outcome;
  {
    nb::gil_scoped_release unlock;
    outcome = run([&python](const Iteration& info, const Unknowns& unknowns) { return python(info, unknowns); });
  }
  python.raise();
  return to_dict(outcome, nlp);
}

Bounds to_bounds(const Nlp& nlp, const RealArray& lbx, const RealArray& ubx, const RealArray& lbg,
                 const RealArray& ubg) {
  Bounds bounds{reals(lbx), reals(ubx), reals(lbg), reals(ubg)};
  const std::size_t n = nlp.problem().n_x, m = nlp.problem().n_g;
  require(bounds.lower_x.size() == n && bounds.upper_x.size() == n, "lbx and ubx must have n_x entries");
  require(bounds.lower_g.size() == m && bounds.upper_g.size() == m, "lbg and ubg must have n_g entries");
  return bounds;
}

// Multipliers to start from: none, or exactly `size`.
Reals given(const std::optional<RealArray>& multipliers, int size, const char* name) {
  if (!multipliers || multipliers->size() == 0) return {};
  require(multipliers->size() == static_cast<std::size_t>(size), std::string(name) + " has a wrong size");
  return reals(*multipliers);
}

// The function behind a casadi.Function of Python, which must be of the library that this module is linked to.
const casadi::Function& function_of(const nb::object& given) {
  require(nb::isinstance(given, nb::module_::import_("casadi").attr("Function")), "a Tape needs a casadi.Function");
  const nb::object swig = given.attr("this");  // an address as a number
  const void* address = PyLong_AsVoidPtr(nb::steal(PyNumber_Long(swig.ptr())).ptr());
  if (PyErr_Occurred()) throw nb::python_error();
  const auto& function = *static_cast<const casadi::Function*>(address);
  require(!function.is_null(), "a Tape needs a function that is not null");
  return function;
}

using Points = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using OutputPoints = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

std::vector<OutputPoints> evaluate(const Tape& tape, const std::vector<Points>& inputs) {
  require(static_cast<int>(inputs.size()) == tape.n_in(), "a tape needs all its inputs");
  const std::size_t n = inputs.empty() ? 1 : inputs[0].shape(0);
  for (int i = 0; i < tape.n_in(); ++i)
    require(inputs[i].shape(0) == n && static_cast<int>(inputs[i].shape(1)) == tape.size_in(i),
            "input " + std::to_string(i) + " must have the shape (points, " + std::to_string(tape.size_in(i)) + ")");
  std::vector<double*> out;
  std::vector<OutputPoints> result;
  for (int o = 0; o < tape.n_out(); ++o) {
    const auto size = static_cast<std::size_t>(tape.size_out(o));
    out.push_back(new double[n * size]);
    nb::capsule owner(out.back(), [](void* p) noexcept { delete[] static_cast<double*>(p); });
    result.emplace_back(out.back(), std::initializer_list<std::size_t>{n, size}, owner);
  }
  std::vector<Lanes> work(tape.slots());
  tape.set_constants(work.data());
  for (std::size_t first = 0; first < n; first += kLanes) {
    Lanes* to = work.data();
    for (const Points& input : inputs)
      for (std::size_t i = 0; i < input.shape(1); ++i, ++to)
        for (std::size_t k = 0; k < kLanes; ++k)
          to->at[k] = input.data()[std::min(first + k, n - 1) * input.shape(1) + i];
    tape.run(work.data());
    for (int o = 0; o < tape.n_out(); ++o)
      for (int i = 0; i < tape.size_out(o); ++i)
        for (std::size_t k = 0; k < kLanes && first + k < n; ++k)
          out[o][(first + k) * tape.size_out(o) + i] = work[tape.slots_of(o)[i]].at[k];
  }
  return result;
}

void bind_tape(nb::module_& module) {
  module.attr("TAPE_VERSION") = Tape::version();
  nb::class_<Tape>(module, "Tape")
      .def("__init__", [](Tape* self, const nb::object& function) { new (self) Tape(compile(function_of(function))); })
      .def_static("read",
                  [](const nb::bytes& bytes) { return Tape::read(std::string(bytes.c_str(), bytes.size())); })
      .def("bytes",
           [](const Tape& tape) {
             const std::string bytes = tape.bytes();
             return nb::bytes(bytes.data(), bytes.size());
           })
      .def("pattern",
           [](const Tape& tape, int output) {
             require(0 <= output && output < tape.n_out(), "a tape has no such output");
             return std::make_pair(to_numpy(tape.rows(output)), to_numpy(tape.columns(output)));
           })
      .def("__call__", &evaluate)
      .def_prop_ro("statements", &Tape::statements)
      .def_prop_ro("slots", &Tape::slots);
}

void bind_nlp(nb::module_& module) {
  nb::class_<Nlp>(module, "Nlp")
      .def("__init__", [](Nlp* self, const nb::kwargs& given) { new (self) Nlp(read_problem(given)); })
      .def_prop_ro("n_x", [](const Nlp& nlp) { return nlp.problem().n_x; })
      .def_prop_ro("n_g", [](const Nlp& nlp) { return nlp.problem().n_g; })
      .def("f", [](Nlp& nlp, const RealArray& x) { return nlp.f(point(nlp, x)); })
      .def("g", [](Nlp& nlp, const RealArray& x) { return to_numpy(nlp.g(point(nlp, x))); })
      .def("gradient", [](Nlp& nlp, const RealArray& x) { return to_numpy(nlp.gradient(point(nlp, x))); })
      .def("jacobian", [](Nlp& nlp, const RealArray& x) { return to_numpy(nlp.jacobian(point(nlp, x))); })
      .def("hessian",
           [](Nlp& nlp, const RealArray& x, double sigma, const RealArray& lambda) {
             require(lambda.size() == static_cast<std::size_t>(nlp.problem().n_g), "lambda has a wrong size");
             return to_numpy(nlp.hessian(point(nlp, x), sigma, lambda.data()));
           })
      .def("first_nonfinite",
           [](Nlp& nlp, const RealArray& x) -> nb::object {
             const auto found = nlp.first_nonfinite(point(nlp, x));
             if (!found) return nb::none();
             return nb::make_tuple(found->group, found->stage, found->output, found->index);
           })
      .def(
          "set_group",
          [](Nlp& nlp, int group, const RealArray& gather, const RealArray& p, const RealArray& cost_weight,
             const RealArray& jacobian, const RealArray& hessian) {
            nlp.set_group(group, {reals(gather), reals(p), reals(cost_weight), reals(jacobian), reals(hessian)});
          },
          "group"_a, "gather_data"_a, "p"_a, "cost_weight"_a, "jac_coef"_a, "hess_coef"_a)
      .def(
          "set_linear",
          [](Nlp& nlp, const RealArray& a_data, const RealArray& jac_const) {
            nlp.set_linear(reals(a_data), reals(jac_const));
          },
          "a_data"_a, "jac_const"_a)
      .def("timings", &timings);
}

// Of each variable; numbers of nodes and stages are bounded, as each has fronts of its own.
Indices stages_of(const IndexArray& array, int n_x) {
  Indices stages = indices(array);
  require(stages.size() == static_cast<std::size_t>(n_x), "stage has a wrong size");
  require(std::all_of(stages.begin(), stages.end(), [n_x](int i) { return i == kAlone || (-n_x <= i && i <= n_x); }),
          "stage has a number beyond that of variables");
  return stages;
}

// The solution of a KKT system and its number of negative eigenvalues; nothing where it is singular.
std::optional<std::pair<Output, int>> solve_kkt(int n_x, int n_equal, int n_unequal, const IndexArray& stage,
                                                const IndexArray& row, const IndexArray& column,
                                                const RealArray& value, const RealArray& rhs, int threads) {
  constexpr int kMost = 1 << 28;  // so that all of them can be counted
  const KktSizes sizes{n_x, n_equal, n_unequal};
  for (const int size : {n_x, n_equal, n_unequal})
    require(0 <= size && size < kMost, "n_x, n_equal and n_unequal must not be negative, nor be above 2^28");
  const Indices stages = stages_of(stage, n_x);
  require(rhs.size() == static_cast<std::size_t>(sizes.all()), "rhs has a wrong size");
  require(threads >= 1, "threads must be at least 1");
  require(row.size() == value.size() && column.size() == value.size(), "entries have different sizes");
  std::vector<KktEntry> entries;
  for (std::size_t e = 0; e < value.size(); ++e)
    entries.push_back({static_cast<std::int64_t>(e), row.data()[e], column.data()[e]});
  StageKkt kkt(sizes, stages, entries, threads);
  if (!kkt.factorize(value.data())) return std::nullopt;
  Reals solution = reals(rhs);
  kkt.solve(solution.data());
  return std::make_pair(to_numpy(solution), kkt.negative_eigenvalues());
}

// Multiplications and additions a second of the product by which fronts are eliminated, of n rows, in the cache.
double product_rate(int n, int depth) {
  require(0 < n && n <= 1024 && 0 < depth && depth <= 1024, "n and depth must be from 1 to 1024");
  const int ld = n + kPadding;
  Reals c(static_cast<std::size_t>(ld) * (n + 1)), l(static_cast<std::size_t>(ld) * depth + kPadding, 1e-3);
  const double operations = static_cast<double>(n) * (n + 1) * depth;
  const auto start = std::chrono::steady_clock::now();
  std::chrono::duration<double> passed{};
  int count = 0;
  for (; passed.count() < 0.02; passed = std::chrono::steady_clock::now() - start, ++count)
    subtract_product(c.data(), ld, l.data(), ld, l.data(), ld, n, n, depth);
  return count * operations / passed.count();
}

nb::dict to_dict(const Iterate& it) {
  nb::dict result;
  for (const auto& [name, values] : {std::pair{"x", &it.x}, {"s", &it.s}, {"y", &it.y}, {"lower_x", &it.lower_x},
                                     {"upper_x", &it.upper_x}, {"lower_s", &it.lower_s}, {"upper_s", &it.upper_s}})
    result[name] = to_numpy(*values);
  result["barrier"] = it.barrier;
  result["regularization"] = it.regularization;
  return result;
}

Iterate to_iterate(const nb::dict& given, const InteriorPoint& solver) {
  const auto n = static_cast<std::size_t>(solver.n_x()), m = static_cast<std::size_t>(solver.n_g()),
             k = static_cast<std::size_t>(solver.n_s());
  auto read = [&given](const char* name, std::size_t size) {
    RealArray array;
    require(given.contains(name) && nb::try_cast(given[name], array) && array.size() == size,
            std::string("an iterate needs '") + name + "' with " + std::to_string(size) + " entries");
    return reals(array);
  };
  auto number = [&given](const char* name, double least) {
    double value = 0;
    require(given.contains(name) && nb::try_cast(given[name], value) && value >= least,
            std::string("an iterate needs '") + name + "', not negative, a barrier positive");
    return value;
  };
  return {read("x", n), read("s", k), read("y", m), read("lower_x", n), read("upper_x", n), read("lower_s", k),
          read("upper_s", k), number("barrier", 1e-300), number("regularization", 0)};
}

nb::list to_list(const std::vector<StepReport>& reports) {
  nb::list result;
  for (const StepReport& report : reports) {
    nb::dict one;
    one["primal"] = report.primal;
    one["dual"] = report.dual;
    one["complementarity"] = report.complementarity;
    one["primal_step"] = report.primal_step;
    one["dual_step"] = report.dual_step;
    one["regularization"] = report.regularization;
    one["barrier"] = report.barrier;
    one["after"] = report.after;
    one["factorizations"] = report.factorizations;
    result.append(one);
  }
  return result;
}

void bind_interior_point(nb::module_& module) {
  nb::class_<InteriorPoint>(module, "InteriorPoint")
      .def("__init__",
           [](InteriorPoint* self, std::shared_ptr<Nlp> nlp, const RealArray& lbx, const RealArray& ubx,
              const RealArray& lbg, const RealArray& ubg, const IndexArray& stage) {
             const Bounds bounds = to_bounds(*nlp, lbx, ubx, lbg, ubg);
             const Indices stages = stages_of(stage, nlp->problem().n_x);
             new (self) InteriorPoint(std::move(nlp), bounds, stages);
           })
      .def_prop_ro("n_slacks", &InteriorPoint::n_s)
      .def(
          "complete",
          [](const InteriorPoint& solver, const RealArray& x, const RealArray& y, const RealArray& lbx,
             const RealArray& ubx, const RealArray& lbg, const RealArray& ubg, double barrier, double push) {
            const Nlp& nlp = solver.nlp();
            Iterate it;
            point(nlp, x);
            require(y.size() == static_cast<std::size_t>(solver.n_g()), "y has a wrong size");
            it.x = reals(x);
            it.y = reals(y);
            solver.complete(it, to_bounds(nlp, lbx, ubx, lbg, ubg), barrier, push);
            return to_dict(it);
          },
          "x"_a, "y"_a, "lbx"_a, "ubx"_a, "lbg"_a, "ubg"_a, "barrier"_a, "push"_a)
      .def(
          "steps",
          [](InteriorPoint& solver, const nb::dict& iterate, const RealArray& lbx,
             const RealArray& ubx, const RealArray& lbg, const RealArray& ubg, const RealArray& compliance,
             double barrier, double most_barrier, double fraction, double tolerance, double seconds, int steps,
             int least_steps) {
            Iterate it = to_iterate(iterate, solver);
            const Bounds bounds = to_bounds(solver.nlp(), lbx, ubx, lbg, ubg);
            require(compliance.size() == static_cast<std::size_t>(solver.n_g()), "compliance has a wrong size");
            require(barrier > 0 && 0 < fraction && fraction < 1, "barrier must be positive, fraction between 0 and 1");
            const Reals soft = reals(compliance);
            std::vector<StepReport> reports;
            {
              nb::gil_scoped_release unlock;
              reports = solver.steps(it, bounds, soft, {barrier, most_barrier, fraction, tolerance, seconds, steps, least_steps});
            }
            return std::make_pair(to_dict(it), to_list(reports));
          },
          "iterate"_a, "lbx"_a, "ubx"_a, "lbg"_a, "ubg"_a, "compliance"_a, "barrier"_a,
          "most_barrier"_a, "fraction"_a = 0.995, "tolerance"_a = 0.0, "seconds"_a = 0.0, "steps"_a = 1,
          "least_steps"_a = 1);
}

void bind_solvers(nb::module_& module) {
  module.attr("ALONE") = kAlone;
  module.def("solve_kkt", &solve_kkt, "n_x"_a, "n_equal"_a, "n_unequal"_a, "stage"_a, "row"_a, "column"_a, "value"_a,
             "rhs"_a, "threads"_a = 1);
  module.def("product_rate", &product_rate, "n"_a, "depth"_a);
  module.attr("WIDEST_REGISTER") = kWidestRegister;
  module.def(
      "use_registers",
      [](int bytes) {
        require((bytes == 16 || bytes == 32 || bytes == 64) && bytes <= kWidestRegister,
                "bytes must be 16, 32 or 64, and at most " + std::to_string(kWidestRegister));
        register_bytes = bytes;
      },
      "bytes"_a);
  module.def(
      "solve_ipopt",
      [](Nlp& nlp, const RealArray& x0, const RealArray& lbx, const RealArray& ubx, const RealArray& lbg,
         const RealArray& ubg, const Options& options, nb::object callback, std::optional<RealArray> lam_g0,
         std::optional<RealArray> lam_x0, std::optional<IndexArray> stage) {
        point(nlp, x0);
        const Bounds bounds = to_bounds(nlp, lbx, ubx, lbg, ubg);
        const Reals start = reals(x0);
        const Multipliers multipliers{given(lam_g0, nlp.problem().n_g, "lam_g0"),
                                      given(lam_x0, nlp.problem().n_x, "lam_x0")};
        const Indices stages = stage ? stages_of(*stage, nlp.problem().n_x) : Indices();
        return solve(nlp, std::move(callback), [&](const Callback& call) {
          return solve_ipopt(nlp, start, bounds, options, call, multipliers, stages);
        });
      },
      "nlp"_a, "x0"_a, "lbx"_a, "ubx"_a, "lbg"_a, "ubg"_a, "options"_a, "callback"_a.none(),
      "lam_g0"_a = nb::none(), "lam_x0"_a = nb::none(), "stage"_a = nb::none());
}

}  // namespace

NB_MODULE(_engine, module) {
  bind_tape(module);
  bind_nlp(module);
  bind_interior_point(module);
  bind_solvers(module);
}
