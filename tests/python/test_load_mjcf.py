"""The MJCF reader against the numbers of MuJoCo itself."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from recording_builder import RecordingBuilder

from signorini import Box, Capsule, Convex, Ellipsoid, HalfSpace, InvalidInputError, Sphere
from signorini.load import add_file, file_format, mjcf
from signorini.load import load as load_world
from signorini.load._placement import from_quaternion

mujoco = pytest.importorskip("mujoco")
pin = pytest.importorskip("pinocchio")

GYMNASIUM = ("humanoid", "ant", "hopper", "half_cheetah", "walker2d")

#: All joint types, several a body, references, springs, axes off the origin, full inertias, nested frames.
ZOO = """<mujoco model="zoo">
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 0 -3"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" pos="0 0 -1" quat="0.9 0.1 0.2 0"/>
    <body name="free" pos="1 2 3" quat="0.5 0.5 -0.5 0.5">
      <freejoint name="root"/>
      <inertial pos="0.1 0.2 0.3" mass="2" fullinertia="0.3 0.4 0.5 0.01 0.02 -0.03"/>
      <geom name="ball" type="sphere" size="0.1"/>
      <body name="arm" pos="0 0.3 0.1" euler="0.3 -0.2 0.5">
        <joint name="slide" type="slide" axis="1 2 0" ref="0.2" range="-0.5 0.7" damping="3" armature="0.1"/>
        <joint name="hinge1" axis="0 1 1" pos="0.1 0 0.2" ref="-0.4" stiffness="5" springref="0.3" range="-2 1"/>
        <joint name="hinge2" axis="1 0 0" pos="0 0.2 0" frictionloss="0.7" damping="0.2" armature="0.05"/>
        <geom name="limb" type="capsule" fromto="0 0 0 0.3 0.1 0.2" size="0.05"/>
        <body name="wrist" pos="0.3 0.1 0.2">
          <joint name="ball" type="ball" pos="0 0 0.05" armature="0.01"/>
          <geom name="hand" type="box" size="0.1 0.05 0.02" pos="0.1 0 0" euler="0.1 0.2 0.3"/>
          <body name="tool" pos="0.1 0.2 0.3" euler="1 0 0"><geom type="ellipsoid" size="0.1 0.2 0.3" mass="1"/></body>
        </body>
      </body>
    </body>
    <body name="door" pos="-2 0 0">
      <joint name="door" axis="0 0 1" pos="0 1 0"/><geom type="cylinder" size="0.1 0.2"/>
    </body>
  </worldbody>
