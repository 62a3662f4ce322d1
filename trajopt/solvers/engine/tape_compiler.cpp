#include "tape.hpp"

#include <casadi/casadi.hpp>
#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <string>
#include <utility>

namespace trajopt {

namespace {

// Mispredicted branches at the ends of runs cost more with a smaller window, memory with a larger one.
constexpr std::size_t kWindow = 2048;

// An operation on earlier values, an input, or a constant.
struct Value {
  enum Kind { kInput, kConstant, kStatement };
  Kind kind;
  std::int32_t operation;  // of a statement; input: which
  int a, b, c;             // operands, -1 where there is none; input: a is the element
  double constant;
  int other;  // CasADi's operation
};

struct TapeGraph {
  std::vector<Value> values;  // operands before what they are used for
  std::vector<int> results;   // values of all outputs, one after the other; -1 for zero

  // Each expression once; throws std::invalid_argument for what is not a scalar operation.
  explicit TapeGraph(const casadi::Function& function);

  // Products that are used once, in a sum or a difference, become part of it; what no result needs is dropped.
  void fuse();

  // Statements in an order with long runs of one operation: those that are ready, from a window that moves
  // through their first order, so that few values are alive at any time.
  std::vector<int> scheduled() const;
};

// Numbers values so that equal expressions have equal numbers.
class Numbering {
 public:
  Numbering(std::vector<Value>& values, std::size_t most) : values_(values) {
    values_.reserve(most);
    std::size_t size = 2;
    while (size < 2 * most) size *= 2;
    known_.assign(size, -1);
  }

  int input(int which, int element) { return number({Value::kInput, which, element, -1, -1, 0, 0}); }
  int constant(double value) { return number({Value::kConstant, 0, -1, -1, -1, value, 0}); }
  int statement(int operation, int a, int b) {
    switch (operation) {
      case casadi::OP_SQ: return of(kMultiply, a, a);
      case casadi::OP_TWICE: return of(kAdd, a, a);
      case casadi::OP_MUL: return of(kMultiply, std::min(a, b), std::max(a, b));
      case casadi::OP_ADD: return of(kAdd, std::min(a, b), std::max(a, b));
      case casadi::OP_SUB: return of(kSubtract, a, b);
      case casadi::OP_NEG: return of(kNegate, a, -1);
      default: return number({Value::kStatement, kOther, a, b, -1, 0, operation});
    }
  }

 private:
  int of(std::int32_t operation, int a, int b) { return number({Value::kStatement, operation, a, b, -1, 0, 0}); }

  int number(const Value& value) {
    const std::size_t last = known_.size() - 1;
    std::size_t at = hash(value) & last;
    for (; known_[at] >= 0; at = (at + 1) & last)
      if (same(values_[known_[at]], value)) return known_[at];
    known_[at] = static_cast<int>(values_.size());
    values_.push_back(value);
    return known_[at];
  }

  static std::uint64_t bits(double number) {
    std::uint64_t result;
    std::memcpy(&result, &number, sizeof result);
    return result;
  }

  static bool same(const Value& one, const Value& two) {
    return one.kind == two.kind && one.operation == two.operation && one.other == two.other && one.a == two.a && one.b == two.b &&
           bits(one.constant) == bits(two.constant);
  }

  static std::size_t hash(const Value& value) {
    std::uint64_t hash = bits(value.constant);
    for (int part : {static_cast<int>(value.kind), value.operation, value.other, value.a, value.b})
      hash = (hash ^ static_cast<std::uint64_t>(part)) * 0x9E3779B97F4A7C15u;
    return hash ^ (hash >> 29);
  }

