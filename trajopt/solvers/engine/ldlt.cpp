#include "ldlt.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dispatch.hpp"

namespace trajopt {

namespace {

constexpr int kPanel = 16;
const double kAlpha = (1 + std::sqrt(17.0)) / 8;

template <int kBytes>
TRAJOPT_INLINE typename Registers<kBytes>::Lane& lane(double* values) {
  return *reinterpret_cast<typename Registers<kBytes>::Lane*>(values);
}

template <int kBytes>
TRAJOPT_INLINE const typename Registers<kBytes>::Lane& lane(const double* values) {
  return *reinterpret_cast<const typename Registers<kBytes>::Lane*>(values);
}

// Columns of a tile of two lanes of rows, which fills the registers: 32 of 64 bytes, or 16.
template <int kBytes>
constexpr int kTile = kBytes == 64 ? 8 : 6;

// Two lanes of rows times N columns.
template <int kBytes, int N>
TRAJOPT_INLINE void tile(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int depth) {
  using Lane = typename Registers<kBytes>::Lane;
  constexpr int kLane = Registers<kBytes>::kLane;
  Lane top[N], bottom[N];
  for (int j = 0; j < N; ++j) {
    top[j] = lane<kBytes>(c + static_cast<std::ptrdiff_t>(j) * ldc);
    bottom[j] = lane<kBytes>(c + static_cast<std::ptrdiff_t>(j) * ldc + kLane);
  }
  for (int k = 0; k < depth; ++k) {
    const double* column = l + static_cast<std::ptrdiff_t>(k) * ldl;
    const double* row = w + static_cast<std::ptrdiff_t>(k) * ldw;
    const Lane upper = lane<kBytes>(column), lower = lane<kBytes>(column + kLane);
    for (int j = 0; j < N; ++j) {
      top[j] -= upper * row[j];
      bottom[j] -= lower * row[j];
    }
  }
  for (int j = 0; j < N; ++j) {
    lane<kBytes>(c + static_cast<std::ptrdiff_t>(j) * ldc) = top[j];
    lane<kBytes>(c + static_cast<std::ptrdiff_t>(j) * ldc + kLane) = bottom[j];
  }
}

// `width` columns, at most N.
template <int kBytes, int N>
TRAJOPT_INLINE void strip(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int rows, int width,
                          int depth) {
  constexpr int kLane = Registers<kBytes>::kLane;
  if constexpr (N > 1)
    if (width < N) return strip<kBytes, N - 1>(c, ldc, l, ldl, w, ldw, rows, width, depth);
  for (int i = 0; i < rows; i += 2 * kLane) tile<kBytes, N>(c + i, ldc, l + i, ldl, w, ldw, depth);
}

// Columns [first, first + done) of the matrix are the panel's part of L; the work has the same columns times D.
struct Panel {
  double* a;
  int n, ld;
  std::vector<double>& w;
  int ldw;
  double* column(int k) { return a + static_cast<std::ptrdiff_t>(k) * ld; }
  double* work(int j) { return w.data() + static_cast<std::ptrdiff_t>(j) * ldw; }
};

// out -= factor * in, from and to rows that may be rounded to whole lanes beyond the last.
template <int kBytes>
TRAJOPT_INLINE void subtract(double* out, const double* in, double factor, int from, int to) {
  constexpr int kLane = Registers<kBytes>::kLane;
  for (int i = from; i < to; i += kLane)
    lane<kBytes>(out + i) -= lane<kBytes>(in + i) * factor;
}

// work(target) = column k of the matrix less the panel's first `done` columns, which begin at `first`.
template <int kBytes>
TRAJOPT_INLINE void updated_by(Panel& p, int k, int first, int done, int from, int target) {
  using Lane = typename Registers<kBytes>::Lane;
  constexpr int kLane = Registers<kBytes>::kLane;
  double* out = p.work(target);
  for (int i = from; i < k; ++i) out[i] = p.column(i)[k];
  std::copy(p.column(k) + k, p.column(k) + p.n, out + k);
  double factors[kPanel + 2];
  for (int l = 0; l < done; ++l) factors[l] = p.work(l)[k];
  const double* left = p.column(first);
  for (int i = from; i < p.n; i += 2 * kLane) {
    Lane upper = lane<kBytes>(out + i), lower = lane<kBytes>(out + i + kLane);
    const double* entry = left + i;
    for (int l = 0; l < done; ++l, entry += p.ld) {
      upper -= lane<kBytes>(entry) * factors[l];
      lower -= lane<kBytes>(entry + kLane) * factors[l];
    }
    lane<kBytes>(out + i) = upper;
    lane<kBytes>(out + i + kLane) = lower;
  }
}

TRAJOPT_DISPATCHED(void, updated, (Panel& p, int k, int first, int done, int from, int target), (p, k, first, done, from, target))

// Exchanges places x <= y, in `width` columns of the work, too.
void exchange(Panel& p, int x, int y, int width, std::vector<int>& order) {
  if (x == y) return;
  for (int c = 0; c < x; ++c) std::swap(p.column(c)[x], p.column(c)[y]);
  for (int i = x + 1; i < y; ++i) std::swap(p.column(x)[i], p.column(i)[y]);
  for (int i = y + 1; i < p.n; ++i) std::swap(p.column(x)[i], p.column(y)[i]);
  std::swap(p.column(x)[x], p.column(y)[y]);
  for (int j = 0; j < width; ++j) std::swap(p.work(j)[x], p.work(j)[y]);
  std::swap(order[x], order[y]);
}

// The largest magnitude of the entries in [from, to).
template <int kBytes>
TRAJOPT_INLINE double magnitude_by(const double* values, int from, int to) {
  using Lane = typename Registers<kBytes>::Lane;
  constexpr int kLane = Registers<kBytes>::kLane;
  Lane most{};
  int i = from;
  for (; i + kLane <= to; i += kLane) {
    const Lane entry = lane<kBytes>(values + i), opposite = -entry;
    const Lane size = entry > opposite ? entry : opposite;
    most = size > most ? size : most;
  }
  double found = 0;
  for (int j = 0; j < kLane; ++j) found = std::max(found, most[j]);
  for (; i < to; ++i) found = std::max(found, std::abs(values[i]));
  return found;
}

TRAJOPT_DISPATCHED(double, magnitude, (const double* values, int from, int to), (values, from, to))

// out = (first * one - second * other) from and to rows that may be rounded to whole lanes beyond the last.
template <int kBytes>
TRAJOPT_INLINE void combine_by(double* out, const double* first, double one, const double* second, double other, int from, int to) {
  constexpr int kLane = Registers<kBytes>::kLane;
  for (int i = from; i < to; i += kLane)
    lane<kBytes>(out + i) = lane<kBytes>(first + i) * one -
                                        lane<kBytes>(second + i) * other;
}

TRAJOPT_DISPATCHED(void, combine, (double* out, const double* first, double one, const double* second, double other, int from, int to), (out, first, one, second, other, from, to))

template <int kBytes>
TRAJOPT_INLINE void scale_by(double* out, const double* in, double factor, int from, int to) {
  constexpr int kLane = Registers<kBytes>::kLane;
  for (int i = from; i < to; i += kLane)
    lane<kBytes>(out + i) = lane<kBytes>(in + i) * factor;
}

TRAJOPT_DISPATCHED(void, scale, (double* out, const double* in, double factor, int from, int to), (out, in, factor, from, to))

// The first entry in [from, to) of this magnitude, the largest; the first of all where there is none, as with NaN.
int place_of(double most, const double* values, int from, int to) {
  for (int i = from; i < to; ++i)
    if (std::abs(values[i]) == most) return i;
  return from;
}

// Eliminates the candidates of a matrix panel by panel.
class Elimination {
 public:
  Elimination(Panel panel, const double* least, double threshold, int candidates, Pivots& pivots)
      : p_(panel), least_(least), threshold_(threshold), limit_(candidates), pivots_(pivots) {}

