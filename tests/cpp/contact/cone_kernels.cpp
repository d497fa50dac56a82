#include "../../../src/solver/cone_kernels.hpp"

#include <boost/test/unit_test.hpp>
#include <vector>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

using Vector3 = Eigen::Vector3d;

constexpr int kCones = 13;  // of 16 places

Vector3 get(const ConeBlock::Row (&rows)[3], int i) {
  const int k = i % ConeBlock::kWidth;
  return {rows[0][k], rows[1][k], rows[2][k]};
}

void put(ConeBlock::Row (&rows)[3], int i, const Vector3& v) {
  for (int r = 0; r < 3; ++r) rows[r][i % ConeBlock::kWidth] = v[r];
}

double determinant(const Vector3& x) { return x[0] * x[0] - x.tail<2>().squaredNorm(); }

Vector3 jordan(const Vector3& a, const Vector3& b) {
  return {a.dot(b), a[0] * b[1] + b[0] * a[1], a[0] * b[2] + b[0] * a[2]};
}

/// Points in the cone, as near the boundary as the interior point comes; the last ones lines.
std::vector<ConeBlock> random_cones(std::uint64_t seed) {
  Random random(seed);
  std::vector<ConeBlock> blocks(2, ConeBlock());
  for (int i = 0; i < 2 * ConeBlock::kWidth; ++i) {
    ConeBlock& block = blocks[static_cast<std::size_t>(i / ConeBlock::kWidth)];
    block.x[0][i % 8] = block.z[0][i % 8] = 1.0;
    put(block.centre, i, Vector3::Ones());
    if (i >= kCones) continue;
    block.weight[i % 8] = 1.0;
    for (auto* rows : {&block.x, &block.z}) {
      Vector3 v = random.vector(3, std::pow(10.0, random.uniform(-3.0, 3.0)));
      if (i >= kCones - 3) v.tail<2>().setZero();
      v[0] = v.tail<2>().norm() * (1.0 + std::pow(10.0, random.uniform(-6.0, 1.0))) + (i >= kCones - 3 ? 0.1 : 0.0);
      put(*rows, i, v);
    }
    for (auto* rows : {&block.dx, &block.centre}) {
      Vector3 v = random.vector(3);
      if (i >= kCones - 3) v.tail<2>().setZero();
      put(*rows, i, v);
    }
  }
  return blocks;
}

template <class Check>
void for_each_kernel(Check&& check) {
  for (int k = 0; const ConeKernels* kernels = cone_kernels(k); ++k)
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      std::vector<ConeBlock> blocks = random_cones(seed);
      kernels->scalings(2, blocks.data());
      BOOST_TEST_CONTEXT("kernels " << k << ", seed " << seed) { check(*kernels, blocks); }
    }
}

struct Cone {
  Vector3 x, z, dx, dz, centre, w, lambda;
  Eigen::Matrix3d h, root;  // H; W
  double eta;
  explicit Cone(const std::vector<ConeBlock>& blocks, int i) {
    const ConeBlock& b = blocks[static_cast<std::size_t>(i / ConeBlock::kWidth)];
    const int k = i % ConeBlock::kWidth;
    x = get(b.x, i), z = get(b.z, i), dx = get(b.dx, i), dz = get(b.dz, i), centre = get(b.centre, i);
    w = get(b.w, i), lambda = get(b.lambda, i), eta = b.eta[k];
    h << b.h[0][k], b.h[1][k], b.h[2][k], b.h[1][k], b.h[3][k], b.h[4][k], b.h[2][k], b.h[4][k], b.h[5][k];
    root.row(0) = w;
    root.col(0) = w;
    root.bottomRightCorner<2, 2>() = Eigen::Matrix2d::Identity() + w.tail<2>() * w.tail<2>().transpose() / (1.0 + w[0]);
    root *= eta;
  }
};

}  // namespace

BOOST_AUTO_TEST_SUITE(cone_kernels_of_all_instruction_sets)

BOOST_AUTO_TEST_CASE(the_scaling_takes_impulse_and_velocity_to_the_same_point) {
  for_each_kernel([](const ConeKernels&, const std::vector<ConeBlock>& blocks) {
    for (int i = 0; i < kCones; ++i) {
      const Cone c(blocks, i);
      BOOST_TEST((c.root * c.z - c.lambda).norm() <= 1e-7 * c.lambda.norm());           // W z = lambda
      BOOST_TEST((c.root * c.lambda - c.x).norm() <= 1e-7 * c.x.norm());                // W^-1 x = lambda
      BOOST_TEST((c.root * c.h * c.root - Eigen::Matrix3d::Identity()).norm() < 1e-3);  // H = W^-2, near the boundary
      BOOST_TEST(c.x.dot(c.z) == c.lambda.squaredNorm(), boost::test_tools::tolerance(1e-9));
    }
  });
}

