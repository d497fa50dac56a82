"""What an MJCF file means, against MuJoCo's own numbers for the same file."""

import math
import re

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

import signorini  # noqa: E402
from signorini import InvalidInputError, Material, Simulator, WorldBuilder  # noqa: E402
from signorini.load import mjcf  # noqa: E402
from signorini.load._mjcf_softness import impedance, spring  # noqa: E402

# Two arms on one base, so that a tendon over both couples velocities of different branches.
ARMS = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="base" pos="0 0 1">
  <joint name="base" axis="0 0 1" damping="0.1"/>
  <geom type="box" size=".1 .1 .1" mass="1" contype="0" conaffinity="0"/>
  <body name="l1" pos=".2 0 0"><joint name="l1" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5" contype="0" conaffinity="0"/>
    <body name="l2" pos=".3 0 0"><joint name="l2" axis="0 1 .2"/>
      <geom type="capsule" fromto="0 0 0 .2 0 .1" size=".02" mass=".3" contype="0" conaffinity="0"/>
      <site name="tip" pos=".1 .02 0" euler="10 20 30"/></body></body>
  <body name="r1" pos="-.2 0 0"><joint name="r1" type="slide" axis="1 0 0"/><geom type="sphere" size=".05" mass=".4"
    contype="0" conaffinity="0"/>
    <body name="r2" pos="-.1 0 0"><joint name="r2" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 -.3 0 0" size=".02" mass=".2" contype="0" conaffinity="0"/></body></body>
</body></worldbody>{}</mujoco>"""
TENDON = """<tendon><fixed name="t"{}><joint joint="l2" coef="0.7"/><joint joint="r1" coef="-2"/>
  <joint joint="r2" coef="0.5"/></fixed></tendon>"""


def both(tmp_path, more, arms=ARMS, dt=1e-6, **options):
    """World, simulator with a tiny step, MuJoCo's model and data, of one file."""
    path = tmp_path / "model.xml"
    path.write_text(arms.format(more))
    world = signorini.load(path, **options)
    assert not world.warnings
    model = mujoco.MjModel.from_xml_path(str(path))
    return world, Simulator(world, time_step=dt), model, mujoco.MjData(model)


def set_state(simulator, model, data, seed, ctrl=(), act=()):
    random = np.random.default_rng(seed)
    q, v = random.uniform(-0.5, 0.5, model.nq), random.uniform(-1.0, 1.0, model.nv)
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, ctrl
    if len(act):
        data.act[:] = act
    simulator.state.q, simulator.state.v, simulator.control = q, v, np.asarray(ctrl, dtype=float)
    return q, v


def accelerations(simulator, model, data):
    """Of the smooth forces, ours from a step so short that nothing else counts."""
    mujoco.mj_forward(model, data)
    v = np.array(simulator.state.v)
    simulator.step()
    return (simulator.state.v - v) / simulator.settings.time_step, np.array(data.qacc_smooth)


ACTUATORS = {
    "motor": '<motor joint="l1" gear="3" ctrlrange="-1 1" ctrllimited="true"/>',
    "clipped": '<motor joint="l1" gear="3" forcerange="-.2 .3"/>',
    "position": '<position joint="l2" kp="7" kv="2" gear="2"/>',
    "velocity": '<velocity joint="r1" kv="5" gear="-1.5"/>',
    "damper": '<damper joint="r2" kv="3" ctrlrange="0 2" gear="2"/>',
    "general": '<general joint="l2" gear="-2" gaintype="affine" gainprm="2 .5 -.3" biastype="affine" biasprm="1 -2"/>',
    "joint range": '<motor joint="r2" gear="-2"/>',
    "tendon motor": '<motor tendon="t" gear="2"/>',
    "tendon position": '<position tendon="t" kp="11" kv="3" gear=".5"/>',
    "site": '<general site="tip" gear="1 2 -3 .4 .5 -.6"/>',
    "in parent": '<motor jointinparent="l1" gear="2"/>',
}


@pytest.mark.parametrize("name", ACTUATORS)
def test_actuators_push_as_mujocos_do(tmp_path, name):
    more = TENDON.format("") + f"<actuator>{ACTUATORS[name]}</actuator>"
    _, simulator, model, data = both(tmp_path, more)
    moved = 0.0
    for seed in range(4):
        set_state(simulator, model, data, seed, ctrl=[(-1.7, 0.4, 1.3, 0.02)[seed]])
        ours, theirs = accelerations(simulator, model, data)
        assert ours == pytest.approx(theirs, rel=5e-3, abs=5e-3 * np.abs(theirs).max())
        data.ctrl[:] = 0.0
        mujoco.mj_forward(model, data)
        moved = max(moved, np.abs(data.qacc_smooth - theirs).max())
    assert moved > 0.1  # the control matters