  // Passes over the candidates until all are eliminated or none is.
  void run() {
    const int candidates = limit_;
    for (int before = -1; before < first_ && first_ < candidates;) {
      before = first_;
      for (limit_ = candidates; first_ < limit_;) eliminate_panel();
    }
    pivots_.count = first_;
    pivots_.singular = false;
    for (int k = first_; k < candidates; ++k) pivots_.singular |= !(left_of(k) > least_[pivots_.order[k]]);
  }

 private:
  void eliminate_panel() {
    done_ = 0;
    while (done_ < kPanel && first_ + done_ < limit_) {
      const int k = first_ + done_, width = choose(k);
      if (width == 0 || !(width == 1 ? take_one(k) : take_two(k)))
        exchange(p_, k, --limit_, done_, pivots_.order);
      else
        done_ += width;
    }
    const int next = first_ + done_, left = p_.n - next;
    if (done_)
      subtract_product(p_.column(next) + next, p_.ld, p_.column(first_) + next, p_.ld, p_.work(0) + next, p_.ldw, left, left,
                       done_);
    first_ = next;
  }

  // The largest magnitude of a row that has not been eliminated.
  double left_of(int k) {
    double most = magnitude(p_.column(k), k, p_.n);
    for (int j = first_; j < k; ++j) most = std::max(most, std::abs(p_.column(j)[k]));
    return most;
  }

