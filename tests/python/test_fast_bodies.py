"""Bodies that move farther in one step than contacts are looked for: they neither pass through anything nor feel what
they pass beside."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import signorini
from signorini import Box, Capsule, HeightField, InverseDynamics, Joint, Material, Simulator, Sphere, WorldBuilder

STEPS = (1e-3, 1e-2)
SMOOTH = Material(friction=0.0)
THIN = 5e-4  # half of the plate's thickness [m]


def add_ball(builder, name, position, radius=0.01, mass=0.1, material=SMOOTH):
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    builder.add_body(name, joints=[Joint(name, "free")], position=position, mass=mass, inertia=inertia)
    builder.add_geometry(name, Sphere(radius), material=material, name=name)


def add_box(builder, name, position, half, orientation, mass=0.1):
    x, y, z = np.square(half)
    inertia = mass / 3.0 * np.diag([y + z, x + z, x + y])
    builder.add_body(
        name, joints=[Joint(name, "free")], position=position, orientation=orientation, mass=mass, inertia=inertia
    )
    builder.add_geometry(name, Box(half), material=SMOOTH, name=name)


def rotation(quaternion):
    v, w = np.asarray(quaternion[:3]), quaternion[3]
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew


def total(simulator):
    return simulator.energy.kinetic + simulator.energy.potential


@settings(max_examples=60, deadline=None)
@given(
    speed=st.floats(4.0, 100.0),
    away=st.floats(1e-4, 1.0),
    sideways=st.floats(-20.0, 20.0),
    time_step=st.sampled_from(STEPS),
    restitution=st.sampled_from([0.0, 0.5, 1.0]),
)
def test_a_ball_stops_at_a_thin_plate_or_bounces(speed, away, sideways, time_step, restitution):
    """Its way to the plate is a fraction of a step that the plate cannot know."""
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    material = Material(friction=0.0, restitution=restitution)
    builder.add_geometry("world", Box((100.0, 100.0, THIN)), material=material)
    add_ball(builder, "ball", (0.0, 0.0, THIN + 0.01 + away), material=material)
    simulator = Simulator(builder.build(), time_step=time_step)
    simulator.state.v[:3] = (sideways, 0.0, -speed)
    lowest = np.inf
    for _ in range(int(away / speed / time_step) + 4):
        simulator.step()
        lowest = min(lowest, simulator.state.q[2] - 0.01 - THIN)
    assert lowest > -1e-9
    wanted = restitution * speed
    assert simulator.state.v[2] == pytest.approx(wanted, abs=1e-6 * speed + 1e-7 / time_step)
    assert simulator.state.v[0] == pytest.approx(sideways, abs=1e-9)
    assert np.abs(simulator.state.v[3:]).max() < 1e-9  # what is smooth does not make it spin
    assert simulator.report.unsolved == 0


@pytest.mark.parametrize("time_step", STEPS)
@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("offset", [0.0, 0.004, 0.015])
def test_two_balls_at_100_m_s_each(time_step, restitution, offset):
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    material = Material(friction=0.0, restitution=restitution)
    add_ball(builder, "left", (-1.003, 0.0, 0.0), material=material)
    add_ball(builder, "right", (1.0, offset, 0.0), material=material)
    simulator = Simulator(builder.build(), time_step=time_step)
    simulator.state.v[0], simulator.state.v[6] = 100.0, -100.0
    nearest = np.inf
    for _ in range(int(0.01 / time_step) + 10):
        simulator.step()
        nearest = min(nearest, np.linalg.norm(simulator.state.q[:3] - simulator.state.q[7:10]))
    v = simulator.state.v.reshape(2, 6)
    assert nearest > 0.02 - 1e-9
    np.testing.assert_allclose(v[0] + v[1], 0.0, atol=1e-9)  # momentum
    energy = 0.05 * float((v[:, :3] ** 2).sum())
    assert energy <= 1000.0 * (1 + 1e-9)
    if restitution > 0.0 or offset == 0.0:  # along the line of centres where they touch, e times what was
        sine = offset / 0.02
        normal = np.array([np.sqrt(1.0 - sine**2), sine, 0.0])
        wanted = np.array([100.0, 0.0, 0.0]) - (1.0 + restitution) * 100.0 * normal[0] * normal
        np.testing.assert_allclose(v[0, :3], wanted, atol=2e-5 / time_step * 1e-2)


@settings(max_examples=60, deadline=None)
@given(
    speed=st.floats(6.0, 100.0),
    clearance=st.floats(1e-4, 0.02),
    phase=st.floats(0.0, 0.3),
    along=st.floats(-0.5, 0.5),
    time_step=st.sampled_from(STEPS),
)
def test_a_ball_that_passes_beside_an_edge_feels_nothing(speed, clearance, phase, along, time_step):
    """The plane of the nearest points at the start of a step is in its way; the box is not."""
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_geometry("world", Box((0.05, 0.05, 0.05)), material=Material(friction=1.0))
    direction = np.array([1.0, along, -1.0])
    direction /= np.linalg.norm(direction)
    normal = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    start = np.array([0.05, 0.0, 0.05]) + (0.01 + clearance) * normal - (0.2 + phase) * direction
    add_ball(builder, "ball", start, material=Material(friction=1.0))
    simulator = Simulator(builder.build(), time_step=time_step)
    # Bodies slower than this are seen as before: within the margin.
    if speed * time_step <= 2e-3 + 3.0 * time_step:
        return
    velocity = speed * direction
    simulator.state.v[:3] = velocity
    for _ in range(int((0.4 + phase) / speed / time_step) + 2):
        simulator.step()
    assert (simulator.state.v[:3] == velocity).all()
    assert (simulator.state.v[3:] == 0.0).all()


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    speed=st.floats(10.0, 100.0),
    height=st.floats(0.12, 0.5),
    spin=st.tuples(*[st.floats(-300.0, 300.0)] * 3),
    quaternion=st.tuples(*[st.floats(0.1, 1.0)] * 4),
    half=st.sampled_from([(0.1, 0.01, 0.01), (0.02, 0.03, 0.04)]),
)
def test_a_spinning_box_does_not_get_through_a_thin_plate(speed, height, spin, quaternion, half):
    builder = WorldBuilder()
    builder.add_geometry("world", Box((10.0, 10.0, THIN)), material=SMOOTH)
    add_box(builder, "box", (0.0, 0.0, height), half, np.asarray(quaternion) / np.linalg.norm(quaternion))
    simulator = Simulator(builder.build())
    simulator.state.v[:3] = rotation(simulator.state.q[3:]).T @ (0.0, 0.0, -speed)
    simulator.state.v[3:] = spin
    energy, turned = total(simulator), 1e-3 * np.linalg.norm(spin)
    for _ in range(int(height / speed / 1e-3) + 30):
        simulator.step()
        low = simulator.state.q[2] - np.abs(rotation(simulator.state.q[3:])[2]) @ half - THIN
        assert low > -2.0 * THIN  # once slow, what turns sinks in as it always did
        assert simulator.state.q[2] > 0.0
        # (S5) keeps energy to third order in the turn of a step, which a thin body hit at a corner makes large.
        turned = max(turned, 1e-3 * np.linalg.norm(simulator.state.v[3:]))
        assert turned > 0.3 or total(simulator) < energy * 1.02


def test_a_fast_rod_on_a_hinge_is_stopped_by_a_thin_post():
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    inertia = 0.5 * 0.5**2 / 3.0 * np.diag([0.01, 1.0, 1.0])
    builder.add_body("rod", joints=[Joint("hinge", "revolute")], mass=0.5, inertia=inertia)
    turn = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    builder.add_geometry("rod", Capsule(0.01, 0.2), position=(0.25, 0.0, 0.0), orientation=turn, material=SMOOTH)
    builder.add_geometry("world", Sphere(0.002), position=(0.4, 0.0, 0.0), material=SMOOTH)
    world = builder.build()
    for first in np.linspace(-0.5, -0.1, 7):
        simulator = Simulator(world)
        simulator.state.q[0], simulator.state.v[0] = first, 120.0  # 48 m/s at the post
        simulator.run(20)
        assert -0.04 < simulator.state.q[0] < -0.02
        assert abs(simulator.state.v[0]) < 1e-3


@pytest.mark.parametrize("time_step", STEPS)
def test_a_fast_ball_does_not_get_below_a_height_field(time_step):
    grid = np.linspace(-2.0, 2.0, 81)
    x, y = np.meshgrid(grid, grid)
    builder = WorldBuilder()
    builder.add_geometry(
        "world", HeightField(0.05 * np.sin(6.0 * x) * np.cos(5.0 * y), (2.0, 2.0), 0.2), material=SMOOTH
    )
    add_ball(builder, "ball", (-1.5, 0.0, 0.2))
    world = builder.build()
    random = np.random.default_rng(3)
    for _ in range(8):
        simulator = Simulator(world, time_step=time_step)
        simulator.state.q[1] = random.uniform(-1.0, 1.0)
        simulator.state.v[:3] = (random.uniform(0.0, 50.0), 0.0, -random.uniform(10.0, 100.0))
        energy = total(simulator)
        met = False
        for _ in range(40):
            simulator.step()
            if np.abs(simulator.state.q[:2]).max() > 1.9:
                break
            met = met or total(simulator) < 0.9 * energy
            assert simulator.report.deepest_overlap < 1e-6
            assert total(simulator) < energy + 1e-6
        assert met


@pytest.mark.parametrize("time_step", STEPS)
def test_a_ball_that_is_hit_does_not_get_through_the_wall_behind_it(time_step):
    """It rests when the step begins, and is fast before it ends."""
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_geometry("world", Box((THIN, 1.0, 1.0)), position=(0.05, 0.0, 0.0), material=SMOOTH)
    add_ball(builder, "cue", (-0.2, 0.0, 0.0))
    add_ball(builder, "ball", (0.0, 0.0, 0.0))
    simulator = Simulator(builder.build(), time_step=time_step)
    simulator.state.v[0] = 100.0
    for _ in range(10):
        simulator.step()
        assert simulator.state.q[7] + 0.01 < 0.05 - THIN + 1e-9
        assert simulator.state.q[7] - simulator.state.q[0] > 0.02 - 1e-9
    assert np.abs(simulator.state.v).max() < 1e-3


@pytest.mark.parametrize("time_step", STEPS)
def test_what_lies_behind_a_plate_is_not_felt(time_step):
    """The plane of a second plate, tilted, comes out in front of the first one; the plate itself does not."""
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_geometry("world", Box((2.0, 2.0, THIN)), material=SMOOTH)
    tilted = (0.0, np.sin(0.3), 0.0, np.cos(0.3))
    builder.add_geometry("world", Box((0.01, 1.0, THIN)), position=(0.05, 0.0, -0.02), orientation=tilted)
    add_ball(builder, "ball", (0.0, 0.0, 0.03))
    simulator = Simulator(builder.build(), time_step=time_step)
    simulator.state.v[:3] = (40.0, 0.0, -50.0)
    simulator.run(4)
    assert simulator.state.v[0] == pytest.approx(40.0, abs=1e-9)
    assert simulator.state.q[2] == pytest.approx(0.01 + THIN, abs=1e-6)


def test_many_fast_balls_among_many_find_the_same_with_and_without_the_tree():
    """From 40 geometries on near pairs come from a tree. A ball flies through a gap in a grid, and one into it."""
    positions = [(0.1 * i, 0.1 * j, 0.0) for i in range(8) for j in range(8)]
    for offset, passes in ((0.05, True), (0.0, False)):
        answers = []
        for near_only in (True, False):
            builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
            for k, position in enumerate(positions):
                if not near_only or abs(position[1] - 0.3 - offset) < 0.06:
                    builder.add_geometry("world", Sphere(0.03), position=position, material=SMOOTH, name=f"fixed{k}")
            add_ball(builder, "ball", (-0.31, 0.3 + offset, 0.0), radius=0.0199)
            simulator = Simulator(builder.build())
            simulator.state.v[0] = 97.0
            simulator.run(20)
            answers.append(np.concatenate([simulator.state.q, simulator.state.v]))
        np.testing.assert_array_equal(*answers)
        assert (answers[0][7] == 97.0) == passes


@pytest.mark.parametrize("restitution", [0.0, 0.6])
@pytest.mark.parametrize("time_step", STEPS)
def test_inverse_dynamics_sees_the_contacts_of_a_fast_step(time_step, restitution):
    material = Material(friction=0.3, restitution=restitution)
    builder = WorldBuilder()
    builder.add_geometry("world", Box((1.0, 1.0, THIN)), material=material)
    add_ball(builder, "ball", (0.0, 0.0, 0.0), material=material)
    world = builder.build()
    random = np.random.default_rng(1)
    inverse = InverseDynamics(world, time_step)
    for _ in range(8):
        simulator = Simulator(world, time_step=time_step)
        simulator.state.q[2] = random.uniform(0.02, 0.02 + 40.0 * time_step)
        simulator.state.v[:] = (5.0, -3.0, -60.0, *random.normal(size=3))
        simulator.applied_force[:] = random.normal(size=6)
        q, v = simulator.state.q.copy(), simulator.state.v.copy()
        simulator.step()
        assert simulator.report.num_contacts == 1
        result = inverse((q, v), simulator.state.v, simulator)
        assert result.status == "solved"
        np.testing.assert_allclose(result.force, simulator.applied_force, atol=1e-6)


def swinging_tip(height, stiffness=1e5, damping=200.0):
    """A ball at the end of a massless arm of 0.5 m, hinged at a height above a soft ground, or below it."""
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    soft = Material(friction=0.0, stiffness=stiffness, damping=damping)
    builder.add_ground(soft)
    hinge = Joint("hinge", "revolute", axis=(0.0, 1.0, 0.0))
    builder.add_body("arm", joints=[hinge], position=(0.0, 0.0, height), mass=1.0, inertia=0.25 * np.eye(3))
    builder.add_geometry("arm", Sphere(0.02), position=(0.5, 0.0, 0.0), material=SMOOTH)
    return builder.build()


@pytest.mark.parametrize("speed", [12.0, 40.0])
@pytest.mark.parametrize("overlap", [-1e-4, 1e-4])
def test_a_limb_that_sinks_into_soft_ground_meets_it_once(speed, overlap):
    """An implicit spring and damper, in closed form (of a gap, but for the arm, which is that where they meet). The arc
    stays above the straight way that they are taken along."""
    k, d, dt, height = 1e5, 200.0, 1e-3, 0.3
    simulator = Simulator(swinging_tip(height, k, d), time_step=dt, tolerance=1e-12)
    angle = np.arcsin((height - 0.02 + overlap) / 0.5)  # below the horizontal
    simulator.state.q[0], simulator.state.v[0] = angle, speed
    lever, inertia = 0.5 * np.cos(angle), 0.25
    simulator.step()
    assert simulator.report.num_contacts == 1
    after = (inertia * speed + dt * lever * k * -overlap) / (inertia + dt * lever**2 * (dt * k + d))
    np.testing.assert_allclose(simulator.state.v[0], after, rtol=1e-9 if overlap > 0.0 else 1e-4)


def test_a_box_sinks_into_soft_ground_as_deep_with_spin_as_without():
    k, speed, mass = 1e4, 15.0, 1.0
    ways = []
    for spin in (0.0, 60.0):
        builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
        ground = Material(friction=0.0, stiffness=k)
        builder.add_geometry("world", Box((1.0, 1.0, 0.5)), position=(0.0, 0.0, -0.5), material=ground)
        add_box(builder, "box", (0.0, 0.0, 0.1), (0.05, 0.03, 0.02), (0.0, 0.0, 0.0, 1.0), mass)
        simulator = Simulator(builder.build())
        simulator.state.v[[2, 5]] = -speed, spin  # about its normal
        run = simulator.run(25, keep_states=True)
        ways.append(run.states[:, 2])
    np.testing.assert_allclose(ways[1], ways[0], atol=1e-6)
    assert 0.02 - min(ways[0]) == pytest.approx(speed * np.sqrt(mass / k), rel=0.1)


@pytest.mark.parametrize("height", [0.3, -0.3])
def test_inverse_dynamics_knows_what_a_limb_meets_on_its_way(height):
    """Without a guess; from below the ground the arc leads deeper than the straight way, which takes rounds (S18)."""
    random = np.random.default_rng(3)
    world = swinging_tip(height)
    simulator, inverse = Simulator(world, time_step=1e-3, tolerance=1e-13), InverseDynamics(world, 1e-3, tolerance=1e-8)
    several = 0
    for _ in range(30):
        gap = random.choice([random.uniform(-2e-4, 2e-4), random.uniform(0.0, 0.01)])
        q, v = np.arcsin([(height - 0.02 - gap) / 0.5]), random.uniform(15.0, 40.0, 1)
        torque = 100.0 * random.normal(size=1)
        simulator.reset()
        simulator.state.q, simulator.state.v, simulator.applied_force = q, v, torque
        simulator.step()
        several += simulator.report.num_contacts > 1
        assert simulator.report.num_contacts <= 3
        found = inverse((q, v), simulator.state.v)
        assert found.status == "solved"
        np.testing.assert_allclose(found.force, torque, atol=1e-7)
    assert several == 0 if height > 0.0 else several > 5


def test_a_restored_simulator_with_fast_bodies_goes_on_bit_for_bit():
    builder = WorldBuilder()
    builder.add_ground(SMOOTH)
    random = np.random.default_rng(0)
    for k in range(6):
        add_ball(builder, f"ball{k}", (0.05 * k, 0.0, 0.3 + 0.1 * k))
        add_box(builder, f"box{k}", (0.05 * k, 0.2, 0.3 + 0.1 * k), (0.05, 0.01, 0.01), (0.0, 0.0, 0.0, 1.0))
    world = builder.build()
    simulator, other = Simulator(world), Simulator(world)
    simulator.state.v[:] = 20.0 * random.normal(size=world.num_v)
    simulator.run(15)
    other.restore(simulator.save())
    for one in (simulator, other):
        one.run(40)
    assert simulator.state_hash == other.state_hash


def test_what_a_second_meeting_does_not_touch_is_not_solved_again():
    """The ball slides along one plate into another, which the answer of a first problem leads to. A stack far away,
    with nothing to start from, is in that problem and in the next one."""

    def factorizations(with_ball):
        builder = WorldBuilder()
        builder.add_geometry("world", Box((0.5, 0.5, THIN)), position=(0.0, 0.0, -THIN), name="floor")
        builder.add_geometry("world", Box((THIN, 0.5, 0.5)), position=(0.2, 0.0, 0.0), name="plate")
        builder.add_geometry("world", Box((0.5, 0.5, 0.1)), position=(9.0, 0.0, -0.1))
        for k in range(6):
            add_box(builder, f"box-{k}", (9.0, 0.0, 0.1 + 0.2 * k), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0, 1.0), mass=10.0**k)
        add_ball(builder, "ball", (0.1, 0.0, 0.05), mass=1e-9)  # too light to move the scale of the certificate
        simulator = Simulator(builder.build())
        if with_ball:
            simulator.state.v[-6:-3] = (150.0, 0.0, -60.0)
        simulator.step()
        assert simulator.report.status == "solved"
        if with_ball:
            touched = {c.geometry_a for c in simulator.contacts if c.body_b == "ball"}
            assert touched == {"floor", "plate"}
        return simulator.report.factorizations

    assert 1 < factorizations(False) <= factorizations(True) <= factorizations(False) + 2


def crowd(places, seed=4):
    """Balls in small groups, some near each other, one of each group fast; in every third group a hinged rod, in every
    third a ball that an equality holds to another."""
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    velocities = []
    for place in places:
        random = np.random.default_rng([seed, place])
        corner = np.array([3.0 * place, 0.0, 0.0])
        builder.add_geometry("world", Box((1.0, 1.0, THIN)), position=corner, material=SMOOTH)
        if place % 3 == 1:
            builder.add_body(
                f"rod-{place}",
                joints=[Joint(f"rod-{place}", "revolute", axis=(0.0, 0.0, 1.0))],
                position=corner + (0.25, 0.0, 0.02),
                mass=0.1,
                center=(0.0, 0.05, 0.0),
                inertia=1e-4 * np.eye(3),
            )
            builder.add_geometry(f"rod-{place}", Box((0.005, 0.1, 0.01)), material=SMOOTH, name=f"rod-{place}")
        x, centres = 0.0, []
        for k in range(6):
            position = corner + (x, 1e-3 * random.normal(), THIN + 0.01 + 1e-5)
            centres.append(position)
            add_ball(builder, f"ball-{place}-{k}", position, material=SMOOTH)
            velocities.append((random.uniform(30.0, 60.0) if k == 0 else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
            x += 0.02 + random.choice([1e-4, 2e-3, 8e-3])
        if place % 3 == 2:
            add_ball(builder, f"tail-{place}", centres[5] + (0.0, 0.2, 0.0), material=SMOOTH)
            velocities.append(np.zeros(6))
            builder.add_connect(f"ball-{place}-5", f"tail-{place}", np.zeros(3), (0.0, -0.2, 0.0))
    simulator = Simulator(builder.build(), tolerance=1e-10)
    simulator.state.v[-len(velocities) * 6 :] = np.concatenate(velocities)
    return simulator


def velocity(simulator, joint):
    joint = simulator.world.joint(joint)
    return simulator.state.v[joint.v_index : joint.v_index + joint.num_v]


def test_what_happens_in_one_place_does_not_depend_on_the_others():
    """Rounds of (S18) leave alone what they do not touch. Without friction velocities are unique."""
    places = range(9)
    together = crowd(places)
    apart = [crowd([place]) for place in places]
    for _ in range(6):
        together.step()
        assert together.report.status == "solved"
        for alone in apart:
            alone.step()
            for body in alone.world.bodies[1:]:
                np.testing.assert_allclose(velocity(together, body.name), velocity(alone, body.name), atol=1e-6)


@pytest.mark.parametrize("shape", [Capsule(0.01, 0.5), Box((0.01, 0.01, 0.5))])
def test_a_thin_rod_that_is_thrown_at_the_ground_gains_no_energy(shape):
    thin, across = 1e-4 / 2, 0.5**2 / 3  # of 1 kg
    for seed in range(12):
        rng = np.random.default_rng(seed)
        builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
        builder.add_ground(Material(friction=0.5))
        turn = rng.normal(size=4)
        joints, inertia = [Joint("rod", "free")], np.diag([across, across, thin])
        builder.add_body("rod", joints=joints, position=(0, 0, 0.7), orientation=turn, mass=1.0, inertia=inertia)
        builder.add_geometry("rod", shape, material=Material(friction=0.5))
        simulator = Simulator(builder.build())
        rotation = simulator.body_placement("rod")[1]
        simulator.state.v[:3] = rotation.T @ (15 * rng.normal(), 15 * rng.normal(), -50.0)
        start = energy = simulator.energy.kinetic
        for _ in range(40):
            simulator.step()
            assert simulator.energy.kinetic <= energy + 1e-6 * start
            energy = simulator.energy.kinetic
        assert simulator.report.unsolved == 0
        assert energy < 0.9 * start


@pytest.mark.parametrize("joint", ["prismatic", "revolute", "ball", "tendon"])
def test_a_joint_that_was_slow_and_is_hit_does_not_pass_its_limit(joint):
    start, limit = 0.005, 0.03  # the limit is farther away than a slow joint looks
    slick = Material(friction=0.0)
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    if joint in ("prismatic", "tendon"):
        upper = math.inf if joint == "tendon" else limit
        arm = Joint("arm", "prismatic", axis=(-1.0, 0.0, 0.0), upper=upper)
    else:
        arm = Joint("arm", joint, axis=(0.0, -1.0, 0.0), anchor=(0.0, 0.0, -1.0), upper=limit)
    builder.add_body("arm", joints=[arm], mass=1.0, inertia=0.01 * np.eye(3))
    builder.add_geometry("arm", Box((0.05, 0.05, 0.05)), material=slick)
    if joint == "tendon":
        builder.add_tendon("string", {"arm": 2.0}, upper=2 * limit)
    builder.add_body("ball", joints=[Joint("ball", "free")], position=(0.25, 0, 0), mass=10.0, inertia=0.01 * np.eye(3))
    builder.add_geometry("ball", Sphere(0.05), material=slick)
    world = builder.build()
    simulator = Simulator(world, tolerance=1e-9)
    if joint == "ball":
        simulator.state.q[:4] = 0.0, -math.sin(start / 2), 0.0, math.cos(start / 2)
    else:
        simulator.state.q[0] = start
    simulator.state.v[-6] = -50.0
    reached = 0.0
    for _ in range(30):
        q, v = simulator.state.q.copy(), simulator.state.v.copy()
        simulator.step()
        value = 2 * math.asin(np.linalg.norm(simulator.state.q[:3])) if joint == "ball" else simulator.state.q[0]
        reached = max(reached, value)
        undone = signorini.inverse_dynamics(world, (q, v), simulator.state.v, 1e-3, impulse_guess=simulator)
        assert undone.solved
        assert undone.force == pytest.approx(np.zeros(world.num_v), abs=1e-2)
    assert reached == pytest.approx(limit, abs=1e-6)
    assert simulator.report.unsolved == 0


def test_a_tendon_between_joints_that_are_hit_against_each_other_does_not_pass_its_limit():
    """Where their speeds are equal, what they change of its length would cancel without the signs."""
    slick, limit = Material(friction=0.0), 0.03
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    for name, side, y in (("left", -1.0, 0.0), ("right", 1.0, 1.0)):
        joints = [Joint(name, "prismatic", axis=(1.0, 0.0, 0.0))]
        builder.add_body(name, joints=joints, position=(0.0, y, 0.0), mass=1.0, inertia=0.01 * np.eye(3))
        builder.add_geometry(name, Box((0.05, 0.05, 0.05)), material=slick)
        ball = f"{name} ball"
        joints = [Joint(ball, "free")]
        builder.add_body(ball, joints=joints, position=(0.25 * side, y, 0), mass=10.0, inertia=0.01 * np.eye(3))
        builder.add_geometry(ball, Sphere(0.05), material=slick)
    builder.add_tendon("string", {"left": 1.0, "right": -1.0}, upper=limit)
    simulator = Simulator(builder.build(), tolerance=1e-9)
    world = simulator.world
    for name, speed in (("left ball", 50.0), ("right ball", -50.0)):
        simulator.state.v[world.v_slice(name).start] = speed
    reached = 0.0
    for _ in range(30):
        simulator.step()
        reached = max(reached, world.tendon_lengths(simulator.state.q)[0])
    assert reached == pytest.approx(limit, abs=1e-6)
    assert simulator.report.unsolved == 0