@pytest.mark.parametrize(
    "actuator",
    [
        '<intvelocity joint="l1" kp="20" kv="1" actrange="-.4 .4"/>',
        '<general joint="l1" dyntype="filter" dynprm="0.05" gainprm="3"/>',
        '<general joint="l1" dyntype="filterexact" dynprm="0.05" gainprm="3"/>',
        '<general tendon="t" dyntype="integrator" gainprm="3" actlimited="true" actrange="-.1 .2"/>',
        '<cylinder joint="l1" timeconst="0.1" area="2" bias="0 -1 -.2"/>',
    ],
)
def test_activations_follow_mujocos(tmp_path, actuator):
    dt = 1e-4
    more = TENDON.format(' damping=".5"') + f'<option timestep="{dt}"/><actuator>{actuator}</actuator>'
    _, simulator, model, data = both(tmp_path, more, dt=dt)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    set_state(simulator, model, data, 1, ctrl=[0.0])
    for k in range(5000):
        control = math.sin(1e-3 * k) + 0.5
        data.ctrl[:] = control
        simulator.control = [control]
        mujoco.mj_step(model, data)
        simulator.step()
    assert simulator.state.activation == pytest.approx(data.act, abs=2e-3)
    assert simulator.state.q == pytest.approx(data.qpos, abs=3e-3 * max(1.0, np.abs(data.qpos).max()))
    assert np.abs(data.act).max() > 0.05
    # and it is a part of the state
    kept = simulator.save()
    simulator.step(20)
    end = simulator.state_hash
    simulator.restore(kept)
    simulator.step(20)
    assert simulator.state_hash == end


@pytest.mark.parametrize(
    "tendon",
    [
        ' stiffness="30" springlength="0.1"',
        ' stiffness="30" springlength="-.05 .2"',
        ' damping="4"',
        ' stiffness="9" damping="1"',
    ],
)
def test_tendons_resist_as_mujocos_do(tmp_path, tendon):
    world, simulator, model, data = both(tmp_path, TENDON.format(tendon))
    for seed in range(4):
        q, _ = set_state(simulator, model, data, seed)
        ours, theirs = accelerations(simulator, model, data)
        assert world.tendon_lengths(q) == pytest.approx(data.ten_length)
        assert ours == pytest.approx(theirs, rel=5e-3, abs=5e-3 * np.abs(theirs).max())


def test_a_stiff_tendon_over_two_branches_is_stable_and_pulls_along_itself_alone(tmp_path):
    """A damper of any size takes the rate of the tendon's length by an impulse on the joints that it goes over."""
    arms = ARMS.replace(' damping="0.1"', "")
    _, simulator, model, data = both(tmp_path, TENDON.format(' damping="1e7"'), arms, dt=1e-3)
    free = Simulator(signorini.load(_write(tmp_path, "free.xml", arms.format(""))), time_step=1e-3)
    q, v = set_state(simulator, model, data, 2)
    free.state.q, free.state.v = q, v
    free.step()
    simulator.step()
    c = np.array([0.0, 0.0, 0.7, -2.0, 0.5])
    assert abs(c @ simulator.state.v) < 1e-6
    assert abs(c @ free.state.v) > 0.1
    change = simulator.state.v - free.state.v
    simulator.state.q = q
    impulse = simulator.mass_matrix @ change
    assert impulse == pytest.approx(c * (impulse @ c) / (c @ c), abs=1e-9 * np.abs(impulse).max())


def _write(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_limits_and_friction_of_tendons(tmp_path):
    more = TENDON.format(' limited="true" range="-.3 .25" frictionloss=".5"')
    world, simulator, _, _ = both(tmp_path, more, dt=1e-3)
    c = np.array([0.0, 0.0, 0.7, -2.0, 0.5])
    reached = [math.inf, -math.inf]
    for force in (-30.0, 30.0):
        simulator.reset()
        simulator.applied_force = np.array([0.0, 0.0, 0.0, force, 0.0])
        for _ in range(1500):
            simulator.step()
            assert simulator.report.status == "solved"
            length = float(world.tendon_lengths(simulator.state.q)[0])
            assert length == pytest.approx(c @ simulator.state.q)
            reached = [min(reached[0], length), max(reached[1], length)]
    assert reached == pytest.approx([-0.3, 0.25], abs=2e-4)


def test_dry_friction_of_a_tendon():
    """Over a slide with coefficient -2 a friction of 0.5 N holds 1 N and takes 1 N from what is more."""
    builder = WorldBuilder(gravity=(0, 0, 0))
    builder.add_body("b", joints=[signorini.Joint("j", "prismatic")], mass=2.0, inertia=np.eye(3))
    builder.add_tendon("t", {"j": -2.0}, friction=0.5)
    simulator = Simulator(builder.build())
    for force, speed in ((0.99, 0.0), (-0.99, 0.0), (1.2, 0.01), (-1.2, -0.01)):
        simulator.reset()
        simulator.applied_force = [force]
        simulator.step(100)
        assert simulator.state.v[0] == pytest.approx(speed, abs=1e-9)


def test_a_tendon_equality_ties_lengths(tmp_path):
    more = """<tendon><fixed name="a"><joint joint="l1" coef="1"/><joint joint="l2" coef="1"/></fixed>
      <fixed name="b"><joint joint="r2" coef="2"/></fixed></tendon>
      <equality><tendon tendon1="a" tendon2="b" polycoef=".1 .5 .2 0 0"/></equality>"""
    world, simulator, _, _ = both(tmp_path, more, dt=1e-3)
    for _ in range(800):
        simulator.step()
        assert simulator.report.status == "solved"
    a, b = world.tendon_lengths(simulator.state.q)
    assert a == pytest.approx(0.1 + 0.5 * b + 0.2 * b**2, abs=1e-4)
    assert abs(b) > 0.05


def test_gravity_compensation(tmp_path):
    arms = ARMS.replace('name="l1" pos=', 'gravcomp="1" name="l1" pos=').replace(
        'name="r2" pos=', 'gravcomp=".4" name="r2" pos='
    )
    _, simulator, model, data = both(tmp_path, "", arms)
    for seed in range(3):
        set_state(simulator, model, data, seed)
        ours, theirs = accelerations(simulator, model, data)
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-3)
    simulator = Simulator(simulator.world, time_step=1e-4)
    simulator.state.v = [0.0, 1.0, -1.0, 0.3, 2.0]
    energy = simulator.energy.total
    simulator.step(2000)
    assert simulator.energy.total == pytest.approx(energy, abs=5e-3)