BOOST_AUTO_TEST_CASE(the_corrector_solves_its_equation) {
  for_each_kernel([](const ConeKernels& kernels, std::vector<ConeBlock>& blocks) {
    for (int i = 0; i < kCones; ++i) put(blocks[static_cast<std::size_t>(i / 8)].dz, i, Vector3(0.3, 0.0, 0.0));
    kernels.corrector(2, blocks.data(), 0.7);
    for (int i = 0; i < kCones; ++i) {
      const Cone c(blocks, i);
      const Vector3 scaled_dx = c.root.inverse() * c.dx, scaled_dz = c.root * c.dz;
      const Vector3 right = Vector3(0.7, 0.0, 0.0) - jordan(scaled_dx, scaled_dz) - jordan(c.lambda, c.lambda);
      const Vector3 left = jordan(c.lambda, c.root * c.centre);
      BOOST_TEST((left - right).norm() <=
                 1e-5 * (1.0 + right.norm() + c.lambda.norm() * c.root.norm() * c.centre.norm()));
    }
  });
}

BOOST_AUTO_TEST_CASE(the_longest_step_ends_on_the_boundary_of_a_cone) {
  for_each_kernel([](const ConeKernels& kernels, std::vector<ConeBlock>& blocks) {
    kernels.dual_direction(2, blocks.data());
    const double step = kernels.longest_step(2, blocks.data());
    double nearest = kInfinity, sum = 0.0;
    for (int i = 0; i < kCones; ++i) {
      const Cone c(blocks, i);
      BOOST_TEST((c.dz - (c.centre - c.h * c.dx)).norm() <= 1e-9 * (c.centre.norm() + c.h.norm() * c.dx.norm()));
      sum += (c.x + 0.1 * step * c.dx).dot(c.z + 0.1 * step * c.dz);
      for (const auto& [x, dx] : {std::pair(c.x, c.dx), std::pair(c.z, c.dz)}) {
        for (const double share : {0.5, 0.999}) {
          const Vector3 inside = x + share * step * dx;
          BOOST_TEST((inside[0] > 0.0 && determinant(inside) > -1e-9 * inside.squaredNorm()));
        }
        const Vector3 end = x + step * dx;
        nearest = std::min(nearest, std::abs(determinant(end)) / (x.squaredNorm() + step * step * dx.squaredNorm()));
      }
    }
    BOOST_TEST(nearest < 1e-9);
    BOOST_TEST(kernels.complementarity(2, blocks.data(), 0.1 * step) == sum, boost::test_tools::tolerance(1e-9));
    for (int i = kCones; i < 2 * ConeBlock::kWidth; ++i) BOOST_TEST(Cone(blocks, i).dz.norm() == 0.0);  // not there
  });
}

BOOST_AUTO_TEST_CASE(without_a_boundary_ahead_the_step_has_no_end) {
  for (int k = 0; const ConeKernels* kernels = cone_kernels(k); ++k) {
    std::vector<ConeBlock> blocks = random_cones(1);
    for (ConeBlock& block : blocks)
      for (int i = 0; i < ConeBlock::kWidth; ++i) {
        put(block.dx, i, Vector3(1.0, 0.5, -0.5));
        put(block.dz, i, Vector3::Zero());
      }
    kernels->scalings(2, blocks.data());
    BOOST_TEST(kernels->longest_step(2, blocks.data()) == kInfinity);
  }
}

BOOST_AUTO_TEST_CASE(the_natural_maps_of_many_contacts_are_those_of_each) {
  for (int k = 0; const ConeKernels* kernels = cone_kernels(k); ++k)
    for (const bool de_saxce : {false, true})
      for (int n = 8; n <= 25; ++n) {
        Random random(static_cast<std::uint64_t>(n));
        Vector l = random.vector(3 * n), t = random.vector(3 * n), friction(2 * n), natural(3 * n);
        for (int i = 0; i < n; ++i) {
          friction[2 * i] = random.uniform(0.0, 1.0) < 0.2 ? 0.0 : random.uniform(0.0, 2.0);
          const double choice = random.uniform(0.0, 1.0);  // pressed hard, flung off, at rest without an impulse
          if (choice < 0.3) l[3 * i + 2] += 5.0;
          if (choice > 0.7) t[3 * i + 2] += 5.0;
          if (choice > 0.45 && choice < 0.55) l.segment<3>(3 * i).setZero(), t.segment<3>(3 * i).setZero();
        }
        double error = 0.0, size = 0.0, found = 0.0;
        const double largest =
            kernels->natural_map(n, friction.data(), 2, de_saxce, l.data(), t.data(), natural.data(), found);
        for (int i = 0; i < n; ++i) {
          Vector3 a = (l - t).segment<3>(3 * i);
          if (de_saxce) a[2] -= friction[2 * i] * t.segment<2>(3 * i).norm();
          project_friction_cone(friction[2 * i], a.data(), a.data());
          const Vector3 e = l.segment<3>(3 * i) - a;
          BOOST_TEST((natural.segment<3>(3 * i) - e).norm() <= 1e-14 * (1.0 + l.norm()));
          error = std::max(error, e.squaredNorm()), size = std::max(size, l.segment<3>(3 * i).squaredNorm());
        }
        BOOST_TEST(largest == error, boost::test_tools::tolerance(1e-12));
        BOOST_TEST(found == size, boost::test_tools::tolerance(1e-12));
        for (const int bad : {0, n - 1}) {
          Vector with_nan = l;
          with_nan[3 * bad + 1] = kNan;
          BOOST_TEST(std::isnan(
              kernels->natural_map(n, friction.data(), 2, de_saxce, with_nan.data(), t.data(), natural.data(), found)));
        }
      }
}

BOOST_AUTO_TEST_SUITE_END()
