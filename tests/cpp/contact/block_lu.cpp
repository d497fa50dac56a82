#include "../../../src/delassus/block_lu.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <boost/test/unit_test.hpp>
#include <vector>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

int whole(Random& random, int lower, int upper) { return static_cast<int>(random.uniform(lower, upper + 1.0)); }

/// Patterns of blocks: all apart, all tied, a chain, a tree, a grid, at random; blocks in any order.
BlockLists pattern(int count, int kind, Random& random) {
  std::vector<int> name(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) name[i] = i;
  for (int i = count - 1; i > 0; --i) std::swap(name[i], name[whole(random, 0, i)]);
  std::vector<std::vector<bool>> tied(name.size(), std::vector<bool>(name.size(), false));
  const auto tie = [&](int a, int b) { tied[std::max(name[a], name[b])][std::min(name[a], name[b])] = true; };
  for (int i = 1; i < count; ++i) {
    if (kind == 1)
      for (int j = 0; j < i; ++j) tie(i, j);
    if (kind == 2 || (kind == 4 && i % 5 != 0)) tie(i, i - 1);
    if (kind == 3) tie(i, whole(random, 0, i - 1));
    if (kind == 4 && i >= 5) tie(i, i - 5);
    if (kind == 5)
      for (int j = 0; j < i; ++j)
        if (random.uniform(0.0, 1.0) < 0.15) tie(i, j);
  }
  BlockLists neighbours;
  for (int j = 0; j < count; ++j) {
    for (int i = j + 1; i < count; ++i)
      if (tied[i][j]) neighbours.items.push_back(i);
    neighbours.first.push_back(static_cast<int>(neighbours.items.size()));
  }
  return neighbours;
}

/// Random values of a matrix with blocks of these sizes; what no block has is NaN in lu.values(), 0 in the matrix.
Matrix fill(BlockLu& lu, const std::vector<int>& offsets, const std::vector<int>& sizes, bool symmetric,
            Random& random) {
  Matrix matrix = Matrix::Zero(lu.size(), lu.size());
  for (const BlockLu::Pair& pair : lu.pairs()) {
    matrix.block(offsets[pair.i], offsets[pair.j], sizes[pair.i], sizes[pair.j]) =
        random.matrix(sizes[pair.i], sizes[pair.j]);
    if (pair.i != pair.j)
      matrix.block(offsets[pair.j], offsets[pair.i], sizes[pair.j], sizes[pair.i]) =
          random.matrix(sizes[pair.j], sizes[pair.i]);
  }
  if (symmetric) {
    matrix = Matrix(matrix + matrix.transpose());
    matrix.diagonal() = matrix.cwiseAbs().rowwise().sum() + Vector::Constant(matrix.rows(), 0.1);
  }
  std::fill(lu.values().begin(), lu.values().end(), kNan);
  const auto put = [&](int i, int j, Index start) {
    Eigen::Map<Matrix>(lu.values().data() + start, sizes[i], sizes[j]) =
        matrix.block(offsets[i], offsets[j], sizes[i], sizes[j]);
  };
  for (const BlockLu::Pair& pair : lu.pairs()) put(pair.i, pair.j, pair.lower), put(pair.j, pair.i, pair.upper);
  return matrix;
}

}  // namespace

BOOST_AUTO_TEST_SUITE(block_lu)