def test_actuators_armature_and_damping_add_to_the_joint(tmp_path):
    more = '<actuator><motor joint="l1" gear="3" armature="0.02" damping="0.1"/></actuator>'
    world, simulator, model, data = both(tmp_path, more)
    joint = world.joint("l1")
    assert (joint.armature, joint.damping) == pytest.approx((0.18, 0.9))
    set_state(simulator, model, data, 0, ctrl=[0.5])
    ours, theirs = accelerations(simulator, model, data)
    assert ours == pytest.approx(theirs, rel=5e-3, abs=5e-3 * np.abs(theirs).max())


def test_limits_of_ball_joints(tmp_path):
    text = """<mujoco><worldbody><body name="b" pos="0 0 1"><joint name="j" type="ball" range="0 40" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03"/></body></worldbody></mujoco>"""
    world = signorini.load(_write(tmp_path, "ball.xml", text))
    assert not world.warnings
    simulator = Simulator(world)
    simulator.state.v = [8.0, 3.0, 0.0]
    angles = []
    for _ in range(600):
        simulator.step()
        assert simulator.report.status == "solved"
        angles.append(2.0 * math.acos(min(1.0, abs(simulator.state.q[3]))))
    assert max(angles) == pytest.approx(math.radians(40.0), abs=2e-4)


# Contact

GEOMS = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="1 1 1" friction="{floor}" {floor_more}/>
  <body name="b" pos="0 0 .1"><freejoint/><geom name="g" type="box" size=".1 .1 .1" friction="{box}" {box_more}/></body>
