"""Torsional and rolling friction (docs/simulation.md, S16) against textbook motions and MuJoCo."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import signorini
from signorini import Box, InvalidInputError, Joint, Material, Simulator, Sphere, WorldBuilder, inverse_dynamics

GRAVITY, RADIUS, MASS = 9.81, 0.1, 2.0
INERTIA = 0.4 * MASS * RADIUS**2
DT = 1e-3


def ball(surface, *, gravity=(0.0, 0.0, -GRAVITY), articulated=False, **settings):
    """A ball on the ground. articulated: on joints of its own instead of one free joint."""
    builder = WorldBuilder(gravity=gravity)
    builder.add_ground(surface)
    joints = [Joint("ball", "free")]
    if articulated:
        joints = [Joint(f"slide_{k}", "prismatic", axis=tuple(np.eye(3)[k])) for k in range(3)]
        joints.append(Joint("turn", "ball"))
    builder.add_body("ball", joints=joints, position=(0.0, 0.0, RADIUS), mass=MASS, inertia=INERTIA * np.eye(3))
    builder.add_geometry("ball", Sphere(RADIUS), material=surface, name="ball")
    return Simulator(builder.build(), **{"time_step": DT, **settings})


def run(simulator, steps):
    for _ in range(steps):
        simulator.step()
        report = simulator.report
        assert report.status == "solved"
        assert report.residual.relative <= simulator.settings.tolerance


def _turned(simulator, articulated):
    rotation = Rotation.from_quat(simulator.state.q[3:]).as_matrix()  # velocities are in the frame of the body
    return (np.eye(3) if articulated else rotation), rotation


def set_velocity(simulator, velocity, articulated=False):
    """Linear and angular, in the world."""
    for part, rotation in zip((slice(0, 3), slice(3, 6)), _turned(simulator, articulated), strict=True):
        simulator.state.v[part] = rotation.T @ velocity[part]


def velocity(simulator, articulated=False):
    parts = zip((slice(0, 3), slice(3, 6)), _turned(simulator, articulated), strict=True)
    return np.concatenate([rotation @ simulator.state.v[part] for part, rotation in parts])


@pytest.mark.parametrize("articulated", [False, True])
@pytest.mark.parametrize("stiffness", [math.inf, 1e5])
def test_a_spinning_ball_slows_down_evenly_and_stops(articulated, stiffness):
    damping = 0.0 if math.isinf(stiffness) else 2.0 * math.sqrt(stiffness * MASS)
    surface = Material(torsion=4e-3, stiffness=stiffness, damping=damping)
    simulator = ball(surface, articulated=articulated)
    run(simulator, 300)  # sink in
    simulator.state.v[5] = 5.0
    slows = 4e-3 * MASS * GRAVITY / INERTIA  # rad/s^2
    run(simulator, 500)
    assert simulator.state.v[5] == pytest.approx(5.0 - 0.5 * slows, rel=1e-5)
    assert simulator.contacts[0].moment_local == pytest.approx([0.0, 0.0, -4e-3 * MASS * GRAVITY], rel=1e-5, abs=1e-9)
    run(simulator, 2000)
    assert np.abs(simulator.state.v).max() < 1e-8
    assert abs(simulator.contacts[0].moment_local[2]) < 1e-8


@pytest.mark.parametrize("articulated", [False, True])
@pytest.mark.parametrize("degrees", [0.0, 17.0, 45.0, 100.0, 200.0, 271.0])
def test_a_rolling_ball_slows_down_on_a_straight_line(degrees, articulated):
    """M v' = -f, I w' = f r - M_r with v = w r: v' = -(m_r / r) g / (1 + 2/5), wherever it goes."""
    along = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])
    rolling = 2e-3
    simulator = ball(Material(friction=0.7, rolling=rolling), articulated=articulated)
    run(simulator, 10)
    set_velocity(simulator, np.concatenate([along, np.cross((0.0, 0.0, 1.0), along) / RADIUS]), articulated)
    slows = rolling / RADIUS * GRAVITY / 1.4
    run(simulator, 1000)
    assert velocity(simulator, articulated)[:3] == pytest.approx((1.0 - slows) * along, abs=1e-5)
    moment = -rolling * MASS * GRAVITY * np.cross((0.0, 0.0, 1.0), along)
    contact = simulator.contacts[0]
    assert contact.frame @ contact.moment_local == pytest.approx(moment, abs=1e-6)


