"""The simulator's interface: state, contacts, save and restore, rollouts, bad input. Physics: test_physics.py."""

import copy
import math
import pickle
import warnings

import numpy as np
import pytest
from test_physics import add_box, add_sphere, pendulum, plate

import signorini
from signorini import (
    Capsule,
    Convex,
    InvalidInputError,
    InverseDynamics,
    Joint,
    Material,
    Simulator,
    SimulatorSettings,
    Sphere,
    WorldBuilder,
    fclib,
    rollout,
    scenes,
)


@pytest.fixture(scope="module")
def tumble():
    """Six boxes and a chain that fall on each other: impacts, slip, joints."""
    builder = WorldBuilder()
    builder.add_ground()
    for i in range(6):
        add_box(
            builder, f"box{i}", 1.0 + i, (0.1, 0.12, 0.08), (0.05 * i, 0.02 * i, 0.2 + 0.25 * i), None, (0.1, i, 0, 5)
        )
    add_sphere(builder, "ball", 2.0, 0.1, (0.0, 0.3, 0.5), None)
    builder.add_body(
        "arm",
        joints=[Joint("hinge", "revolute", axis=(0, 1, 0), lower=-1.0, upper=1.0, friction=0.1, damping=0.01)],
        position=(0.5, 0.0, 0.6),
        mass=1.0,
        center=(-0.3, 0.0, 0.0),
        inertia=0.01 * np.eye(3),
    )
    builder.add_geometry("arm", signorini.Capsule(0.05, 0.2), position=(-0.3, 0, 0), orientation=(0, 0.7071, 0, 0.7071))
    builder.add_motor("motor", "hinge", gear=2.0, control_range=(-1.0, 1.0))
    return builder.build()


def test_state_control_and_forces_are_views(tumble):
    simulator = Simulator(tumble)
    simulator.state.q[tumble.q_slice("hinge")] = 0.2
    assert simulator.state.q[tumble.q_slice("hinge")] == 0.2
    simulator.control[0] = 0.5
    simulator.applied_force[tumble.v_slice("hinge")] = 0.1
    before = simulator.state.v.copy()
    simulator.step()
    assert simulator.state.time == pytest.approx(1e-3)
    assert (simulator.state.v != before).any()
    with pytest.raises(InvalidInputError, match=r"q: has shape \(2,\)"):
        simulator.state.q = [0.0, 1.0]


def test_same_input_same_bits(tumble):
    hashes = set()
    for _ in range(2):
        simulator = Simulator(tumble)
        simulator.run(400)
        hashes.add(simulator.state_hash)
    simulator.reset()
    simulator.run(400)
    assert hashes == {simulator.state_hash}


def test_every_step_is_solved(tumble):
    simulator = Simulator(tumble)
    trace = simulator.run(1500)
    assert trace.solved.all()
    assert trace.relative.max() <= simulator.settings.tolerance
    assert trace.num_contacts.max() >= 8


@pytest.mark.parametrize("at", [1, 150, 333])
def test_a_restored_run_goes_on_bit_for_bit(tumble, at):
    simulator = Simulator(tumble)
    simulator.control[0] = 0.7
    simulator.run(at)
    saved = simulator.save()
    simulator.run(300)
    other = Simulator(tumble)
    other.restore(saved)
    assert other.state.time == pytest.approx(at * 1e-3)
    other.run(300)
    assert other.state_hash == simulator.state_hash
    assert other.report.steps == simulator.report.steps


def test_a_plate_that_slaps_down_goes_on_bit_for_bit_from_its_middle():
    """Saved in every step from before it arrives until it lies: also while more corners push than the first four."""
    builder = WorldBuilder()
    material = Material(friction=0.5)
    builder.add_ground(material)
    tilted = (np.sin(0.075), 0.0, 0.0, np.cos(0.075))
    add = {"position": (0.0, 0.0, 0.04), "orientation": tilted, "mass": 1.0, "inertia": np.diag([25e-4, 25e-4, 5e-3])}
    builder.add_body("plate", joints=[Joint("plate", "free")], **add)
    builder.add_geometry("plate", plate(1e-4, np.random.default_rng(2)), material=material)
    world = builder.build()
    simulator = Simulator(world)
    simulator.run(70)
    saved, after, most = [], [], 0

    def known(one):
        return one.state_hash, [(contact.id, contact.mode) for contact in one.contacts]

    for _ in range(30):
        saved.append(simulator.save())
        simulator.step()
        after.append(known(simulator))
        most = max(most, sum(contact.mode != "open" for contact in simulator.contacts))
    assert most > 4
    other = Simulator(world)
    for at, before in enumerate(saved):
        other.restore(before)
        for k in range(at, 30):
            other.step()
            assert known(other) == after[k], (at, k)