</worldbody>{more}</mujoco>"""


def slide(tmp_path, floor=1.0, box=1.0, floor_more="", box_more="", more="", **options):
    """Deceleration over g of a box that slides: the friction of the contact."""
    text = GEOMS.format(floor=floor, box=box, floor_more=floor_more, box_more=box_more, more=more)
    world = signorini.load(_write(tmp_path, "slide.xml", text), **options)
    simulator = Simulator(world)
    simulator.state.v[0] = 3.0
    simulator.step(100)
    return (3.0 - simulator.state.v[0]) / (0.1 * 9.81)


@pytest.mark.parametrize(
    ("given", "friction"),
    [
        ({"floor": 0.2, "box": 0.7}, 0.7),  # MuJoCo takes the larger one
        ({"floor": 0.2, "box": 0.7, "floor_more": 'priority="1"'}, 0.2),
        ({"floor": 0.2, "box": 0.7, "box_more": 'priority="1" condim="1"'}, 0.0),
        ({"floor": 0.2, "box": 0.7, "box_more": 'condim="1"'}, 0.7),  # the larger condim
        ({"floor": 0.2, "box": 0.7, "box_more": 'condim="1"', "floor_more": 'condim="1"'}, 0.0),
        ({"more": '<contact><pair geom1="g" geom2="floor" friction=".35 .35 0 0 0"/></contact>'}, 0.35),
        ({"more": '<contact><pair geom1="floor" geom2="g" condim="1" friction=".35 .35 0 0 0"/></contact>'}, 0.0),
        (
            {
                "box_more": 'contype="0" conaffinity="0"',
                "more": '<contact><pair geom1="floor" geom2="g" friction=".6 .6 0 0 0"/></contact>',
            },
            0.6,
        ),
        ({"more": '<contact><exclude body1="world" body2="b"/></contact>', "floor": 0.3}, None),
    ],
)
def test_friction_of_two_geoms(tmp_path, given, friction):
    found = slide(tmp_path, **given)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "slide.xml"))
    data = mujoco.MjData(model)
    data.qpos[2] -= 1e-3
    mujoco.mj_forward(model, data)
    if friction is None:
        assert data.ncon == 0
        assert found == pytest.approx(0.0, abs=1e-9)
        return
    theirs = data.contact[0].friction[0] if data.contact[0].dim >= 3 else 0.0
    assert theirs == pytest.approx(friction)
    assert found == pytest.approx(friction, abs=2e-3)


def test_a_pair_of_geometries_with_its_own_material():
    builder = WorldBuilder()
    ground = builder.add_ground(Material(friction=0.9))
    joints = [signorini.Joint("b", "free")]
    builder.add_body("b", joints=joints, mass=1.0, inertia=0.1 * np.eye(3), position=(0, 0, 0.1))
    ball = builder.add_geometry("b", signorini.Box((0.1, 0.1, 0.1)), group=0, mask=0)
    builder.set_pair_material(ground, ball, Material(friction=0.25))
    simulator = Simulator(builder.build())
    simulator.state.v[0] = 2.0
    simulator.step(100)
    assert (2.0 - simulator.state.v[0]) / 0.981 == pytest.approx(0.25, abs=2e-3)
    with pytest.raises(InvalidInputError, match="contact pair"):
        builder.set_pair_material(ground, 9, Material())
    with pytest.raises(InvalidInputError, match="itself"):
        builder.set_pair_material(ball, ball, Material())


@pytest.mark.parametrize(
    "soft",
    [
        'solref="0.02 1" solimp="0.8 0.95 0.001"',
        'solref=".05 .7"',
        'solref="-800 -20"',
        'solref=".01 1" solimp=".99 .99 .01"',
    ],
)
def test_soft_contact_sinks_in_as_far_as_mujocos(tmp_path, soft):
    """A ball, so that its inverse mass is that of the contact; frictionless, as a pyramid of friction changes MuJoCo's
    normal by a few percent."""
    text = f"""<mujoco><option timestep="2e-4"/><worldbody><geom type="plane" size="1 1 1" condim="1" {soft}/>
      <body pos="0 0 .1"><freejoint/><geom size=".1" mass="3" condim="1" {soft}/></body></worldbody></mujoco>"""
    path = _write(tmp_path, "ball.xml", text)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    world = signorini.load(path)
    simulator = Simulator(world, time_step=2e-4)
    for _ in range(10000):
        mujoco.mj_step(model, data)
        simulator.step()
    theirs, ours = 0.1 - data.qpos[2], 0.1 - simulator.state.q[2]
    assert theirs > 1e-6
    assert ours == pytest.approx(theirs, rel=2e-3)
    rigid = Simulator(signorini.load(path, compliance="rigid"), time_step=2e-4)
    rigid.step(1000)
    assert abs(0.1 - rigid.state.q[2]) < 1e-6


def test_defaults_are_rigid_unless_all_is_asked_for(tmp_path):
    path = _write(tmp_path, "d.xml", GEOMS.format(floor=1, box=1, floor_more="", box_more="", more=""))
    assert math.isinf(signorini.load(path).geometries[1].material.stiffness)
    assert 1e3 < signorini.load(path, compliance="all").geometries[1].material.stiffness < 1e7
    with pytest.raises(InvalidInputError, match="compliance"):
        signorini.load(path, compliance="soft")


def test_the_spring_has_the_damping_ratio_of_solref():
    """b / (2 sqrt k) of the free motion m x'' = -K x - B x' is dampratio."""
    for ratio in (0.3, 1.0):
        held = spring((0.03, ratio), (0.9, 0.9, 0.001, 0.5, 2.0), 0.5, "file")
        mass = 2.0
        found = held.damping / (2.0 * math.sqrt(held.stiffness * mass))
        assert found == pytest.approx(ratio, rel=1e-9)


def test_impedance_is_mujocos():
    solimp = (0.2, 0.95, 0.01, 0.3, 3.0)
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1" solimp=".2 .95 .01 .3 3"/>
      <body pos="0 0 .1"><freejoint/><geom size=".1" solimp=".2 .95 .01 .3 3"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for depth in (1e-5, 1e-3, 2.9e-3, 3.1e-3, 7e-3, 2e-2):
        data.qpos[2] = 0.1 - depth
        mujoco.mj_forward(model, data)
        assert impedance(solimp, depth) == pytest.approx(data.efc_KBIP[0, 2], abs=1e-9)


def test_limits_and_equalities_get_springs(tmp_path):
    more = """<equality><joint joint1="l1" joint2="r2" solref=".1 1"/>
      <weld body1="l2" body2="r2" solref=".1 1"/><connect body1="l1" body2="r1" anchor="0 0 0"/></equality>"""
    arms = ARMS.replace('name="l2" axis', 'solreflimit=".05 1" limited="true" range="-10 10" name="l2" axis')
    world, _, model, _ = both(tmp_path, more, arms)
    joint = world.joint("l2")
    expected = spring((0.05, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0), model.dof_invweight0[2], "file")
    assert (joint.limit_stiffness, joint.limit_damping) == pytest.approx(expected)
    coupling, weld, connect = world.constraints
    assert coupling.stiffness < 1e5
    assert weld.stiffness != weld.turn_stiffness
    assert math.isinf(connect.stiffness)
    assert all(math.isinf(c.stiffness) for c in both(tmp_path, more, arms, compliance="rigid")[0].constraints)


