#include "ldlt.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace trajopt {

namespace {

// Compiled for several processors, chosen when the library is loaded.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define TRAJOPT_DISPATCHED __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define TRAJOPT_DISPATCHED
#endif
#define TRAJOPT_INLINE inline __attribute__((always_inline))

typedef double Lane __attribute__((vector_size(64), aligned(8), may_alias));
constexpr int kLane = 8;
constexpr int kPanel = 16;
const double kAlpha = (1 + std::sqrt(17.0)) / 8;
constexpr double kNone = 1e-20;

// Two lanes of rows times N columns.
template <int N>
TRAJOPT_INLINE void tile(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int depth) {
  Lane top[N], bottom[N];
  for (int j = 0; j < N; ++j) {
    top[j] = *reinterpret_cast<const Lane*>(c + static_cast<std::ptrdiff_t>(j) * ldc);
    bottom[j] = *reinterpret_cast<const Lane*>(c + static_cast<std::ptrdiff_t>(j) * ldc + kLane);
  }
  for (int k = 0; k < depth; ++k) {
    const double* column = l + static_cast<std::ptrdiff_t>(k) * ldl;
    const double* row = w + static_cast<std::ptrdiff_t>(k) * ldw;
    const Lane upper = *reinterpret_cast<const Lane*>(column), lower = *reinterpret_cast<const Lane*>(column + kLane);
    for (int j = 0; j < N; ++j) {
      top[j] -= upper * row[j];
      bottom[j] -= lower * row[j];
    }
  }
  for (int j = 0; j < N; ++j) {
    *reinterpret_cast<Lane*>(c + static_cast<std::ptrdiff_t>(j) * ldc) = top[j];
    *reinterpret_cast<Lane*>(c + static_cast<std::ptrdiff_t>(j) * ldc + kLane) = bottom[j];
  }
}

template <int N>
TRAJOPT_INLINE void strip(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int rows, int depth) {
  for (int i = 0; i < rows; i += 2 * kLane) tile<N>(c + i, ldc, l + i, ldl, w, ldw, depth);
}

struct Panel {
  double* a;
  int n, ld;
  std::vector<double>& w;
  int ldw;
  double* column(int k) { return a + static_cast<std::ptrdiff_t>(k) * ld; }
  double* work(int j) { return w.data() + static_cast<std::ptrdiff_t>(j) * ldw; }
};

// out -= factor * in, from and to rows that may be rounded to whole lanes beyond the last.
TRAJOPT_INLINE void subtract(double* out, const double* in, double factor, int from, int to) {
  for (int i = from; i < to; i += kLane)
    *reinterpret_cast<Lane*>(out + i) -= *reinterpret_cast<const Lane*>(in + i) * factor;
}

// work(target) = column k of the matrix less the panel's first `done` columns, which begin at `first`.
TRAJOPT_DISPATCHED void updated(Panel& p, int k, int first, int done, int from, int target) {
  double* out = p.work(target);
  for (int i = from; i < k; ++i) out[i] = p.column(i)[k];
  std::copy(p.column(k) + k, p.column(k) + p.n, out + k);
  double factors[kPanel + 2];
  for (int l = 0; l < done; ++l) factors[l] = p.work(l)[k];
  const double* left = p.column(first);
  for (int i = from; i < p.n; i += 2 * kLane) {
    Lane upper = *reinterpret_cast<const Lane*>(out + i), lower = *reinterpret_cast<const Lane*>(out + i + kLane);
    const double* entry = left + i;
    for (int l = 0; l < done; ++l, entry += p.ld) {
      upper -= *reinterpret_cast<const Lane*>(entry) * factors[l];
      lower -= *reinterpret_cast<const Lane*>(entry + kLane) * factors[l];
    }
    *reinterpret_cast<Lane*>(out + i) = upper;
    *reinterpret_cast<Lane*>(out + i + kLane) = lower;
  }
}

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

int largest(const double* values, int from, int to) {
  int found = from;
  for (int i = from + 1; i < to; ++i)
    if (std::abs(values[i]) > std::abs(values[found])) found = i;
  return found;
}

}  // namespace

TRAJOPT_DISPATCHED void subtract_product(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int rows,
                                         int columns, int depth) {
  for (int j = 0; j < columns; j += kLane) {
    double* here = c + static_cast<std::ptrdiff_t>(j) * ldc + j;
    const int left = rows - j;
    switch (std::min(kLane, columns - j)) {
      case 8: strip<8>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      case 7: strip<7>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      case 6: strip<6>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      case 5: strip<5>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      case 4: strip<4>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      case 3: strip<3>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      case 2: strip<2>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
      default: strip<1>(here, ldc, l + j, ldl, w + j, ldw, left, depth); break;
    }
  }
}