@pytest.mark.parametrize(("now", "before"), [(b"signorini state 5", 4), (b"signorini detector 3", 2)])
def test_states_of_an_older_format_are_refused(tumble, now, before):
    simulator = Simulator(tumble)
    simulator.run(100)
    saved, hash_ = simulator.save(), simulator.state_hash
    assert saved.count(now) == 1
    with pytest.raises(InvalidInputError, match="another version|not what save"):
        simulator.restore(saved.replace(now, now[:-1] + b"%d" % before))
    assert simulator.state_hash == hash_


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[:-1], lambda b: b + b"x", lambda b: b"y" * len(b)])
def test_damaged_states_are_refused(tumble, damage):
    simulator = Simulator(tumble)
    simulator.run(100)
    before = simulator.state_hash
    with pytest.raises(InvalidInputError, match="bytes"):
        simulator.restore(damage(simulator.save()))
    assert simulator.state_hash == before
    with pytest.raises(InvalidInputError, match="another time step"):
        Simulator(tumble, time_step=2e-3).restore(simulator.save())


def test_every_flipped_bit_of_a_saved_state_is_refused(tumble):
    simulator = Simulator(tumble)
    simulator.run(100)
    saved = simulator.save()
    simulator.step(3)
    before = simulator.save()
    for bit in range(8 * len(saved)):
        damaged = bytearray(saved)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(InvalidInputError, match="bytes"):
            simulator.restore(bytes(damaged))
    assert simulator.save() == before
    simulator.restore(saved)
    assert simulator.save() == saved


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_rollout_is_bit_equal_to_stepping_one_by_one(tumble, threads):
    rng = np.random.default_rng(0)
    steps, num = 120, 4
    start = np.hstack([np.tile(tumble.initial_q, (num, 1)), 0.3 * rng.normal(size=(num, tumble.num_v))])
    controls = rng.uniform(-1, 1, size=(num, steps, 1))
    result = rollout(tumble, start, controls, threads=threads)
    for i in range(num):
        simulator = Simulator(tumble)
        simulator.state.q, simulator.state.v = start[i, : tumble.num_q], start[i, tumble.num_q :]
        states = simulator.run(steps, controls[i], keep_states=True).states
        assert (states == result.states[i]).all()
        assert result.unsolved[i] == simulator.report.unsolved


def starts(world, count):
    return np.hstack([np.tile(world.initial_q, (count, 1)), np.zeros((count, world.num_v))])


def test_a_rollout_that_explodes_does_not_stop_the_others(tumble):
    start = starts(tumble, 2)
    speed = tumble.num_q + tumble.v_slice("box0").start
    start[0, speed : speed + 6] = 1e100 / 6.0 * np.arange(1, 7)  # what a step takes, and what it leads to is more
    result = rollout(tumble, start, num_steps=4)
    gone = np.isnan(result.states[0]).all(axis=1)
    assert gone[-1]
    assert result.unsolved[0] == gone.sum()
    assert np.isfinite(result.states[0, ~gone]).all()
    assert np.isfinite(result.states[1]).all()


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e101])
@pytest.mark.parametrize(("field", "at"), [("q", 0), ("q", 6), ("v", 2)])
def test_a_rollout_refuses_where_no_step_can_start(tumble, field, at, value):
    start = starts(tumble, 3)
    start[1, at + (tumble.num_q if field == "v" else 0)] = value
    with pytest.raises(InvalidInputError, match=rf"^states\[1\]\.{field}\[{at}\]: is (nan|inf|-1e\+101), must"):
        rollout(tumble, start, num_steps=3)


def test_a_rollout_refuses_quaternions_of_length_0_and_takes_others(tumble):
    start = starts(tumble, 3)
    quaternion = tumble.q_slice("box3").start + 3
    start[1, quaternion : quaternion + 4] = 0.0, 0.0, 0.0, 2.0  # a step makes it one of length 1
    rollout(tumble, start, num_steps=1)
    start[2, quaternion : quaternion + 4] = 0.0
    with pytest.raises(InvalidInputError, match=r"^states\[2\]\.q: .*quaternion of length 0 \(joint 'box3'\)"):
        rollout(tumble, start, num_steps=1)
    simulator = Simulator(tumble)
    simulator.state.q[quaternion : quaternion + 4] = 0.0
    with pytest.raises(InvalidInputError, match=r"^q: .*quaternion of length 0 \(joint 'box3'\)"):
        simulator.step()