BOOST_AUTO_TEST_CASE(any_pattern_is_solved_and_blocks_may_shrink_to_nothing) {
  Random random(6);
  int solved = 0;
  BlockLu lu;
  for (int count = 0; count <= 65; count += count == 30 ? 34 : 1)  // 64 and 65: with and without the bits of a word
    for (int kind = 0; kind < 6; ++kind) {
      std::vector<int> room, offsets;
      int size = 0;
      for (int j = 0; j < count; ++j) {
        const double choice = random.uniform(0.0, 1.0);
        room.push_back(choice < 0.6 || count > 30 ? 3 : choice < 0.7 ? 0 : whole(random, 1, 18));
        offsets.push_back(size);
        size += room.back();
      }
      lu.analyze(room, pattern(count, kind, random));
      BOOST_REQUIRE(lu.size() == size);
      for (int round = 0; round < 4; ++round) {
        std::vector<int> sizes = room;
        for (int& one : sizes)
          if (round == 3 || (round > 0 && random.uniform(0.0, 1.0) < 0.5)) one = round == 1 ? whole(random, 0, one) : 0;
        lu.set_sizes(sizes);
        std::vector<Index> rows;
        for (int j = 0; j < count; ++j)
          for (int r = 0; r < sizes[j]; ++r) rows.push_back(offsets[j] + r);
        const auto n = static_cast<Index>(rows.size());
        for (const bool symmetric : {false, true}) {
          const Matrix matrix = fill(lu, offsets, sizes, symmetric, random);
          Matrix kept(n, n);
          for (Index c = 0; c < n; ++c)
            for (Index r = 0; r < n; ++r) kept(r, c) = matrix(rows[r], rows[c]);
          const Eigen::FullPivLU<Matrix> reference(n > 0 ? kept : Matrix(Matrix::Identity(1, 1)));
          if (n > 0 && reference.rcond() < 1e-8) continue;  // pivots are sought inside supernodes alone
          BOOST_TEST_CONTEXT("count " << count << ", kind " << kind << ", round " << round << ", " << symmetric) {
            BOOST_REQUIRE((symmetric ? lu.factor_symmetric() : lu.factor()));
            Vector rhs = Vector::Constant(size, 7.0), x(n);
            const Vector right = random.vector(n);
            for (Index k = 0; k < n; ++k) rhs[rows[k]] = right[k];
            lu.solve(rhs);
            for (Index k = 0; k < n; ++k) x[k] = rhs[rows[k]], rhs[rows[k]] = 7.0;
            BOOST_TEST((kept * x - right).norm() <= 1e-8 * (kept.norm() * x.norm() + right.norm()));
            BOOST_TEST((rhs.array() == 7.0).all());  // rows that are not there are left alone
            BOOST_TEST(lu.determinant_sign() == (n == 0 || reference.determinant() > 0.0 ? 1 : -1));
            ++solved;
          }
        }
      }
    }
  BOOST_TEST(solved > 1000);
}

BOOST_AUTO_TEST_CASE(what_has_no_inverse_is_refused_wherever_it_is) {
  Random random(7);
  for (const double bad : {0.0, kNan, kInfinity})
    for (int at = 0; at < 12; ++at) {
      const std::vector<int> sizes(12, 3);
      std::vector<int> offsets;
      for (int j = 0; j < 12; ++j) offsets.push_back(3 * j);
      BlockLu lu;
      lu.analyze(sizes, pattern(12, 2, random));
      fill(lu, offsets, sizes, true, random);
      for (const BlockLu::Pair& pair : lu.pairs()) {
        if (pair.i != at && pair.j != at) continue;  // a row and a column of zeros, with something on the diagonal
        for (int k = 0; k < 3; ++k) {
          if (pair.i == at) lu.values()[pair.lower + 3 * k + 1] = lu.values()[pair.upper + 3 + k] = 0.0;
          if (pair.j == at) lu.values()[pair.lower + 3 + k] = lu.values()[pair.upper + 3 * k + 1] = 0.0;
        }
        if (pair.i == pair.j) lu.values()[pair.lower + 4] = bad;
      }
      BOOST_TEST(!lu.factor());
      BOOST_TEST(lu.determinant_sign() == 0);
      BOOST_TEST(!lu.factor_symmetric());
      BOOST_TEST(lu.determinant_sign() == 0);
    }
}

BOOST_AUTO_TEST_CASE(what_is_assembled_is_factored_again_with_other_diagonal_blocks) {
  Random random(7);
  for (int kind = 0; kind < 6; ++kind) {
    std::vector<int> sizes, offsets;
    int size = 0;
    for (int j = 0; j < 12; ++j) {
      sizes.push_back(random.uniform(0.0, 1.0) < 0.7 ? 3 : 1);
      offsets.push_back(size);
      size += sizes.back();
    }
    BlockLu lu;
    lu.analyze(sizes, pattern(12, kind, random));
    const Matrix matrix = fill(lu, offsets, sizes, false, random);
    const std::vector<double> values = lu.values();
    std::vector<double> fronts(static_cast<std::size_t>(lu.num_factor_entries()));
    lu.assemble(values.data(), fronts.data());
    std::fill(lu.values().begin(), lu.values().end(), kNan);  // not looked at
    for (int round = 0; round < 3; ++round) {
      BlockDiagonal added;
      Matrix sum = matrix;
      for (int j = 0; j < 12; ++j) {
        added.emplace_back(random.matrix(3, 3));
        sum.block(offsets[j], offsets[j], sizes[j], sizes[j]) += added.back().topLeftCorner(sizes[j], sizes[j]);
      }
      BOOST_REQUIRE(lu.factor(fronts.data(), added, round == 0));
      const Vector right = random.vector(size);
      Vector x = right;
      lu.solve(x);
      BOOST_TEST((sum * x - right).norm() <= 1e-8 * (sum.norm() * x.norm() + right.norm()));
    }
  }
}

BOOST_AUTO_TEST_SUITE_END()
