"""The robots that people have: each loads, agrees with other readers of the same file, and falls on the ground for 2 s
without an unsolved step."""

import importlib.util
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import signorini
from signorini import Simulator
from signorini.scenes._worlds import gymnasium_file, robots_folder

URDF = {  # by file: whether it floats
    "talos_data/robots/talos_reduced.urdf": True,
    "talos_data/robots/talos_full_v2.urdf": True,
    "solo_description/robots/solo12.urdf": True,
    "ur_description/urdf/ur5_robot.urdf": False,
    "allegro_hand_description/urdf/allegro_right_hand.urdf": False,
    "g1_description/urdf/g1_29dof_rev_1_0.urdf": True,
    "go2_description/urdf/go2.urdf": True,
    "panda_description/urdf/panda.urdf": False,
    "anymal_c_simple_description/urdf/anymal.urdf": True,
}
GYMNASIUM = ("ant", "half_cheetah", "hopper", "humanoid", "walker2d")
DM_CONTROL = ("humanoid", "quadruped", "dog", "stacker")


def dm_control_file(name):
    spec = importlib.util.find_spec("dm_control")
    if spec is None:
        pytest.skip("dm_control is not installed")
    return Path(spec.origin).parent / "suite" / f"{name}.xml"


def falls_for_two_seconds(world):
    simulator = Simulator(world, on_unsolved="raise")
    trace = simulator.run(2000)
    assert trace.solved.all()
    assert np.isfinite(simulator.state.q).all()
    assert trace.num_contacts.max() > 0
    if all(math.isinf(geometry.material.stiffness) for geometry in world.geometries):
        assert trace.penetration[-100:].max() < 1e-4


@pytest.mark.parametrize("file", URDF)
def test_urdf_robots(file):
    pin = pytest.importorskip("pinocchio")
    try:
        path = robots_folder() / file
    except FileNotFoundError as error:
        pytest.skip(str(error))
    floating = URDF[file]
    world = signorini.load(path, floating_base=floating, ground="touching")
    assert all(isinstance(warning, str) and warning for warning in world.warnings)
    root = [pin.JointModelFreeFlyer()] if floating else []
    theirs = pin.buildModelFromUrdf(str(path), *root)
    assert sum(body.mass for body in world.bodies) >= pin.computeTotalMass(theirs) * (1.0 - 1e-12)
    # Masses and inertias: the same mass matrix at any configuration; and the same ranges.
    simulator = Simulator(world)
    data, random = theirs.createData(), np.random.default_rng(1)
    assert theirs.nq == world.num_q  # no continuous joints, which Pinocchio keeps as cosine and sine
    for _ in range(2):
        q = world.integrate(world.initial_q, random.standard_normal(world.num_v), 0.5)
        upper = np.triu(pin.crba(theirs, data, q))
        simulator.state.q = q
        expected = upper + np.triu(upper, 1).T
        assert simulator.mass_matrix == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max())
    for joint in world.joints:
        if joint.num_v == 1:
            limits = theirs.lowerPositionLimit[joint.q_index], theirs.upperPositionLimit[joint.q_index]
            assert (joint.lower, joint.upper) == pytest.approx(limits)
    falls_for_two_seconds(world)


@pytest.mark.parametrize("name", [*(f"gymnasium {n}" for n in GYMNASIUM), *(f"dm_control {n}" for n in DM_CONTROL)])
def test_mjcf_robots(name):
    mujoco = pytest.importorskip("mujoco")
    package, robot = name.split()
    try:
        path = gymnasium_file(f"{robot}.xml") if package == "gymnasium" else dm_control_file(robot)
    except FileNotFoundError as error:
        pytest.skip(str(error))
    world = signorini.load(path)
    assert all(isinstance(warning, str) and warning for warning in world.warnings)
    theirs = mujoco.MjModel.from_xml_path(str(path))
    for i, body in enumerate(world.bodies[1:], 1):
        assert body.mass == pytest.approx(theirs.body_mass[i], abs=1e-12)
        assert np.linalg.eigvalsh(body.inertia) == pytest.approx(np.sort(theirs.body_inertia[i]), rel=1e-9, abs=1e-15)
    ranges = {theirs.joint(j).name: theirs.jnt_range[j] for j in range(theirs.njnt) if theirs.jnt_limited[j]}
    assert len([joint for joint in world.joints if joint.num_v == 1]) == int((theirs.jnt_type >= 2).sum())
    for joint in world.joints:
        if joint.num_v == 1:
            assert (joint.lower, joint.upper) == pytest.approx(ranges.get(joint.name, (-math.inf, math.inf)))
    assert len(world.actuators) == theirs.nu
    falls_for_two_seconds(world)


@pytest.mark.parametrize("fixed", [False, True])
def test_cassie(fixed):
    """Masses and ranges are those written in the file, which no other reader here takes: its legs are loops."""
    try:
        path = robots_folder() / "cassie_description/robots/cassie_v2.sdf"
    except FileNotFoundError as error:
        pytest.skip(str(error))
    world = signorini.load(path, ground="touching", floating_base=False if fixed else None)
    model = ET.parse(path).getroot().find("model")
    masses = {link.get("name"): float(link.find("inertial/mass").text) for link in model.iter("link")}
    assert sum(body.mass for body in world.bodies) == pytest.approx(sum(masses.values()), rel=1e-12)
    for joint in model.iter("joint"):
        limit = joint.find("axis/limit")
        if joint.get("type") != "revolute" or limit is None:
            continue
        ours = world.joint(joint.get("name"))
        written = tuple(float(limit.find(side).text) for side in ("lower", "upper"))
        assert (ours.lower, ours.upper) == pytest.approx(written)
    gaps = world.constraint_gaps(world.initial_q)
    assert np.abs(gaps).max() < 1e-9
    falls_for_two_seconds(world)