def test_a_rollout_refuses_controls_that_are_not_finite(tumble):
    controls = np.zeros((3, 4, 1))
    controls[2, 1, 0] = math.nan
    with pytest.raises(InvalidInputError, match=r"^controls\[2, 1, 0\]: is nan"):
        rollout(tumble, starts(tumble, 3), controls)


def test_a_box_at_rest_stays_on_its_corners_without_a_margin():
    """Far from the origin on a slope, where its gaps are a little more or less than 0 by rounding."""
    slope = np.array([0.0, math.sin(0.05), 0.0, math.cos(0.05)])
    up = np.array([math.sin(0.1), 0.0, math.cos(0.1)])
    place = 1000.0 * np.array([math.cos(0.1), 0.0, -math.sin(0.1)]) + (0.05 + 1e-3) * up
    builder = WorldBuilder()
    builder.add_geometry("world", signorini.HalfSpace(), orientation=slope)
    add_box(builder, "box", 1.0, (0.1, 0.05, 0.05), place, None, slope)
    simulator = Simulator(builder.build(), contact_margin=0.0)
    simulator.step(200)
    for _ in range(300):
        simulator.step()
        assert (simulator.contacts.mode != "open").sum() == 4
        assert simulator.contact_force("world", "box") == pytest.approx([0.0, 0.0, 9.81], abs=1e-4)


def test_contacts_say_who_where_and_how_strong():
    builder = WorldBuilder()
    builder.add_ground()
    add_box(builder, "box", 2.0, (0.1, 0.1, 0.1), (0.0, 0.0, 0.1), None)
    simulator = Simulator(builder.build())
    simulator.run(10)
    contacts = simulator.contacts
    assert len(contacts) == 4
    assert {(c.body_a, c.body_b, c.geometry_a, c.geometry_b) for c in contacts} == {("world", "box", "ground", "box")}
    total = sum(c.force for c in contacts)
    assert total == pytest.approx([0.0, 0.0, 2.0 * 9.81], abs=1e-8)
    assert simulator.contact_force("world", "box") == pytest.approx(total)
    assert simulator.contact_force("box", "world") == pytest.approx(-total)
    ids = {c.id for c in contacts}
    for c in contacts:
        assert c.normal == pytest.approx([0.0, 0.0, 1.0])
        assert c.frame @ c.force_local == pytest.approx(c.force)
        assert abs(c.position[2]) < 1e-9
    simulator.run(100)
    assert {c.id for c in simulator.contacts} == ids


def test_columns_of_contacts_say_the_same_as_the_items():
    world, q, v = scenes.worlds()["boxes"](size=8)
    simulator = Simulator(world)
    simulator.state.q, simulator.state.v = q, v
    modes = set()
    for _ in range(30):
        simulator.run(20)
        contacts = simulator.contacts
        modes |= set(contacts.mode)
        for k, one in enumerate(contacts):
            a, b = (world.geometries[i] for i in contacts.geometries[k])
            assert (a.name, b.name, world.body_names[a.body]) == (one.geometry_a, one.geometry_b, one.body_a)
            assert (contacts.mode[k], contacts.id[k], contacts.distance[k]) == (one.mode, one.id, one.distance)
            for name in ("position", "normal", "frame", "force_local", "moment_local", "velocity"):
                assert np.array_equal(getattr(contacts, name)[k], getattr(one, name)), name
            assert contacts.force[k] == pytest.approx(one.force, abs=1e-12)
        by_world = [world.geometries[i].body == 0 for i in contacts.geometries[:, 0]]
        whole = sum(simulator.contact_force("world", body) for body in world.body_names[1:])
        assert contacts.force[by_world].sum(axis=0) == pytest.approx(whole, abs=1e-9)
    assert modes == {"open", "stick", "slide"}
    assert [one.id for one in contacts[-2:]] == list(contacts.id[-2:])
    assert contacts[-1].id == contacts.id[-1]
    with pytest.raises(IndexError):
        contacts[len(contacts)]
    assert contacts[np.array(1)].id == contacts[np.int32(1)].id == contacts.id[1]
    held = contacts.position.copy()
    simulator.run(20)
    assert np.array_equal(contacts.position, held)  # of its own


