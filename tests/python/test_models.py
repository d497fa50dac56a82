"""The contact models of other engines (docs/models.md) against independent solvers, and a world stepped under each."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from reference import planted_problem
from typer.testing import CliRunner

import signorini
from signorini import ContactProblem, Simulator, fclib
from signorini.cli.main import app
from signorini.experiments import Options, _plots, models

FRICTION = models.FRICTION
WEIGHT = models.MASS * models.GRAVITY


def random_problem(seed, contacts=3):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * contacts, 3 * contacts + 6))
    g = root @ root.T / (3 * contacts)
    return g, rng.normal(size=3 * contacts), rng.uniform(0.1, 0.5, contacts)


def lemke(matrix, q):
    """z >= 0, w = matrix z + q >= 0, z . w = 0 by Lemke's pivots; q is moved a little, so that no two rows tie."""
    n = len(q)
    q = q + 1e-10 * np.random.default_rng(0).uniform(0.5, 1.0, n)
    if (q >= 0).all():
        return np.zeros(n)
    table = np.hstack([np.eye(n), -matrix, -np.ones((n, 1)), q[:, None]])  # columns w, z, z0, right-hand side
    basis = list(range(n))
    row, entering = int(np.argmin(q)), 2 * n
    for _ in range(100 * n):
        table[row] /= table[row, entering]
        others = np.arange(n) != row
        table[others] -= np.outer(table[others, entering], table[row])
        leaving, basis[row] = basis[row], entering
        if leaving == 2 * n:
            z = np.zeros(2 * n + 1)
            z[basis] = table[:, -1]
            return z[n : 2 * n]
        entering = (leaving + n) % (2 * n)  # the complement of what left
        column = table[:, entering]
        assert (column > 1e-12).any(), "a ray: no solution found"
        ratios = np.where(column > 1e-12, table[:, -1] / np.where(column > 1e-12, column, 1.0), np.inf)
        row = int(np.argmin(ratios))
    raise AssertionError("Lemke's pivots cycle")


def pyramid_lcp(g, free, mu, facets):
    """The impulse of the friction pyramid by Lemke, as Stewart and Trinkle write it, with a multiplier for each edge of
    the polygon. z of a contact: x_N; beta >= 0 along each edge, both ways; lambda. x_T = sum of beta edge,
    beta+ + beta- <= limit x_N with multiplier lambda, velocity along +-edge + lambda >= 0."""
    half, contacts = facets // 2, len(mu)
    angles = 2.0 * np.pi * np.arange(half) / facets
    edges = np.stack([-np.sin(angles), np.cos(angles)])  # 2 x half
    size = 1 + 3 * half
    to_impulse = np.zeros((3 * contacts, size * contacts))
    matrix = np.zeros((size * contacts, size * contacts))
    for i in range(contacts):
        first = size * i
        beta, multiplier = first + 1 + np.arange(2 * half), first + 1 + 2 * half + np.arange(half)
        to_impulse[3 * i + 2, first] = 1.0
        to_impulse[3 * i : 3 * i + 2, beta] = np.hstack([edges, -edges])
        matrix[beta[:half], multiplier] = matrix[beta[half:], multiplier] = 1.0
        matrix[multiplier, beta[:half]] = matrix[multiplier, beta[half:]] = -1.0
        matrix[multiplier, first] = np.tan(np.pi / facets) * mu[i]
    matrix += to_impulse.T @ g @ to_impulse
    return to_impulse @ lemke(matrix, to_impulse.T @ free)


@pytest.mark.parametrize("facets", [4, 6, 8])
def test_pyramid_against_lemke(facets):
    slips = 0
    for seed in range(15):
        g, free, mu = random_problem(seed)
        expected = pyramid_lcp(g, free, mu, facets)
        found = signorini.solve(ContactProblem(g, free, mu), "lcp-pgs", tolerance=1e-11, facets=facets)
        assert found.model_residual <= 1e-11
        np.testing.assert_allclose(found.velocity, g @ expected + free, atol=1e-8)
        np.testing.assert_allclose(found.impulse, expected, atol=1e-7)
        tangent, normal = found.impulse.reshape(-1, 3)[:, :2], found.impulse[2::3]
        slips += int((np.linalg.norm(tangent, axis=1) > mu * normal * (1 + 1e-9)).sum())
    assert slips > 5  # outside the cone: the pyramid was really asked