  std::vector<Value>& values_;
  std::vector<int> known_;  // numbers by hash, each in the first free place from there; -1 where there is none
};

[[noreturn]] void refuse(const casadi::Function& function, const std::string& what) {
  throw std::invalid_argument("function '" + function.name() + "' has " + what + ": only scalar operations can be run");
}

int operands(const casadi::Function& function, int operation) {
  if (casadi::casadi_math<double>::is_unary(operation)) return 1;
  if (casadi::casadi_math<double>::is_binary(operation)) return 2;
  refuse(function, "operation " + std::to_string(operation));
}

TapeGraph::TapeGraph(const casadi::Function& function) {
  if (!function.is_a("SXFunction")) refuse(function, "the type " + function.class_name());
  std::vector<std::size_t> first_result;
  std::size_t n_results = 0;
  for (casadi_int i = 0; i < function.n_out(); ++i) {
    first_result.push_back(n_results);
    n_results += static_cast<std::size_t>(function.nnz_out(i));
  }
  results.assign(n_results, -1);
  const casadi_int count = function.n_instructions();
  std::vector<int> place(static_cast<std::size_t>(function.sz_w()), -1);
  Numbering number(values, static_cast<std::size_t>(count) + 1);  // and zero
  for (casadi_int k = 0; k < count; ++k) {
    const int operation = static_cast<int>(function.instruction_id(k));
    const std::vector<casadi_int> in = function.instruction_input(k), out = function.instruction_output(k);
    int value = -1;
    if (operation == casadi::OP_OUTPUT) {
      results[first_result[out[0]] + static_cast<std::size_t>(out[1])] = place[in[0]];
      continue;
    } else if (operation == casadi::OP_INPUT) {
      value = number.input(static_cast<int>(in[0]), static_cast<int>(in[1]));
    } else if (operation == casadi::OP_CONST) {
      value = number.constant(function.instruction_constant(k));
    } else {
      const int n = operands(function, operation);
      value = number.statement(operation, place[in[0]], n == 2 ? place[in[1]] : -1);
    }
    place[out[0]] = value;
  }
  for (int& result : results)
    if (result < 0) result = number.constant(0);
}

void TapeGraph::fuse() {
  std::vector<int> uses(values.size(), 0);
  std::vector<char> needed(values.size(), 0);
  const auto need = [&](int value) {
    if (value < 0) return;
    needed[value] = 1;
    ++uses[value];
  };
  for (int result : results) need(result);
  for (std::size_t i = values.size(); i-- > 0;) {
    if (!needed[i] || values[i].kind != Value::kStatement) continue;
    for (int operand : {values[i].a, values[i].b}) need(operand);
  }
  const auto absorbed = [&](int value) {
    return values[value].kind == Value::kStatement && values[value].operation == kMultiply && uses[value] == 1;
  };
  for (std::size_t i = 0; i < values.size(); ++i) {
    Value& sum = values[i];
    if (!needed[i] || sum.kind != Value::kStatement || (sum.operation != kAdd && sum.operation != kSubtract) ||
        sum.a == sum.b)
      continue;
    // Of two products the later one: the other has been waiting in memory anyway.
    const bool left = absorbed(sum.a), right = absorbed(sum.b) && !(left && sum.a > sum.b);
    if (!left && !right) continue;
    const int product = right ? sum.b : sum.a, other = right ? sum.a : sum.b;
    const auto operation = sum.operation == kAdd ? kMultiplyAdd : right ? kMultiplyFrom : kMultiplyLess;
    sum = {Value::kStatement, operation, values[product].a, values[product].b, other, 0, 0};
    needed[product] = 0;
  }
  std::vector<int> kept(values.size(), -1);
  std::size_t n = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!needed[i]) continue;
    Value value = values[i];
    if (value.kind == Value::kStatement)
      for (int* operand : {&value.a, &value.b, &value.c})
        if (*operand >= 0) *operand = kept[*operand];
    kept[i] = static_cast<int>(n);
    values[n++] = value;
  }
  values.resize(n);
  for (int& result : results) result = kept[result];
}

std::vector<int> TapeGraph::scheduled() const {
  std::vector<int> statements, waits_for(values.size(), 0), first_user(values.size() + 1, 0);
  const auto is_statement = [&](int value) { return value >= 0 && values[value].kind == Value::kStatement; };
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (values[i].kind != Value::kStatement) continue;
    statements.push_back(static_cast<int>(i));
    for (int operand : {values[i].a, values[i].b, values[i].c})
      if (is_statement(operand)) ++waits_for[i], ++first_user[operand + 1];
  }
  for (std::size_t i = 0; i < values.size(); ++i) first_user[i + 1] += first_user[i];
  std::vector<int> users(first_user.back()), filled(first_user);
  for (int i : statements)
    for (int operand : {values[i].a, values[i].b, values[i].c})
      if (is_statement(operand)) users[filled[operand]++] = i;

  std::vector<int> order, ready[kOperations];
  order.reserve(statements.size());
  std::vector<char> admitted(values.size(), 0);
  std::size_t next = 0;
  const auto make_ready = [&](int i) { ready[values[i].operation].push_back(i); };
  while (order.size() < statements.size()) {
    for (; next < statements.size() && next - order.size() < kWindow; ++next) {
      admitted[statements[next]] = 1;
      if (waits_for[statements[next]] == 0) make_ready(statements[next]);
    }
    auto most = std::max_element(std::begin(ready), std::end(ready),
                                 [](const auto& one, const auto& other) { return one.size() < other.size(); });
    std::vector<int> now;
    now.swap(*most);
    std::sort(now.begin(), now.end());
    for (int i : now) {
      order.push_back(i);
      for (int u = first_user[i]; u < first_user[i + 1]; ++u)
        if (--waits_for[users[u]] == 0 && admitted[users[u]]) make_ready(users[u]);
    }
  }
  return order;
}