def test_masks_slices_and_indices_select_contacts(tumble):
    simulator = Simulator(tumble)
    simulator.run(300)
    contacts = simulator.contacts
    n = len(contacts)
    assert n > 2
    up = contacts.normal[:, 2] > 0.5
    for key in (slice(1, None), slice(None, None, -2), up, ~up, up.tolist(), np.array([n - 1, 0, 0]), [-1], []):
        chosen, rows = contacts[key], np.arange(n)[key]
        assert [one.id for one in chosen] == [contacts[int(k)].id for k in rows]
        assert np.array_equal(chosen.mode, contacts.mode[rows])
        for name in ("geometries", "id", "distance", "position", "normal", "frame", "force", "velocity"):
            assert np.array_equal(getattr(chosen, name), getattr(contacts, name)[rows]), name
            assert not np.shares_memory(getattr(chosen, name), getattr(contacts, name)), name
        assert len(pickle.loads(pickle.dumps(chosen))) == len(rows)
    for wrong in (np.zeros(n + 1, bool), [n], np.array([0.5])):
        with pytest.raises(IndexError):
            contacts[wrong]
    for wrong in (np.zeros((1, 1), int), (0, 1), 0.5):
        with pytest.raises(TypeError):
            contacts[wrong]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda contacts: pickle.loads(pickle.dumps(contacts))])
def test_contacts_are_copied_and_pickled(tumble, copied):
    simulator = Simulator(tumble)
    assert len(copied(simulator.contacts)) == 0
    simulator.run(300)
    contacts = simulator.contacts
    again = copied(contacts)
    assert len(again) == len(contacts) > 0
    assert [(one.id, one.body_a, one.geometry_b) for one in again] == [
        (one.id, one.body_a, one.geometry_b) for one in contacts
    ]
    assert np.array_equal(again.force, contacts.force)
    assert np.array_equal(again.mode, contacts.mode)
    assert not np.shares_memory(again.position, contacts.position)
    for name in ("position", "normal", "frame", "force_local", "moment_local", "velocity"):
        assert not np.shares_memory(getattr(contacts[0], name), getattr(contacts, name)), name


def test_contact_problem_is_what_was_solved(tumble, tmp_path):
    simulator = Simulator(tumble)
    simulator.run(300)
    problem = simulator.contact_problem()
    assert problem.size >= 3 * simulator.report.num_contacts
    again = signorini.solve(problem, tolerance=1e-8)
    assert again.solved
    builder = WorldBuilder()
    builder.add_ground()
    add_box(builder, "box", 2.0, (0.1, 0.1, 0.1), (0.0, 0.0, 0.1), None)
    contacts_only = Simulator(builder.build())
    contacts_only.step()
    fclib.write(tmp_path / "step.hdf5", contacts_only.contact_problem())
    assert fclib.read(tmp_path / "step.hdf5").num_contacts == 4


@pytest.mark.parametrize("law", ["ncp", "ccp"])
def test_the_certificate_holds_for_contacts_left_out_of_the_solve_too(law):
    world, q, v = signorini.scenes.worlds()["boxes"](size=8)
    simulator = Simulator(world, law=law)
    simulator.state.q, simulator.state.v = q, v
    left_out = 0
    for _ in range(12):
        simulator.run(50)
        report, problem = simulator.report, simulator.contact_problem()
        assert problem.num_constraints == report.num_contacts
        left_out += report.num_contacts - report.num_constraints
        impulse = np.concatenate([simulator.settings.time_step * c.force_local for c in simulator.contacts] or [[]])
        certificate = signorini.residual(problem, impulse, law=law)
        assert certificate.relative <= simulator.settings.tolerance
        assert certificate.relative <= report.residual.relative * (1.0 + 1e-6) + 1e-12
    assert left_out > 0


def test_nothing_is_known_of_contacts_after_reset_and_restore():
    world, q, v = scenes.worlds()["boxes"](size=8)
    simulator = Simulator(world)
    saved = simulator.save()
    for forget in (simulator.reset, lambda: simulator.restore(saved)):
        simulator.state.q, simulator.state.v = q, v
        simulator.run(400)
        assert len(simulator.contacts) == simulator.report.num_contacts > 0
        forget()
        assert not simulator.contacts
        assert simulator.contact_problem().size == 0
        assert not simulator.contact_force("box-0", "box-1").any()


def test_a_blow_passes_through_contacts_that_were_open():
    """A ball hits a row of resting ones in one step; each gap, too wide to close by itself, must transmit."""
    radius, gap, dt = 0.1, 1e-6, 1e-3
    builder = WorldBuilder(gravity=(0.0, 0.0, 0.0))
    for i in range(5):
        add_sphere(builder, f"ball{i}", 1.0, radius, (i * (2.0 * radius + gap), 0.0, 0.0), None)
    simulator = Simulator(builder.build(), time_step=dt)
    simulator.state.v[0] = 1.0
    simulator.step()
    x, v = simulator.state.q[::7], simulator.state.v[::6]
    assert sum(v) == pytest.approx(1.0, abs=1e-9)
    assert (np.diff(x) >= 2.0 * radius - 1e-9).all()
    assert (v > 0.1).all()


