#include "signorini/problem/constraint_set.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

const std::vector<double> kFrictions = {0.0, 1e-6, 0.3, 1.0, 3.0, 1e6};

ConstraintSets one_cone(double friction) { return ConstraintSets::friction_cones(Vector::Constant(1, friction)); }

ConstraintSets one_of_each(double friction) {
  ConstraintSets sets;
  sets.add_friction_cone(friction);
  sets.add_half_line();
  sets.add_interval(-0.25, 0.5);
  sets.add_equality(2);
  return sets;
}

Vector projected(const ConstraintSets& sets, const Vector& x) {
  Vector out(x.size());
  sets.project(x, out);
  return out;
}

Vector projected_dual(const ConstraintSets& sets, const Vector& x) {
  Vector out(x.size());
  sets.project_dual(x, out);
  return out;
}

}  // namespace

BOOST_AUTO_TEST_CASE(friction_cone_closed_forms) {
  const ConstraintSets sets = one_cone(0.5);
  BOOST_TEST((projected(sets, vector3(0.1, 0.2, 1.0)) - vector3(0.1, 0.2, 1.0)).norm() == 0.0);  // inside
  BOOST_TEST(projected(sets, vector3(0.3, 0.4, -1.0)).norm() == 0.0);                            // in the polar cone
  BOOST_TEST((projected(sets, vector3(1.0, 0.0, 0.0)) - vector3(0.2, 0.0, 0.4)).norm() <= 1e-15);
  BOOST_TEST((projected(sets, vector3(0.0, -2.0, 1.0)) - vector3(0.0, -0.8, 1.6)).norm() <= 1e-15);
}

BOOST_AUTO_TEST_CASE(without_friction_the_cone_is_a_ray) {
  const ConstraintSets sets = one_cone(0.0);
  BOOST_TEST((projected(sets, vector3(3.0, -4.0, 2.0)) - vector3(0.0, 0.0, 2.0)).norm() == 0.0);
  BOOST_TEST(projected(sets, vector3(3.0, -4.0, -2.0)).norm() == 0.0);
  BOOST_TEST((projected_dual(sets, vector3(3.0, -4.0, -2.0)) - vector3(3.0, -4.0, 0.0)).norm() == 0.0);
}

BOOST_AUTO_TEST_CASE(projection_is_in_the_set_idempotent_and_nonexpansive) {
  Random random(1);
  for (const double mu : kFrictions) {
    const ConstraintSets sets = one_of_each(mu);
    for (int trial = 0; trial < 300; ++trial) {
      const double size = std::pow(10.0, random.uniform(-6.0, 6.0));
      const Vector x = random.vector(sets.size(), size), y = random.vector(sets.size(), size);
      const Vector px = projected(sets, x), py = projected(sets, y);
      BOOST_TEST(px.head(2).norm() <= mu * px[2] * (1.0 + 1e-12) + 1e-300);
      BOOST_TEST(px[3] >= 0.0);
      BOOST_TEST((px[4] >= -0.25 && px[4] <= 0.5));
      BOOST_TEST(px.tail(2) == x.tail(2));
      BOOST_TEST((projected(sets, px) - px).norm() <= 1e-12 * px.norm());
      BOOST_TEST((px - py).norm() <= (x - y).norm() * (1.0 + 1e-12));
    }
  }
}

BOOST_AUTO_TEST_CASE(moreau_splits_a_vector_into_orthogonal_parts) {
  Random random(2);
  for (const double mu : kFrictions) {
    const ConstraintSets sets = one_cone(mu);
    for (int trial = 0; trial < 300; ++trial) {
      const Vector x = random.vector(3, std::pow(10.0, random.uniform(-3.0, 3.0)));
      const Vector part = projected(sets, x), dual = projected_dual(sets, -x);
      const double tolerance = 1e-12 * x.norm();
      BOOST_TEST((x - (part - dual)).norm() <= tolerance);                       // x = P_K(x) - P_K*(-x)
      BOOST_TEST(std::abs(part.dot(dual)) <= 1e-9 * x.squaredNorm());            // orthogonal
      BOOST_TEST(mu * dual.head(2).norm() <= dual[2] + (1.0 + mu) * tolerance);  // in K*
    }
  }
}