@pytest.mark.parametrize("degrees", [0.0, 45.0, 130.0])
def test_a_ball_stays_on_a_slope_below_rolling_over_radius_whatever_its_direction(degrees):
    rolling = 0.01  # the slope is 0.1
    for share, moves in ((0.98, False), (1.02, True)):
        slope = math.atan(share * rolling / RADIUS)
        down = GRAVITY * math.sin(slope) * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        simulator = ball(Material(rolling=rolling), gravity=(*down, -GRAVITY * math.cos(slope)))
        run(simulator, 500)
        speed = velocity(simulator)[:2]
        if moves:
            faster = 0.02 / 1.02 * down / 1.4
            assert speed == pytest.approx(0.5 * faster, rel=2e-2)
        else:
            assert np.abs(speed).max() < 1e-8


def test_a_ball_that_turns_about_everything_obeys_the_laws_of_both():
    """Torques are opposite to what turns: of rolling |moment| = m_r N, of torsion m_t N."""
    simulator = ball(Material(friction=0.7, torsion=5e-3, rolling=2e-3))
    run(simulator, 10)
    simulator.state.v[:] = (1.0, 0.5, 0.0, -5.0, 10.0, 3.0)
    run(simulator, 20)
    contact = simulator.contacts[0]
    moment, normal = contact.moment_local, contact.force_local[2]
    turns = contact.frame.T @ velocity(simulator)[3:]
    assert np.hypot(*moment[:2]) == pytest.approx(2e-3 * normal, rel=1e-5)
    assert moment[:2] == pytest.approx(-2e-3 * normal * turns[:2] / np.hypot(*turns[:2]), rel=1e-4)
    assert moment[2] == pytest.approx(-math.copysign(5e-3 * normal, turns[2]), rel=1e-5)


def test_a_box_of_four_points_shares_the_torsion():
    surface = Material(friction=0.0, torsion=3e-3)
    builder = WorldBuilder(gravity=(0.0, 0.0, -GRAVITY))
    builder.add_ground(surface)
    builder.add_body("box", joints=[Joint("box", "free")], position=(0, 0, 0.1), mass=MASS, inertia=0.02 * np.eye(3))
    builder.add_geometry("box", Box((0.2, 0.2, 0.1)), material=surface)
    simulator = Simulator(builder.build(), time_step=DT)
    run(simulator, 10)
    simulator.state.v[5] = 2.0
    run(simulator, 100)
    assert len(simulator.contacts) == 4
    assert simulator.state.v[5] == pytest.approx(2.0 - 0.1 * 3e-3 * MASS * GRAVITY / 0.02, rel=1e-6)


def test_the_condim_of_a_pair_is_the_larger_and_so_are_its_coefficients():
    def mixed(a, b):
        builder = WorldBuilder()
        builder.add_body("a", joints=[Joint("a", "free")], mass=1.0, inertia=np.eye(3))
        builder.add_geometry("a", Sphere(0.1), material=a)
        builder.add_geometry("world", Sphere(0.1), material=b)
        simulator = Simulator(builder.build())
        simulator.state.v[:] = (0.0, 0.0, 0.0, 5.0, 5.0, 5.0)
        simulator.state.q[:3] = (0.0, 0.0, 0.199)
        simulator.step()
        (contact,) = simulator.contacts
        return np.abs(contact.moment_local) / contact.force_local[2]

    three = Material(torsion=0.02, rolling=0.01, condim=3)
    assert mixed(three, three) == pytest.approx([0.0, 0.0, 0.0])
    four = Material(torsion=0.005, rolling=0.01, condim=4)
    assert mixed(three, four)[2] == pytest.approx(0.02, rel=1e-5)
    assert mixed(three, four)[:2] == pytest.approx([0.0, 0.0])
    assert mixed(four, Material(condim=6))[0] > 0.0
    assert mixed(Material(), Material(torsion=0.005))[2] == pytest.approx(0.005, rel=1e-5)
    assert mixed(Material(priority=1), Material(torsion=0.005)) == pytest.approx([0.0, 0.0, 0.0])
    frictionless = Material(torsion=0.005, condim=1)
    assert mixed(frictionless, frictionless) == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"torsion": -1e-3}, "torsion"),
        ({"rolling": math.nan}, "rolling"),
        ({"rolling": math.inf}, "rolling"),
        ({"condim": 2}, "condim"),
        ({"condim": 0}, "condim"),
        ({"condim": True}, "condim"),
        ({"torsion": "little"}, "torsion"),
    ],
)
def test_bad_coefficients_are_refused(changes, field):
    builder = WorldBuilder()
    with pytest.raises(InvalidInputError, match=field):
        builder.add_geometry("world", Sphere(0.1), material=Material(**changes))


