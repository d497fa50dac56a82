"""Trees of all kinds of joints against Pinocchio, and what no force from outside can change."""

import numpy as np
import pytest

from signorini import Joint, Simulator, WorldBuilder

pin = pytest.importorskip("pinocchio")


def random_inertia(rng):
    a = rng.normal(size=(3, 3))
    spread = 0.02 * (a @ a.T + np.eye(3))  # of the mass, about its centre
    return np.trace(spread) * np.eye(3) - spread


def random_tree(seed, num_bodies=9, root="free", gravity=(0.3, -0.2, -9.81)):
    rng = np.random.default_rng(seed)
    builder = WorldBuilder(gravity=gravity)
    names = ["world"]
    for i in range(num_bodies):
        if i == 0 and root == "free":
            joints, parent = [Joint("root", "free")], "world"
        else:
            parent = names[rng.integers(1, len(names))] if len(names) > 1 else "world"
            joints = [
                Joint(
                    f"joint{i}.{k}",
                    kind,
                    axis=tuple(rng.normal(size=3)),
                    anchor=tuple(0.1 * rng.normal(size=3)),
                    reference=0.0 if kind == "ball" else rng.normal(),
                    armature=0.05 * rng.uniform(),
                )
                for k, kind in enumerate(
                    rng.choice(["ball", "revolute", "revolute", "prismatic"], size=rng.choice([0, 1, 1, 2]))
                )
            ]
        names.append(
            builder.add_body(
                f"body{i}",
                parent=parent,
                position=0.3 * rng.normal(size=3),
                orientation=rng.normal(size=4) if len(joints) == 0 or joints[0].type != "free" else (0, 0, 0, 1),
                joints=joints,
                mass=0.5 + rng.uniform(),
                center=0.1 * rng.normal(size=3),
                inertia=random_inertia(rng),
            )
        )
    return builder.build()


def random_state(world, seed):
    rng = np.random.default_rng(seed)
    return world.integrate(world.initial_q, rng.normal(size=world.num_v), 1.0), rng.normal(size=world.num_v)


def full(matrix):
    return np.triu(matrix) + np.triu(matrix, 1).T


@pytest.mark.parametrize("root", ["free", "fixed"])
@pytest.mark.parametrize("seed", range(6))
def test_mass_matrix_placements_energy_and_acceleration(seed, root):
    world = random_tree(seed, root=root)
    model = pin.Model()
    model.loadFromString(world.pinocchio_model())
    data = model.createData()
    q, v = random_state(world, seed)
    time_step = 1e-3
    simulator = Simulator(world, time_step=time_step)
    simulator.state.q[:], simulator.state.v[:] = q, v
    assert simulator.mass_matrix == pytest.approx(full(pin.crba(model, data, q)), abs=1e-12)
    assert simulator.energy.kinetic == pytest.approx(0.5 * v @ simulator.mass_matrix @ v, rel=1e-12)
    pin.framesForwardKinematics(model, data, q)
    for frame, place in zip(model.frames, data.oMf, strict=True):
        if frame.type == pin.BODY and frame.name != "universe":
            position, rotation = simulator.body_placement(frame.name)
            assert position == pytest.approx(place.translation, abs=1e-12)
            assert rotation == pytest.approx(place.rotation, abs=1e-12)
    acceleration = pin.aba(model, data, q, v, np.zeros(world.num_v))
    if root == "free":  # Pinocchio's is that of the frame that turns along (S3)
        acceleration[:3] += np.cross(v[3:6], v[:3])
    expected = v + time_step * acceleration
    if root == "free":  # (S4)
        expected[:3] = pin.exp3(-time_step * expected[3:6]) @ expected[:3]
    simulator.step()
    assert simulator.state.v == pytest.approx(expected, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_in_free_flight_keeps_its_momentum(seed):
    world = random_tree(seed, gravity=(0.0, 0.0, 0.0))
    q, v = random_state(world, seed)
    drifts = []
    for time_step in (1e-4, 5e-5):
        simulator = Simulator(world, time_step=time_step)
        simulator.state.q[:], simulator.state.v[:] = q, 0.3 * v
        before, energy = simulator.momentum, simulator.energy.total
        simulator.run(round(0.2 / time_step))
        change = np.abs(simulator.momentum - before).max() / np.abs(before).max()
        drifts.append((change, abs(simulator.energy.total / energy - 1)))
    # First order in the time step, both.
    assert max(drifts[1]) < 1e-3
    assert drifts[1][0] < 0.6 * drifts[0][0]
    assert drifts[1][1] < 0.6 * drifts[0][1]
