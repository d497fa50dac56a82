#include "signorini/solver/penalty_rule.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

AdmmSettings with_rule(PenaltyRule rule) {
  AdmmSettings settings;
  settings.penalty_rule = rule;
  settings.spectral_exponent = 0.3;
  settings.spectral_increment = 0.05;
  settings.linear_factor = 4.0;
  settings.ratio = 10.0;
  return settings;
}

Penalty started(PenaltyRule rule, double penalty = 0.0, double m = 1e-4, double L = 100.0) {
  Penalty rho;
  rho.start(with_rule(rule), m, L, penalty);
  return rho;
}

bool close(double a, double b) { return std::abs(a - b) <= 1e-12 * std::abs(b); }

}  // namespace

BOOST_AUTO_TEST_CASE(spectral_rule_follows_equation_46) {
  Penalty rho = started(PenaltyRule::Spectral);
  BOOST_TEST(close(rho.value(), 0.1 * std::pow(1e6, 0.3)));
  BOOST_TEST(!rho.update(9.0, 1.0, 1.0, 1.0));  // inside the tube
  BOOST_TEST(!rho.update(1.0, 9.0, 1.0, 1.0));
  BOOST_TEST(rho.update(10.0, 1.0, 1.0, 1.0));
  BOOST_TEST(close(rho.value(), 0.1 * std::pow(1e6, 0.35)));
  BOOST_TEST(rho.update(1.0, 10.0, 1.0, 1.0));
  BOOST_TEST(rho.update(1.0, 10.0, 1.0, 1.0));
  BOOST_TEST(close(rho.value(), 0.1 * std::pow(1e6, 0.25)));
}

BOOST_AUTO_TEST_CASE(spectral_rule_goes_on_from_a_given_penalty) {
  Penalty rho = started(PenaltyRule::Spectral, 0.7);
  BOOST_TEST(close(rho.value(), 0.7));
  BOOST_TEST(rho.update(10.0, 1.0, 1.0, 1.0));
  BOOST_TEST(close(rho.value(), 0.7 * std::pow(1e6, 0.05)));
}

BOOST_AUTO_TEST_CASE(linear_rule_follows_equation_44) {
  Penalty rho = started(PenaltyRule::Linear, 3.0);
  BOOST_TEST(rho.update(10.0, 1.0, 1.0, 1.0));
  BOOST_TEST(close(rho.value(), 12.0));
  BOOST_TEST(rho.update(0.1, 1.0, 1.0, 1.0));
  BOOST_TEST(close(rho.value(), 3.0));
  BOOST_TEST(!rho.update(1.0, 1.0, 1.0, 1.0));
}

BOOST_AUTO_TEST_CASE(residual_balancing_looks_seldom_and_ignores_small_ratios) {
  Penalty rho = started(PenaltyRule::ResidualBalancing, 1.0);
  int moves = 0, first = 0;
  for (int k = 1; k <= 1000; ++k) {
    if (rho.update(1.0, 1e-4, 1.0, 1.0) && ++moves == 1) first = k;
  }
  BOOST_TEST(first > 1);
  BOOST_TEST(moves > 1);
  BOOST_TEST(moves <= 8);
  BOOST_TEST(rho.value() > 1.0);

  Penalty calm = started(PenaltyRule::ResidualBalancing, 1.0);
  for (int k = 0; k < 1000; ++k) BOOST_TEST(!calm.update(1.0, 0.5, 1.0, 1.0));
  BOOST_TEST(calm.value() == 1.0);
}

BOOST_AUTO_TEST_CASE(residual_balancing_weighs_residuals_by_their_scales) {
  Penalty rho = started(PenaltyRule::ResidualBalancing, 1.0);
  bool moved = false;
  for (int k = 0; k < 1000 && !moved; ++k) moved = rho.update(1.0, 1.0, 1e4, 1.0);
  BOOST_TEST(moved);
  BOOST_TEST(close(rho.value(), 1e-2));
}

BOOST_AUTO_TEST_CASE(constant_stays) {
  Penalty rho = started(PenaltyRule::Constant, 0.4);
  for (int k = 0; k < 100; ++k) BOOST_TEST(!rho.update(1.0, 1e-6, 1.0, 1.0));
  BOOST_TEST(rho.value() == 0.4);
}

BOOST_AUTO_TEST_CASE(rho_stays_finite_and_positive) {
  for (const PenaltyRule rule : {PenaltyRule::Spectral, PenaltyRule::Linear, PenaltyRule::ResidualBalancing}) {
    Penalty up = started(rule), down = started(rule), bad = started(rule);
    for (int k = 0; k < 2000; ++k) {
      up.update(1.0, 0.0, 1.0, 1.0), down.update(0.0, 1.0, 1.0, 1.0), bad.update(kNan, 1.0, 1.0, 0.0);
    }
    for (const Penalty& rho : {up, down, bad}) BOOST_TEST((std::isfinite(rho.value()) && rho.value() > 0.0));
  }
}
