#include "tape.hpp"

#include <casadi/casadi.hpp>

#include <algorithm>
#include <cstring>
#include <numeric>
#include <utility>

#include "dispatch.hpp"
#include "require.hpp"

namespace trajopt {

namespace {

static_assert(sizeof(Eight<16>) == sizeof(Lanes));

void other(Lanes& target, const Lanes& a, const Lanes& b, std::int32_t operation) {
  for (int lane = 0; lane < kLanes; ++lane) {
    double result = 0;
    casadi::casadi_math<double>::fun(static_cast<unsigned char>(operation), a.at[lane], b.at[lane], result);
    target.at[lane] = result;
  }
}

bool is_casadis(std::int32_t operation) {
  return 0 <= operation && operation < 256 &&
         (casadi::casadi_math<double>::is_unary(static_cast<unsigned char>(operation)) ||
          casadi::casadi_math<double>::is_binary(static_cast<unsigned char>(operation)));
}

template <int kBytes>
TRAJOPT_INLINE void evaluate_by(const std::int32_t* code, const std::int32_t* end, Lanes* work) {
  auto* w = reinterpret_cast<Eight<kBytes>*>(work);
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
        for (; n > 0; --n, code += 2) w[code[0]] = w[code[1]] * -1.0;
        break;
      default:
        for (; n > 0; --n, code += 4) other(work[code[0]], work[code[1]], work[code[2]], code[3]);
    }
  }
}

TRAJOPT_DISPATCHED(void, evaluate, (const std::int32_t* code, const std::int32_t* end, Lanes* work), (code, end, work))

template <class Number>
void append(std::string& text, const std::vector<Number>& values) {
  const std::uint64_t n = values.size();
  text.append(reinterpret_cast<const char*>(&n), sizeof n);
  text.append(reinterpret_cast<const char*>(values.data()), n * sizeof(Number));
}

void append(std::string& text, int value) { append(text, std::vector<int>{value}); }

template <class Number>
void extract(const std::string& text, std::size_t& at, std::vector<Number>& values) {
  std::uint64_t n = 0;
  require(text.size() - at >= sizeof n, "a tape is cut off");
  std::memcpy(&n, text.data() + at, sizeof n);
  at += sizeof n;
  require((text.size() - at) / sizeof(Number) >= n, "a tape is cut off");
  values.resize(n);
  if (n > 0) std::memcpy(values.data(), text.data() + at, n * sizeof(Number));
  at += n * sizeof(Number);
}

void extract(const std::string& text, std::size_t& at, int& value) {
  std::vector<int> one;
  extract(text, at, one);
  require(one.size() == 1, "a tape is damaged");
  value = one[0];
}

// In the order of the file.
template <class Parts, class Visitor>
void for_each(Parts& parts, const Visitor& visit) {
  visit(parts.in), visit(parts.out), visit(parts.constants), visit(parts.result), visit(parts.row), visit(parts.column);
  visit(parts.slots), visit(parts.code);
}

}  // namespace

Tape::Tape(TapeParts parts) : parts_(std::move(parts)) {
  check();
  n_inputs_ = std::accumulate(parts_.in.begin(), parts_.in.end(), 0);
  first_result_.assign(1, 0);
  for (int size : parts_.out) first_result_.push_back(first_result_.back() + size);
  const std::vector<std::int32_t>& code = parts_.code;
  for (std::size_t at = 0; at < code.size(); at += 2 + static_cast<std::size_t>(length(code[at])) * code[at + 1])
    statements_ += code[at + 1];
}

// A file may hold anything: no statement may leave the work.
void Tape::check() const {
  const auto& [in, out, constants, result, row, column, code, slots] = parts_;
  const auto must = [](bool condition) { require(condition, "a tape is damaged"); };
  const auto in_range = [&must](const std::vector<int>& values, int end) {
    must(std::all_of(values.begin(), values.end(), [end](int value) { return 0 <= value && value < end; }));
  };
  constexpr int kMost = 1 << 24;
  for (const std::vector<int>* values : {&in, &out, &row, &column}) in_range(*values, kMost);
  const std::size_t fixed = std::accumulate(in.begin(), in.end(), constants.size());
  const std::size_t results = std::accumulate(out.begin(), out.end(), std::size_t{0});
  must(results == result.size() && results == row.size() && results == column.size());
  // each statement takes a slot at most
  must(0 <= slots && slots < kMost && fixed <= static_cast<std::size_t>(slots) &&
       static_cast<std::size_t>(slots) <= fixed + code.size());
  in_range(result, slots);
  for (std::size_t at = 0; at < code.size();) {
    must(at + 2 <= code.size() && 0 <= code[at] && code[at] < kOperations && code[at + 1] > 0);
    const std::int32_t operation = code[at];
    const auto n = static_cast<std::size_t>(code[at + 1]), width = static_cast<std::size_t>(length(operation));
    at += 2;
    must(n <= (code.size() - at) / width);
    for (std::size_t end = at + n * width; at < end; ++at) {
      const bool foreign = operation == kOther && (end - at) % width == 1;
      must(foreign ? is_casadis(code[at]) : 0 <= code[at] && code[at] < slots);
    }
  }
}

const char* Tape::version() { return "trajopt tape 1\n"; }

Tape Tape::read(const std::string& bytes) {
  std::size_t at = std::strlen(version());
  require(bytes.compare(0, at, version()) == 0, "not a tape of this version");
  TapeParts parts;
  for_each(parts, [&](auto& values) { extract(bytes, at, values); });
  require(at == bytes.size(), "a tape is damaged");
  return Tape(std::move(parts));
}

std::string Tape::bytes() const {
  std::string text = version();
  for_each(parts_, [&](const auto& values) { append(text, values); });
  return text;
}

void Tape::set_constants(Lanes* work) const {
  Lanes* to = work + n_inputs_;
  for (const double constant : parts_.constants) std::fill_n((to++)->at, kLanes, constant);
}

void Tape::run(Lanes* work) const { evaluate(parts_.code.data(), parts_.code.data() + parts_.code.size(), work); }

}  // namespace trajopt