@pytest.mark.parametrize("impedance", [0.6, 0.9, 0.99])
def test_convex_newton_against_clarabel(impedance):
    pytest.importorskip("clarabel")
    from signorini.peers import clarabel

    for seed in range(5):
        g, free, mu = random_problem(seed, contacts=6)
        mean = np.repeat(np.diag(g).reshape(-1, 3).mean(axis=1), 3)
        compliance = (1.0 - impedance) / impedance * mean
        expected = clarabel.solve(ContactProblem(g, free, mu, compliance=compliance), "ccp", 1e-7)
        assert expected.residual.relative < 1e-6
        found = signorini.solve(ContactProblem(g, free, mu), "convex-newton", tolerance=1e-11, impedance=impedance)
        np.testing.assert_allclose(found.impulse, expected.impulse, atol=1e-6)
        assert found.model_residual <= 1e-11
        assert not found.solved


def test_convex_newton_with_a_mass_matrix_equals_it_with_the_delassus_matrix():
    rng = np.random.default_rng(3)
    mass, jacobian = np.diag(rng.uniform(0.5, 5.0, 20)), rng.normal(size=(18, 20))
    free, mu = rng.normal(size=18), rng.uniform(0.2, 0.9, 6)
    explicit = ContactProblem(jacobian @ np.linalg.solve(mass, jacobian.T), free, mu)
    implicit = ContactProblem.from_mass(mass, jacobian, free, mu)
    answers = [signorini.solve(p, "convex-newton", tolerance=1e-11).impulse for p in (explicit, implicit)]
    np.testing.assert_allclose(*answers, atol=1e-8)


def test_bisection_obeys_signorini_at_every_contact():
    for seed in range(10):
        g, free, mu = random_problem(seed, contacts=6)
        s = signorini.solve(ContactProblem(g, free, mu), "bisection", tolerance=1e-12, max_iterations=20000)
        assert s.model_residual <= 1e-12
        normal, speed = s.impulse[2::3], s.velocity[2::3]
        assert (normal >= 0.0).all()
        assert (speed >= -1e-10).all()
        assert np.abs(normal * speed).max() <= 1e-10
        assert (np.linalg.norm(s.impulse.reshape(-1, 3)[:, :2], axis=1) <= mu * normal * (1 + 1e-12)).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"facets": 5}, r"facets: is 5, must be even and in \[4, 64\]"),
        ({"facets": 66}, r"facets: is 66, must be even and in \[4, 64\]"),
        ({"facets": 4.0}, "facets: is 4.0, must be an integer"),
        ({"impedance": 1.0}, r"impedance: is 1, must be in \[0.001, 1 - 1e-6\]"),
        ({"impedance": "stiff"}, "impedance"),
        ({"least_relaxation": 0.0}, r"least_relaxation: is 0, must be in \(0, 1\]"),
        ({"relaxation_decay": 2.0}, r"relaxation_decay: is 2, must be in \[0, 1\]"),
    ],
)
def test_bad_settings(options, message):
    problem = ContactProblem(np.eye(3), [0.0, 0.0, -1.0], [0.5])
    with pytest.raises(signorini.InvalidInputError, match=message):
        signorini.solve(problem, "auto", **options)
    in_simulator = {key: value for key, value in options.items() if key in ("facets", "impedance")}
    if in_simulator:
        with pytest.raises(signorini.InvalidInputError, match=message):
            Simulator(models.block().world, **in_simulator)


def simulate(steps, push, **settings):
    """A block pushed with these shares of mu m g along x and y: its velocity and height at the end, the simulator."""
    start = models.block()
    simulator = Simulator(start.world, **settings)
    simulator.set_external_wrench("block", FRICTION * WEIGHT * np.array([*push, 0.0]))
    simulator.run(steps - 1)
    before = simulator.body_placement("block")[0]
    simulator.step()
    after = simulator.body_placement("block")[0]
    return (after - before) / simulator.settings.time_step, after[2] - 0.5 * models.EDGE, simulator


@pytest.mark.parametrize("model", models.MODELS, ids=lambda model: model.name)
def test_a_world_steps_under_each_model(model):
    velocity, height, simulator = simulate(200, (1.1, 0.0), **model.settings)
    exact = 0.1 * FRICTION * models.GRAVITY * 0.2
    tolerance = 0.2 if model.name == "bisection" else 0.002  # which takes its direction from the corner's coupling
    assert velocity[0] == pytest.approx(exact, rel=tolerance)
    assert abs(velocity[1]) < (0.05 * exact if model.name == "bisection" else 1e-6)
    lifts = model.name.startswith("CCP")
    hop = FRICTION * exact * 1e-3
    assert height == pytest.approx(hop if lifts else 0.0, abs=0.05 * hop)
    law_is_solved = model.name.startswith("NCP") or "law" in model.settings
    assert (simulator.report.unsolved < 5) == law_is_solved
    assert simulator.report.solver == model.settings.get("solver", simulator.report.solver)


