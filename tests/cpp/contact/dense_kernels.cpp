#include "../../../src/delassus/dense_kernels.hpp"

#include <Eigen/LU>
#include <boost/test/unit_test.hpp>
#include <vector>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// A front of p pivots and u others as the kernels take it, and with what they make of it.
struct Front {
  Matrix whole, l, up, s;
  std::vector<int> pivots;
  int sign = 0;

  Front(const Matrix& matrix, int p)
      : whole(matrix),
        l(matrix.leftCols(p)),
        up(matrix.topRightCorner(p, matrix.cols() - p)),
        s(matrix.bottomRightCorner(matrix.rows() - p, matrix.cols() - p)),
        pivots(static_cast<std::size_t>(p)) {}

  void factor(const DenseKernels& kernels, bool on_diagonal) {
    const auto p = static_cast<int>(l.cols()), u = static_cast<int>(up.cols());
    sign = kernels.factor_front(p, u, l.data(), up.data(), s.data(), pivots.data(), on_diagonal);
  }
  void factor_symmetric(const DenseKernels& kernels) {
    l.triangularView<Eigen::StrictlyUpper>().setConstant(kNan);  // not read
    s.triangularView<Eigen::StrictlyUpper>().setConstant(kNan);
    up.setConstant(kNan);
    const auto p = static_cast<int>(l.cols()), u = static_cast<int>(up.cols());
    sign = kernels.factor_symmetric_front(p, u, l.data(), up.data(), s.data());
    pivots.clear();
  }

  /// Solves the whole by the factors, the Schur complement by Eigen.
  Vector solve(const DenseKernels& kernels, const Vector& rhs) const {
    const Index p = l.cols(), u = up.cols();
    Vector x = rhs.head(p), y(u);
    kernels.forward(static_cast<int>(p), static_cast<int>(u), l.data(), pivots.empty() ? nullptr : pivots.data(),
                    x.data(), y.data());
    Vector below = rhs.tail(u) + y;
    if (u > 0) below = s.fullPivLu().solve(below);
    kernels.backward(static_cast<int>(p), static_cast<int>(u), l.data(), up.data(), x.data(), below.data());
    Vector all(p + u);
    all << x, below;
    return all;
  }
};

template <class Check>
void for_each_kernel_and_size(Check&& check) {
  for (int k = 0; const DenseKernels* kernels = dense_kernels(k); ++k)
    for (int p = 1; p <= 34; p += p < 28 ? 1 : 3)
      for (const int u : {0, 1, 2, 3, 5, 6, 7, 8, 9, 12, 15, 16, 17, 23, 24, 31, 50}) {
        BOOST_TEST_CONTEXT("kernels " << k << ", p = " << p << ", u = " << u) { check(*kernels, p, u); }
      }
}

}  // namespace

BOOST_AUTO_TEST_SUITE(dense_kernels_of_all_instruction_sets)

BOOST_AUTO_TEST_CASE(factors_of_a_front_solve_it_with_pivots_far_from_the_diagonal) {
  Random random(3);
  for_each_kernel_and_size([&](const DenseKernels& kernels, int p, int u) {
    // No diagonal to lean on: without pivoting rounding would grow by many digits.
    const Matrix matrix = random.matrix(p + u, p + u);
    const Eigen::FullPivLU<Matrix> reference(matrix);
    if (reference.rcond() < 1e-5 || matrix.topLeftCorner(p, p).fullPivLu().rcond() < 1e-4) return;
    const Vector x = random.vector(p + u), rhs = matrix * x;
    const Matrix schur = matrix.bottomRightCorner(u, u) -
                         matrix.bottomLeftCorner(u, p) *
                             matrix.topLeftCorner(p, p).fullPivLu().solve(Matrix(matrix.topRightCorner(p, u)));
    for (const bool on_diagonal : {false, true}) {  // which small pivots still leave
      const double allowed = on_diagonal ? 1e-6 : 1e-8;
      Front front(matrix, p);
      front.factor(kernels, on_diagonal);
      BOOST_TEST(front.sign == (matrix.topLeftCorner(p, p).determinant() > 0.0 ? 1 : -1));
      BOOST_TEST((front.solve(kernels, rhs) - x).norm() <= allowed * x.norm());
      BOOST_TEST((front.s - schur).norm() <= allowed * (1.0 + schur.norm()));
    }
  });
}

BOOST_AUTO_TEST_CASE(factors_of_a_symmetric_front_solve_it_and_read_its_lower_triangle_only) {
  Random random(4);
  for_each_kernel_and_size([&](const DenseKernels& kernels, int p, int u) {
    const Matrix root = random.matrix(p + u, p + u);
    const Matrix matrix = root * root.transpose() + 0.1 * Matrix::Identity(p + u, p + u);
    Front front(matrix, p);
    front.factor_symmetric(kernels);
    BOOST_TEST(front.sign == 1);
    front.s = Matrix(front.s.selfadjointView<Eigen::Lower>());
    const Vector x = random.vector(p + u), rhs = matrix * x;
    BOOST_TEST((front.solve(kernels, rhs) - x).norm() <= 1e-9 * x.norm());
    Front indefinite(matrix, p);
    indefinite.l(p - 1, p - 1) -= 2.0 * matrix(p - 1, p - 1);  // its last pivot falls by as much
    indefinite.factor_symmetric(kernels);
    BOOST_TEST(indefinite.sign == 0);
  });
}

BOOST_AUTO_TEST_CASE(a_front_without_inverse_is_refused) {
  for_each_kernel_and_size([&](const DenseKernels& kernels, int p, int u) {
    Matrix matrix = Matrix::Identity(p + u, p + u);
    for (const double pivot : {0.0, kNan})
      for (const bool on_diagonal : {false, true}) {
        matrix(p - 1, p - 1) = pivot;
        Front front(matrix, p);
        front.factor(kernels, on_diagonal);
        BOOST_TEST(front.sign == 0);
      }
  });
}

BOOST_AUTO_TEST_CASE(a_product_of_blocks_is_that_of_the_matrix) {
  Random random(5);
  const int first[] = {0, 2, 3, 6};
  const int columns[] = {0, 2, 1, 0, 1, 2};
  for (int k = 0; const DenseKernels* kernels = dense_kernels(k); ++k) {
    Matrix matrix = Matrix::Zero(9, 9);
    std::vector<double> values;
    std::vector<DenseKernels::BlockAt> blocks;
    for (int row = 0; row < 3; ++row)
      for (int b = first[row]; b < first[row + 1]; ++b) {
        const Matrix block = random.matrix(3, 3);
        matrix.block(3 * row, 3 * columns[b], 3, 3) = block;
        blocks.push_back({3 * columns[b], static_cast<long long>(values.size())});
        values.insert(values.end(), block.data(), block.data() + 9);
      }
    const Vector x = random.vector(9);
    Vector y = Vector::Constant(10, 7.0);  // of which the last one is not its business
    kernels->multiply_blocks(3, first, blocks.data(), values.data(), x.data(), y.data());
    BOOST_TEST((y.head(9) - matrix * x).norm() < 1e-14);
    BOOST_TEST(y[9] == 7.0);
  }
}

BOOST_AUTO_TEST_SUITE_END()