TRAJOPT_DISPATCHED void substitute_forward(const double* a, int n, int ld, const Pivots& pivots, double* z) {
  for (int k = 0; k < pivots.count; ++k) {
    const double *column = a + static_cast<std::ptrdiff_t>(k) * ld, factor = z[k];
    subtract(z, column, factor, k + 1, n);
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

TRAJOPT_DISPATCHED void substitute_backward(const double* a, int n, int ld, const Pivots& pivots, double* z) {
  for (int k = pivots.count; k-- > 0;) {
    const double* column = a + static_cast<std::ptrdiff_t>(k) * ld;
    Lane sums{};
    for (int i = k + 1; i < n; i += kLane)
      sums += *reinterpret_cast<const Lane*>(column + i) * *reinterpret_cast<const Lane*>(z + i);
    double sum = 0;
    for (int j = 0; j < kLane; ++j) sum += sums[j];
    z[k] -= sum;
  }
}

void eliminate(double* a, int n, int ld, int candidates, Pivots& pivots) {
  static thread_local std::vector<double> work;
  const int ldw = n + kPadding;
  work.assign(static_cast<std::size_t>(ldw) * (kPanel + 2), 0.0);
  Panel p{a, n, ld, work, ldw};
  pivots.order.resize(candidates);
  for (int i = 0; i < candidates; ++i) pivots.order[i] = i;
  pivots.diagonal.assign(candidates, 0.0);
  pivots.below.assign(candidates, 0.0);
  pivots.negative = 0;
  int first = 0, limit = candidates;
  while (first < limit) {
    int done = 0;
    while (done < kPanel && first + done < limit) {
      const int k = first + done;
      updated(p, k, first, done, k, done);
      double* w = p.work(done);
      const double own = std::abs(w[k]);
      const int r = k + 1 < limit ? largest(w, k + 1, limit) : k;
      const double most = k + 1 < limit ? std::abs(w[r]) : 0.0;
      if (!(std::max(own, most) > kNone)) {  // no pivot: to the end, to be left
        exchange(p, k, limit - 1, done, pivots.order);
        --limit;
        continue;
      }
      int width = 1;
      if (own < kAlpha * most) {
        updated(p, r, first, done, k, done + 1);
        double* v = p.work(done + 1);
        double other = 0;
        for (int i = k; i < limit; ++i)
          if (i != r) other = std::max(other, std::abs(v[i]));
        const bool first_will_do = own >= kAlpha * most * (most / other);
        if (!first_will_do && std::abs(v[r]) >= kAlpha * other) {
          std::copy(v + k, v + n, w + k);
          exchange(p, k, r, done + 1, pivots.order);
        } else if (!first_will_do) {
          width = 2;
          exchange(p, k + 1, r, done + 2, pivots.order);
        }
      }
      if (width == 1) {
        const double pivot = w[k];
        pivots.diagonal[k] = pivot;
        pivots.negative += pivot < 0;
        double* left = p.column(k);
        for (int i = k + 1; i < n; ++i) left[i] = w[i] / pivot;
      } else {
        double* v = p.work(done + 1);
        const double d11 = w[k], d21 = w[k + 1], d22 = v[k + 1];
        // scaled by the off-diagonal entry, which is the largest
        const double x = d22 / d21, y = d11 / d21, t = 1 / (x * y - 1);
        pivots.diagonal[k] = d11;
        pivots.below[k] = d21;
        pivots.diagonal[k + 1] = d22;
        pivots.negative += x * y - 1 < 0 ? 1 : (d11 + d22 < 0 ? 2 : 0);
        double *left = p.column(k), *right = p.column(k + 1);
        for (int i = k + 2; i < n; ++i) {
          left[i] = (x * w[i] - v[i]) * t / d21;
          right[i] = (y * v[i] - w[i]) * t / d21;
        }
        left[k + 1] = 0;
      }
      done += width;
    }
    if (done == 0) break;
    const int next = first + done;
    subtract_product(p.column(next) + next, ld, p.column(first) + next, ld, p.work(0) + next, ldw, n - next, n - next,
                     done);
    first = next;
  }
  pivots.count = first;
}

}  // namespace trajopt