@pytest.mark.parametrize("solver", ["lcp-pgs", "convex-newton", "bisection"])
def test_inverse_dynamics_is_of_the_law(solver):
    with pytest.raises(signorini.InvalidInputError, match=f"solver: is {solver}, must be one that solves the law"):
        signorini.InverseDynamics(models.block().world, settings=signorini.SimulatorSettings(solver=solver))


def test_creep_of_the_convex_model_is_that_of_its_compliance():
    for impedance in (0.9, 0.99):
        velocity, _, _ = simulate(300, (0.9, 0.0), solver="convex-newton", impedance=impedance)
        expected = models.creep_of_compliance(impedance, 0.9 * FRICTION * WEIGHT, WEIGHT)
        assert velocity[0] == pytest.approx(expected, rel=1e-3)
    velocity, _, _ = simulate(300, (0.9, 0.0), tolerance=1e-9)
    assert abs(velocity[0]) < 1e-12


def test_only_the_convex_model_pushes_before_it_touches():
    """The ball moves at 2 m/s along the ground: the CCP pushes up to mu v dt away from it, Signorini's law nowhere."""
    ball = models.Scene("ball", models.sphere, (100, 100), FRICTION)
    gap = {model.name: models.measure(ball, model, 100)["force_gap"] for model in models.MODELS}
    for name, found in gap.items():
        if name.startswith("CCP"):
            assert 0.7 * FRICTION * 2.0 * 1e-3 < found < FRICTION * 2.0 * 1e-3
        else:
            assert found < 1e-6
    assert gap["CCP, d = .999"] == pytest.approx(gap["CCP, ADMM"], rel=1e-2)


def test_pyramids_in_the_simulator():
    diagonal = 1.1 * np.array([math.sqrt(0.5), math.sqrt(0.5)])
    exact = 0.1 * FRICTION * models.GRAVITY * 0.1
    assert np.linalg.norm(simulate(100, diagonal, solver="lcp-pgs")[0]) < 1e-6 * exact  # sticks
    velocity, _, _ = simulate(100, diagonal, solver="lcp-pgs", facets=8)
    np.testing.assert_allclose(velocity[:2], math.sqrt(0.5) * exact, rtol=1e-4)


def test_command_line(tmp_path):
    mass, jacobian, free, mu, _ = planted_problem(1)
    problem = ContactProblem(jacobian @ np.linalg.solve(mass, jacobian.T), free, mu, name="planted")
    fclib.write(tmp_path / "planted.hdf5", problem)
    for options in ({"solver": "lcp-pgs", "facets": 8}, {"solver": "convex-newton", "impedance": 0.8}):
        words = [word for key, value in options.items() for word in (f"--{key}", str(value))]
        result = CliRunner().invoke(app, ["solve", str(tmp_path), *words, "--json", "-"])
        assert result.exit_code == 1, result.output
        (found,) = json.loads(result.stdout)["results"]
        same = signorini.solve(fclib.read(tmp_path / "planted.hdf5"), **options)
        assert found["status"] == same.status == "stalled"
        assert found["model_residual"] == same.model_residual <= 1e-6 < found["residual"]["relative"]
    assert CliRunner().invoke(app, ["solve", str(tmp_path), "--facets", "7"]).exit_code == 2


def test_experiment(tmp_path, monkeypatch):
    few = [model for model in models.MODELS if "PGS" not in model.name and model.name != "LCP, 4 facets"]
    few.insert(0, models.MODELS[0])
    monkeypatch.setattr(models, "MODELS", tuple(few))
    monkeypatch.setattr(models, "SAMPLE", 40)
    scenes = [
        replace(scene, steps=(0, 20 if scene.name in ("stack 1:1e4", "humanoid") else 150))
        for scene in models._all_scenes(True, [])
    ]
    monkeypatch.setattr(models, "_all_scenes", lambda quick, notes: scenes)
    report = models.run(Options(output=tmp_path, quick=True))
    content = json.loads((tmp_path / "models.json").read_text())
    assert set(content["models"]) == {model.name for model in few}
    assert len(content["scenes"]) >= 7
    assert (tmp_path / "models.png").exists() == _plots.available()
    assert len(report.tables) == 1 + len(content["scenes"])
    for verdict in report.verdicts:
        assert verdict.met is not False, str(verdict)
