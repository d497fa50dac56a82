#include "signorini/solver/anderson.hpp"

#include <boost/test/unit_test.hpp>
#include <functional>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// Steps from 0 until |T(x) - x| <= tolerance.
int steps_to_fixed_point(const std::function<Vector(const Vector&)>& map, Index n, int memory, double tolerance,
                         int limit = 100000) {
  Anderson anderson;
  anderson.setup(n, memory);
  Vector x = Vector::Zero(n), next(n);
  for (int k = 0; k < limit; ++k) {
    const Vector image = map(x);
    if ((image - x).norm() <= tolerance) return k;
    anderson.step(x, image, next);
    x = next;
  }
  return limit;
}

}  // namespace

BOOST_AUTO_TEST_CASE(without_memory_it_is_the_map) {
  Anderson anderson;
  anderson.setup(3, 0);
  Vector next(3);
  anderson.step(vector3(1.0, 2.0, 3.0), vector3(4.0, 5.0, 6.0), next);
  BOOST_TEST(next == vector3(4.0, 5.0, 6.0));
}

BOOST_AUTO_TEST_CASE(a_linear_map_needs_as_many_steps_as_it_has_unknowns) {
  Vector rates(5);
  rates << 0.999, 0.99, 0.9, 0.5, -0.5;
  const auto map = [&](const Vector& x) { return Vector(rates.cwiseProduct(x) + Vector::Ones(5)); };
  BOOST_TEST(steps_to_fixed_point(map, 5, 10, 1e-6) <= 15);
  BOOST_TEST(steps_to_fixed_point(map, 5, 0, 1e-6) >= 5000);
}

BOOST_AUTO_TEST_CASE(a_map_that_converges_by_itself_still_does) {
  // A projected contraction whose active set changes on the way: extrapolations overshoot.
  Random random(31);
  const Matrix root = random.matrix(12, 12);
  const Matrix a = root * root.transpose() + 1e-2 * Matrix::Identity(12, 12);
  const Vector b = random.vector(12);
  const double step = 1.0 / a.norm();
  const auto map = [&](const Vector& x) { return Vector((x - step * (a * x + b)).cwiseMax(0.0)); };
  const int plain = steps_to_fixed_point(map, 12, 0, 1e-10), accelerated = steps_to_fixed_point(map, 12, 5, 1e-10);
  BOOST_TEST(plain < 100000);
  BOOST_TEST(accelerated < plain);
}

BOOST_AUTO_TEST_CASE(an_extrapolation_that_makes_it_worse_is_undone) {
  // x -> x / 2 away from 0, but for a trap where extrapolation lands: T jumps there.
  Anderson anderson;
  anderson.setup(1, 3);
  Vector x = Vector::Constant(1, 8.0), image = 0.5 * x, next(1);
  anderson.step(x, image, next);
  BOOST_TEST(next[0] == 4.0);  // no history: plain
  x = next, image = 0.5 * x;
  anderson.step(x, image, next);
  BOOST_TEST(std::abs(next[0]) <= 1e-6);  // the fixed point of a linear map
  const Vector plain = image;
  anderson.step(next, Vector::Constant(1, 100.0), x);
  BOOST_TEST(x[0] == plain[0]);
  // and plain steps follow
  image = 0.5 * x;
  anderson.step(x, image, next);
  x = next, image = 0.5 * x;
  anderson.step(x, image, next);
  BOOST_TEST(next[0] == image[0]);
}

BOOST_AUTO_TEST_CASE(nan_does_not_extrapolate) {
  Anderson anderson;
  anderson.setup(1, 3);
  Vector next(1);
  anderson.step(Vector::Constant(1, 8.0), Vector::Constant(1, 4.0), next);
  anderson.step(Vector::Constant(1, 4.0), Vector::Constant(1, 2.0), next);
  anderson.step(Vector(next), Vector::Constant(1, kNan), next);
  BOOST_TEST(next[0] == 2.0);
}

BOOST_AUTO_TEST_CASE(restarted_for_fewer_unknowns_it_is_as_if_made_for_them) {
  Anderson used, fresh;
  used.setup(12, 3);
  fresh.setup(5, 3);
  Random random(32);
  for (int k = 0; k < 6; ++k) {
    Vector next(12);
    used.step(random.vector(12), random.vector(12), next);
  }
  used.restart(5);
  Vector rates(5);
  rates << 0.999, 0.99, 0.9, 0.5, -0.5;
  Vector x = Vector::Ones(5), next(5), expected(5);
  for (int k = 0; k < 8; ++k) {
    const Vector image = rates.cwiseProduct(x);
    used.step(x, image, next);
    fresh.step(x, image, expected);
    BOOST_TEST(next == expected);
    x = next;
  }
}
