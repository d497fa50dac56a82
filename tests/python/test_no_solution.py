"""Branch and bound over the states of contacts: what it excludes has no solution, what has one is not excluded."""

import numpy as np
import pytest
from reference import planted_problem
from scipy.optimize import OptimizeResult
from test_solve import rod_between_walls

import signorini
from signorini import ContactProblem
from signorini.experiments import _no_solution
from signorini.experiments._no_solution import State, _nearest, _rows, has_none, islands, proven


@pytest.mark.parametrize("friction", [0.32, 1.0, 10.0])
def test_a_rod_that_jams(friction):
    assert has_none(rod_between_walls(friction, beside=1.0))
    assert proven(rod_between_walls(friction, closing=0.02, beside=1.0), 1e-8)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.3])
def test_a_rod_that_turns(friction):
    assert not has_none(rod_between_walls(friction))


@pytest.mark.parametrize("seed", range(6))
def test_what_has_a_solution_is_not_excluded(seed):
    """Nor is the node of the very states that were planted, however narrow its sector."""
    mass, j, g, mu, impulse = planted_problem(seed, num_contacts=3, num_velocities=6 + seed)
    assert not has_none(ContactProblem.from_mass(mass, j, g, mu), most_nodes=200)
    a, b = j @ np.linalg.solve(mass, j.T), g / np.linalg.norm(g.reshape(-1, 3), axis=1).max()
    sigma = j @ np.linalg.solve(mass, j.T @ impulse) + g
    angle = np.arctan2(sigma[4], sigma[3])
    for below, above in ((np.pi / 3, np.pi / 3), (0.1, 0.5), (2e-3, 1e-3)):
        states = [State("stick"), State("slip", angle - below, angle + above), State("open")]
        assert _nearest([_rows(a, b, mu[i], i, state) for i, state in enumerate(states)]) is not None
    elsewhere = [State("stick"), State("slip", angle + 2.0, angle + 2.5), State("open")]
    assert _nearest([_rows(a, b, mu[i], i, state) for i, state in enumerate(elsewhere)]) is None


def test_a_linear_program_that_fails_proves_nothing(monkeypatch):
    def fails(*_, **__):
        return OptimizeResult(status=4, message="numerical difficulties")

    monkeypatch.setattr(_no_solution, "linprog", fails)
    assert not has_none(rod_between_walls(1.0, beside=1.0))


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