  // Brings the pivot to place k, and to k + 1 where it has two rows: their number, or 0 where there is none.
  int choose(int k) {
    updated(p_, k, first_, done_, k, done_);
    double* w = p_.work(done_);
    const double own = std::abs(w[k]), most = magnitude(w, k + 1, limit_);
    if (!(std::max(own, most) > least_[pivots_.order[k]])) return 0;
    if (own >= kAlpha * most) return 1;
    const int r = place_of(most, w, k + 1, limit_);
    updated(p_, r, first_, done_, k, done_ + 1);
    const double* v = p_.work(done_ + 1);
    const double other = std::max(magnitude(v, k, r), magnitude(v, r + 1, limit_));
    if (own >= kAlpha * most * (most / other)) return 1;
    if (std::abs(v[r]) >= kAlpha * other) {
      std::copy(v + k, v + p_.n, w + k);
      exchange(p_, k, r, done_ + 1, pivots_.order);
      return 1;
    }
    exchange(p_, k + 1, r, done_ + 2, pivots_.order);
    return 2;
  }

  bool take_one(int k) {
    const double *w = p_.work(done_), pivot = w[k];
    if (!(std::abs(pivot) >= threshold_ * magnitude(w, limit_, p_.n))) return false;
    pivots_.diagonal[k] = pivot;
    pivots_.below[k] = 0;
    pivots_.negative += pivot < 0;
    scale(p_.column(k), w, 1 / pivot, k + 1, p_.n);
    return true;
  }

  bool take_two(int k) {
    const double *w = p_.work(done_), *v = p_.work(done_ + 1);
    const double d11 = w[k], d21 = w[k + 1], d22 = v[k + 1];
    // scaled by the off-diagonal entry, which is the largest
    const double x = d22 / d21, y = d11 / d21, t = 1 / (x * y - 1), factor = t / d21;
    const double beyond = magnitude(w, limit_, p_.n), across = magnitude(v, limit_, p_.n);
    const double worst = std::max(std::abs(x) * beyond + across, std::abs(y) * across + beyond);
    if (!(threshold_ * std::abs(factor) * worst <= 1)) return false;
    pivots_.diagonal[k] = d11;
    pivots_.below[k] = d21;
    pivots_.diagonal[k + 1] = d22;
    pivots_.below[k + 1] = 0;
    pivots_.negative += x * y - 1 < 0 ? 1 : (d11 + d22 < 0 ? 2 : 0);
    combine(p_.column(k), w, x * factor, v, factor, k + 2, p_.n);
    combine(p_.column(k + 1), v, y * factor, w, factor, k + 2, p_.n);
    p_.column(k)[k + 1] = 0;
    return true;
  }

