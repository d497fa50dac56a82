"""Wall, capsules, chain and cable against mechanics."""

from itertools import pairwise

import numpy as np
import pytest

import signorini
from signorini import InvalidInputError
from signorini.scenes import worlds

G = 9.81


def started(name, *, tolerance=1e-6, **options):
    start = worlds()[name](**options)
    simulator = signorini.Simulator(start.world, tolerance=tolerance)
    simulator.state.q, simulator.state.v = start.q, start.v
    return simulator


def mass(world):
    return sum(body.mass for body in world.bodies)


def positions(simulator):
    return simulator.state.q.reshape(-1, 7)[:, :3].copy()


# Wall


def test_the_wall_is_flush_and_its_masses_are_dealt_out():
    world, q, _ = worlds()["cube-wall"](rows=4, columns=3, ball_mass=0)
    masses = np.array([body.mass for body in world.bodies[1:]])
    assert len(masses) == 4 * 3 + 2  # every other row has a box more: half ones at its ends
    np.testing.assert_allclose(np.sort(masses), np.geomspace(1.0, 1e4, 14))
    assert (np.diff(masses) < 0.0).any()
    sizes = np.array([geometry.shape.size for geometry in world.geometries[1:]])
    x = q.reshape(-1, 7)[:, 0]
    for z in np.unique(q.reshape(-1, 7)[:, 2]):
        row = q.reshape(-1, 7)[:, 2] == z
        ends = np.array([(x[row] - sizes[row, 0]).min(), (x[row] + sizes[row, 0]).max()])
        np.testing.assert_allclose(ends, [-0.6 + 5e-4, 0.6 - 5e-4], atol=1e-12)
    other = worlds()["cube-wall"](rows=4, columns=3, ball_mass=0, seed=1).world
    assert [body.mass for body in other.bodies] != [body.mass for body in world.bodies]


def test_a_wall_that_nobody_hits_stands():
    simulator = started("cube-wall", tolerance=1e-9, ball_mass=0)
    start = positions(simulator)
    trace = simulator.run(1000)
    assert np.all(trace.solved)
    assert np.abs(positions(simulator) - start).max() < 1e-6
    np.testing.assert_allclose(supported(simulator), mass(simulator.world) * G, rtol=1e-6)


def supported(simulator):
    """Force of the ground on everything, upwards [N]."""
    return sum(c.force[2] for c in simulator.contacts if c.geometry_a == "ground")


def test_impact_changes_momentum_by_what_the_ground_and_gravity_give_and_energy_never_grows():
    simulator = started("cube-wall")
    weight = mass(simulator.world) * np.array([0.0, 0.0, -G])
    ball = simulator.world.v_slice("ball")
    before, energy = simulator.momentum[:3].copy(), simulator.energy.total
    np.testing.assert_allclose(before, [0.0, 2e4, 0.0], atol=1e-9)
    for _ in range(60):
        simulator.step()
        ground = sum((c.force for c in simulator.contacts if c.geometry_a == "ground"), np.zeros(3))
        after = simulator.momentum[:3].copy()
        np.testing.assert_allclose(after - before, 1e-3 * (weight + ground), atol=1e-9 * 2e4)
        assert simulator.energy.total <= energy * (1 + 1e-9)
        before, energy = after, simulator.energy.total
    assert simulator.state.v[ball][1] < 10.0  # it did hit
    assert simulator.report.unsolved == 0


# Capsules


def test_capsules_weigh_what_a_fine_grid_says():
    world, _, _ = worlds()["capsules-box"](size=1, radius=0.2, length=0.5, density=700.0)
    body, shape = world.bodies[1], next(g.shape for g in world.geometries if g.name == "capsule-0")
    radius, half = shape.size[:2]
    step = radius / 40
    x, y, z = np.meshgrid(*(np.arange(-e + step / 2, e, step) for e in (radius, radius, half + radius)), indexing="ij")
    inside = x**2 + y**2 + np.maximum(np.abs(z) - half, 0.0) ** 2 <= radius**2
    weight = 700.0 * step**3
    assert body.mass == pytest.approx(weight * inside.sum(), rel=5e-3)
    squares = np.array([(y**2 + z**2)[inside].sum(), (x**2 + z**2)[inside].sum(), (x**2 + y**2)[inside].sum()])
    np.testing.assert_allclose(np.diag(body.inertia), weight * squares, rtol=1e-2)


