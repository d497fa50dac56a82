// A 2 kg block on the floor, pushed sideways with 1 N s during a step of 10 ms: it slides, and friction takes
// friction * m g dt of the push.
#include <cmath>
#include <iostream>
#include <memory>
#include <signorini/delassus/dense.hpp>
#include <signorini/solver/solve.hpp>

int main() {
  using namespace signorini;
  const double mass = 2.0, friction = 0.5, weight = mass * 9.81 * 0.01, push = 1.0;  // kg, -, N s, N s

  // One contact, rows (T1, T2, N): G = 1/m, and the velocity that the block would have without the floor.
  const auto delassus = std::make_shared<DenseDelassus>(Matrix::Identity(3, 3) / mass);
  const Vector free_velocity = (Vector(3) << push, 0.0, -weight).finished() / mass;
  const ContactProblem problem(delassus, free_velocity, ConstraintSets::friction_cones(Vector::Constant(1, friction)));

  const Solution solution = solve(problem);
  std::cout << name(solution.status) << " by " << name(solution.solver) << ", relative residual "
            << solution.residual.relative << "\nimpulse  " << solution.impulse.transpose() << " N s"
            << "\nvelocity " << solution.velocity.transpose() << " m/s\n";

  const double expected = (push - friction * weight) / mass;
  return solution.status == Status::Solved && std::abs(solution.velocity[0] - expected) < 1e-5 ? 0 : 1;
}