  Panel p_;
  const double* least_;
  double threshold_;
  int first_ = 0, done_ = 0, limit_;
  Pivots& pivots_;
};

}  // namespace

template <int kBytes>
TRAJOPT_INLINE void subtract_product_by(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int rows, int columns, int depth) {
  constexpr int kColumns = kTile<kBytes>;
  for (int j = 0; j < columns; j += kColumns)
    strip<kBytes, kColumns>(c + static_cast<std::ptrdiff_t>(j) * ldc + j, ldc, l + j, ldl, w + j, ldw, rows - j,
                            std::min(kColumns, columns - j), depth);
}

TRAJOPT_DISPATCHED(void, subtract_product, (double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int rows, int columns, int depth), (c, ldc, l, ldl, w, ldw, rows, columns, depth))

template <int kBytes>
TRAJOPT_INLINE void substitute_forward_by(const double* l, int n, const Pivots& pivots, double* z) {
  for (int k = 0; k < pivots.count; ++k) {
    subtract<kBytes>(z + k + 1, l, z[k], 0, n - k - 1);
    l += n - k - 1;
  }
  const std::vector<double>&d = pivots.diagonal, &e = pivots.below;
  for (int k = 0; k < pivots.count; ++k) {
    if (e[k] != 0) {
      const double x = d[k + 1] / e[k], y = d[k] / e[k], t = 1 / (x * y - 1) / e[k], first = z[k], second = z[k + 1];
      z[k] = (x * first - second) * t;
      z[k + 1] = (y * second - first) * t;
      ++k;
    } else {
      z[k] /= d[k];
    }
  }
}

TRAJOPT_DISPATCHED(void, substitute_forward, (const double* l, int n, const Pivots& pivots, double* z), (l, n, pivots, z))

template <int kBytes>
TRAJOPT_INLINE void substitute_backward_by(const double* l, int n, const Pivots& pivots, double* z) {
  using Lane = typename Registers<kBytes>::Lane;
  constexpr int kLane = Registers<kBytes>::kLane;
  l += static_cast<std::ptrdiff_t>(pivots.count) * (2 * n - pivots.count - 1) / 2;
  for (int k = pivots.count; k-- > 0;) {
    const int below = n - k - 1;
    l -= below;
    Lane sums{};
    for (int i = 0; i < below; i += kLane)
      sums += lane<kBytes>(l + i) * lane<kBytes>(z + k + 1 + i);
    double sum = 0;
    for (int j = 0; j < kLane; ++j) sum += sums[j];
    z[k] -= sum;
  }
}

TRAJOPT_DISPATCHED(void, substitute_backward, (const double* l, int n, const Pivots& pivots, double* z), (l, n, pivots, z))

template <int kBytes>
TRAJOPT_INLINE void row_magnitudes_by(const double* a, int n, int ld, int columns, double* most) {
  using Lane = typename Registers<kBytes>::Lane;
  constexpr int kLane = Registers<kBytes>::kLane;
  for (int j = 0; j < columns; ++j) {
    const double* column = a + static_cast<std::ptrdiff_t>(j) * ld;
    Lane found{};
    for (int i = j; i < n; i += kLane) {
      const Lane entry = lane<kBytes>(column + i), opposite = -entry;
      const Lane size = entry > opposite ? entry : opposite;
      Lane& seen = lane<kBytes>(most + i);
      seen = size > seen ? size : seen;
      found = size > found ? size : found;
    }
    for (int i = 0; i < kLane; ++i) most[j] = std::max(most[j], found[i]);
  }
}

TRAJOPT_DISPATCHED(void, row_magnitudes, (const double* a, int n, int ld, int columns, double* most), (a, n, ld, columns, most))

void eliminate(double* a, int n, int ld, int candidates, const double* least, double threshold, Pivots& pivots) {
  static thread_local std::vector<double> work;
  const int ldw = n + kPadding;
  work.assign(static_cast<std::size_t>(ldw) * (kPanel + 2), 0.0);
  pivots.order.resize(candidates);
  for (int i = 0; i < candidates; ++i) pivots.order[i] = i;
  pivots.diagonal.resize(candidates);
  pivots.below.resize(candidates);
  pivots.negative = 0;
  Elimination({a, n, ld, work, ldw}, least, threshold, candidates, pivots).run();
}

}  // namespace trajopt