def test_a_soft_limit_gives_way_by_load_over_stiffness():
    builder = WorldBuilder(gravity=(0, 0, 0))
    joint = signorini.Joint("j", axis=(0, 0, 1), upper=0.5, limit_stiffness=200.0, limit_damping=5.0)
    builder.add_body("b", joints=[joint], mass=1.0, inertia=np.eye(3))
    simulator = Simulator(builder.build())
    simulator.applied_force = [3.0]
    simulator.step(8000)
    assert simulator.state.q[0] == pytest.approx(0.5 + 3.0 / 200.0, abs=1e-6)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: b.add_tendon("t", {}), "terms"),
        (lambda b: b.add_tendon("t", {"none": 1.0}), "none"),
        (lambda b: b.add_tendon("t", {"j": math.nan}), "coefficient"),
        (lambda b: b.add_tendon("t", {"ball": 1.0}), "revolute or prismatic"),
        (lambda b: b.add_tendon("t", {"j": 1.0}, lower=1.0, upper=0.0), "upper"),
        (lambda b: b.add_tendon("t", {"j": 1.0}, stiffness=-1.0), "stiffness"),
        (lambda b: b.add_tendon("t", {"j": 1.0}, spring_range=(1.0, 0.0)), "spring_upper"),
        (lambda b: b.add_actuator("a"), "acts on"),
        (lambda b: b.add_actuator("a", "j", body="b"), "acts on"),
        (lambda b: b.add_actuator("a", tendon="t"), "tendon"),
        (lambda b: b.add_actuator("a", "j", gain=(1, 2)), "gain"),
        (lambda b: b.add_actuator("a", "ball", bias=(0, 1, 0)), "length"),
        (lambda b: b.add_actuator("a", body="b", bias=(0, 0, 1)), "length"),
        (lambda b: b.add_actuator("a", "j", activation="filter"), "time_constant"),
        (lambda b: b.add_actuator("a", "j", activation="muscle"), "activation"),
        (lambda b: b.add_actuator("a", "j", activation_range=(1, 0)), "activation_range"),
        (lambda b: b.add_body("c", gravity_compensation=math.inf), "gravity_compensation"),
        (lambda b: b.add_weld("b", "world", turn_stiffness=-1.0), "turn_stiffness"),
        (lambda b: b.add_geometry("b", signorini.Sphere(1.0), material=Material(friction_mix="min")), "friction_mix"),
        (lambda b: b.add_geometry("b", signorini.Sphere(1.0), material=Material(priority=10**20)), "priority"),
        (lambda b: b.set_pair_material(0, 1, None), "material: is a NoneType"),
    ],
)
def test_bad_values_are_refused_by_name(call, message):
    builder = WorldBuilder()
    builder.add_body("b", joints=[signorini.Joint("j")], mass=1.0, inertia=np.eye(3))
    builder.add_body("d", joints=[signorini.Joint("ball", "ball")], mass=1.0, inertia=np.eye(3))
    with pytest.raises(InvalidInputError, match=message):
        call(builder)


def test_names_of_tendons_are_unique_and_their_limits_show_in_errors():
    builder = WorldBuilder()
    builder.add_body("b", joints=[signorini.Joint("j")], mass=1.0, inertia=np.eye(3))
    builder.add_tendon("t", {"j": 2.0}, upper=0.1)
    with pytest.raises(InvalidInputError, match="unique"):
        builder.add_tendon("t", {"j": 1.0})
    world = builder.build()
    result = signorini.inverse_dynamics(world, (world.initial_q, [0.0]), [300.0], 1e-3)
    assert result.status != "solved"
    assert "tendon 't'" in str(result.worst)


def test_keyframes_hold_controls_and_activations(tmp_path):
    more = """<actuator><muscle joint="r2" lengthrange="0 1"/><motor name="m" joint="l2"/>
        <intvelocity name="i" joint="l1" kp="2"/></actuator>
      <keyframe><key name="k" time="3" qpos=".1 .2 .3 .4 .5" qvel="5 4 3 2 1" act=".2 .7" ctrl="3 .4 .6"/></keyframe>"""
    path = _write(tmp_path, "k.xml", ARMS.format(more))
    builder = WorldBuilder()
    builder.add_file(path, prefix="a/")
    builder.add_file(path, prefix="b/", position=(0, 5, 0))
    world = builder.build()
    simulator = Simulator(world)
    key = mjcf.keyframe(path, world, "k", prefix="b/")
    key.apply(simulator)
    assert simulator.state.q[:5] == pytest.approx(np.zeros(5))
    assert simulator.state.q[5:] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert simulator.state.v[5:] == pytest.approx([5, 4, 3, 2, 1])
    assert world.actuator_names == ("a/m", "a/i", "b/m", "b/i")  # without the muscle
    assert simulator.control == pytest.approx([0, 0, 0.4, 0.6])
    assert simulator.state.activation == pytest.approx([0, 0, 0, 0.7])
    assert simulator.state.time == 3.0