def test_on_unsolved():
    def simulator(on_unsolved):
        start = scenes.worlds()["cube-stack"](mass_ratio=1e4, slip=0.5, num_cubes=10)
        s = Simulator(start.world, solver="pgs", max_iterations=1, tolerance=1e-12, on_unsolved=on_unsolved)
        s.state.v = start.v
        return s

    quiet = simulator("continue")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quiet.step(2)
    assert quiet.report.unsolved == 2
    assert quiet.report.status == "max iterations"
    with pytest.warns(signorini.UnsolvedStepWarning, match="relative residual"):
        simulator("warn").step()
    with pytest.raises(signorini.UnsolvedStepError, match="contact problem not solved at time 0.001 s"):
        simulator("raise").step()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time_step": 0.0}, "time_step: is 0"),
        ({"time_step": math.nan}, "time_step"),
        ({"time_step": "1"}, "time_step: is '1'"),
        ({"tolerance": 2.0}, "tolerance"),
        ({"law": "lcp"}, "law: is 'lcp'"),
        ({"solver": "magic"}, "solver: is 'magic'"),
        ({"baumgarte": 1.5}, "baumgarte: is 1.5"),
        ({"contact_margin": -0.1}, "contact_margin"),
        ({"max_iterations": 0}, "max_iterations: is 0"),
        ({"on_unsolved": "ignore"}, "on_unsolved"),
        ({"timestep": 1e-3}, "timestep"),
    ],
)
def test_bad_settings(tumble, changes, message):
    with pytest.raises(InvalidInputError, match=message):
        Simulator(tumble, **changes)


@pytest.mark.parametrize("field", ["q", "v", "control", "applied_force"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
def test_what_is_not_finite_is_refused_and_the_state_stays(tumble, field, value):
    simulator = Simulator(tumble)
    simulator.run(5)
    target = {
        "q": simulator.state.q,
        "v": simulator.state.v,
        "control": simulator.control,
        "applied_force": simulator.applied_force,
    }[field]
    target[0] = value
    before = simulator.state.q.copy(), simulator.state.v.copy()
    with pytest.raises(InvalidInputError, match=rf"{field}\[0\]: is"):
        simulator.step()
    assert np.array_equal(simulator.state.q, before[0], equal_nan=True)
    assert np.array_equal(simulator.state.v, before[1], equal_nan=True)


def test_huge_velocities_stay_finite_or_are_reported(tumble):
    simulator = Simulator(tumble)
    simulator.state.v[:] = 1e4
    try:
        simulator.run(20)
    except InvalidInputError as error:
        assert "v" in str(error)
    assert np.isfinite(simulator.state.q).all()
    assert np.isfinite(simulator.state.v).all()


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda b: b.add_body("a", mass=-1.0), "body 'a'.mass: is -1"),
        (lambda b: b.add_body("a", mass=math.nan), "body 'a'.mass: is nan"),
        (lambda b: b.add_body("a", parent="b"), "there is no 'b'"),
        (lambda b: b.add_body("world"), "body 'world'"),
        (lambda b: b.add_body("a", mass=1.0, inertia=-np.eye(3)), "body 'a'.inertia"),
        (lambda b: b.add_body("a", mass=1.0, inertia=np.diag([1, 1, -1e-6])), "body 'a'.inertia.*-1e-06.*negative"),
        (lambda b: b.add_body("a", mass=1e3, inertia=np.diag([1e-10, 1e-10, -5e-10])), "body 'a'.inertia.*negative"),
        (lambda b: b.add_body("a", mass=1.0, inertia=np.diag([1, 1, 9])), "body 'a'.inertia.*1, 1, 9.*sum of the"),
        (lambda b: b.add_body("a", mass=0.0, inertia=np.eye(3)), "body 'a'.mass: is 0, must be > 0 where"),
        (lambda b: b.add_body("a", mass=1.0, inertia=np.eye(2)), r"body 'a'.inertia: has shape \(2, 2\)"),
        (lambda b: b.add_body("a", orientation=(0, 0, 0, 0)), "quaternion of length 0"),
        (lambda b: b.add_body("a", joints=[Joint("j", "screw")]), "joint 'j'.type: is 'screw'"),
        (lambda b: b.add_body("a", joints=[Joint("j", axis=(0, 0, 0))]), "joint 'j'.axis"),
        (lambda b: b.add_body("a", joints=[Joint("j", lower=1.0, upper=0.0)]), "joint 'j'.upper"),
        (lambda b: b.add_geometry("nobody", signorini.Sphere(1.0)), "there is no 'nobody'"),
        (lambda b: b.add_geometry("world", signorini.Sphere(-1.0)), r"size\[0\]: is -1"),
        (lambda b: b.add_geometry("world", "sphere"), "shape: is 'sphere'"),
        (lambda b: b.add_geometry("world", signorini.Box((1, 1))), "half_extents"),
        (lambda b: b.add_ground(signorini.Material(friction=-0.1)), "friction: is -0.1"),
        (lambda b: b.add_ground(signorini.Material(restitution=1.1)), "restitution"),
        (lambda b: b.add_ground(signorini.Material(stiffness=0.0)), "stiffness"),
        (lambda b: b.add_motor("m", "nothing"), "there is no 'nothing'"),
        (lambda b: b.exclude("world", "wrld"), "did you mean 'world'"),
        (lambda b: b.add_weld("world", "world"), "body_b"),
    ],
)
def test_bad_worlds(act, message):
    with pytest.raises(InvalidInputError, match=message):
        act(WorldBuilder())