def test_a_restored_simulator_goes_on_bit_by_bit():
    simulator = ball(Material(torsion=5e-3, rolling=2e-3))
    simulator.state.v[:] = (1.0, 0.5, 0.0, -5.0, 10.0, 3.0)
    run(simulator, 30)
    saved = simulator.save()
    run(simulator, 30)
    expected = simulator.state_hash
    other = ball(Material(torsion=5e-3, rolling=2e-3))
    other.restore(saved)
    run(other, 30)
    assert other.state_hash == expected


@pytest.mark.parametrize("solver", ["admm", "pgs", "interior-point"])
def test_other_solvers_agree(solver):
    results = []
    for name in ("auto", solver):
        simulator = ball(Material(torsion=5e-3, rolling=2e-3), solver=name, time_step=1e-2)
        simulator.state.v[:] = (1.0, 0.5, 0.0, -5.0, 10.0, 3.0)
        run(simulator, 30)
        results.append(simulator.state.v.copy())
    assert results[0] == pytest.approx(results[1], abs=1e-4)


def test_the_ccp_rolls_and_spins_as_the_ncp():
    """Its contact does not slide here, so that the two laws agree."""
    results = []
    for law in ("ncp", "ccp"):
        simulator = ball(Material(torsion=5e-3, rolling=2e-3), law=law)
        run(simulator, 5)
        set_velocity(simulator, np.array((1.0, 0.5, 0.0, -5.0, 10.0, 3.0)))
        run(simulator, 200)
        results.append(simulator.state.v.copy())
    assert velocity(simulator)[5] == pytest.approx(3.0 - 0.2 * 5e-3 * MASS * GRAVITY / INERTIA, abs=5e-3)
    assert results[0] == pytest.approx(results[1], abs=5e-3)