def test_a_weld_of_bodies_that_are_fixed_to_each_other_does_nothing():
    builder = WorldBuilder()
    builder.add_body("a", joints=[signorini.Joint("a", "free")], mass=1.0, inertia=np.eye(3))
    builder.add_body("b", parent="a", position=(1, 0, 0), mass=1.0, inertia=np.eye(3))
    builder.add_weld("a", "b")
    builder.add_connect("a", "b", (0, 0, 0), (0, 0, 0))
    simulator = Simulator(builder.build())
    simulator.step(10)
    assert simulator.report.status == "solved"
    assert simulator.state.v[2] == pytest.approx(-9.81e-2)


def test_a_tendon_equality_is_not_that_of_a_joint_of_the_same_name(tmp_path):
    text = """<mujoco><worldbody>
      <body><joint name="x" axis="0 1 0"/><geom size=".1"/></body>
      <body pos="1 0 0"><joint name="y" axis="0 1 0"/><geom size=".1"/></body></worldbody>
      <tendon><fixed name="x"><joint joint="y" coef="2"/></fixed></tendon>
      <equality><tendon tendon1="x" polycoef=".3 0 0 0 0"/></equality></mujoco>"""
    simulator = Simulator(signorini.load(_write(tmp_path, "clash.xml", text)))
    simulator.step(500)
    assert simulator.state.q == pytest.approx([0.0, 0.15], abs=1e-4)


@pytest.mark.parametrize(
    ("solref", "solimp"),
    [
        ("0.02 1", ".2 .95 0 .5 2"),  # no width
        ("-100 1", ".8 .9 .001 .5 2"),  # of neither format: the default
        (".05 0", ".8 .9 .001 .5 2"),
        ("1e-200 1", ".8 .9 .001 .5 2"),
    ],
)
def test_odd_solref_and_solimp(tmp_path, solref, solimp):
    text = f"""<mujoco><worldbody><geom type="plane" size="1 1 1" solref="{solref}" solimp="{solimp}"/>
      <body pos="0 0 .0999"><freejoint/><geom size=".1" solref="{solref}" solimp="{solimp}"/></body>
      </worldbody></mujoco>"""
    path = _write(tmp_path, "odd.xml", text)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    numbers = [float(x) for x in solimp.split()]
    assert impedance(numbers, 1e-4) == pytest.approx(data.efc_KBIP[0, 2], rel=1e-9)
    held = signorini.load(path).geometries[1].material
    if solref.startswith("1e-200"):
        assert math.isinf(held.stiffness)
    else:
        expected = spring((0.02, 1.0), numbers, float(model.body_invweight0[1, 0]), "file")
        assert (held.stiffness, held.damping) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("more", "warning", "left"),
    [
        ('<motor tendon="t" gear="0"/>', "their gear is 0", 0),
        ('<motor joint="l1" group="3"/>', "their group is disabled", 0),
        ('<motor joint="l1"/></actuator><option><flag actuation="disable"/></option><actuator>', "is disabled", 0),
        ('<motor tendon="t"/>', "actuatorfrcrange .*: r2", 1),  # which the tendon goes over
        ('<motor joint="r2"/><motor site="tip" gear="0 0 1"/>', None, 2),
        ('<motor joint="l2"/><motor site="tip" gear="0 0 1"/>', "actuatorfrcrange .*: l2", 2),
        ('<motor tendon="t" armature=".1"/>', "armature of actuators", 1),
    ],
)
def test_what_actuators_lose_is_listed(tmp_path, more, warning, left):
    arms = ARMS.replace("<option ", '<option actuatorgroupdisable="3" ')
    name = "l2" if warning and "l2" in warning else "r2"
    if warning is None or "frcrange" in warning:
        arms = arms.replace(f'<joint name="{name}"', f'<joint actuatorfrcrange="-1 1" name="{name}"')
    text = arms.format(TENDON.format(' actuatorfrcrange="-1 1"') + f"<actuator>{more}</actuator>")
    world = signorini.load(_write(tmp_path, "lost.xml", text))
    assert len(world.actuators) == left
    if warning is None:
        assert not world.warnings
    else:
        (told,) = world.warnings
        assert re.search(warning, told)


def test_the_range_of_a_joint_clips_what_the_actuators_own_range_let_pass(tmp_path):
    arms = ARMS.replace('<joint name="l1"', '<joint actuatorfrcrange="-1 .5" name="l1"')
    _, simulator, model, data = both(
        tmp_path, '<actuator><motor joint="l1" gear="-2" forcerange="1 3"/></actuator>', arms
    )
    set_state(simulator, model, data, 0, ctrl=[2.0])
    ours, theirs = accelerations(simulator, model, data)
    assert ours == pytest.approx(theirs, rel=5e-3, abs=5e-3 * np.abs(theirs).max())