def test_what_moves_needs_mass():
    builder = WorldBuilder()
    builder.add_body("ghost", joints=[Joint("hinge")])
    with pytest.raises(InvalidInputError, match="body 'ghost'.mass: is 0"):
        builder.build()
    builder = WorldBuilder()
    builder.add_body("point", joints=[Joint("hinge")], mass=1.0)  # on its own axis
    with pytest.raises(InvalidInputError, match="joint 'hinge': inertia"):
        Simulator(builder.build())


def test_dangling_names_get_suggestions(tumble):
    with pytest.raises(InvalidInputError, match="joint: there is no 'hnge'; did you mean 'hinge'"):
        tumble.joint("hnge")


def test_a_world_crosses_to_pinocchio():
    pin = pytest.importorskip("pinocchio")
    world = pendulum(3).build()
    model = pin.Model()
    model.loadFromString(world.pinocchio_model())
    data = model.createData()
    rng = np.random.default_rng(2)
    simulator = Simulator(world)
    simulator.state.q[:], simulator.state.v[:] = rng.normal(size=3), rng.normal(size=3)
    q, v = simulator.state.q.copy(), simulator.state.v.copy()
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    assert simulator.mass_matrix == pytest.approx(mass)
    acceleration = pin.aba(model, data, q, v, np.zeros(3))
    simulator.step()
    assert simulator.state.v == pytest.approx(v + 1e-3 * acceleration, rel=1e-9)
    builder = WorldBuilder()
    builder.add_pinocchio(world.pinocchio_model())
    other = Simulator(builder.build())
    other.state.q[:], other.state.v[:] = q, v
    other.step()
    assert other.state.v == pytest.approx(simulator.state.v, rel=1e-12)


def test_bodies_whose_mass_is_in_few_places_are_taken():
    builder = WorldBuilder()
    for k, moments in enumerate([(0, 0, 0), (0, 1, 1), (1, 1, 2), (1, 1, 2.001), (1e-16, 1e-16, 1e-15)]):
        builder.add_body(f"b{k}", mass=1.0, inertia=np.diag(moments))
    builder.add_body("frame")


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda b: b.add_body(3), "body.name: is 3, must be a string"),
        (lambda b: b.add_body("b", parent=3), r"body 'b'.parent: is 3, must be a string"),
        (lambda b: b.add_body("b", joints=Joint), "body 'b'.joints: is <class .*Joint'>, must be a list of"),
        (lambda b: b.add_body("b", joints=Joint("k")), r"body 'b'.joints: is Joint\(name='k'"),
        (lambda b: b.add_body("b", joints=["k"]), r"body 'b'.joints: is \['k'\]"),
        (lambda b: b.add_body("b", joints=[Joint(3)]), "joint.name: is 3"),
        (lambda b: b.add_geometry("a", Sphere(0.1), name=3), "geometry.name: is 3"),
        (lambda b: b.add_geometry("a", Sphere(0.1), material=0), "material: is a int"),
        (lambda b: b.add_tendon("t", {"jj": 1.0}), r"tendon 't'.joints: there is no 'jj'; did you mean 'j'\?"),
        (lambda b: b.add_tendon("t", ["j"]), r"tendon 't'.joints: is \['j'\]"),
        (lambda b: b.add_tendon(3, {"j": 1.0}), "tendon.name: is 3"),
        (lambda b: b.add_weld("a", "world", name=3), "weld.name: is 3"),
        (lambda b: b.add_motor(3, "j"), "actuator.name: is 3"),
        (lambda b: b.add_motor("m", ["j"]), r"actuator 'm'.joint: is \['j'\], must be a string"),
    ],
)
def test_names_and_lists_of_another_type(act, message):
    with pytest.raises(InvalidInputError, match=message):
        act(small_builder())