// Gives slots to values, and takes them back after their last use.
class Slots {
 public:
  explicit Slots(int first) : count_(first) {}
  int take() {
    if (free_.empty()) return count_++;
    const int slot = free_.back();
    free_.pop_back();
    return slot;
  }
  void give_back(int slot) { free_.push_back(slot); }
  int count() const { return count_; }

 private:
  int count_;
  std::vector<int> free_;
};

// Sizes and patterns of inputs and outputs.
void describe(const casadi::Function& function, TapeParts& parts) {
  for (casadi_int i = 0; i < function.n_in(); ++i) parts.in.push_back(static_cast<int>(function.nnz_in(i)));
  for (casadi_int i = 0; i < function.n_out(); ++i) {
    parts.out.push_back(static_cast<int>(function.nnz_out(i)));
    const std::vector<casadi_int> row = function.sparsity_out(i).get_row(), column = function.sparsity_out(i).get_col();
    parts.row.insert(parts.row.end(), row.begin(), row.end());
    parts.column.insert(parts.column.end(), column.begin(), column.end());
  }
}

// Slots of inputs and of constants, which come after them.
std::vector<int> fixed_slots(const TapeGraph& graph, TapeParts& parts) {
  std::vector<int> first_input{0}, slot(graph.values.size(), -1);
  for (int size : parts.in) first_input.push_back(first_input.back() + size);
  for (std::size_t i = 0; i < graph.values.size(); ++i) {
    const Value& value = graph.values[i];
    if (value.kind == Value::kInput) slot[i] = first_input[value.operation] + value.a;
    if (value.kind != Value::kConstant) continue;
    slot[i] = first_input.back() + static_cast<int>(parts.constants.size());
    parts.constants.push_back(value.constant);
  }
  parts.slots = first_input.back() + static_cast<int>(parts.constants.size());
  return slot;
}

// Gives slots to the statements and writes them in this order.
void write_code(const TapeGraph& graph, const std::vector<int>& order, std::vector<int>& slot, TapeParts& parts) {
  std::vector<int> last(graph.values.size(), -1);  // statement that uses a value last
  for (std::size_t k = 0; k < order.size(); ++k) {
    const Value& value = graph.values[order[k]];
    for (int operand : {value.a, value.b, value.c})
      if (operand >= 0) last[operand] = static_cast<int>(k);
  }
  for (int result : graph.results) last[result] = static_cast<int>(order.size());
  Slots slots(parts.slots);
  std::vector<std::int32_t>& code = parts.code;
  std::size_t run = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const Value& value = graph.values[order[k]];
    for (int operand : {value.a, value.b, value.c}) {
      if (operand < 0 || last[operand] != static_cast<int>(k)) continue;
      if (graph.values[operand].kind == Value::kStatement) slots.give_back(slot[operand]);
      last[operand] = -1;
    }
    slot[order[k]] = slots.take();
    if (k == 0 || graph.values[order[k - 1]].operation != value.operation) {
      run = code.size();
      code.insert(code.end(), {value.operation, 0});
    }
    ++code[run + 1];
    code.push_back(slot[order[k]]);
    code.push_back(slot[value.a]);
    if (length(value.operation) > 2) code.push_back(slot[value.b < 0 ? value.a : value.b]);
    if (length(value.operation) > 3) code.push_back(value.operation == kOther ? value.other : slot[value.c]);
  }
  parts.slots = slots.count();
}

}  // namespace

Tape compile(const casadi::Function& function) {
  TapeGraph graph(function);
  graph.fuse();
  TapeParts parts;
  describe(function, parts);
  std::vector<int> slot = fixed_slots(graph, parts);
  write_code(graph, graph.scheduled(), slot, parts);
  for (int result : graph.results) parts.result.push_back(slot[result]);
  return Tape(std::move(parts));
}

}  // namespace trajopt