FREE = """<mujoco><worldbody><body name="b"><joint type="free" {}/>
  <geom type="box" size=".1 .2 .05" pos=".1 0 .05" mass="1"/></body></worldbody></mujoco>"""


def test_armature_of_a_free_joint_turns_no_gyroscope(tmp_path):
    path = _write(tmp_path, "free.xml", FREE.format('armature=".3"'))
    world, model = signorini.load(path), mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qvel[:] = 0.3, -1.0, 0.5, 2.0, 4.0, 1.0
    mujoco.mj_forward(model, data)
    simulator = Simulator(world, time_step=1e-6)
    _, simulator.state.v = mjcf.state(mjcf.read(path), world, data.qpos, data.qvel)
    simulator.step()
    assert (simulator.state.v[3:] - data.qvel[3:]) / 1e-6 == pytest.approx(data.qacc[3:], abs=1e-3)
    linear = simulator.state.v[:3] + 1e-6 * np.cross(data.qvel[3:], data.qvel[:3])  # from the body's axes that turn
    assert (linear - data.qvel[:3]) / 1e-6 == pytest.approx(data.qacc[:3], abs=1e-3)


def test_dry_friction_of_a_free_joint_holds_it(tmp_path):
    simulator = Simulator(signorini.load(_write(tmp_path, "free.xml", FREE.format('frictionloss="10"'))))
    simulator.step(50)
    assert np.abs(simulator.state.v).max() < 1e-9
    simulator.applied_force = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    simulator.step(50)
    assert simulator.state.v[2] < -0.01


TWO = """<mujoco><worldbody>{}<body name="a" pos="0 0 .1"><freejoint/><geom name="g" size=".1"/>
  <body name="b" pos="0 0 .15"><joint axis="0 0 1"/><geom name="h" size=".1"/></body></body></worldbody>{}</mujoco>"""
FLOOR, PAIR = '<geom type="plane" size="1 1 1"/>', '<contact><pair geom1="g" geom2="h"/></contact>'


@pytest.mark.parametrize("options", [{"self_collision": False}, {"exclude_overlapping": True}])
def test_what_the_caller_excludes_overrules_pairs_of_the_file(tmp_path, options):
    path = _write(tmp_path, "pair.xml", TWO.format("", PAIR))
    assert [pair[:2] for pair in signorini.load(path).touching_pairs()] == [(0, 1)]
    assert not signorini.load(path, **options).touching_pairs()


def test_a_floor_is_not_a_part_of_the_robot(tmp_path):
    path = _write(tmp_path, "floor.xml", TWO.format(FLOOR, ""))
    simulator = Simulator(signorini.load(path, self_collision=False))
    simulator.step(100)
    assert simulator.state.q[2] == pytest.approx(0.1, abs=1e-5)


def test_ground_holds_what_overlapped_a_floor_of_the_file(tmp_path):
    text = TWO.format(FLOOR.replace("<geom", '<geom pos="0 0 .01"'), "")
    world = signorini.load(_write(tmp_path, "floor.xml", text), exclude_overlapping=True, ground=True)
    (warning,) = world.warnings
    assert "overlap" in warning
    simulator = Simulator(world)
    simulator.step(100)
    assert simulator.state.q[2] == pytest.approx(0.1, abs=1e-5)


def test_the_last_word_about_a_pair_counts():
    builder = WorldBuilder()
    ground = builder.add_ground()
    builder.add_body(
        "b", joints=[signorini.Joint("b", "free")], mass=1.0, inertia=0.1 * np.eye(3), position=(0, 0, 0.1)
    )
    box = builder.add_geometry("b", signorini.Box((0.1, 0.1, 0.1)))

    def slowed() -> float:
        simulator = Simulator(builder.build())
        simulator.state.v[0] = 2.0
        simulator.step(100)
        return float((2.0 - simulator.state.v[0]) / 0.981)

    builder.exclude("b", "world")
    for material, friction in ((Material(friction=0.3), 0.3), (Material(0.5), 0.5), (Material(condim=1), 0.0)):
        builder.set_pair_material(box, ground, material)
        assert slowed() == pytest.approx(friction, abs=2e-3)
    builder.set_pair_material(box, ground, Material())
    builder.exclude_geometries(box, ground)
    assert not builder.build().touching_pairs(margin=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: b.add_tendon("t", {"j": 1.0}, lower=math.inf), "lower"),
        (lambda b: b.add_tendon("t", {"j": 1.0}, upper=-math.inf), "upper"),
        (lambda b: b.add_tendon("t", {"j": 1.0}, spring_range=(1.0,)), "spring_range"),
        (lambda b: b.add_body("c", joints=[signorini.Joint("k", lower=math.inf)]), "lower"),
        (lambda b: b.add_actuator("a", "j", force_range=(math.inf, math.inf)), "force_range"),
        (lambda b: b.add_actuator("a", "j", control_range=(-math.inf, -math.inf)), "control_range"),
        (lambda b: b.add_actuator("a", "j", activation_range=(math.nan, 0.0)), "activation_range"),
        (lambda b: b.add_actuator("a", "j", force_range=(1.0,)), "force_range"),
        (lambda b: b.add_coupling("j", None, kind="tendon"), "there is no 'j'"),
        (lambda b: b.add_coupling("j", None, kind="body"), "kind"),
    ],
)
def test_ranges_leave_a_value(call, message):
    builder = WorldBuilder()
    builder.add_body("b", joints=[signorini.Joint("j")], mass=1.0, inertia=np.eye(3))
    with pytest.raises(InvalidInputError, match=message):
        call(builder)