def test_an_external_wrench_is_refused_at_once(tumble):
    simulator = Simulator(tumble)
    simulator.set_external_wrench("box1", (1.0, 2.0, 3.0))
    for field in ("force", "moment"):
        for value in (math.nan, math.inf, -1e101):
            with pytest.raises(InvalidInputError, match=rf"^{field}\[1\]: is (nan|inf|-1e\+101), must be"):
                simulator.set_external_wrench("box1", **{"force": (9.0, 9.0, 9.0), field: (0.0, value, 0.0)})
    assert simulator._external_wrench[tumble.body_index("box1")].tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]


def test_what_is_set_whole_is_refused_at_once(tumble):
    simulator = Simulator(tumble)
    for field, target in (
        *(("q", simulator.state), ("v", simulator.state), ("activation", simulator.state)),
        *(("control", simulator), ("applied_force", simulator)),
    ):
        before = getattr(target, field).copy()
        for value in (math.nan, math.inf, 1e101):
            given = before.copy()
            given[-1] = value
            with pytest.raises(InvalidInputError, match=rf"^{field}\[{len(before) - 1}\]: is "):
                setattr(target, field, given)
            with pytest.raises(InvalidInputError, match=rf"^{field}: is "):
                setattr(target, field, value)
        assert (getattr(target, field) == before).all()


def test_a_contact_force_names_the_body_that_is_not_there(tumble):
    simulator = Simulator(tumble)
    with pytest.raises(InvalidInputError, match="^body_a: there is no 'bx1'; did you mean 'box1'"):
        simulator.contact_force("bx1", "box2")
    with pytest.raises(InvalidInputError, match="^body_b: there is no 'bx2'; did you mean 'box2'"):
        simulator.contact_force("box1", "bx2")


def test_worlds_settings_and_flags_of_another_type(tumble):
    start = starts(tumble, 1)
    for call in (Simulator, lambda world: rollout(world, start, num_steps=1), lambda world: InverseDynamics(world)):
        with pytest.raises(InvalidInputError, match="^world: is a int, must be a signorini.World"):
            call(3)
    for call in (
        lambda settings: Simulator(tumble, settings),
        lambda settings: rollout(tumble, start, num_steps=1, settings=settings),
        lambda settings: InverseDynamics(tumble, settings=settings),
    ):
        for wrong, kind in ({"time_step": 1e-3}, "dict"), (0, "int"):
            with pytest.raises(InvalidInputError, match=f"^settings: is a {kind}, must be a SimulatorSettings"):
                call(wrong)
    with pytest.raises(InvalidInputError, match="^keep_states: is 'no', must be True or False"):
        Simulator(tumble).run(1, keep_states="no")
    with pytest.raises(InvalidInputError, match="^controller: is a int, must be"):
        Simulator(tumble).run(1, controller=3)


def test_settings_are_plain_data(tumble):
    settings = SimulatorSettings(time_step=2e-3)
    assert Simulator(tumble, settings, tolerance=1e-8).settings == SimulatorSettings(time_step=2e-3, tolerance=1e-8)


@pytest.mark.parametrize("steps", [-1, 1.5, "3", True])
def test_steps_are_counted_in_whole_numbers(tumble, steps):
    simulator = Simulator(tumble)
    for call in (simulator.step, simulator.run, lambda n: simulator.run(n, controller=lambda: None)):
        with pytest.raises(InvalidInputError, match="num_steps: is"):
            call(steps)
    assert simulator.report.steps == 0


def test_a_prompt_shows_what_there_is(tumble):
    simulator = Simulator(tumble)
    simulator.step(3)
    assert f"{len(tumble.bodies)} bodies" in repr(tumble)
    assert f"{tumble.num_v} velocities" in repr(simulator)
    assert "steps=3" in repr(simulator)
    assert "time=0.003" in repr(simulator.state)
    assert {"load", "Simulator", "WorldBuilder", "fclib"} <= set(dir(signorini))


def small_builder():
    builder = WorldBuilder()
    builder.add_body("a", joints=[Joint("j", "free")], mass=1.0, inertia=np.eye(3))
    builder.add_geometry("a", Sphere(0.1))
    return builder


