"""Problems of the hardest steps, as files."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import signorini
from signorini import (
    Box,
    ContactProblem,
    Equality,
    FrictionCone,
    HalfLine,
    Interval,
    Joint,
    WorldBuilder,
    fclib,
)
from signorini._hardest import Hardest, as_contacts
from signorini.cli.main import app


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_they_are_the_costliest_of_the_run_and_what_was_solved():
    world, q, v = signorini.scenes.worlds()["boxes"](size=8)

    def simulator():
        s = signorini.Simulator(world)
        s.state.q, s.state.v = q, v
        return s

    plain, watched = simulator(), simulator()
    hardest = Hardest(watched, count=3)
    costs = []
    for _ in range(6):
        hardest.watch()
        trace = watched.run(60)
        hardest.add(trace)
        costs.extend(trace.factorizations)
    plain.run(360)
    assert watched.state_hash == plain.state_hash
    kept = sorted((cost, -minus) for cost, minus, _ in hardest._kept)
    assert [cost for cost, _ in kept] == sorted(costs)[-3:]
    for cost, step in kept:
        assert costs[step] == cost
    again = simulator()
    for cost, step, problem in ((c, -m, p) for c, m, p in hardest._kept):
        again.reset()
        again.state.q, again.state.v = q, v
        again.run(step + 1)
        assert np.array_equal(again.contact_problem().free_velocity, problem.free_velocity), (cost, step)


def test_steps_under_a_controller_are_repeated_under_its_controls():
    builder = WorldBuilder()
    builder.add_ground()
    builder.add_body("sled", joints=[Joint("sled", "free")], position=(0, 0, 0.1), mass=1.0, inertia=np.eye(3) / 60)
    builder.add_geometry("sled", Box((0.1, 0.1, 0.1)))
    builder.add_motor("push", "sled")
    simulator = signorini.Simulator(builder.build())

    def push():
        simulator.control[0] += 0.1

    hardest = Hardest(simulator, count=20)
    hardest.watch()
    trace = simulator.run(20, controller=push)
    hardest.add(trace)
    assert len(hardest._kept) == 20
    simulator.reset()
    problems = {-minus: problem for _, minus, problem in hardest._kept}
    for step in range(20):
        simulator.control = 0.1 * (step + 1)
        simulator.step()
        wanted = simulator.contact_problem().free_velocity
        np.testing.assert_allclose(problems[step].free_velocity, wanted, atol=1e-12)


def test_run_writes_files_that_solve_reads(tmp_path):
    arguments = ("run", "cube-stack", "--duration", 0.1, "--option", "num_cubes=3", "--option", "slip=0.3")
    arguments += ("--json", "-")
    plain = run(*arguments)
    result = run(*arguments, "--hardest", tmp_path / "steps")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["state_hash"] == json.loads(plain.stdout)["state_hash"]
    files = sorted((tmp_path / "steps").glob("cube-stack-*.hdf5"))
    assert len(files) == 10
    for file in files:
        problem = fclib.read(file)
        assert problem.num_contacts == 12
        assert signorini.solve(problem).solved


def test_a_folder_that_cannot_be_made_is_said_before_the_run(tmp_path):
    (tmp_path / "file").write_text("")
    result = run("run", "cube-stack", "--duration", 1e6, "--hardest", tmp_path / "file")
    assert result.exit_code == 2
    assert "file" in result.output


def test_half_lines_and_equalities_become_what_a_file_can_hold(tmp_path):
    jacobian = np.random.default_rng(3).standard_normal((6, 7))
    free_velocity = np.array([-0.3, 0.2, -1.0, 0.1, -0.4, 0.2])
    constraints = [Equality(), FrictionCone(0.4), HalfLine(), HalfLine()]
    problem = ContactProblem(jacobian @ jacobian.T, free_velocity, constraints=constraints)
    contacts = as_contacts(problem)
    assert [type(c) for c in contacts.constraints] == [FrictionCone] * 3 + [Equality]
    fclib.write(tmp_path / "p.hdf5", contacts)
    ours = signorini.solve(problem, tolerance=1e-10).impulse
    theirs = signorini.solve(fclib.read(tmp_path / "p.hdf5"), tolerance=1e-10).impulse
    assert theirs[[9, 0, 1, 2, 5, 8]] == pytest.approx(ours, abs=1e-8)
    assert as_contacts(ContactProblem([[1.0]], [0.0], constraints=[Interval(-1.0, 1.0)])) is None
