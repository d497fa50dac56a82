#include "signorini/problem/contact_problem.hpp"

#include <boost/test/unit_test.hpp>

#include "support.hpp"

using namespace signorini;
using namespace signorini::testing;

namespace {

struct Ingredients {
  std::shared_ptr<const DelassusOperator> delassus = dense(Matrix::Identity(6, 6));
  Vector free_velocity = Vector::Zero(6);
  ConstraintSets sets = ConstraintSets::friction_cones(Vector::Constant(2, 0.5));
  Vector compliance = Vector::Zero(6);

  std::string refused() const {
    return refused_field([this] { ContactProblem(delassus, free_velocity, sets, compliance); });
  }
};

Ingredients with(void (*change)(Ingredients&)) {
  Ingredients ingredients;
  change(ingredients);
  return ingredients;
}

}  // namespace

BOOST_AUTO_TEST_CASE(good_input_is_accepted) {
  BOOST_TEST(Ingredients().refused() == "");
  BOOST_TEST(with([](Ingredients& i) { i.compliance = Vector(); }).refused() == "");
}

BOOST_AUTO_TEST_CASE(every_error_names_its_field) {
  BOOST_TEST(with([](Ingredients& i) { i.delassus = nullptr; }).refused() == "delassus");
  BOOST_TEST(with([](Ingredients& i) { i.free_velocity = Vector::Zero(5); }).refused() == "free_velocity");
  BOOST_TEST(with([](Ingredients& i) { i.sets.add_half_line(); }).refused() == "sets");
  BOOST_TEST(with([](Ingredients& i) { i.compliance = Vector::Zero(7); }).refused() == "compliance");
  BOOST_TEST(with([](Ingredients& i) { i.free_velocity[1] = kNan; }).refused() == "free_velocity[1]");
  BOOST_TEST(with([](Ingredients& i) { i.free_velocity[5] = -kInfinity; }).refused() == "free_velocity[5]");
  BOOST_TEST(with([](Ingredients& i) { i.free_velocity[0] = 1e300; }).refused() == "free_velocity[0]");
  BOOST_TEST(with([](Ingredients& i) { i.compliance[2] = -1e-12; }).refused() == "compliance[2]");
  BOOST_TEST(with([](Ingredients& i) { i.compliance[3] = kNan; }).refused() == "compliance[3]");
  BOOST_TEST(with([](Ingredients& i) {
               Matrix g = Matrix::Identity(6, 6);
               g(4, 4) = -1.0;
               i.delassus = dense(g);
             }).refused() == "delassus diagonal[4]");
}

BOOST_AUTO_TEST_CASE(the_message_holds_value_and_range) {
  try {
    const Ingredients ingredients = with([](Ingredients& i) { i.compliance[2] = -0.125; });
    ContactProblem(ingredients.delassus, ingredients.free_velocity, ingredients.sets, ingredients.compliance);
    BOOST_FAIL("accepted");
  } catch (const InvalidInput& error) {
    const std::string message = error.what();
    BOOST_TEST(message.find("-0.125") != std::string::npos);
    BOOST_TEST(message.find("[0, ") != std::string::npos);
  }
}

BOOST_AUTO_TEST_CASE(bad_operators_are_refused) {
  Matrix bad = Matrix::Identity(3, 3);
  bad(1, 2) = kNan;
  BOOST_TEST(refused_field([&] { DenseDelassus{bad}; }) == "delassus[1, 2]");
  BOOST_TEST(refused_field([&] { SparseDelassus{SparseMatrix(bad.sparseView())}; }) == "delassus[1, 2]");
  BOOST_TEST(refused_field([&] { DenseDelassus{Matrix(2, 3).setZero()}; }) == "delassus");
  BOOST_TEST(refused_field([&] { SparseDelassus{SparseMatrix(2, 3)}; }) == "delassus");

  SparseMatrix mass(3, 3), jacobian(6, 3);
  mass.setIdentity();
  BOOST_TEST(refused_field([&] { MassSpaceDelassus(SparseMatrix(3, 2), jacobian); }) == "mass");
  BOOST_TEST(refused_field([&] { MassSpaceDelassus(-mass, jacobian); }) == "mass");
  BOOST_TEST(refused_field([&] { MassSpaceDelassus(SparseMatrix(3, 3), jacobian); }) == "mass");
  BOOST_TEST(refused_field([&] { MassSpaceDelassus(mass, SparseMatrix(6, 4)); }) == "jacobian");
  jacobian.insert(0, 0) = kInfinity;
  BOOST_TEST(refused_field([&] { MassSpaceDelassus(mass, jacobian); }) == "jacobian[0, 0]");
}

BOOST_AUTO_TEST_CASE(definiteness_is_checked_on_request) {
  const Matrix square = Random(11).matrix(6, 4);
  Ingredients i;
  i.delassus = dense(square * square.transpose());  // singular, semidefinite
  ContactProblem(i.delassus, i.free_velocity, i.sets).check_definite();
  Matrix indefinite = Matrix::Identity(6, 6);
  indefinite(0, 1) = indefinite(1, 0) = 1.5;
  const ContactProblem problem(dense(indefinite), i.free_velocity, i.sets);
  BOOST_TEST(refused_field([&] { problem.check_definite(); }) == "delassus");
  // Files in single precision are off by 1e-7 or so: that much is rounding, 1e-4 is not.
  const auto off_by = [&](double excess) {
    Matrix g = Matrix::Identity(6, 6);
    g(0, 1) = g(1, 0) = 1.0 + excess;
    return refused_field([&] { ContactProblem(dense(g), i.free_velocity, i.sets).check_definite(); });
  };
  BOOST_TEST(off_by(1e-6) == "");
  BOOST_TEST(off_by(1e-4) == "delassus");
  // Enough compliance makes it definite.
  ContactProblem(dense(indefinite), i.free_velocity, i.sets, Vector::Constant(6, 1.0)).check_definite();
}