@pytest.mark.parametrize(
    ("field", "give"),
    [
        ("gravity", lambda b, x: WorldBuilder(x)),
        ("mass", lambda b, x: b.add_body("b", mass=x)),
        ("inertia", lambda b, x: b.add_body("b", inertia=x)),
        ("position", lambda b, x: b.add_body("b", position=x)),
        ("damping", lambda b, x: b.add_body("b", joints=[Joint("k", damping=x)])),
        ("radius", lambda b, x: b.add_geometry("a", Sphere(x))),
        ("half_length", lambda b, x: b.add_geometry("a", Capsule(0.1, x))),
        ("group", lambda b, x: b.add_geometry("a", Sphere(0.1), group=x)),
        ("priority", lambda b, x: b.add_geometry("a", Sphere(0.1), material=Material(priority=x))),
        ("geometry_a", lambda b, x: b.exclude_geometries(x, 0)),
        ("lower", lambda b, x: b.add_tendon("t", {"j": 1.0}, lower=x)),
        ("stiffness", lambda b, x: b.add_connect("a", "world", (0, 0, 0), (0, 0, 0), stiffness=x)),
        ("turn_damping", lambda b, x: b.add_weld("a", "world", turn_damping=x)),
        ("gear", lambda b, x: b.add_motor("m", "j", gear=x)),
        ("kp", lambda b, x: b.add_position_actuator("m", "j", kp=x)),
        ("time_step", lambda b, x: b.build().integrate(np.zeros(7), np.zeros(6), x)),
        ("margin", lambda b, x: b.build().touching_pairs(margin=x)),
        ("contact_margin", lambda b, x: Simulator(b.build(), contact_margin=x)),
        ("max_iterations", lambda b, x: Simulator(b.build(), max_iterations=x)),
        ("q", lambda b, x: setattr(Simulator(b.build()).state, "q", x)),
        ("time", lambda b, x: setattr(Simulator(b.build()).state, "time", x)),
        ("controls", lambda b, x: Simulator(b.build()).run(1, x)),
        ("states", lambda b, x: rollout(b.build(), x, num_steps=1)),
        ("threads", lambda b, x: rollout(b.build(), np.zeros((1, 13)), num_steps=1, threads=x)),
    ],
)
def test_what_is_no_number_is_refused(field, give):
    for value in ("x", ["x"]):
        with pytest.raises(InvalidInputError, match=rf"\b{field}: (is|has entries of type) "):
            give(small_builder(), value)


def test_groups_and_masks_have_32_bits():
    builder = small_builder()
    for bits in (1 << 31, 2**32 - 1):
        index = builder.add_geometry("a", Sphere(0.1), group=bits, mask=bits)
        geometry = builder.build().geometries[index]
        assert (geometry.group, geometry.mask) == (bits, bits)
    for field in ("group", "mask"):
        for value in (-1, 2**32):
            with pytest.raises(InvalidInputError, match=rf"\b{field}: is {value}, must be in \[0, 2\^32\)"):
                builder.add_geometry("a", Sphere(0.1), **{field: value})


def test_numbers_are_numbers_however_they_come():
    builder = WorldBuilder()
    for refused in (["1", "2", "3"], [1j, 0, 0], np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0]), None):
        with pytest.raises(InvalidInputError, match="position"):
            builder.add_body("b", position=refused)
    with pytest.raises(InvalidInputError, match="height"):
        builder.add_ground(height="x")
    for refused in ("x", 0.5, np.nan, 2**31):
        with pytest.raises(InvalidInputError, match="triangles"):
            builder.add_geometry("world", Convex(np.eye(3), [[refused, 1, 2]]))
    builder.add_body("b", position=(0.0, 0.0, 1.0), mass=np.array(1.0), joints=[Joint("b", "free")], inertia=np.eye(3))
    builder.add_body("c", joints=[Joint("hinge", "revolute")], mass=1.0, inertia=np.eye(3))
    for refused in (None, 5, [], ["x"]):
        with pytest.raises(InvalidInputError, match="coefficients"):
            builder.add_coupling("hinge", None, coefficients=refused)
    simulator = Simulator(builder.build())
    with pytest.raises(InvalidInputError, match="q"):
        simulator.state.q = None


def test_a_time_that_is_no_number_is_refused():
    builder = signorini.WorldBuilder()
    builder.add_body("a", joints=[signorini.Joint("a", "free")], mass=1.0, inertia=np.eye(3))
    simulator = signorini.Simulator(builder.build())
    simulator.state.time = np.nan
    with pytest.raises(signorini.InvalidInputError, match="^time: is nan"):
        simulator.step()