</mujoco>"""


def gymnasium_file(name):
    spec = importlib.util.find_spec("gymnasium")
    if spec is None:
        pytest.skip("gymnasium is not installed")
    return Path(spec.origin).parent / "envs" / "mujoco" / "assets" / f"{name}.xml"


@pytest.fixture(params=[*GYMNASIUM, "zoo"])
def file(request, tmp_path):
    if request.param != "zoo":
        return gymnasium_file(request.param)
    return write(tmp_path, ZOO)


def write(tmp_path, text, name="model.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def read(tmp_path, text, **options):
    builder = RecordingBuilder()
    add_file(builder, write(tmp_path, text), **options)
    return builder


def body_xml(inside, more=""):
    return f"<mujoco><worldbody><body name='b'>{inside}<geom name='g' size='1'/></body></worldbody>{more}</mujoco>"


def random_state(model, random):
    """qpos of MuJoCo, q with quaternions x y z w, and T with v = T qvel."""
    qpos = model.qpos0 + random.uniform(-0.8, 0.8, model.nq)
    q, turn = qpos.copy(), np.eye(model.nv)
    for j in range(model.njnt):
        a, dof, kind = model.jnt_qposadr[j], model.jnt_dofadr[j], model.jnt_type[j]
        if kind <= 1:
            a += 3 if kind == 0 else 0
            qpos[a : a + 4] = random.standard_normal(4)
            qpos[a : a + 4] /= np.linalg.norm(qpos[a : a + 4])
            q[a - 3 : a] = qpos[a - 3 : a] if kind == 0 else q[a - 3 : a]
            q[a : a + 4] = np.roll(qpos[a : a + 4], -1)
        if kind == 0:
            turn[dof : dof + 3, dof : dof + 3] = from_quaternion(q[a : a + 4]).T
    return qpos, q, turn


def full_mass_matrix(model, data):
    dense = np.zeros((model.nv, model.nv))
    for i in range(model.nv):  # M v for unit vectors: no format of the factor to know
        unit, column = np.zeros(model.nv), np.zeros(model.nv)
        unit[i] = 1.0
        mujoco.mj_mulM(model, data, column, unit)
        dense[:, i] = column
    return dense


def check_against_mujoco(pinocchio_model, path, poses):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    ours = pinocchio_model.createData()
    random = np.random.default_rng(3)
    for _ in range(3):
        qpos, q, turn = random_state(model, random)
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        mass = full_mass_matrix(model, data)
        upper = np.triu(pin.crba(pinocchio_model, ours, q))
        matrix = upper + np.triu(upper, 1).T
        np.testing.assert_allclose(turn.T @ matrix @ turn, mass, atol=1e-10 * np.abs(mass).max())
        pin.framesForwardKinematics(pinocchio_model, ours, q)
        for i, frame in enumerate(poses(pinocchio_model), 1):
            np.testing.assert_allclose(ours.oMf[frame].translation, data.xpos[i], atol=1e-10)
            np.testing.assert_allclose(ours.oMf[frame].rotation, data.xmat[i].reshape(3, 3), atol=1e-10)
    assert pin.computeTotalMass(pinocchio_model) == pytest.approx(model.body_mass[1:].sum(), rel=1e-12)


def test_same_mass_matrix_and_poses_as_mujoco(file):
    builder = RecordingBuilder()
    add_file(builder, file)
    model = builder.pinocchio()
    check_against_mujoco(model, file, lambda m: [i for i, f in enumerate(m.frames) if f.name.startswith("body ")])


def test_same_joint_parameters_as_mujoco(file):
    builder = RecordingBuilder()
    add_file(builder, file)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert len(builder.joints) == model.njnt
    for j, joint in enumerate(builder.joints.values()):
        dof, kind = model.jnt_dofadr[j], model.jnt_type[j]
        assert joint.type == ("free", "ball", "prismatic", "revolute")[kind]
        assert joint.damping == model.dof_damping[dof]
        assert joint.armature == model.dof_armature[dof]
        assert joint.friction == model.dof_frictionloss[dof]
        if kind >= 2:
            assert joint.reference == model.qpos0[model.jnt_qposadr[j]]
            assert joint.stiffness == model.jnt_stiffness[j]
            limits = tuple(model.jnt_range[j]) if model.jnt_limited[j] else (-math.inf, math.inf)
            assert (joint.lower, joint.upper) == limits
            if joint.stiffness:
                assert joint.spring_reference == model.qpos_spring[model.jnt_qposadr[j]]
    kinds = {name for name, _, _ in builder.calls}
    assert model.nu == 0 or "add_actuator" in kinds


def test_geometries(tmp_path):
    builder = read(tmp_path, ZOO)
    shapes = {rest["name"]: shape for _, shape, rest in builder.geometries}
    assert isinstance(shapes["floor"], HalfSpace)
    assert shapes["ball"] == Sphere(0.1)
    assert isinstance(shapes["limb"], Capsule)
    assert shapes["limb"].half_length == pytest.approx(0.5 * math.sqrt(0.14))
    assert shapes["hand"] == Box((0.1, 0.05, 0.02))
    assert shapes["tool_geom"] == Ellipsoid((0.1, 0.2, 0.3))
    floor = next(rest for _, _, rest in builder.geometries if rest["name"] == "floor")
    model = mujoco.MjModel.from_xml_string(ZOO)
    w, x, y, z = model.geom_quat[0]
    np.testing.assert_allclose(floor["orientation"], from_quaternion((x, y, z, w)))


def test_groups_excludes_and_what_does_not_collide(tmp_path):
    text = """<mujoco><worldbody>
      <geom name="floor" type="plane" size="1 1 1" contype="2" conaffinity="5"/>
      <body name="a"><freejoint/><geom name="ga" size="1"/>
        <geom name="seen" size="1" contype="0" conaffinity="0"/></body>
      <body name="b" pos="3 0 0"><freejoint/><geom name="gb" size="1"/></body>
    </worldbody><contact><exclude body1="a" body2="b"/></contact></mujoco>"""
    builder = read(tmp_path, text, prefix="p/")
    assert [(rest["name"], rest["group"], rest["mask"]) for _, _, rest in builder.geometries] == [
        ("p/floor", 2, 5),
        ("p/ga", 1, 1),
        ("p/gb", 1, 1),
    ]
    assert [args for args, _ in builder.called("exclude")] == [("p/a", "p/b")]
    assert [joint.name for joint in builder.joints.values()] == ["p/a_free", "p/b_free"]


def test_equalities_meet_at_the_start(tmp_path):
    """Frames of connect and weld are the same points in the world at qpos0."""
    text = """<mujoco><worldbody>
      <body name="a" pos="1 2 3" euler="10 20 30"><joint name="ja" ref="0.1"/><geom size="1"/></body>
      <body name="b" pos="-1 0 2" euler="-40 5 60"><joint name="jb"/><geom size="1"/></body>
    </worldbody><equality>
      <connect name="c" body1="a" body2="b" anchor="0.1 0.2 0.3"/>
      <weld name="w" body1="a" body2="b" anchor="0.3 0.2 0.1"/>
      <weld name="ww" body1="a"/>
      <joint name="j" joint1="ja" joint2="jb" polycoef="0.1 2 3 0 0"/>
      <joint name="off" joint1="ja" active="false"/>
    </equality></mujoco>"""
    builder = read(tmp_path, text)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def place(body, position, rotation):
        i = 0 if body == "world" else mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
        turn = data.xmat[i].reshape(3, 3)
        return np.column_stack([turn @ rotation, turn @ position + data.xpos[i]])

    (((a, b, point_a, point_b), _),) = builder.called("add_connect")
    unit = np.eye(3)
    np.testing.assert_allclose(place(a, point_a, unit)[:, 3], place(b, point_b, unit)[:, 3])
    welds = builder.called("add_weld")
    assert [args for args, _ in welds] == [("a", "b"), ("a", "world")]
    for (a, b), rest in welds:
        np.testing.assert_allclose(
            place(a, rest["position_a"], rest["orientation_a"]),
            place(b, rest["position_b"], rest["orientation_b"]),
            atol=1e-12,
        )
    ((args, rest),) = builder.called("add_coupling")
    assert args == ("ja", "jb", [0.1, 2.0, 3.0, 0.0, 0.0])
    assert rest["reference"] == pytest.approx(math.radians(0.1))
    assert any("not active" in warning and "off" in warning for warning in builder.warnings)


def test_what_is_not_carried_over_is_listed(tmp_path):
    text = """<mujoco><option viscosity="1"><flag filterparent="disable"/></option>
    <asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset>
    <worldbody><light/><camera/><site name="s"/>
      <geom name="floor" type="plane" size="1 1 1" friction="0.5"/>
      <body name="b"><freejoint/><geom name="hill" type="hfield" hfield="h"/>
        <geom name="g" size="1" condim="6" margin="0.1"/><site name="t" pos="1 0 0"/>
        <body name="c"><joint name="j" type="ball" stiffness="1"/><geom name="h" size="1"/></body></body>
      <body name="m" mocap="true"><geom name="k" size="1" contype="0" conaffinity="0"/></body>
    </worldbody>
    <tendon><spatial name="string"><site site="s"/><site site="t"/></spatial></tendon>
    <actuator><motor name="winch" tendon="string"/><motor name="both" joint="j" gear="1 1 0"/></actuator>
    <contact><pair geom1="floor" geom2="g" condim="4" friction="1 2 0 0 0" margin="0.2"/></contact></mujoco>"""
    builder = read(tmp_path, text)
    told = "\n".join(builder.warnings)
    for words in (
        "height fields that move do not collide: hill",
        "mocap bodies do not move: m",
        "springs of free and ball joints: j",
        "one friction here, their first: floor with g",
        "margin of contact pairs: floor with g",
        "margin of geoms: g",
        "spatial tendons are not carried over: string",
        "they pull spatial tendons: winch",
        "gear turns several axes, or none, or pushes a free body: both",
        "viscosity",
        'filterparent="disable"',
    ):
        assert words in told
    for irrelevant in ("light", "camera"):
        assert irrelevant not in told


def test_nothing_is_said_when_nothing_is_lost(tmp_path):
    assert read(tmp_path, body_xml("<freejoint/>")).warnings == []


def test_includes_and_meshes_are_relative_to_the_file(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "t.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    (tmp_path / "part.xml").write_text(
        '<mujoco><compiler meshdir="assets"/><asset><mesh name="t" file="t.obj"/></asset></mujoco>'
    )
    text = body_xml("<freejoint/><geom name='m' type='mesh' mesh='t' pos='1 0 0'/>").replace(
        "<mujoco>", '<mujoco><include file="part.xml"/>'
    )
    builder = read(tmp_path, text)
    shape, rest = next((s, r) for _, s, r in builder.geometries if r["name"] == "m")
    assert isinstance(shape, Convex)
    points = shape.vertices @ rest["orientation"].T + np.array(rest["position"])
    np.testing.assert_allclose(points.min(0), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(points.max(0), [2, 1, 1], atol=1e-6)


def test_format_and_options(tmp_path):
    path = write(tmp_path, ZOO)
    assert file_format(path) == "mjcf"
    assert mjcf.read(path).gravity == (0.0, 0.0, -3.0)
    with pytest.raises(InvalidInputError, match="floating_base"):
        add_file(RecordingBuilder(), path, floating_base=True)
    moved = read(tmp_path, ZOO, position=(10, 0, 0))
    np.testing.assert_allclose(moved.bodies["door"].position, [8, 0, 0])
    assert moved.geometries[0][2]["position"] == [10, 0, -1]
    assert any("gravity" in warning for warning in moved.warnings)  # the builder's is another


def test_the_real_builder_takes_it_and_starts_at_qpos0(file):
    world = load_world(file)
    model = mujoco.MjModel.from_xml_path(str(file))
    pinocchio_model = pin.Model()
    pinocchio_model.loadFromString(world.pinocchio_model())
    assert world.num_v == model.nv
    q, v = mjcf.state(mjcf.read(file), world, model.qpos0, np.zeros(model.nv))
    inside = np.array([joint.num_q != 1 or joint.lower <= q[joint.q_index] <= joint.upper for joint in world.joints])
    if inside.all():
        np.testing.assert_allclose(q, world.initial_q, atol=1e-12)
    assert not v.any()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for i, body in enumerate(world.body_names[1:], 1):
        position, rotation = world.body_placement(body, q)
        np.testing.assert_allclose(position, data.xpos[i], atol=1e-12)
        np.testing.assert_allclose(rotation, data.xmat[i].reshape(3, 3), atol=1e-12)
    if [joint.name for joint in world.joints] == [model.joint(j).name for j in range(model.njnt)]:
        check_against_mujoco(pinocchio_model, file, lambda m: [])


def test_keyframes(tmp_path):
    path = write(
        tmp_path,
        body_xml(
            "<freejoint name='f'/>",
            "<keyframe><key name='up' qpos='1 2 3 0 1 0 0' qvel='0 1 0 0 0 2'/></keyframe>",
        ),
    )
    world = load_world(path)
    q, v, *_ = mjcf.keyframe(path, world, "up")
    np.testing.assert_allclose(q, [1, 2, 3, 1, 0, 0, 0])
    np.testing.assert_allclose(v, [0, -1, 0, 0, 0, 2], atol=1e-15)  # half a turn about x
    with pytest.raises(InvalidInputError, match="up"):
        mjcf.keyframe(path, world, "down")


def test_all_bits_of_contype_are_kept(tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "bits.xml"
    file.write_text("""<mujoco><worldbody><body><freejoint/>
      <geom size=".1" contype="-1" conaffinity="-2147483648"/></body></worldbody></mujoco>""")
    geometry = load_world(file).geometries[0]
    assert (geometry.group, geometry.mask) == (2**32 - 1, 2**31)
