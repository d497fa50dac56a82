"""A 2 kg block on the floor, pushed sideways with 1 N s during a step of 10 ms: it slides."""

import numpy as np

import signorini

mass, friction, push = 2.0, 0.5, 1.0  # kg, -, N s
weight = mass * 9.81 * 0.01  # the impulse of gravity over the step, N s

# One contact, rows (T1, T2, N): G = 1/m, and the velocity that the block would have without the floor.
problem = signorini.ContactProblem(np.eye(3) / mass, np.array([push, 0.0, -weight]) / mass, [friction])
solution = signorini.solve(problem)

print(solution)
print("impulse ", solution.impulse, "N s")
print("velocity", solution.velocity, "m/s")

assert solution.solved
assert np.isclose(solution.velocity[0], (push - friction * weight) / mass)
