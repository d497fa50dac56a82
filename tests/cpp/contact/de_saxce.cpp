#include "signorini/problem/de_saxce.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

/// Two contacts of friction 0.5 and 2 with a half line between them.
ConstraintSets sets_with_a_half_line() {
  ConstraintSets sets;
  sets.add_friction_cone(0.5);
  sets.add_half_line();
  sets.add_friction_cone(2.0);
  return sets;
}

}  // namespace

BOOST_AUTO_TEST_CASE(correction_is_friction_times_sliding_speed_along_the_normal) {
  const ConstraintSets sets = sets_with_a_half_line();
  Vector velocity(7), expected(7), correction(7);
  velocity << 3.0, -4.0, -7.0, 9.0, 0.0, 0.25, 1.0;
  expected << 0.0, 0.0, 2.5, 0.0, 0.0, 0.0, 0.5;
  de_saxce_correction(sets, Law::Ncp, velocity, correction);
  BOOST_TEST(correction == expected);
  Vector sum = velocity;
  add_de_saxce_correction(sets, Law::Ncp, sum);
  BOOST_TEST(sum == Vector(velocity + expected));
}

BOOST_AUTO_TEST_CASE(the_relaxation_has_none) {
  const ConstraintSets sets = sets_with_a_half_line();
  const Vector velocity = Random(4).vector(7);
  Vector correction = Vector::Ones(7), sum = velocity;
  de_saxce_correction(sets, Law::Ccp, velocity, correction);
  add_de_saxce_correction(sets, Law::Ccp, sum);
  BOOST_TEST(correction.norm() == 0.0);
  BOOST_TEST(sum == velocity);
}

BOOST_AUTO_TEST_CASE(correction_is_positively_homogeneous) {
  const ConstraintSets sets = sets_with_a_half_line();
  const Vector velocity = Random(5).vector(7);
  Vector once(7), scaled(7);
  de_saxce_correction(sets, Law::Ncp, velocity, once);
  de_saxce_correction(sets, Law::Ncp, 1e-9 * velocity, scaled);
  BOOST_TEST((scaled - 1e-9 * once).norm() <= 1e-15 * scaled.norm());
}
