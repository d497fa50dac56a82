"""The step against closed forms, with the default settings."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import signorini
from signorini import Box, Convex, Joint, Material, Simulator, Sphere, WorldBuilder

G = 9.81
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def box_inertia(mass, half):
    x, y, z = (2.0 * np.asarray(half)) ** 2
    return mass / 12.0 * np.diag([y + z, x + z, x + y])


def add_box(builder, name, mass, half, position, material, orientation=IDENTITY):
    joint = Joint(name, "free")
    inertia = box_inertia(mass, half)
    builder.add_body(name, joints=[joint], position=position, orientation=orientation, mass=mass, inertia=inertia)
    builder.add_geometry(name, Box(tuple(half)), material=material, name=name)


def add_sphere(builder, name, mass, radius, position, material):
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    builder.add_body(name, joints=[Joint(name, "free")], position=position, mass=mass, inertia=inertia)
    builder.add_geometry(name, Sphere(radius), material=material, name=name)


def tilted_gravity(degrees):
    """A slope, seen from the slope: gravity leans towards +x."""
    angle = np.radians(degrees)
    return (G * np.sin(angle), 0.0, -G * np.cos(angle))


def slope_with_box(degrees, friction, half=(0.1, 0.1, 0.1), mass=1.0, **settings):
    builder = WorldBuilder(gravity=tilted_gravity(degrees))
    material = Material(friction=friction)
    builder.add_ground(material)
    add_box(builder, "box", mass, half, (0.0, 0.0, half[2]), material)
    return Simulator(builder.build(), **settings)


def certified(simulator):
    report = simulator.report
    return report.unsolved == 0 and report.residual.relative <= simulator.settings.tolerance


def test_box_rests_on_a_slope_below_the_friction_angle_and_does_not_creep():
    simulator = slope_with_box(20.0, 0.5)
    simulator.run(500)
    start = simulator.state.q[:3].copy()
    simulator.run(1000)
    creep = np.linalg.norm(simulator.state.q[:3] - start)  # m in one second
    assert creep < 1e-6
    assert certified(simulator)
    assert {c.mode for c in simulator.contacts} == {"stick"}


def test_box_slides_down_a_slope_above_the_friction_angle():
    mu, degrees = 0.3, 30.0
    simulator = slope_with_box(degrees, mu)
    steps = 500
    simulator.run(steps)
    angle = np.radians(degrees)
    acceleration = G * (np.sin(angle) - mu * np.cos(angle))
    assert simulator.state.v[0] == pytest.approx(acceleration * steps * 1e-3, rel=1e-6)
    assert abs(simulator.state.q[2] - 0.1) < 1e-8
    assert {c.mode for c in simulator.contacts} == {"slide"}
    assert certified(simulator)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (np.sqrt(0.5), np.sqrt(0.5))], ids=["axis", "diagonal"])
def test_stick_at_nine_tenths_of_the_cone_and_slip_at_eleven(direction):
    mu, mass = 0.5, 2.0
    for share, slips in ((0.9, False), (1.1, True)):
        builder = WorldBuilder()
        material = Material(friction=mu)
        builder.add_ground(material)
        add_box(builder, "box", mass, (0.1, 0.1, 0.05), (0.0, 0.0, 0.05), material)
        simulator = Simulator(builder.build())
        # At the height of the ground, so that it does not tip: force at the centre, moment that takes the arm away.
        push = share * mu * mass * G * np.array([*direction, 0.0])
        simulator.set_external_wrench("box", push, np.cross([0.0, 0.0, -0.05], push))
        simulator.run(100)
        start, highest = simulator.state.q[:3].copy(), 0.0
        v_start = simulator.state.v[:3].copy()
        for _ in range(400):
            simulator.step()
            highest = max(highest, simulator.state.q[2] - 0.05)
        moved = simulator.state.q[:3] - start
        if slips:
            gained = np.dot(simulator.state.v[:2] - v_start[:2], direction)
            assert gained == pytest.approx((share - 1.0) * mu * G * 0.4, rel=0.01)
        else:
            assert np.linalg.norm(moved) / 0.4 < 1e-6  # creep [m/s]
        assert highest < 1e-5  # hop
        assert certified(simulator)


def test_a_gap_that_stays_open_has_no_force_at_all():
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_ground()
    add_sphere(builder, "ball", 1.0, 0.1, (0.0, 0.0, 0.1 + 1e-4), None)  # within the contact margin
    simulator = Simulator(builder.build())
    simulator.run(100)
    assert simulator.report.num_contacts == 1
    assert np.all(simulator.contact_force("world", "ball") == 0.0)
    assert np.all(simulator.state.v == 0.0)


def test_a_falling_ball_touches_down_without_penetration():
    builder = WorldBuilder()
    builder.add_ground()
    add_sphere(builder, "ball", 1.0, 0.1, (0.0, 0.0, 0.6), None)
    simulator = Simulator(builder.build(), tolerance=1e-10)
    deepest = 0.0
    for _ in range(600):
        simulator.step()
        deepest = min(deepest, simulator.state.q[2] - 0.1)
    assert deepest > -1e-9
    assert simulator.contact_force("world", "ball") == pytest.approx([0.0, 0.0, G], abs=1e-9)
    assert np.abs(simulator.state.v).max() < 1e-9


@pytest.mark.parametrize("restitution", [0.3, 0.5, 0.8])
def test_bounce_height(restitution):
    height = 1.0
    builder = WorldBuilder()
    material = Material(restitution=restitution)
    builder.add_ground(material)
    add_sphere(builder, "ball", 1.0, 0.1, (0.0, 0.0, 0.1 + height), material)
    simulator = Simulator(builder.build())
    fall, flight = np.sqrt(2 * height / G), 2 * restitution * np.sqrt(2 * height / G)
    apex = 0.0
    for _ in range(int((fall + 0.9 * flight) * 1000)):
        simulator.step()
        if simulator.state.time > fall + 0.1 * flight:
            apex = max(apex, simulator.state.q[2] - 0.1)
    assert apex == pytest.approx(restitution**2 * height, rel=0.02)


@pytest.mark.parametrize("shape", ["ball", "box"])
def test_compliant_rest_depth(shape):
    mass, stiffness = 3.0, 2e4
    builder = WorldBuilder()
    builder.add_ground(Material(stiffness=stiffness, damping=50.0))  # against a rigid body: the patch's stiffness
    if shape == "ball":
        add_sphere(builder, "body", mass, 0.1, (0.0, 0.0, 0.1), Material())
    else:
        add_box(builder, "body", mass, (0.1, 0.1, 0.1), (0.0, 0.0, 0.1), Material())
    simulator = Simulator(builder.build(), tolerance=1e-9)
    simulator.run(3000)
    assert 0.1 - simulator.state.q[2] == pytest.approx(mass * G / stiffness, rel=1e-6)
    assert simulator.contact_force("world", "body")[2] == pytest.approx(mass * G, rel=1e-6)


def test_a_very_stiff_contact_is_the_rigid_one():
    paths = []
    for stiffness in (np.inf, 1e13):
        builder = WorldBuilder()
        builder.add_ground(Material(stiffness=stiffness))
        add_box(builder, "box", 1.0, (0.1, 0.2, 0.3), (0.0, 0.0, 0.5), Material(), orientation=(0.1, 0.2, 0.0, 0.97))
        simulator = Simulator(builder.build(), baumgarte=1.0, max_correction_speed=1e6)
        simulator.run(300)
        paths.append(simulator.state.q.copy())
    assert paths[0] == pytest.approx(paths[1], abs=1e-5)


def test_a_rolling_ball_keeps_rolling():
    radius, speed = 0.1, 1.0
    builder = WorldBuilder()
    builder.add_ground()
    add_sphere(builder, "ball", 1.0, radius, (0.0, 0.0, radius), None)
    simulator = Simulator(builder.build())
    simulator.state.v[:] = [speed, 0, 0, 0, speed / radius, 0]
    simulator.run(1000)
    assert simulator.state.q[0] == pytest.approx(speed, rel=1e-6)
    assert {c.mode for c in simulator.contacts} == {"stick"}


def test_a_sliding_ball_ends_up_rolling_at_five_sevenths():
    builder = WorldBuilder()
    builder.add_ground(Material(friction=0.3))
    add_sphere(builder, "ball", 1.0, 0.1, (0.0, 0.0, 0.1), Material(friction=0.3))
    simulator = Simulator(builder.build())
    simulator.state.v[0] = 2.0
    simulator.run(1000)
    rotation = simulator.body_placement("ball")[1]
    assert (rotation @ simulator.state.v[:3])[0] == pytest.approx(10.0 / 7.0, rel=1e-4)


def test_a_ball_rolls_down_a_slope_at_five_sevenths_of_the_slide():
    builder = WorldBuilder(gravity=tilted_gravity(15.0))
    builder.add_ground()
    add_sphere(builder, "ball", 1.0, 0.1, (0.0, 0.0, 0.1), None)
    simulator = Simulator(builder.build())
    simulator.run(1000)
    rotation = simulator.body_placement("ball")[1]
    expected = 5.0 / 7.0 * G * np.sin(np.radians(15.0))
    assert (rotation @ simulator.state.v[:3])[0] == pytest.approx(expected, rel=1e-3)


def test_a_tossed_tumbling_body_keeps_momentum_and_energy():
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    add_box(builder, "box", 2.0, (0.1, 0.2, 0.4), (0.0, 0.0, 1.0), None)
    simulator = Simulator(builder.build())
    simulator.state.v[:] = [1.0, -2.0, 0.5, 3.0, 0.2, 5.0]
    momentum, energy = simulator.momentum, simulator.energy.total
    simulator.run(5000)
    assert simulator.momentum == pytest.approx(momentum, rel=1e-9, abs=1e-9)
    assert simulator.energy.total == pytest.approx(energy, rel=1e-4)


@pytest.mark.parametrize("spin", [(10.0, 0.0, 10.0), (30.0, 0.0, 300.0), (100.0, 0.0, 100.0), (0.0, 500.0, 2000.0)])
@pytest.mark.parametrize("radius", [0.002, 0.05])
def test_a_rod_keeps_its_energy_however_thin_it_is_and_fast_it_turns(radius, spin):
    mass, length = 1.0, 0.2
    across = mass * (length**2 / 12 + radius**2 / 4)
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    joints = [Joint("rod", "free")]
    builder.add_body("rod", joints=joints, mass=mass, inertia=np.diag([across, across, mass * radius**2 / 2]))
    simulator = Simulator(builder.build())
    simulator.state.v[3:] = spin
    energy, momentum = simulator.energy.kinetic, simulator.momentum
    for _ in range(200):
        simulator.step()
        assert simulator.energy.kinetic == pytest.approx(energy, rel=1e-11)
    assert simulator.momentum == pytest.approx(momentum, abs=1e-11 * np.linalg.norm(momentum))


def test_colliding_bodies_keep_momentum_and_lose_energy():
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    rng = np.random.default_rng(3)
    for i in range(6):
        position = 0.5 * np.array([i % 2, (i // 2) % 2, i // 4], dtype=float)
        orientation = rng.normal(size=4)
        add_box(builder, f"box{i}", 1.0 + i, (0.1, 0.15, 0.2), position, Material(friction=0.5), orientation)
    simulator = Simulator(builder.build())
    center = simulator.state.q.reshape(-1, 7)[:, :3].mean(axis=0)
    for i in range(6):
        rotation = simulator.body_placement(f"box{i}")[1]
        inward = center - simulator.state.q[7 * i : 7 * i + 3]
        simulator.state.v[6 * i : 6 * i + 3] = rotation.T @ (3.0 * inward)
        simulator.state.v[6 * i + 3 : 6 * i + 6] = rng.normal(size=3)
    momentum, energy = simulator.momentum, simulator.energy.kinetic
    touched = 0
    for _ in range(1000):
        simulator.step()
        touched += any(c.mode != "open" for c in simulator.contacts)
        # Nothing bounces, but correcting an overlap may add a little: 0.1 % of what there is.
        assert simulator.energy.kinetic <= energy * 1.001
        energy = simulator.energy.kinetic
    assert touched > 10
    assert simulator.momentum == pytest.approx(momentum, abs=1e-7)
    assert certified(simulator)


def stack(num_cubes, mass_ratio, misalignment=0.0, edge=0.2):
    builder = WorldBuilder()
    material = Material(friction=0.8)
    builder.add_ground(material)
    rng = np.random.default_rng(1)
    for i in range(num_cubes):
        shift = misalignment * rng.uniform(-1, 1, size=2)
        mass = mass_ratio ** (i / max(1, num_cubes - 1))
        position = (*shift, edge * (i + 0.5))
        add_box(builder, f"cube{i}", mass, (edge / 2,) * 3, position, material)
    return Simulator(builder.build())


@pytest.mark.parametrize(("misalignment", "steps"), [(0.0, 2000), (0.005, 10000)])
def test_the_stack_of_one_to_ten_thousand_stands(misalignment, steps):
    simulator = stack(15, 1e4, misalignment)
    start = simulator.state.q[-7:-4].copy()
    trace = simulator.run(steps)
    assert np.linalg.norm(simulator.state.q[-7:-4] - start) < 1e-4
    assert trace.solved.all()
    ground = []
    for _ in range(200):
        simulator.step()
        ground.append(simulator.contact_force("world", "cube0")[2])
    weight = G * sum(1e4 ** (i / 14) for i in range(15))
    # 20 tonnes on a kilogram: a certificate of 1e-6 leaves the kilogram 0.1 mm/s, and single forces some per cent.
    assert np.mean(ground) == pytest.approx(weight, rel=2e-3)
    assert ground == pytest.approx(np.full(200, weight), rel=0.2)


def test_energy_never_rises_as_a_stack_falls_and_settles():
    simulator = stack(4, 1.0, 0.08)
    for i in range(4):
        simulator.state.q[7 * i + 2] += 0.05 * (i + 1)
    energy = simulator.energy.total
    for _ in range(1500):
        simulator.step()
        assert simulator.energy.total <= energy + 1e-4 * abs(energy)
        energy = simulator.energy.total


def test_compliance_spreads_the_load_of_a_table_evenly():
    builder = WorldBuilder()
    builder.add_ground(Material(stiffness=1e5, damping=100.0))
    add_box(builder, "table", 4.0, (0.5, 0.3, 0.1), (0.0, 0.0, 0.1), Material())
    simulator = Simulator(builder.build())
    simulator.run(2000)
    forces = [c.force[2] for c in simulator.contacts]
    assert len(forces) == 4
    assert forces == pytest.approx([G] * 4, rel=1e-6)


@pytest.mark.parametrize("time_step", [1e-4, 1e-3, 5e-3, 2e-2])
def test_time_steps_from_tenths_to_tens_of_milliseconds(time_step):
    builder = WorldBuilder()
    builder.add_ground()
    add_box(builder, "box", 1.0, (0.1, 0.1, 0.1), (0.0, 0.0, 0.3), None, orientation=(0.2, 0.1, 0.0, 0.97))
    simulator = Simulator(builder.build(), time_step=time_step)
    simulator.run(int(2.0 / time_step))
    assert np.abs(simulator.state.v).max() < 1e-3
    assert simulator.state.q[2] == pytest.approx(0.1, abs=1e-4)
    assert simulator.contact_force("world", "box")[2] == pytest.approx(G, rel=1e-3)
    assert certified(simulator)


def pendulum(num_links=1, close=None, **joint):
    """A chain of rods in the x-z plane, hinged about y; close: position that the end is held at."""
    builder = WorldBuilder()
    length, mass, parent = 0.5, 1.0, "world"
    for i in range(num_links):
        builder.add_body(
            f"link{i}",
            parent=parent,
            position=(0.0, 0.0, 0.0) if i == 0 else (length, 0.0, 0.0),
            joints=[Joint(f"hinge{i}", "revolute", axis=(0.0, 1.0, 0.0), **joint)],
            mass=mass,
            center=(length / 2, 0.0, 0.0),
            inertia=np.diag([1e-4, mass * length**2 / 12, mass * length**2 / 12]),
        )
        parent = f"link{i}"
    if close is not None:
        builder.add_connect("world", parent, close, (length, 0.0, 0.0))
    return builder


def test_a_pendulum_swings_with_its_period():
    simulator = Simulator(pendulum().build(), time_step=1e-4)
    simulator.state.q[0] = np.pi / 2 - 0.01  # hangs at pi / 2 about y
    period = 2 * np.pi * np.sqrt(2 * 0.5 / (3 * G))
    simulator.run(round(period / 1e-4))
    assert simulator.state.q[0] == pytest.approx(np.pi / 2 - 0.01, abs=2e-5)


def test_a_joint_limit_stops_the_joint_and_holds_it():
    simulator = Simulator(pendulum(upper=1.0).build(), tolerance=1e-10)
    simulator.run(3000)
    assert simulator.state.q[0] == pytest.approx(1.0, abs=1e-7)
    assert simulator.state.v[0] == pytest.approx(0.0, abs=1e-9)
    assert certified(simulator)


def test_dry_friction_holds_up_to_its_torque():
    torque = 1.0 * G * 0.25  # of gravity on the horizontal rod
    for share, moves in ((1.05, False), (0.95, True)):
        simulator = Simulator(pendulum(friction=share * torque).build())
        simulator.run(200)
        assert (abs(simulator.state.q[0]) > 1e-4) == moves


def test_damping_is_implicit_and_never_explodes():
    simulator = Simulator(pendulum(damping=1e6).build(), time_step=1e-2)
    simulator.run(100)
    assert abs(simulator.state.v[0]) < 1e-5
    assert simulator.state.v[0] == pytest.approx(G * 0.25 / 1e6, rel=1e-3)


def test_a_stiff_position_actuator_is_stable_and_settles_where_it_should():
    builder = pendulum()
    builder.add_position_actuator("motor", "hinge0", kp=1e5, kv=10.0)
    simulator = Simulator(builder.build(), time_step=1e-2)
    simulator.control[:] = 0.3
    simulator.run(2000)
    sag = G * 0.25 * np.cos(0.3) / 1e5
    assert simulator.state.q[0] == pytest.approx(0.3 + sag, abs=1e-8)


def test_a_spring_joint_settles_where_it_balances():
    simulator = Simulator(pendulum(stiffness=50.0, damping=1.0).build())
    simulator.run(5000)
    q = simulator.state.q[0]
    assert 50.0 * q == pytest.approx(G * 0.25 * np.cos(q), rel=1e-6)


def test_a_closed_loop_stays_closed_for_ten_seconds():
    simulator = Simulator(pendulum(3, close=(0.6, 0.0, 0.0)).build())
    simulator.state.q[:] = _close_three_bars(0.6)
    simulator.state.v[0] = 2.0  # the loop makes the rest follow
    simulator.step()
    worst = fastest = 0.0
    for _ in range(1000):
        simulator.run(10)
        fastest = max(fastest, np.abs(simulator.state.v).max())
        position, rotation = simulator.body_placement("link2")
        worst = max(worst, np.linalg.norm(position + rotation @ [0.5, 0.0, 0.0] - [0.6, 0.0, 0.0]))
    assert worst < 1e-6
    assert fastest > 0.5
    assert certified(simulator)


@pytest.mark.parametrize("tilt", [1e-8, 1e-6])
def test_a_plane_linkage_whose_axes_are_not_quite_parallel_turns_freely(tilt):
    """Rigid to the last digit it could not move at all: the rows that say so are rounding, and must not act."""
    builder = WorldBuilder()
    for i in range(3):
        builder.add_body(
            f"link{i}",
            parent=f"link{i - 1}" if i else "world",
            position=(0.5 if i else 0.0, 0.0, 0.0),
            joints=[Joint(f"hinge{i}", "revolute", axis=(tilt * (i - 1), 1.0, tilt * i))],
            mass=1.0,
            center=(0.25, 0.0, 0.0),
            inertia=np.diag([1e-4, 0.25 / 12, 0.25 / 12]),
        )
    builder.add_connect("world", "link2", (0.6, 0.0, 0.0), (0.5, 0.0, 0.0))
    simulator = Simulator(builder.build())
    simulator.state.q[:] = _close_three_bars(0.6)
    simulator.state.v[0] = 2.0
    simulator.step()
    start = simulator.energy.total
    turned = gap = 0.0
    for _ in range(200):
        simulator.run(10)
        assert simulator.energy.total < start + 0.01
        turned = max(turned, abs(simulator.state.q[0] - _close_three_bars(0.6)[0]))
        gap = max(gap, np.abs(simulator.world.constraint_gaps(simulator.state.q)).max())
    assert turned > 0.3
    assert gap < 1e-6
    assert certified(simulator)


def _close_three_bars(distance, length=0.5):
    """Angles of a symmetric four-bar linkage whose ground link has this length, bars hanging down."""
    lean = np.arccos((distance - length) / 2 / length)
    return np.array([lean, -lean, -lean])


def test_a_mimic_joint_follows():
    builder = pendulum(2)
    builder.add_coupling("hinge1", "hinge0", (0.1, -0.5))
    simulator = Simulator(builder.build())
    simulator.state.q[:] = [0.0, 0.1]
    simulator.run(2000)
    assert simulator.state.q[1] == pytest.approx(0.1 - 0.5 * simulator.state.q[0], abs=1e-9)
    assert abs(simulator.state.q[0]) > 0.01


def test_a_weld_holds_a_cantilever():
    builder = WorldBuilder()
    add_box(builder, "box", 2.0, (0.1, 0.1, 0.1), (0.3, 0.0, 1.0), None)
    builder.add_weld("world", "box", position_a=(0.0, 0.0, 1.0), position_b=(-0.3, 0.0, 0.0))
    simulator = Simulator(builder.build())
    simulator.run(1000)
    assert simulator.state.q == pytest.approx([0.3, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], abs=1e-9)


def test_external_wrench_accelerates_as_newton_says():
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    add_box(builder, "box", 2.0, (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), None)
    simulator = Simulator(builder.build())
    simulator.set_external_wrench("box", (4.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    simulator.run(100)
    rotation = simulator.body_placement("box")[1]
    assert rotation @ simulator.state.v[:3] == pytest.approx([0.2, 0.0, 0.0], abs=1e-12)
    assert simulator.state.v[5] == pytest.approx(0.1 / (2.0 / 12 * 0.08) * 0.1, rel=1e-9)


def test_ccp_lifts_a_sliding_box_and_ncp_does_not():
    heights = {}
    for law in ("ncp", "ccp"):
        builder = WorldBuilder()
        builder.add_ground()
        add_box(builder, "box", 1.0, (0.2, 0.2, 0.05), (0.0, 0.0, 0.05), None)
        simulator = Simulator(builder.build(), law=law)
        simulator.state.v[0] = 2.0
        simulator.step()
        simulator.step()
        heights[law] = simulator.state.q[2] - 0.05
    assert abs(heights["ncp"]) < 1e-9
    assert heights["ccp"] > 1e-3  # at mu v, for a step: the relaxation's price


def test_zero_friction_slides_for_ever():
    simulator = slope_with_box(0.0, 0.0)
    simulator.state.v[0] = 1.0
    simulator.run(1000)
    assert simulator.state.v[0] == pytest.approx(1.0, abs=1e-12)


def test_deep_overlap_separates_without_exploding():
    builder = WorldBuilder()
    builder.add_ground()
    add_box(builder, "a", 1.0, (0.1, 0.1, 0.1), (0.0, 0.0, 0.1), None)
    add_box(builder, "b", 1.0, (0.1, 0.1, 0.1), (0.02, 0.01, 0.12), None)
    simulator = Simulator(builder.build())
    fastest = 0.0
    for _ in range(1000):
        simulator.step()
        fastest = max(fastest, np.abs(simulator.state.v).max())
    assert np.isfinite(simulator.state.q).all()
    assert fastest < 30.0


def test_package_exports_what_these_tests_use():
    assert set(signorini.__all__) >= {"Simulator", "WorldBuilder", "Material", "Box", "rollout"}


def plate(uneven, random):
    """Its bottom has 12 corners, each lower or higher by up to `uneven` [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    bottom = np.column_stack([0.1 * ring, -0.01 + uneven * random.uniform(-1.0, 1.0, 12)])
    points = np.concatenate([bottom, np.column_stack([0.09 * ring, np.full(12, 0.01)])])
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    triangles[inwards] = triangles[inwards, ::-1]
    return Convex(points, triangles)


@pytest.mark.parametrize("time_step", [1e-3, 1e-4])
@pytest.mark.parametrize(("uneven", "floor"), [(2e-4, "plane"), (0.0, "plane"), (0.0, "box")])
def test_a_plate_that_slaps_down_does_not_sink_in(uneven, floor, time_step):
    """Whichever of its corners come down: an overlap is taken back the faster, the shorter the step."""
    random = np.random.default_rng(0)
    material = Material(friction=0.5)
    for _ in range(4):
        builder = WorldBuilder()
        if floor == "plane":
            builder.add_ground(material)
        else:
            builder.add_geometry("world", Box((1.0, 1.0, 0.5)), position=(0.0, 0.0, -0.5), material=material)
        axis, half_tilt = random.uniform(-np.pi, np.pi), 0.075
        orientation = (np.sin(half_tilt) * np.cos(axis), np.sin(half_tilt) * np.sin(axis), 0.0, np.cos(half_tilt))
        inertia = np.diag([0.0025, 0.0025, 0.005])
        joints = [Joint("plate", "free")]
        builder.add_body(
            "plate", joints=joints, position=(0, 0, 0.04), orientation=orientation, mass=1.0, inertia=inertia
        )
        builder.add_geometry("plate", plate(uneven, random), material=material)
        simulator = Simulator(builder.build(), time_step=time_step)
        deepest = 0.0
        for _ in range(round(0.25 / time_step)):
            simulator.step()
            deepest = max(deepest, simulator.report.deepest_overlap)
        assert deepest < 1e-7
        assert simulator.report.unsolved == 0
        assert np.abs(simulator.state.v).max() < 1e-3  # it lies
        assert simulator.state.q[2] == pytest.approx(0.01, abs=2.0 * uneven + 1e-6)


@pytest.mark.parametrize("time_step", [1e-3, 1e-4, 1e-5])
def test_an_overlap_goes_back_at_one_speed_however_small_the_step(time_step):
    overlap, builder = 1e-4, WorldBuilder()
    builder.add_ground()
    add_box(builder, "box", 1.0, (0.1, 0.1, 0.1), (0, 0, 0.1 - overlap), None)
    simulator = Simulator(builder.build(), time_step=time_step)
    speeds = []
    for _ in range(round(2e-3 / time_step)):
        simulator.step()
        speeds.append(simulator.state.v[2])
    assert max(speeds) == pytest.approx(0.2 * overlap / 1e-3, rel=1e-3)  # a fifth of it in a millisecond