@pytest.mark.parametrize("flag", ["spring", "damper", "clampctrl", "gravity"])
def test_what_flags_switch_off(tmp_path, flag):
    more = (
        TENDON.format(' stiffness="30" springlength="1" damping="2"')
        + """<actuator>
      <motor joint="l1" gear="3" ctrlrange="-.1 .1" ctrllimited="true" damping="1"/></actuator>"""
    )
    arms = ARMS.replace('name="l2" axis', 'name="l2" stiffness="20" springref="1" axis')
    on = arms.format(more)
    off = on.replace("</option>", "").replace('"0 0 -9.81"/>', f'"0 0 -9.81"><flag {flag}="disable"/></option>')
    found = []
    for text in (on, off):
        path = _write(tmp_path, "flags.xml", text)
        model, simulator = mujoco.MjModel.from_xml_path(str(path)), Simulator(signorini.load(path), time_step=1e-6)
        data = mujoco.MjData(model)
        set_state(simulator, model, data, 3, ctrl=[2.0])
        ours, theirs = accelerations(simulator, model, data)
        assert ours == pytest.approx(theirs, rel=5e-3, abs=5e-3 * np.abs(theirs).max())
        found.append(theirs)
    assert np.abs(found[0] - found[1]).max() > 0.1


def test_flags_switch_constraints_off(tmp_path):
    text = """<mujoco><option><flag {}="disable"/></option><worldbody><geom type="plane" size="1 1 1"/>
      <body pos="0 0 .1"><joint name="x" type="slide" axis="0 0 1" range="-.1 1" limited="true" frictionloss=".1"/>
        <geom size=".1"/></body></worldbody><equality><joint joint1="x"/></equality></mujoco>"""
    left = {}
    for flag in ("limit", "contact", "equality", "frictionloss", "constraint", "midphase"):
        world = signorini.load(_write(tmp_path, "flags.xml", text.format(flag)))
        joint = world.joints[0]
        has = (joint.lower == -0.1, bool(world.geometries), bool(world.constraints), joint.friction > 0.0)
        left[flag] = "".join("01"[x] for x in has)
    assert left == {
        "limit": "0111", "contact": "1011", "equality": "1101", "frictionloss": "1110", "constraint": "0000",
        "midphase": "1111",
    }  # fmt: skip


def test_the_softness_of_a_fixed_geom_with_priority_is_lost_and_listed(tmp_path):
    text = GEOMS.format(floor=1, box=1, floor_more='priority="1" solref=".05 1"', box_more="", more="")
    world = signorini.load(_write(tmp_path, "soft.xml", text))
    (warning,) = world.warnings
    assert "priority" in warning
    assert "floor" in warning
    assert not signorini.load(tmp_path / "soft.xml", compliance="rigid").warnings


def test_meshes_that_only_show_are_shown(tmp_path):
    text = """<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody><body><freejoint/>
      <geom size=".1"/><geom type="mesh" mesh="m" contype="0" conaffinity="0"/></body></worldbody></mujoco>"""
    world = signorini.load(_write(tmp_path, "mesh.xml", text))
    assert not world.warnings
    assert [type(visual.shape).__name__ for visual in world.visuals] == ["Sphere", "TriangleMesh"]


def test_a_fast_ball_joint_at_rest_inverts():
    builder = WorldBuilder(gravity=(0, 0, 0))
    builder.add_body("b", joints=[signorini.Joint("j", "ball", upper=0.01)], mass=1.0, inertia=np.eye(3))
    world = builder.build()
    result = signorini.inverse_dynamics(world, (world.initial_q, np.zeros(3)), [20.0, 0, 0], 1e-3, closest=True)
    assert result.status == "solved"
    simulator = Simulator(world)
    simulator.applied_force = result.force
    simulator.step()
    assert simulator.state.v == pytest.approx(np.array([20.0, 0.0, 0.0]), abs=1e-6)


def test_a_margin_without_a_limit_is_not_missed(tmp_path):
    arms = ARMS.replace('<joint name="l1"', '<joint margin=".1" name="l1"')
    assert not signorini.load(_write(tmp_path, "margin.xml", arms.format(""))).warnings
    limited = arms.replace('margin=".1"', 'margin=".1" range="-1 1" limited="true"')
    (warning,) = signorini.load(_write(tmp_path, "margin.xml", limited.format(""))).warnings
    assert "margins" in warning