def test_the_ccp_solves_steps_with_contacts_that_do_not_push():
    """One ball rests, one hangs in the air within the margin, one is pulled off: what is open has no load to find."""
    surface = Material(torsion=5e-3, rolling=2e-3)
    builder = WorldBuilder()
    builder.add_ground(surface)
    for k, height in enumerate((0.1, 0.1008, 0.1)):
        name = f"ball_{k}"
        place = (0.5 * k, 0.0, height)
        builder.add_body(name, joints=[Joint(name, "free")], position=place, mass=MASS, inertia=INERTIA * np.eye(3))
        builder.add_geometry(name, Sphere(RADIUS), material=surface)
    simulator = Simulator(builder.build(), law="ccp", time_step=DT)
    simulator.state.v[:] = 3 * (0.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    run(simulator, 5)
    simulator.applied_force[14] = 2.0 * MASS * GRAVITY
    expected = simulator.state.v[15:].copy()
    run(simulator, 5)
    assert simulator.state.v[15:] == pytest.approx(expected)  # nothing holds it any more
    run(simulator, 30)


def test_the_ccp_finds_loads_that_many_points_share():
    """Each of 16 points feels what the loads of all make of the common turn."""
    surface = Material(friction=0.5, torsion=4e-3, rolling=2e-3)
    builder = WorldBuilder()
    builder.add_ground(surface)
    builder.add_body("raft", joints=[Joint("raft", "free")], position=(0, 0, 0.1), mass=MASS, inertia=0.02 * np.eye(3))
    for k in range(4):
        builder.add_geometry("raft", Box((0.1, 0.1, 0.1)), material=surface, position=(0.3 * k, 0.0, 0.0))
    simulator = Simulator(builder.build(), law="ccp", time_step=DT, tolerance=1e-9)
    run(simulator, 10)
    simulator.state.v[:] = (1.0, 0.3, 0.0, 0.5, 0.4, 3.0)
    run(simulator, 100)


def test_the_certificate_of_a_step_is_no_milder_than_that_of_all_contacts():
    """A ball that flies off is left out of the problem, fast as it is; torsion counts in what its speed is worth."""
    torsion = 1.0
    surface = Material(torsion=torsion)
    builder = WorldBuilder()
    builder.add_ground(surface)
    for k in range(2):
        name, place = f"ball_{k}", (0.5 * k, 0.0, RADIUS)
        builder.add_body(name, joints=[Joint(name, "free")], position=place, mass=MASS, inertia=INERTIA * np.eye(3))
        builder.add_geometry(name, Sphere(RADIUS), material=surface)
    simulator = Simulator(builder.build(), solver="pgs", tolerance=1e-2, time_step=DT)
    simulator.state.v[:] = (0.1, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0)
    simulator.step()
    assert len(simulator.contacts) == 2
    assert simulator.report.num_constraints == 2
    forces = [c.force_local for c in simulator.contacts]
    moments = [(c.moment_local[2], 0.0, torsion * c.force_local[2]) for c in simulator.contacts]
    impulse = DT * np.concatenate([*forces, *moments])
    whole = signorini.residual(simulator.contact_problem(), impulse).relative
    assert whole > 1e-6
    assert simulator.report.residual.relative >= 0.999 * whole


@pytest.mark.parametrize("boxes", [False, True])
def test_a_heap_that_spins_and_rolls_is_solved_and_comes_to_rest(boxes):
    builder = WorldBuilder()
    surface = Material(friction=1.0, torsion=0.02, rolling=0.01)
    builder.add_ground(surface)
    rng = np.random.default_rng(3)
    for i in range(18):
        place = np.array((0.11 * (i % 3), 0.11 * (i // 3 % 3), 0.06 + 0.12 * (i // 9)))
        position = place + rng.uniform(-0.02, 0.02, 3) * (1, 1, 0)
        name = f"body_{i}"
        builder.add_body(name, joints=[Joint(name, "free")], position=position, mass=1.0, inertia=1e-3 * np.eye(3))
        shape = Box((0.05, 0.05, 0.05)) if boxes and i % 2 else Sphere(0.05)
        builder.add_geometry(name, shape, material=surface)
    simulator = Simulator(builder.build(), time_step=DT)
    run(simulator, 1000)
    assert np.abs(simulator.state.v).max() < 1e-5
    for contact in simulator.contacts:
        moment, normal = contact.moment_local, contact.force_local[2]
        assert np.hypot(*moment[:2]) <= 0.01 * normal + 1e-4
        assert abs(moment[2]) <= 0.02 * normal + 1e-4


def inverse_of_a_step(simulator, applied, *, guess, **options):
    """The inverse of a step with these forces; they are what it has to find."""
    simulator.applied_force[:] = applied
    before = simulator.state.q.copy(), simulator.state.v.copy()
    simulator.step()
    guess = simulator if guess else None
    result = inverse_dynamics(simulator.world, before, simulator.state.v, DT, impulse_guess=guess, **options)
    assert result.status == "solved"
    return result


@pytest.mark.parametrize("stiffness", [math.inf, 1e4])
@pytest.mark.parametrize("articulated", [False, True])
def test_inverse_dynamics_of_a_step_gives_its_forces(stiffness, articulated):
    surface = Material(torsion=5e-3, rolling=2e-3, stiffness=stiffness)
    simulator = ball(surface, articulated=articulated, tolerance=1e-10)
    simulator.state.v[:] = (1.0, 0.5, 0.0, -5.0, 10.0, 3.0)
    for applied in ((0.0,) * 6, (0.3, -0.2, 0.1, 0.02, 0.03, -0.01)):
        run(simulator, 5)
        result = inverse_of_a_step(simulator, applied, guess=True)
        assert result.force == pytest.approx(applied, abs=1e-7)
        (contact,) = [c for c in result.contacts if c.force_local[2] > 0.0]
        own = contact.frame @ contact.moment_local
        (contact,) = simulator.contacts
        assert own == pytest.approx(contact.frame @ contact.moment_local, abs=1e-8)


def test_inverse_dynamics_of_a_ball_held_still_gives_no_more_than_friction_can():
    """Turned by a torque that torsion holds, it stays; asked to stay under a larger one, the motor has to help."""
    simulator = ball(Material(torsion=5e-3))
    run(simulator, 10)
    holds = 5e-3 * MASS * GRAVITY
    simulator.applied_force[5] = 0.9 * holds
    run(simulator, 100)
    assert np.abs(simulator.state.v).max() < 1e-8
    before = simulator.state.q.copy(), simulator.state.v.copy()
    simulator.step()
    for guess in (simulator, simulator.contacts):
        result = inverse_dynamics(simulator.world, before, simulator.state.v, DT, impulse_guess=guess)
        assert result.force == pytest.approx(simulator.applied_force, rel=1e-4, abs=1e-7)
    simulator.applied_force[5] = 1.1 * holds
    run(simulator, 100)
    assert velocity(simulator)[5] == pytest.approx(0.1 * holds / INERTIA * 0.1, rel=1e-4)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
def test_inverse_dynamics_of_what_turns_needs_no_guess_on_soft_ground(law):
    """The normal force follows from the overlap, the moments from it."""
    surface = Material(friction=0.0, torsion=5e-3, rolling=2e-3, stiffness=1e4, damping=50.0)
    simulator = ball(surface, law=law, tolerance=1e-9)
    simulator.state.v[:] = (1.0, 0.5, 0.0, -5.0, 10.0, 3.0)
    for applied in ((0.0,) * 6, (0.3, -0.2, 0.1, 0.02, 0.03, -0.01)):
        run(simulator, 20)
        result = inverse_of_a_step(simulator, applied, guess=False, law=law)
        assert result.force == pytest.approx(applied, abs=1e-4)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
def test_inverse_dynamics_holds_moments_of_a_guess_within_the_new_normal_force(law):
    """Pressed and twisted, then asked to stay with less overlap: torsion gives what that allows, the motor the rest."""
    stiffness = 1e4
    simulator = ball(Material(torsion=5e-3, stiffness=stiffness, damping=200.0), law=law)
    simulator.applied_force[2] = -100.0
    run(simulator, 500)
    twist = simulator.applied_force[5] = 0.9 * 5e-3 * (100.0 + MASS * GRAVITY)
    run(simulator, 100)
    before = simulator.state.q.copy(), np.zeros(6)
    v_next = np.array((0.0, 0.0, 0.15, 0.0, 0.0, 0.0))
    simulator.step()
    result = inverse_dynamics(simulator.world, before, v_next, DT, law=law, impulse_guess=simulator)
    assert result.status == "solved"
    (contact,) = result.contacts
    normal = contact.force_local[2]
    assert 0.0 < 5e-3 * normal < 0.9 * twist
    assert abs(contact.moment_local[2]) == pytest.approx(5e-3 * normal, rel=1e-6)
    assert result.force[5] == pytest.approx(abs(contact.moment_local[2]), rel=1e-6)


@pytest.mark.parametrize("law", ["ncp", "ccp"])
@pytest.mark.parametrize("stiffness", [math.inf, 1e5])
def test_the_closest_motion_of_a_ball_is_that_which_friction_allows(law, stiffness):
    """Asked to stop at once, nothing but torsion and rolling slows it down."""
    simulator = ball(Material(torsion=4e-3, rolling=2e-3, stiffness=stiffness), law=law, tolerance=1e-9)
    run(simulator, 300)
    for start in ((0.0, 0.0, 0.0, 0.0, 0.0, 5.0), (0.5, 0.0, 0.0, 0.0, 5.0, 0.0), (0.0,) * 6):
        simulator.state.v[:] = start
        before = simulator.state.q.copy(), simulator.state.v.copy()
        result = inverse_dynamics(simulator.world, before, np.zeros(6), DT, law=law, closest=True)
        assert result.status == "solved"
        assert result.force == pytest.approx(np.zeros(6), abs=1e-6)
        saved = simulator.save()
        simulator.step()
        assert result.v_next == pytest.approx(simulator.state.v, abs=2e-5)
        simulator.restore(saved)


MJCF = """<mujoco><option timestep="0.001" cone="elliptic"/><default><geom solref="0.004 1" condim="{condim}"
  friction="0.8 0.01 0.004"/></default><worldbody><geom type="plane" size="9 9 1"/>
  <body pos="0 0 .1"><freejoint/><geom size=".1" mass="2"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("condim", "start"),
    [(4, (0, 0, 0, 0, 0, 5)), (6, (0, 0, 0, 0, 0, 5)), (6, (1, 0, 0, 0, 10, 0)), (3, (1, 0, 0, 0, 10, 3))],
)
def test_mjcf_files_spin_and_roll_as_mujoco_has_them(tmp_path, condim, start):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "ball.xml"
    path.write_text(MJCF.format(condim=condim))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    simulator = Simulator(signorini.load(path), time_step=DT)
    for k in range(600):
        if k == 100:
            data.qvel[:3], data.qvel[3:] = start[:3], start[3:]  # it has not turned
            set_velocity(simulator, np.array(start, dtype=float))
        mujoco.mj_step(model, data)
        simulator.step()
    assert simulator.report.unsolved == 0
    ours = velocity(simulator)
    assert ours[:2] == pytest.approx(data.qvel[:2], abs=0.01)  # MuJoCo's are in the world; its ball lifts off
    assert simulator.state.v[3:] == pytest.approx(data.qvel[3:], abs=0.1)
    assert np.abs(np.asarray(start) - ours).max() > 0.1 or condim == 3


@pytest.mark.parametrize("law", ["ncp", "ccp"])
def test_the_certificate_holds_for_moments_of_contacts_left_out(law):
    rolling, torsion = 0.01, 0.02
    surface = Material(friction=0.6, torsion=torsion, rolling=rolling)
    builder = WorldBuilder()
    builder.add_ground(surface)
    rng = np.random.default_rng(0)
    for i in range(18):
        place = (0.25 * (i % 3) + rng.uniform(-0.02, 0.02), 0.25 * (i // 3 % 3), 0.12 + 0.23 * (i // 9))
        name = f"body {i}"
        builder.add_body(name, joints=[Joint(name, "free")], position=place, mass=1.0, inertia=5e-3 * np.eye(3))
        builder.add_geometry(name, Box((0.1, 0.1, 0.1)) if i % 2 else Sphere(0.1), material=surface)
    simulator = Simulator(builder.build(), law=law)
    simulator.state.v[:] = np.random.default_rng(1).normal(size=simulator.world.num_v) * 0.5
    left_out = 0
    for _ in range(30):
        simulator.run(10)
        contacts = simulator.contacts
        if not contacts:
            continue
        left_out += 3 * len(contacts) - simulator.report.num_constraints
        moments = []
        for contact in contacts:
            moment, normal = contact.moment_local, contact.force_local[2]
            moments += [moment[0], moment[1], rolling * normal, moment[2], 0.0, torsion * normal]
        impulse = simulator.settings.time_step * np.concatenate([contacts.force_local.ravel(), moments])
        certificate = signorini.residual(simulator.contact_problem(), impulse, law=law)
        # Loads are r times the normal impulse to the tolerance only.
        assert certificate.relative <= 5.0 * simulator.settings.tolerance
    assert left_out > 0
