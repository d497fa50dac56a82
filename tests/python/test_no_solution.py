"""Branch and bound over the states of contacts: what it excludes has no solution, what has one is not excluded."""

import numpy as np
import pytest
from reference import planted_problem
from test_solve import rod_between_walls

import signorini
from signorini import ContactProblem
from signorini.experiments._no_solution import has_none, islands, proven


@pytest.mark.parametrize("friction", [0.32, 1.0, 10.0])
def test_a_rod_that_jams(friction):
    assert has_none(rod_between_walls(friction, beside=1.0))
    assert proven(rod_between_walls(friction, closing=0.02, beside=1.0), 1e-8)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.3])
def test_a_rod_that_turns(friction):
    assert not has_none(rod_between_walls(friction))


@pytest.mark.parametrize("seed", range(6))
def test_what_has_a_solution_is_not_excluded(seed):
    mass, j, g, mu, _ = planted_problem(seed, num_contacts=3, num_velocities=6 + seed)
    assert not has_none(ContactProblem.from_mass(mass, j, g, mu), most_nodes=200)


def test_bodies_that_are_crushed():
    delassus = np.zeros((6, 6))
    delassus[np.ix_([2, 5], [2, 5])] = [[1.0, -1.0], [-1.0, 1.0]]
    delassus[[0, 1, 3, 4], [0, 1, 3, 4]] = 1.0
    assert has_none(ContactProblem(delassus, [0.0, 0, -1, 0, 0, -1], [0.5, 0.5]))
    assert not has_none(ContactProblem(delassus, [0.0, 0, -1, 0, 0, 1], [0.5, 0.5]))  # one gives way


def test_islands_are_the_whole():
    problem = rod_between_walls(1.0, beside=1.0)
    parts = islands(problem)
    assert [part.num_contacts for part in parts] == [1, 2]
    np.testing.assert_array_equal(parts[0].free_velocity, [0, 0, -1])
    np.testing.assert_array_equal(parts[1].delassus.toarray(), problem.delassus.toarray()[:6, :6])
    assert signorini.solve(parts[0]).solved