BOOST_AUTO_TEST_CASE(scale_is_the_mean_diagonal_of_each_set) {
  Matrix g = Matrix::Zero(7, 7);
  g.diagonal() << 1.0, 2.0, 6.0, 0.0, 0.0, 0.0, 5.0;
  ConstraintSets sets = ConstraintSets::friction_cones(Vector::Constant(2, 0.5));
  sets.add_half_line();
  Vector expected(7);
  expected << 3.0, 3.0, 3.0, 1.0, 1.0, 1.0, 5.0;
  BOOST_TEST((ContactProblem(dense(g), Vector::Zero(7), sets).scale() - expected).norm() <= 1e-15);
  const ContactProblem compliant(dense(g), Vector::Zero(7), sets, Vector::Constant(7, 0.5));
  expected << 3.5, 3.5, 3.5, 0.5, 0.5, 0.5, 5.5;
  BOOST_TEST((compliant.scale() - expected).norm() <= 1e-14);
}

BOOST_AUTO_TEST_CASE(settings_and_guess_are_checked) {
  const ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, -1.0));
  const auto refused = [&](void (*change)(Settings&)) {
    Settings settings;
    change(settings);
    return refused_field([&] { solve(problem, settings); });
  };
  BOOST_TEST(refused([](Settings&) {}) == "");
  BOOST_TEST(refused([](Settings& s) { s.tolerance = 0.0; }) == "tolerance");
  BOOST_TEST(refused([](Settings& s) { s.tolerance = kNan; }) == "tolerance");
  BOOST_TEST(refused([](Settings& s) { s.max_iterations = -1; }) == "max_iterations");
  BOOST_TEST(refused([](Settings& s) { s.admm.proximal_weight = 0.0; }) == "proximal_weight");
  BOOST_TEST(refused([](Settings& s) { s.admm.penalty = -1.0; }) == "penalty");
  BOOST_TEST(refused([](Settings& s) { s.admm.ratio = 1.0; }) == "ratio");
  BOOST_TEST(refused([](Settings& s) { s.admm.linear_factor = 1.0; }) == "linear_factor");
  BOOST_TEST(refused([](Settings& s) { s.admm.spectral_increment = 0.0; }) == "spectral_increment");
  BOOST_TEST(refused([](Settings& s) { s.admm.anderson_memory = -1; }) == "anderson_memory");
  BOOST_TEST(refused([](Settings& s) { s.admm.paper_tolerance = kNan; }) == "paper_tolerance");
  BOOST_TEST(refused([](Settings& s) { s.pgs.over_relaxation = 2.0; }) == "over_relaxation");

  const auto refused_guess = [&](const Vector& impulse) {
    Guess guess;
    guess.impulse = impulse;
    return refused_field([&] { solve(problem, Settings(), &guess); });
  };
  BOOST_TEST(refused_guess(Vector::Zero(2)) == "guess");
  BOOST_TEST(refused_guess(vector3(0.0, kNan, 0.0)) == "guess[1]");
  BOOST_TEST(refused_guess(vector3(0.0, 0.0, -kInfinity)) == "guess[2]");
  BOOST_TEST(refused_guess(vector3(5.0, 0.0, -3.0)) == "");  // needs not be feasible
  for (const double penalty : {-1.0, kNan, kInfinity}) {
    Guess guess;
    guess.impulse = Vector::Zero(3), guess.penalty = penalty;
    BOOST_TEST(refused_field([&] { solve(problem, Settings(), &guess); }) == "guess penalty");
  }
}

BOOST_AUTO_TEST_CASE(an_impulse_of_another_size_is_refused) {
  const ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, -1.0));
  Vector sigma(3), few(2);
  for (const Index size : {0, 2, 4}) {
    BOOST_TEST(refused_field([&] { residual(problem, Vector::Zero(size)); }) == "impulse");
    BOOST_TEST(refused_field([&] { problem.velocity(Vector::Zero(size), sigma); }) == "impulse");
  }
  BOOST_TEST(refused_field([&] { residual(problem, Vector::Zero(3), Law::Ncp, few); }) == "velocity");
}

BOOST_AUTO_TEST_CASE(a_refused_assignment_leaves_no_rows) {
  ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, -1.0));
  const auto again = [&] { problem.assign(problem.delassus_ptr(), Vector::Zero(3), problem.sets(), Vector(), kNan); };
  BOOST_TEST(refused_field(again) == "reference");
  BOOST_TEST(problem.size() == 0);
}

BOOST_AUTO_TEST_CASE(what_was_moved_from_can_be_used) {
  ContactProblem problem = point_on_ground(1.0, 0.5, vector3(0.0, 0.0, -1.0));
  Workspace workspace;
  Solution solution;
  const ContactProblem other = std::move(problem);
  Workspace others = std::move(workspace);
  solve(problem, Settings(), workspace, solution);
  solve(other, Settings(), others, solution);
  BOOST_TEST((solution.status == Status::Solved));
}

BOOST_AUTO_TEST_CASE(a_vector_may_grow_into_what_is_computed_from_it) {
  GrowVector vector = vector3(1.0, 2.0, 3.0);
  vector = Matrix::Ones(50, 3) * vector;
  BOOST_TEST((vector.size() == 50 && (vector.array() == 6.0).all()));
  vector = vector.replicate(10, 1);
  BOOST_TEST((vector.size() == 500 && (vector.array() == 6.0).all()));
}