def test_capsules_end_in_the_bin_and_the_ground_carries_them():
    simulator = started("capsules-box", size=12)
    energy = simulator.energy.total
    for _ in range(15):
        trace = simulator.run(100)
        assert np.all(trace.solved)
        assert simulator.energy.total < energy + 1e-9
        energy = simulator.energy.total
    force = sum(c.force for c in simulator.contacts if c.geometry_a == "ground" or c.geometry_a.startswith("wall"))
    weight = mass(simulator.world) * G
    np.testing.assert_allclose(force, [0.0, 0.0, weight], atol=0.05 * weight)  # some still roll
    assert simulator.report.deepest_overlap < 1e-4


# Chain and cable


def test_a_chain_at_rest_hangs_from_its_first_link_by_its_weight():
    simulator = started("chain", tolerance=1e-9, size=8, mass_ratio=100.0, speed=0.0)
    start = positions(simulator)
    simulator.run(500)
    assert simulator.report.unsolved == 0
    assert np.abs(positions(simulator) - start).max() < 1e-6
    weights = G * np.array([body.mass for body in simulator.world.bodies[2:]])
    for i in range(7):  # tension at every link: all that hangs below
        force = simulator.contact_force(f"link-{i}", f"link-{i + 1}")
        np.testing.assert_allclose(force, [0.0, 0.0, weights[i:].sum()], atol=1e-6 * weights.sum())


def test_links_of_a_swinging_chain_stay_in_each_other():
    simulator = started("chain")
    pitch = 0.04
    for _ in range(20):
        trace = simulator.run(50)
        assert np.all(trace.solved)
        assert trace.penetration.max() < 5e-5
        along = np.linalg.norm(np.diff(positions(simulator), axis=0), axis=1)
        assert along.max() < pitch + 1e-4  # held from outside only: it may get shorter
    assert np.abs(simulator.state.v).max() > 0.1


def ends_apart(simulator, size, pitch=0.1):
    """Largest gap between the ends that a cable's constraints hold together [m]."""
    middles, ends = positions(simulator), []
    for i in range(size):
        axis = 0.5 * pitch * simulator.body_placement(f"capsule-{i}")[1][:, 2]
        ends.append((middles[i] + axis, middles[i] - axis))
    gaps = [
        np.linalg.norm(ends[0][0]),
        *(np.linalg.norm(a[1] - b[0]) for a, b in pairwise(ends)),
    ]
    return max(gaps)


def test_a_swinging_cable_keeps_its_energy_and_holds_together():
    simulator = started("cable", angle=0.5)
    lowest = simulator.energy.total - swing_energy(simulator)
    energy = simulator.energy.total - lowest
    for _ in range(20):
        trace = simulator.run(100)
        assert np.all(trace.solved)
        assert ends_apart(simulator, 20) < 1e-6
        assert simulator.energy.total - lowest == pytest.approx(energy, rel=1e-2)


def swing_energy(simulator):
    """Of the start over the cable hanging still [J]."""
    z = positions(simulator)[:, 2]
    masses = np.array([body.mass for body in simulator.world.bodies[1:]])
    return masses @ z * G * (1.0 - 1.0 / np.cos(0.5))


def test_a_hanging_cable_carries_its_ball():
    simulator = started("cable", tolerance=1e-9, angle=0.0, mass_ratio=1e3)
    simulator.run(200)
    problem = simulator.contact_problem()
    impulse = signorini.solve(problem, tolerance=1e-10).impulse
    weight = mass(simulator.world) * G
    assert np.linalg.norm(impulse[:3]) / 1e-3 == pytest.approx(weight, rel=1e-6)  # the first constraint: the top
    assert np.abs(simulator.state.v).max() < 1e-9
    assert ends_apart(simulator, 20) < 1e-9


def test_options_are_checked():
    for name, options in (
        ("cube-wall", {"rows": 0}),
        ("cube-wall", {"mass_ratio": float("nan")}),
        ("cube-wall", {"gap": 0.2}),
        ("capsules-box", {"length": -1.0}),
        ("chain", {"size": 1}),
        ("cable", {"pitch": 0.0}),
    ):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            worlds()[name](**options)