BOOST_AUTO_TEST_CASE(dual_of_the_other_sets) {
  const ConstraintSets sets = one_of_each(0.5);
  Vector x(7);
  x << 0.0, 0.0, 1.0, -2.0, -3.0, 4.0, -5.0;
  const Vector dual = projected_dual(sets, x);
  BOOST_TEST(dual[3] == 0.0);              // half line: s >= 0
  BOOST_TEST(dual[4] == -3.0);             // interval: any velocity has its impulse
  BOOST_TEST(dual.tail(2).norm() == 0.0);  // equality: s = 0
}

BOOST_AUTO_TEST_CASE(projection_in_place_and_nan) {
  Random random(3);
  const ConstraintSets sets = one_of_each(0.4);
  Vector x = random.vector(sets.size(), 2.0);
  const Vector expected = projected(sets, x);
  sets.project(x, x);
  BOOST_TEST(x == expected);
  for (Index i = 0; i < sets.size(); ++i) {
    Vector bad = Vector::Ones(sets.size());
    bad[i] = kNan;
    BOOST_TEST(!projected(sets, bad).allFinite());
    if (i != 4) BOOST_TEST(!projected_dual(sets, bad).allFinite());
  }
}

BOOST_AUTO_TEST_CASE(rows_are_laid_out_in_order) {
  const ConstraintSets sets = one_of_each(0.5);
  BOOST_TEST(sets.size() == 7);
  BOOST_TEST(sets.num_sets() == 5);
  BOOST_TEST(sets.num_contacts() == 1);
  BOOST_TEST(sets[1].offset == 3);
  BOOST_TEST(sets[4].offset == 6);
}

BOOST_AUTO_TEST_CASE(bad_sets_are_refused_by_name) {
  for (const double mu : {-1e-9, kNan, kInfinity, 1e7}) {
    BOOST_TEST(refused_field([&] { one_cone(mu); }) == "friction[0]");
  }
  Vector friction(3);
  friction << 0.5, 0.5, -1.0;
  BOOST_TEST(refused_field([&] { ConstraintSets::friction_cones(friction); }) == "friction[2]");
  ConstraintSets sets;
  BOOST_TEST(refused_field([&] { sets.add_interval(1.0, 0.0); }) == "constraints[0]");
  BOOST_TEST(refused_field([&] { sets.add_interval(kNan, 0.0); }) == "constraints[0]");
  BOOST_TEST(refused_field([&] { sets.add_interval(0.0, kNan); }) == "constraints[0]");
  BOOST_TEST(refused_field([&] { sets.add_interval(kInfinity, kInfinity); }) == "constraints[0]");
  BOOST_TEST(refused_field([&] { sets.add_equality(-1); }) == "count");
  BOOST_TEST(sets.size() == 0);
  sets.add_interval(-kInfinity, kInfinity);
  BOOST_TEST(sets.size() == 1);
  ConstraintSet set;
  set.friction = kNan;
  sets.add(set);
  BOOST_TEST(refused_field([&] { ContactProblem(dense(Matrix::Identity(4, 4)), Vector::Zero(4), sets); }) ==
             "friction[0]");
  Vector out(4);
  BOOST_TEST(refused_field([&] { sets.project(Vector::Zero(5), out); }) == "x");
}

BOOST_AUTO_TEST_CASE(a_move_leaves_no_half_sets) {
  ConstraintSets sets = one_of_each(0.5);
  const ConstraintSets moved = std::move(sets);
  BOOST_TEST(moved.num_sets() == 5);
  BOOST_TEST((sets.size() == 0) == (sets.num_sets() == 0));
}
