// LDL^T of the leading part of a dense symmetric matrix, with Bunch-Kaufman pivots within that part.
#pragma once

#include <vector>

namespace trajopt {

// Rows that kernels may read and write beyond the last one of a column.
constexpr int kPadding = 16;

struct Pivots {
  std::vector<int> order;        // row of the matrix at each place
  std::vector<double> diagonal;  // of D
  std::vector<double> below;     // of D; not zero in the first column of a 2 by 2 pivot
  int count = 0;                 // eliminated; the others among the first rows are left in the Schur complement
  int negative = 0;              // eigenvalues of D
  bool singular = false;         // a row is left of which nothing is above its value of `least`
};

// Eliminates the first `candidates` rows and columns of the lower triangle `a` (n by n, leading dimension
// ld >= n + kPadding) as far as they have pivots; columns of L, without its unit diagonal, take their place. A row
// is left without a pivot where its entries among the candidates are not above its value of `least`, or where the
// pivot would be smaller than `threshold` times an entry of a row that is not eliminated here.
void eliminate(double* a, int n, int ld, int candidates, const double* least, double threshold, Pivots& pivots);

// c -= l w^T on and below the diagonal: c is rows by columns, lower, of leading dimension ldc; l is rows by depth, w columns by
// depth. Rows beyond the last and entries above the diagonal may be written.
void subtract_product(double* c, int ldc, const double* l, int ldl, const double* w, int ldw, int rows, int columns,
                      int depth);

// Solve L D y = z in place, and L^T y = z, for the eliminated rows: l has the entries of L below its diagonal, column
// by column, and kPadding more; z has n entries and kPadding zeros, which the first may change.
void substitute_forward(const double* l, int n, const Pivots& pivots, double* z);
void substitute_backward(const double* l, int n, const Pivots& pivots, double* z);

// most[i] = the largest magnitude of row i of the symmetric matrix among its first `columns` columns, and of its
// column i; most has n entries and kPadding more, zero at first.
void row_magnitudes(const double* a, int n, int ld, int columns, double* most);

}  // namespace trajopt
