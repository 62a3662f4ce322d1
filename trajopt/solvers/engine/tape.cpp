#include "tape.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>

#include "dispatch.hpp"
#include "require.hpp"
#include "tape_code.hpp"
#include "tape_graph.hpp"

namespace trajopt {

namespace {

typedef double Vector __attribute__((vector_size(64), may_alias));
static_assert(sizeof(Vector) == sizeof(Lanes));

void other(Lanes& target, const Lanes& a, const Lanes& b, std::int32_t operation) {
  for (int lane = 0; lane < kLanes; ++lane) {
    double result = 0;
    casadi::casadi_math<double>::fun(static_cast<unsigned char>(operation), a.at[lane], b.at[lane], result);
    target.at[lane] = result;
  }
}

TRAJOPT_DISPATCHED void evaluate(const std::int32_t* code, const std::int32_t* end, Lanes* work) {
  Vector* w = reinterpret_cast<Vector*>(work);
  while (code != end) {
    const std::int32_t operation = code[0];
    std::int32_t n = code[1];
    code += 2;
    switch (operation) {
      case kMultiply:
        for (; n > 0; --n, code += 3) w[code[0]] = w[code[1]] * w[code[2]];
        break;
      case kAdd:
        for (; n > 0; --n, code += 3) w[code[0]] = w[code[1]] + w[code[2]];
        break;
      case kSubtract:
        for (; n > 0; --n, code += 3) w[code[0]] = w[code[1]] - w[code[2]];
        break;
      case kMultiplyAdd:
        for (; n > 0; --n, code += 4) w[code[0]] = w[code[3]] + w[code[1]] * w[code[2]];
        break;
      case kMultiplyFrom:
        for (; n > 0; --n, code += 4) w[code[0]] = w[code[3]] - w[code[1]] * w[code[2]];
        break;
      case kMultiplyLess:
        for (; n > 0; --n, code += 4) w[code[0]] = w[code[1]] * w[code[2]] - w[code[3]];
        break;
      case kNegate:
        for (; n > 0; --n, code += 2) w[code[0]] = -w[code[1]];
        break;
      default:
        for (; n > 0; --n, code += 4) other(work[code[0]], work[code[1]], work[code[2]], code[3]);
    }
  }
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

template <class Number>
void append(std::string& text, const std::vector<Number>& values) {
  const std::uint64_t n = values.size();
  text.append(reinterpret_cast<const char*>(&n), sizeof n);
  text.append(reinterpret_cast<const char*>(values.data()), n * sizeof(Number));
}

template <class Number>
void extract(const std::string& text, std::size_t& at, std::vector<Number>& values) {
  std::uint64_t n = 0;
  require(text.size() - at >= sizeof n, "a tape is cut off");
  std::memcpy(&n, text.data() + at, sizeof n);
  at += sizeof n;
  require((text.size() - at) / sizeof(Number) >= n, "a tape is cut off");
  values.resize(n);
  std::memcpy(values.data(), text.data() + at, n * sizeof(Number));
  at += n * sizeof(Number);
}

}  // namespace

Tape::Tape(const casadi::Function& function) {
  TapeGraph graph(function);
  graph.fuse();
  std::vector<int> first_input, slot(graph.values.size(), -1), last(graph.values.size(), -1);
  int n_inputs = 0;
  for (casadi_int i = 0; i < function.n_in(); ++i) {
    first_input.push_back(n_inputs);
    in_.push_back(static_cast<int>(function.nnz_in(i)));
    n_inputs += in_.back();
  }
  for (std::size_t i = 0; i < graph.values.size(); ++i) {
    const Value& value = graph.values[i];
    if (value.kind == Value::kInput) slot[i] = first_input[value.operation] + value.a;
    if (value.kind == Value::kConstant) {
      slot[i] = n_inputs + static_cast<int>(constants_.size());
      constants_.push_back(value.constant);
    }
  }
  const std::vector<int> order = graph.scheduled();
  for (std::size_t k = 0; k < order.size(); ++k) {
    const Value& value = graph.values[order[k]];
    for (int operand : {value.a, value.b, value.c})
      if (operand >= 0) last[operand] = static_cast<int>(k);
  }
  for (int result : graph.results) last[result] = static_cast<int>(order.size());
  Slots slots(n_inputs + static_cast<int>(constants_.size()));
  std::size_t run = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const Value& value = graph.values[order[k]];
    for (int* used : {&last[value.a], value.b < 0 ? nullptr : &last[value.b], value.c < 0 ? nullptr : &last[value.c]}) {
      if (used == nullptr || *used != static_cast<int>(k)) continue;
      const auto operand = static_cast<std::size_t>(used - last.data());
      if (graph.values[operand].kind == Value::kStatement) slots.give_back(slot[operand]);
      *used = -1;
    }
    slot[order[k]] = slots.take();
    if (k == 0 || graph.values[order[k - 1]].operation != value.operation) {
      run = code_.size();
      code_.insert(code_.end(), {value.operation, 0});
    }
    ++code_[run + 1];
    code_.push_back(slot[order[k]]);
    code_.push_back(slot[value.a]);
    if (length(value.operation) > 2) code_.push_back(slot[value.b < 0 ? value.a : value.b]);
    if (length(value.operation) > 3) code_.push_back(value.operation == kOther ? value.other : slot[value.c]);
  }
  slots_ = slots.count();
  for (casadi_int i = 0; i < function.n_out(); ++i) {
    out_.push_back(static_cast<int>(function.nnz_out(i)));
    const std::vector<casadi_int> row = function.sparsity_out(i).get_row(), column = function.sparsity_out(i).get_col();
    row_.insert(row_.end(), row.begin(), row.end());
    column_.insert(column_.end(), column.begin(), column.end());
  }
  for (int result : graph.results) result_.push_back(slot[result]);
  complete();
}

void Tape::complete() {
  n_inputs_ = statements_ = 0;
  for (int size : in_) n_inputs_ += size;
  first_result_.assign(1, 0);
  for (int size : out_) first_result_.push_back(first_result_.back() + size);
  for (std::size_t at = 0; at + 1 < code_.size(); at += 2 + static_cast<std::size_t>(length(code_[at])) * code_[at + 1])
    statements_ += code_[at + 1];
}

// A file may hold anything: no statement may leave the work.
void Tape::check() const {
  const char* const wrong = "a tape is damaged";
  const auto is_slot = [this](int slot) { return 0 <= slot && slot < slots_; };
  const auto is_size = [](int size) { return 0 <= size && size < (1 << 24); };
  require(std::all_of(in_.begin(), in_.end(), is_size) && std::all_of(out_.begin(), out_.end(), is_size), wrong);
  std::size_t fixed = constants_.size(), results = 0;
  for (int size : in_) fixed += static_cast<std::size_t>(size);
  for (int size : out_) results += static_cast<std::size_t>(size);
  require(is_size(slots_) && fixed <= static_cast<std::size_t>(slots_) && results == result_.size(), wrong);
  require(row_.size() == results && column_.size() == results, wrong);
  require(std::all_of(result_.begin(), result_.end(), is_slot), wrong);
  for (std::size_t at = 0; at < code_.size();) {
    require(at + 2 <= code_.size() && 0 <= code_[at] && code_[at] < kOperations && code_[at + 1] > 0, wrong);
    const std::int32_t operation = code_[at];
    const auto n = static_cast<std::size_t>(code_[at + 1]), width = static_cast<std::size_t>(length(operation));
    at += 2;
    require(n <= (code_.size() - at) / width, wrong);
    for (std::size_t end = at + n * width; at < end; at += width)
      for (std::size_t k = 0; k < width; ++k)
        require(operation == kOther && k == 3 ? casadi::casadi_math<double>::is_unary(code_[at + k]) ||
                                                    casadi::casadi_math<double>::is_binary(code_[at + k])
                                              : is_slot(code_[at + k]),
                wrong);
  }
}

const char* Tape::version() { return "trajopt tape 1\n"; }

Tape Tape::read(const std::string& bytes) {
  std::size_t at = std::strlen(version());
  require(bytes.compare(0, at, version()) == 0, "not a tape of this version");
  Tape tape;
  std::vector<int> slots;
  extract(bytes, at, tape.in_);
  extract(bytes, at, tape.out_);
  extract(bytes, at, tape.constants_);
  extract(bytes, at, tape.result_);
  extract(bytes, at, tape.row_);
  extract(bytes, at, tape.column_);
  extract(bytes, at, slots);
  extract(bytes, at, tape.code_);
  require(at == bytes.size() && slots.size() == 1, "a tape is damaged");
  tape.slots_ = slots[0];
  tape.check();
  tape.complete();
  return tape;
}

std::string Tape::bytes() const {
  std::string text = version();
  append(text, in_);
  append(text, out_);
  append(text, constants_);
  append(text, result_);
  append(text, row_);
  append(text, column_);
  append(text, std::vector<int>{slots_});
  append(text, code_);
  return text;
}

void Tape::set_constants(Lanes* work) const {
  for (std::size_t i = 0; i < constants_.size(); ++i) std::fill_n(work[n_inputs_ + i].at, kLanes, constants_[i]);
}

void Tape::run(Lanes* work) const { evaluate(code_.data(), code_.data() + code_.size(), work); }

}  // namespace trajopt
