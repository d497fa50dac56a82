"""The SDF reader: where things are, how links hang, how loops are closed, and the rules of docs/robot_files.md."""

import math
import time

import numpy as np
import pytest
from recording_builder import RecordingBuilder

import signorini
from signorini import InvalidInputError, Material
from signorini.load import _sdf_reader, add_file, file_format
from signorini.load import load as load_world

INERTIAL = """<inertial><mass>{0}</mass><inertia><ixx>0.1</ixx><iyy>0.12</iyy><izz>0.13</izz></inertia></inertial>"""
UNIT = INERTIAL.format(1)


def sdf(inside, version="1.9", world=False):
    inner = f'<world name="w">{inside}</world>' if world else f'<model name="m">{inside}</model>'
    return f'<sdf version="{version}">{inner}</sdf>'


def link(name, pose="0 0 0 0 0 0", more="", inertial=UNIT):
    return f'<link name="{name}"><pose>{pose}</pose>{inertial}{more}</link>'


def joint(name, parent, child, kind="revolute", axis="<xyz>0 0 1</xyz>", pose="0 0 0 0 0 0", more=""):
    axis = f"<axis>{axis}</axis>" if axis else ""
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{name}" type="{kind}"><pose>{pose}</pose>{ends}{axis}{more}</joint>'


def load(tmp_path, text, **options):
    path = tmp_path / "robot.sdf"
    path.write_text(text)
    return load_world(path, **options)


def record(tmp_path, text, **options):
    path = tmp_path / "robot.sdf"
    path.write_text(text)
    builder = RecordingBuilder()
    add_file(builder, path, **options)
    return builder


def turn(axis, angle):
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def relative(world, q, a, b):
    """Position and rotation of body b in body a."""
    (p, r), (p_b, r_b) = (world.body_placement(body, q) for body in (a, b))
    return r.T @ (p_b - p), r.T @ r_b


# Where things are

BOX = """<model name="box"><pose>0 0 9 0 0 0</pose>
  <link name="lid"><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose></link><link name="base"><pose>0 0 0.2 0.1 0 0</pose></link>
  <joint name="hinge" type="revolute"><pose>0.1 0 0 0 0.3 0</pose><parent>base</parent><child>lid</child>
    <axis><xyz>1 0 1</xyz><use_parent_model_frame>1</use_parent_model_frame></axis></joint></model>"""
PLACES = """<sdf version="1.9"><world name="w"><gravity>0 0 -3</gravity>
  <frame name="desk"><pose>1 2 3 0 0 0.5</pose></frame>
  <include><uri>model://box</uri><name>b1</name><pose relative_to="desk">0 1 0 0.1 0.2 0.3</pose></include>
  <include><uri>model://box</uri><name>b2</name><placement_frame>lid</placement_frame><pose>5 0 0 0 0 1</pose></include>
  <model name="arm" canonical_link="one"><pose relative_to="b1::lid">0 0 1 0 0 0</pose>
    <frame name="f" attached_to="one"><pose degrees="true">0 0 0.5 90 0 30</pose></frame>
    <link name="one"><pose rotation_format="quat_xyzw">0.1 0 0 0 0 0.6 0.8</pose></link>
    <link name="two"><pose relative_to="j12">0 0 0.1 0.2 0 0</pose></link>
    <joint name="j12" type="revolute"><pose relative_to="f">0 0.2 0 0 0 0</pose><parent>one</parent><child>two</child>
      <axis><xyz expressed_in="__model__">0 1 1</xyz></axis></joint>
    <model name="tool"><pose relative_to="two">0 0 0.3 0 0.4 0</pose><link name="tip"/>
      <frame name="grip"><pose>0.1 0.1 0.1 0 0 0</pose></frame></model>
    <joint name="slide" type="prismatic"><pose>0.1 0 0 0.3 0 0</pose><parent>two</parent><child>tool::tip</child>
      <axis><xyz expressed_in="tool::grip">1 2 0</xyz></axis></joint>
  </model></world></sdf>"""
OLD = """<sdf version="1.4"><model name="m"><pose>0 0 0 0.3 0.2 0.1</pose>
  <link name="a"><pose>0 0 1 0.5 0 0</pose></link><link name="b"><pose>0 1 1 0 0.5 0</pose></link>
  <joint name="j" type="revolute"><pose>0.1 0 0 0.7 0.3 0</pose><parent>a</parent><child>b</child>
    <axis><xyz>0 1 1</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint>
  <joint name="w" type="revolute"><pose>0 0.1 0 0 0 0</pose><parent>world</parent><child>a</child>
    <axis><xyz>1 1 1</xyz><limit><lower>-1e16</lower><upper>1e16</upper></limit></axis></joint></model></sdf>"""
# What Drake 1.51, which reads SDF by libsdformat, makes of these two: by body its position and its z axis.
Q = {
    PLACES: {
        "b1::hinge": 0.273923374,
        "b2::hinge": -0.460426572,
        "arm::j12": -0.918052952,
        "arm::slide": -0.966944728,
    },
    OLD: {"j": 0.273923374, "w": -0.4604265724722594},
}
BY_DRAKE = {
    PLACES: {
        "b1::lid": ([0.532040682, 3.103466476, 3.276420752], [0.655257352, 0.401158487, 0.640085673]),
        "b1::base": ([0.562442235, 2.892032572, 3.195034065], [0.278171840, 0.001261554, 0.960530497]),
        "b2::lid": (
            [4.968613078, 0.032157853, -0.001014194],
            [-0.049553314, 0.061968698, 0.996847204],
        ),
        "b2::base": (
            [5.076859565, -0.196226538, -0.124850921],
            [-0.497885906, -0.306001041, 0.811463484],
        ),
        "arm::tool::tip": (
            [1.796999974, 3.949443799, 3.299355899],
            [0.296954736, 0.923992782, -0.240946515],
        ),
        "arm::one": ([1.135050656, 3.611805238, 3.901056059], [0.618647221, 0.418236842, 0.665096654]),
        "arm::two": (
            [1.635995266, 3.975561411, 4.347885995],
            [0.602477189, 0.706249390, -0.371797034],
        ),
    },
    OLD: {
        "a": ([0.209064851, -0.290354515, 0.958321784], [-0.117416944, -0.468868934, 0.875428571]),
        "b": ([0.418860848, 0.671132214, 0.978410006], [0.619722242, -0.020143929, 0.784562658]),
    },
}


@pytest.mark.parametrize("text", [PLACES, OLD], ids=["1.9", "1.4"])
def test_bodies_are_where_drake_puts_them(tmp_path, text):
    (tmp_path / "box").mkdir()
    (tmp_path / "box" / "model.config").write_text('<model><sdf version="1.6">the.sdf</sdf></model>')
    (tmp_path / "box" / "the.sdf").write_text(f'<sdf version="1.6">{BOX}</sdf>')
    world = load(tmp_path, text)
    q = world.initial_q
    for name, value in Q[text].items():
        q[world.q_slice(name)] = value
    for body, (position, axis) in BY_DRAKE[text].items():
        at, rotation = world.body_placement(body, q)
        np.testing.assert_allclose(at, position, atol=1e-9)
        np.testing.assert_allclose(rotation[:, 2], axis, atol=1e-9)
    assert world.gravity[2] == (-3.0 if text == PLACES else -9.81)


def test_poses_by_hand(tmp_path):
    half = math.pi / 2
    text = sdf(
        '<pose>1 0 0 0 0 0</pose><frame name="f"><pose>0 2 0 0 0 1.5707963267948966</pose></frame>'
        + '<link name="a"><pose relative_to="f">3 0 0 0 0 0</pose></link>'
        + '<link name="b"><pose relative_to="a">0 0 4 1.5707963267948966 0 0</pose>'
        + '<collision name="c"><pose relative_to="f">0 0 0 0 0 0</pose><geometry><sphere><radius>1</radius></sphere>'
        + "</geometry></collision></link>"
        + joint("j", "a", "b", "prismatic", pose="0 0 0.5 0 0 0")
    )
    world = load(tmp_path, text, position=(0, 0, 10))
    (a, turned), (b, _) = world.body_placement("a"), world.body_placement("b")
    np.testing.assert_allclose(a, [1, 5, 10], atol=1e-14)
    np.testing.assert_allclose(turned, turn([0, 0, 1], half), atol=1e-14)
    np.testing.assert_allclose(b, [1, 5, 14], atol=1e-14)
    q = world.initial_q
    q[world.q_slice("j")] = 0.25  # along z of b, which is -y of a, which is x
    np.testing.assert_allclose(world.body_placement("b", q)[0], [1.25, 5, 14], atol=1e-14)
    (sphere,) = world.geometries
    place = world.body_placement("b")[1] @ sphere.placement.translation + b
    np.testing.assert_allclose(place, [1, 2, 10], atol=1e-14)


def test_the_same_robot_as_urdf(tmp_path):
    pin = pytest.importorskip("pinocchio")
    (tmp_path / "robot.urdf").write_text(
        """<robot name="r"><link name="base"/>
        <link name="one"><inertial><origin xyz="0.1 0 0.2" rpy="0.3 0 0"/><mass value="2"/>
          <inertia ixx="0.1" iyy="0.12" izz="0.13" ixy="0.01" ixz="0.02" iyz="0"/></inertial></link>
        <link name="two"><inertial><origin xyz="0 0.1 0"/><mass value="3"/>
          <inertia ixx="0.2" iyy="0.22" izz="0.13" ixy="0" ixz="0" iyz="0.01"/></inertial></link>
        <link name="tool"><inertial><origin xyz="0 0 0"/><mass value="0.5"/>
          <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j1" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 1" rpy="0.1 0.2 0.3"/>
          <axis xyz="0 1 1"/><limit lower="-1" upper="2" effort="5" velocity="1"/><dynamics damping="0.5"/></joint>
        <joint name="j2" type="prismatic"><parent link="one"/><child link="two"/><origin xyz="0 0.3 0.4" rpy="0 0.5 0"/>
          <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="7" velocity="1"/><dynamics friction="0.25"/></joint>
        <joint name="j3" type="fixed"><parent link="two"/><child link="tool"/>
          <origin xyz="0 0 0.2" rpy="0 0 1"/></joint>
        </robot>"""
    )

    def inertial(pose, mass, xx, yy, zz, xy, xz, yz):
        entries = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (xx, yy, zz, xy, xz, yz), strict=True)
        inner = "".join(f"<{key}>{value}</{key}>" for key, value in entries)
        return f"<inertial><pose>{pose}</pose><mass>{mass}</mass><inertia>{inner}</inertia></inertial>"

    text = sdf(
        '<link name="base"/>'
        + '<link name="one"><pose relative_to="base">0 0 1 0.1 0.2 0.3</pose>'
        + inertial("0.1 0 0.2 0.3 0 0", 2, 0.1, 0.12, 0.13, 0.01, 0.02, 0)
        + '</link><link name="two"><pose relative_to="one">0 0.3 0.4 0 0.5 0</pose>'
        + inertial("0 0.1 0 0 0 0", 3, 0.2, 0.22, 0.13, 0, 0, 0.01)
        + '</link><link name="tool"><pose relative_to="two">0 0 0.2 0 0 1</pose>'
        + inertial("0 0 0 0 0 0", 0.5, 0.02, 0.02, 0.01, 0, 0, 0)
        + "</link>"
        + joint("hold", "world", "base", "fixed", "")
        + joint("j1", "base", "one", axis="<xyz>0 1 1</xyz><limit><lower>-1</lower><upper>2</upper><effort>5</effort>"
                "</limit><dynamics><damping>0.5</damping></dynamics>")
        + joint("j2", "one", "two", "prismatic", "<xyz>1 0 0</xyz><limit><lower>-1</lower><upper>1</upper>"
                "<effort>7</effort></limit><dynamics><friction>0.25</friction></dynamics>")
        + joint("j3", "two", "tool", "fixed", "")
    )  # fmt: skip
    ours, theirs = load(tmp_path, text), load_world(tmp_path / "robot.urdf")
    assert ours.joint_names == theirs.joint_names == ("j1", "j2")
    models = []
    for world in (ours, theirs):
        model = pin.Model()
        model.loadFromString(world.pinocchio_model())
        models.append((model, model.createData()))
    random = np.random.default_rng(1)
    for _ in range(3):
        q = random.uniform(-1, 1, 2)
        masses = [np.triu(pin.crba(model, data, q)) for model, data in models]
        weights = [pin.computeGeneralizedGravity(model, data, q) for model, data in models]
        np.testing.assert_allclose(masses[0], masses[1], atol=1e-13)
        np.testing.assert_allclose(weights[0], weights[1], atol=1e-12)
    for a, b in zip(ours.joints, theirs.joints, strict=True):
        for key in ("lower", "upper", "damping", "friction", "stiffness"):
            assert getattr(a, key) == getattr(b, key)
    for a, b in zip(ours.actuators, theirs.actuators, strict=True):
        assert (a.name, a.force_lower, a.force_upper) == (b.name, b.force_lower, b.force_upper)


def test_inertia_is_one_where_none_is_given(tmp_path):
    world = load(tmp_path, sdf('<link name="a"/>'))
    assert world.bodies[1].mass == 1.0
    np.testing.assert_array_equal(world.bodies[1].inertia, np.eye(3))


# Joints


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "universal", "revolute2", "ball", "screw", "old screw"])
def test_joints_either_way_round(tmp_path, kind, turned):
    """The child is held and the parent hangs on it: values are still those of the child in the parent."""
    ends = ("b", "a") if turned else ("a", "b")  # b is the child
    axis2 = "<axis2><xyz>0 1 0.5</xyz></axis2>" if kind in ("universal", "revolute2") else ""
    more = axis2 + ("<screw_thread_pitch>0.3</screw_thread_pitch>" if kind == "screw" else "")
    if kind == "old screw":  # radians a metre, left-handed
        kind, more = "screw", f"<thread_pitch>{-2 * math.pi / 0.3!r}</thread_pitch>"
    text = sdf(
        link("a", "1 0 0 0.1 0.2 0")
        + link("b", "0 1 0 0 0.3 0.4")
        + joint("hold", "world", ends[1] if turned else "a", "fixed", "")
        + joint("j", "a", "b", kind, "" if kind == "ball" else "<xyz>1 0 1</xyz>", "0.1 0.2 0.3 0.5 0 0", more)
    )
    held = "b" if turned else "a"
    text = text.replace("<child>a</child>", f"<child>{held}</child>", 1)
    world = load(tmp_path, text)
    q = world.initial_q
    (p, r), frame = relative(world, q, "a", "b"), turn([1, 0, 0], 0.5)
    anchor = p + r @ np.array([0.1, 0.2, 0.3])
    first, second = r @ frame @ np.array([1, 0, 1]) / math.sqrt(2), r @ frame @ np.array([0, 1, 0.5])
    if kind == "ball":
        half = np.array([0.3, -0.1, 0.2])
        quaternion = np.array([*half, math.sqrt(1 - half @ half)])
        q[world.q_slice("j")] = quaternion
        angle, axis = 2 * math.acos(quaternion[3]), half / np.linalg.norm(half)
        link_turn = turn(axis, -angle if turned else angle)  # of a seen from b, in the axes of a; of b in those of b
        moved = r @ link_turn if not turned else link_turn @ r
    elif kind == "prismatic":
        q[world.q_slice("j")] = 0.7
        at, rotation = relative(world, q, "a", "b")
        np.testing.assert_allclose(at, p + 0.7 * first, atol=1e-13)
        np.testing.assert_allclose(rotation, r, atol=1e-13)
        return
    elif kind == "screw":
        q[world.q_slice("j")], q[world.q_slice("j_slide")] = 0.7, 0.7 * 0.3 / (2 * math.pi)
        assert np.abs(world.constraint_gaps(q)).max() < 1e-15
        moved = turn(first, 0.7) @ r
        anchor_now = anchor + 0.7 * 0.3 / (2 * math.pi) * first
        at, rotation = relative(world, q, "a", "b")
        np.testing.assert_allclose(rotation, moved, atol=1e-13)
        np.testing.assert_allclose(at + rotation @ np.array([0.1, 0.2, 0.3]), anchor_now, atol=1e-13)
        return
    elif kind == "revolute":
        q[world.q_slice("j")] = 0.7
        moved = turn(first, 0.7) @ r
    else:
        q[world.q_slice("j_1")], q[world.q_slice("j_2")] = 0.7, -0.4
        moved = turn(first, 0.7) @ turn(second, -0.4) @ r
    at, rotation = relative(world, q, "a", "b")
    np.testing.assert_allclose(rotation, moved, atol=1e-13)
    np.testing.assert_allclose(at + rotation @ np.array([0.1, 0.2, 0.3]), anchor, atol=1e-13)  # the point stays


@pytest.mark.parametrize("turned", [False, True])
def test_a_universal_joint_that_starts_away_from_0(tmp_path, turned):
    """Both its references are not 0 then; q = 0 is the file's configuration all the same."""
    limit = "<limit><lower>0.5</lower><upper>1</upper></limit>"
    mimic = (
        '<mimic joint="j" axis="axis"><multiplier>2</multiplier><offset>0.1</offset><reference>0.2</reference></mimic>'
    )
    text = sdf(
        link("a", "1 0 0 0.1 0.2 0")
        + link("b", "0 1 0 0 0.3 0.4")
        + joint("hold", "world", "b" if turned else "a", "fixed", "")
        + joint("j", "a", "b", "universal", f"<xyz>1 0 1</xyz>{limit}", "0.1 0.2 0.3 0.5 0 0",
                f"<axis2><xyz>0 1 0.5</xyz>{mimic}</axis2>")
    )  # fmt: skip
    world = load(tmp_path, text)
    q = world.initial_q
    values = [float(q[world.q_slice(name)][0]) for name in ("j_1", "j_2")]
    assert 0.5 <= values[0] <= 1.0
    assert values[1] == pytest.approx(2 * (values[0] - 0.2) + 0.1, abs=1e-9)
    q[:] = 0.0
    at, rotation = relative(world, q, "a", "b")
    there, turned_there = np.array([0.0, 1.0, 0.0]) - [1, 0, 0], turn([0, 0, 1], 0.4) @ turn([0, 1, 0], 0.3)
    own = turn([0, 1, 0], 0.2) @ turn([1, 0, 0], 0.1)
    np.testing.assert_allclose(at, own.T @ there, atol=1e-13)
    np.testing.assert_allclose(rotation, own.T @ turned_there, atol=1e-13)
    assert world.actuator_names == ("j_1",)


def test_what_joints_carry_over(tmp_path):
    spring = "<damping>0.1</damping><friction>0.2</friction><spring_stiffness>30</spring_stiffness>"
    axis = (
        "<xyz>0 2 0</xyz><limit><lower>-1e16</lower><upper>0.5</upper><effort>-1</effort><velocity>3</velocity></limit>"
    )
    axis += f"<dynamics>{spring}<spring_reference>0.3</spring_reference></dynamics>"
    none = "<xyz>1 0 0</xyz><limit><effort>0</effort></limit>"
    text = sdf(
        "".join(link(name) for name in "abcd")
        + joint("hold", "world", "a", "fixed", "")
        + joint("j", "a", "b", axis=axis)
        + joint("c", "b", "c", "continuous", "<xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper></limit>")
        + joint("p", "c", "d", "prismatic", none)
    )
    builder = record(tmp_path, text, prefix="r/")
    j, c = builder.joints["r/j"], builder.joints["r/c"]
    np.testing.assert_allclose(j.axis, [0, 1, 0])
    assert (j.lower, j.upper, j.damping, j.friction) == (-math.inf, 0.5, 0.1, 0.2)
    assert (j.stiffness, j.spring_reference) == (30.0, 0.3)
    assert (c.lower, c.upper) == (-math.inf, math.inf)
    motors = {args[0]: rest["force_range"] for args, rest in builder.called("add_motor")}
    assert motors == {"r/j": (-math.inf, math.inf), "r/c": (-math.inf, math.inf)}  # no effort, no motor
    assert builder.warnings == ["robot.sdf: velocity limits are not kept: j"]
    assert record(tmp_path, text, motors=False).called("add_motor") == []


# Loops

GRAVITY = 9.81
CRANK, COUPLER, ROCKER, GROUND = 0.3, 0.7, 0.5, 0.8  # [m], a four-bar linkage in the plane x z
ANGLE = 0.9  # of the crank in the file


def corners(angle):
    """Ends of crank and rocker (x, z), when the crank is at an angle."""
    b = CRANK * np.array([math.cos(angle), math.sin(angle)])
    d = np.array([GROUND, 0.0])
    away = np.linalg.norm(d - b)
    along = (COUPLER**2 - ROCKER**2 + away**2) / (2 * away)
    unit = (d - b) / away
    return b, b + along * unit + math.sqrt(COUPLER**2 - along**2) * np.array([-unit[1], unit[0]])


def bars(angle):
    """Of each bar: mass, inertia about its middle, middle (x, z) and direction."""
    b, c = corners(angle)
    o, d = np.zeros(2), np.array([GROUND, 0.0])
    for start, end, length in ((o, b, CRANK), (b, c, COUPLER), (d, c, ROCKER)):
        mass = 2.0 * length
        yield mass, mass * length**2 / 12.0, 0.5 * (start + end), math.atan2(*(end - start)[::-1])


def four_bar(closing="revolute", cut="rocker", limit="", swap=False):
    """Links have their frames in their middles, x along them."""
    links = ""
    for name, (mass, inertia, middle, angle) in zip(("crank", "coupler", "rocker"), bars(ANGLE), strict=True):
        moments = f"<ixx>1e-4</ixx><iyy>{inertia!r}</iyy><izz>{inertia!r}</izz>"
        links += link(
            name,
            f"{float(middle[0])!r} 0 {float(middle[1])!r} 0 {-angle!r} 0",
            inertial=f"<inertial><mass>{mass!r}</mass><inertia>{moments}</inertia></inertial>",
        )
    ends = ("coupler", "rocker") if cut == "rocker" else ("rocker", "coupler")
    if swap:
        ends = ends[::-1]
    half = {"crank": CRANK / 2, "coupler": COUPLER / 2, "rocker": ROCKER / 2}
    y = "<xyz>0 1 0</xyz>"
    return sdf(
        links
        + joint("o", "world", "crank", axis=y + limit, pose=f"{-half['crank']} 0 0 0 0 0")
        + joint("b", "crank", "coupler", axis=y, pose=f"{-half['coupler']} 0 0 0 0 0")
        + joint("d", "world", "rocker", axis=y, pose=f"{-half['rocker']} 0 0 0 0 0")
        + joint("c", *ends, closing, "" if closing == "ball" else y, pose=f"{half[ends[1]]} 0 0 0 0 0")
    )


def swung(times):
    """The crank's angle from rest, by Lagrange's equation of the one coordinate: M a'' + M' a'^2 / 2 + V' = 0."""
    from scipy.integrate import solve_ivp

    h = 1e-4

    def mass(angle):
        before, after = bars(angle - h), bars(angle + h)
        total = 0.0
        for (m, i, p, a), (_, _, p_2, a_2) in zip(before, after, strict=True):
            rate, turning = (p_2 - p) / (2 * h), (a_2 - a) / (2 * h)
            total += m * rate @ rate + i * turning**2
        return total

    def height(angle):
        return sum(m * GRAVITY * p[1] for m, _, p, _ in bars(angle))

    def rates(_, state):
        angle, speed = state
        slope = (mass(angle + h) - mass(angle - h)) / (2 * h)
        force = (height(angle + h) - height(angle - h)) / (2 * h)
        return speed, -(0.5 * slope * speed**2 + force) / mass(angle)

    return solve_ivp(rates, (0.0, times[-1]), (ANGLE, 0.0), t_eval=times, rtol=1e-8, atol=1e-9).y[0]


@pytest.mark.parametrize(("closing", "cut"), [("revolute", "rocker"), ("revolute", "coupler"), ("ball", "rocker")])
def test_a_four_bar_linkage_swings_as_lagrange_says(tmp_path, closing, cut):
    world = load(tmp_path, four_bar(closing, cut))
    assert len(world.constraints) == 1
    assert np.abs(world.constraint_gaps()).max() < 1e-12
    steps, angles, drift = 2000, [], []
    for refined in (1, 2):
        simulator = signorini.Simulator(world, time_step=1e-3 / refined)
        simulator.state.q = world.initial_q
        before = simulator.energy.total
        trace = simulator.run(steps * refined, keep_states=True)
        assert trace.solved.all()
        states = trace.states[refined - 1 :: refined, : world.num_q]
        assert max(np.abs(world.constraint_gaps(q)).max() for q in states[::5]) < 1e-6
        angles.append(ANGLE - states[:, world.q_slice("o")].ravel())  # about +y the crank turns down
        drift.append(abs(simulator.energy.total - before))
    expected = swung(np.arange(1, steps + 1) * 1e-3)
    assert np.ptp(expected) > 1.0
    errors = [np.abs(found - expected).max() for found in angles]
    assert errors[0] < 0.1
    assert errors[1] < 0.55 * errors[0]  # of first order in the time step
    assert np.abs(2 * angles[1] - angles[0] - expected).max() < 2e-3  # extrapolated to 0
    assert drift[0] < 0.005 * before
    assert drift[1] < 0.55 * drift[0]


def test_a_start_outside_limits_is_moved_with_the_loop_closed(tmp_path):
    limit = "<limit><lower>0.2</lower><upper>1</upper></limit>"
    world = load(tmp_path, four_bar(limit=limit))
    q = world.initial_q
    assert 0.2 <= q[world.q_slice("o")][0] <= 1.0
    assert np.abs(world.constraint_gaps()).max() < 1e-9
    angle = ANGLE - q[world.q_slice("o")][0]
    _, c = corners(angle)
    rocker = world.body_placement("rocker")
    np.testing.assert_allclose((rocker[0] + rocker[1] @ [ROCKER / 2, 0, 0])[[0, 2]], c, atol=1e-9)
    q[:] = 0.0  # still the file's configuration
    np.testing.assert_allclose(world.constraint_gaps(q), 0.0, atol=1e-12)
    held = "<xyz>0 1 0</xyz><limit><lower>0</lower><upper>0.01</upper></limit></axis></joint>"
    text = four_bar(limit="<limit><lower>2.9</lower><upper>3</upper></limit>")
    far = load(tmp_path, text.replace('<xyz>0 1 0</xyz></axis></joint><joint name="c"', f'{held}<joint name="c"'))
    assert any("loops are open at the start" in warning for warning in far.warnings)


def test_closed_configuration(tmp_path):
    world = load(tmp_path, four_bar())
    q = world.initial_q
    q[world.q_slice("o")] = -0.6
    assert np.abs(world.constraint_gaps(q)).max() > 0.05
    closed = world.closed_configuration(q)
    assert np.abs(world.constraint_gaps(closed)).max() < 1e-9
    assert np.abs(closed - q).max() < 1.0
    with pytest.raises(InvalidInputError, match="q: has shape"):
        world.closed_configuration([0.0])


def test_balls_close_loops_and_what_does_more_stays_in_the_tree(tmp_path):
    limited = "<xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper></limit>"
    ring = "".join(link(name, f"{i} 0 0 0 0 0") for i, name in enumerate("abcd"))
    base = joint("hold", "world", "a", "fixed", "")
    inner = joint("ab", "a", "b") + joint("ac", "a", "c") + joint("bd", "b", "d", axis=limited)
    for last, closes in (
        (joint("cd", "c", "d"), "cd"),
        (joint("cd", "c", "d", "ball", ""), "cd"),
        (joint("cd", "c", "d", axis=limited), "ac"),
        (joint("cd", "c", "d", "prismatic"), "ac"),
        (joint("cd", "c", "d", "fixed", ""), "ac"),
    ):
        world = load(tmp_path, sdf(ring + base + inner + last))
        assert {c.name.removesuffix("_2") for c in world.constraints} == {closes}, last
    cut = joint(
        "ab2", "b", "c", more="<physics><simbody><must_be_loop_joint>1</must_be_loop_joint></simbody></physics>"
    )
    world = load(
        tmp_path, sdf("".join(link(n) for n in "abc") + base + joint("ab", "a", "b") + joint("ac", "a", "c") + cut)
    )
    assert world.constraints[0].name == "ab2"


def test_what_a_closing_joint_loses_is_listed_and_its_links_never_touch(tmp_path):
    ball = "<collision name='s'><geometry><sphere><radius>0.2</radius></sphere></geometry></collision>"
    dynamics = "<xyz>0 1 0</xyz><dynamics><damping>1</damping></dynamics>"
    text = sdf(
        "<self_collide>1</self_collide>"
        + "".join(link(name, more=ball) for name in "abc")
        + joint("ab", "a", "b", axis=dynamics)
        + joint("ac", "a", "c", axis=dynamics)
        + joint("bc", "b", "c", axis=dynamics)
    )
    world = load(tmp_path, text, exclude_overlapping=False)
    assert any("close loops" in warning and "bc (damping)" in warning for warning in world.warnings)
    assert world.touching_pairs(margin=1.0) == []


def test_a_hinge_that_closes_a_loop_holds_its_axis(tmp_path):
    axis2 = "<axis2><xyz>0 1 0</xyz></axis2>"
    text = sdf(
        link("a", "0 0 0 0.1 0.2 0.3")
        + link("b", "1 0 0 0 0 0.4")
        + joint("hold", "world", "a", "fixed", "")
        + joint("tree", "a", "b", "universal", "<xyz>1 0 0</xyz>", more=axis2)
        + joint("hinge", "a", "b", axis="<xyz>1 0 0</xyz>")
    )
    world = load(tmp_path, text)
    assert [c.name for c in world.constraints] == ["hinge", "hinge_2"]
    np.testing.assert_allclose(world.constraint_gaps([0.3, 0.0]), 0.0, atol=1e-14)
    assert np.abs(world.constraint_gaps([0.3, 0.1])).max() > 0.004
    for side in ("placement_a", "placement_b"):
        one, other = (getattr(c, side).translation for c in world.constraints)
        np.testing.assert_allclose(
            one + other, 0.0 if side == "placement_b" else 2 * relative(world, None, "a", "b")[0]
        )
        assert np.linalg.norm(one - other) == pytest.approx(0.1)


def test_slopes_of_the_gaps():
    """Gauss-Newton's matrix against differences, far from closed (the turns of a weld: where they are 0)."""
    from signorini import Joint, WorldBuilder, _closure

    builder = WorldBuilder()
    for name, parent in (("a", "world"), ("b", "a"), ("c", "b"), ("d", "a")):
        hinge = Joint(name, "ball") if name == "c" else Joint(name, axis=(0.3, 1.0, 0.2), anchor=(0.1, 0.0, 0.2))
        position = (0.2, 0.3, 0.1)
        builder.add_body(name, parent=parent, position=position, joints=[hinge], mass=1.0, inertia=np.eye(3))
    builder.add_connect("c", "d", (0.1, 0.2, 0.3), (0.2, 0.0, 0.1))
    builder.add_coupling("b", "d", (0.1, 2.0, 0.5), reference=0.2, driver_reference=0.3)
    builder.add_weld("c", "world", position_a=(0.1, 0.0, 0.0), position_b=(0.0, 0.2, 0.0))
    world = builder.build()
    q, h = world.initial_q, 1e-6
    for turned in (False, True):
        if turned:
            q = world.integrate(q, np.random.default_rng(3).uniform(-0.5, 0.5, world.num_v), 1.0)
        slopes = _closure._jacobian(world, q)
        ahead, back = (
            np.transpose([_closure.gaps(world, world.integrate(q, step, s)) for step in np.eye(world.num_v)])
            for s in (h, -h)
        )
        rows = 7 if turned else 10
        np.testing.assert_allclose(slopes[:rows], ((ahead - back) / (2 * h))[:rows], atol=1e-8)


@pytest.mark.parametrize("off", [1e-6, 1e-4])
def test_axes_that_are_parallel_to_a_few_digits_do_not_jam_a_plane_loop(tmp_path, off):
    found = []
    for axis in ("0 1 0", f"{off} 1 {0.5 * off}"):
        first = (
            '<joint name="b" type="revolute"><pose>-0.35 0 0 0 0 0</pose><parent>crank</parent><child>coupler</child>'
        )
        text = four_bar().replace(f"{first}<axis><xyz>0 1 0", f"{first}<axis><xyz>{axis}")
        world = load(tmp_path, text)
        simulator = signorini.Simulator(world)
        simulator.state.q = world.initial_q
        simulator.step(1000)
        found.append(float(simulator.state.q[world.q_slice("o")][0]))
    assert any("made parallel" in warning and "b" in warning for warning in world.warnings)
    assert abs(found[0]) > 0.5
    assert found[1] == pytest.approx(found[0], abs=1e-6)


@pytest.mark.parametrize("off", [0.0, 1e-4])
def test_a_slider_crank(tmp_path, off):
    """Crank of 0.3 m, rod of 0.5 m, whose end slides along x: where the crank is, the slider must be."""
    sine, cosine = 0.6, 0.8  # of the crank's angle; the rod then dips by asin(0.36)
    dip = math.asin(0.3 * sine / 0.5)
    end = 0.3 * cosine + 0.5 * math.cos(dip)
    y = f"<xyz>0 1 {off}</xyz>"
    text = sdf(
        link("crank", f"0 0 0 0 {-math.atan2(sine, cosine)!r} 0")
        + link("rod", f"{0.3 * cosine} 0 {0.3 * sine} 0 {dip!r} 0")
        + link("slider", f"{end!r} 0 0 0 0 0")
        + joint("o", "world", "crank", axis="<xyz>0 1 0</xyz>")
        + joint("a", "crank", "rod", axis="<xyz>0 1 0</xyz>")
        + joint("s", "world", "slider", "prismatic", f"<xyz>1 {-off} 0</xyz>")
        + joint("b", "rod", "slider", axis=y)
    )
    world = load(tmp_path, text, gravity=(0, 0, 0))
    assert [c.name for c in world.constraints] == ["b"]
    simulator = signorini.Simulator(world)
    simulator.state.q = world.initial_q
    simulator.applied_force[world.v_slice("o")] = 1.0
    simulator.step(1000)
    q = simulator.state.q
    angle = math.atan2(sine, cosine) - q[world.q_slice("o")][0]
    assert abs(q[world.q_slice("o")][0]) > 0.2
    expected = 0.3 * math.cos(angle) + math.sqrt(0.5**2 - (0.3 * math.sin(angle)) ** 2)
    assert end + q[world.q_slice("s")][0] == pytest.approx(expected, abs=1e-6)
    assert any("made parallel" in warning for warning in world.warnings) == (off > 0.0)


def test_axes_of_a_loop_that_can_move_stay_as_they_are(tmp_path):
    """Seven freedoms: nothing is redundant."""
    text = sdf(
        "".join(link(name, f"{i} 0 0 0 0 0") for i, name in enumerate("abcde"))
        + joint("hold", "world", "a", "fixed", "")
        + joint("ab", "a", "b", axis="<xyz>0 1 1e-4</xyz>")
        + joint("bc", "b", "c", axis="<xyz>0 1 0</xyz>")
        + joint("cd", "c", "d", axis="<xyz>0 1 0</xyz>")
        + joint("de", "d", "e", axis="<xyz>0 1 0</xyz>")
        + joint("ae", "a", "e", "ball", "")
    )
    world = load(tmp_path, text)
    np.testing.assert_allclose(world.joint("ab").axis, np.array([0, 1, 1e-4]) / math.hypot(1, 1e-4), atol=1e-15)
    assert world.warnings == ()


def test_what_joins_links_that_are_fixed_to_each_other_is_no_loop(tmp_path):
    text = sdf(
        link("a") + link("b", "0 0 1 0.3 0.2 0.1")
        + joint("x", "a", "b", "fixed", "") + joint("y", "a", "b", "fixed", "") + joint("z", "a", "b", "ball", "")
    )  # fmt: skip
    world = load(tmp_path, text)
    assert world.constraints == ()
    signorini.Simulator(world).step()


def test_a_fixed_joint_that_closes_a_loop_is_a_weld(tmp_path):
    """Two slides side by side, and their ends in one piece: one of them has a spring, and holds both."""
    spring = "<xyz>0 0 1</xyz><dynamics><spring_stiffness>100</spring_stiffness></dynamics>"
    text = sdf(
        "".join(link(name, f"{i} 0 0 0 0 {i}") for i, name in enumerate("abc"))
        + joint("hold", "world", "a", "fixed", "")
        + joint("ab", "a", "b", "prismatic", spring)
        + joint("ac", "a", "c", "prismatic")
        + joint("bc", "b", "c", "fixed", "", "0.1 0.2 0.3 0.4 0.5 0.6")
    )
    world = load(tmp_path, text)
    (weld,) = world.constraints
    assert (weld.name, weld.type.name) == ("bc", "weld")
    assert np.abs(world.constraint_gaps()).max() < 1e-14
    simulator = signorini.Simulator(world)
    lowest = simulator.run(1000, keep_states=True).states[:, :2].min(0)
    np.testing.assert_allclose(lowest, -2 * 2 * 9.81 / 100, rtol=0.02)  # twice the depth of rest, for both


# Models and worlds


def test_what_floats_and_what_does_not(tmp_path):
    text = sdf(
        '<model name="free">' + link("a") + link("b") + joint("j", "a", "b") + "</model>"
        '<model name="table"><static>1</static>' + link("top") + link("leg") + joint("k", "top", "leg") + "</model>"
        '<model name="held">' + link("a") + joint("w", "world", "a") + "</model>"
        '<model name="two">' + link("a") + link("b") + "</model>",
        world=True,
    )  # fmt: skip
    world = load(tmp_path, text)
    assert set(world.joint_names) == {
        *("free::root_joint", "free::j", "held::w", "two::root_joint", "two::b_root_joint"),
    }
    assert {body.name for body in world.bodies[1:]} == {
        *("free::a", "free::b", "table::top", "table::leg", "held::a", "two::a", "two::b"),
    }
    assert world.gravity.tolist() == [0.0, 0.0, -9.8]
    assert set(load(tmp_path, text, floating_base=False).joint_names) == {"free::j", "held::w"}
    assert load(tmp_path, sdf(link("a"))).joint_names == ("root_joint",)


def test_a_joint_of_the_world_ties_models(tmp_path):
    text = sdf(
        '<model name="x">' + link("a") + '</model><model name="y"><pose>1 0 0 0 0 0</pose>' + link("a") + "</model>"
        + joint("tie", "x::a", "y", "ball", ""),
        world=True,
    )  # fmt: skip
    world = load(tmp_path, text)
    assert world.joint_names == ("x::root_joint", "tie")


def test_static_inclusion_and_names(tmp_path):
    (tmp_path / "part.sdf").write_text(sdf(link("l"), "1.5"))
    text = sdf(
        "<include><uri>part.sdf</uri></include><include><uri>part.sdf</uri><name>n</name><static>1</static></include>"
    )
    world = load(tmp_path, text)
    assert world.body_names == ("world", "m::l", "n::l")
    assert world.joint_names == ("m::root_joint",)


@pytest.mark.parametrize("variable", ["GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH"])
def test_models_are_found_by_the_environment(tmp_path, monkeypatch, variable):
    (tmp_path / "models" / "part").mkdir(parents=True)
    (tmp_path / "models" / "part" / "model.sdf").write_text(sdf(link("l")))
    (tmp_path / "here").mkdir()
    monkeypatch.setenv(variable, str(tmp_path / "models"))
    assert load(tmp_path / "here", sdf("<include><uri>model://part</uri></include>")).body_names == ("world", "m::l")


# Collisions

BALL = "<sphere><radius>0.2</radius></sphere>"
SPHERE = f"<geometry>{BALL}</geometry>"


def test_links_of_a_model_touch_only_on_request(tmp_path):
    def pairs(model="", of_a="", **options):
        def ball(name, more=""):
            return link(name, more=f"<collision name='c'>{SPHERE}</collision>{more}")

        text = sdf(model + ball("a", of_a) + ball("b") + ball("c") + joint("j", "a", "b"))
        world = load(tmp_path, text, exclude_overlapping=False, **options)
        names = world.geometry_names
        return {(names[a], names[b]) for a, b, _ in world.touching_pairs(margin=1.0)}

    assert pairs() == set()
    assert pairs("<self_collide>true</self_collide>") == {("c", "c_0"), ("b_0", "c_0")}  # a and b are joined
    assert pairs(of_a="<self_collide>true</self_collide>") == {("c", "c_0")}
    assert pairs("<self_collide>true</self_collide>", self_collision=False) == set()


def test_models_of_a_world_that_overlap_still_touch(tmp_path):
    def ball(model, name, where):
        return f'<model name="{model}"><self_collide>1</self_collide><pose>{where}</pose>' + "".join(
            link(f"{name}{i}", f"{i} 0 0 0 0 0", f"<collision name='c'>{SPHERE}</collision>") for i in (0, 0.1)
        ) + "</model>"  # fmt: skip

    text = sdf(ball("x", "a", "0 0 0 0 0 0") + ball("y", "b", "0 0 0.3 0 0 0"), world=True)
    for options in ({}, {"self_collision": False}):
        world = load(tmp_path, text, **options)
        pairs = world.touching_pairs(margin=0.0)
        bodies = {tuple(world.body_names[world.geometries[g].body] for g in pair[:2]) for pair in pairs}
        assert bodies == {(f"x::a{i}", f"y::b{j}") for i in (0, 0.1) for j in (0, 0.1)}


def test_surfaces(tmp_path):
    def collision(name, surface):
        return f'<collision name="{name}">{SPHERE}<surface>{surface}</surface></collision>'

    ode = "<friction><ode><mu>0.3</mu><mu2>0.2</mu2><slip1>1</slip1></ode></friction>"
    bounce = "<bounce><restitution_coefficient>0.5</restitution_coefficient><threshold>0.1</threshold></bounce>"
    mask = "<contact><collide_bitmask>5</collide_bitmask><ode><kp>1e5</kp></ode></contact>"
    category = "<contact><collide_bitmask>1</collide_bitmask><category_bitmask>6</category_bitmask></contact>"
    text = sdf(
        link("a", more=collision("x", ode + bounce) + collision("y", mask) + collision("z", category))
        + link("b", more=f'<collision name="plain">{SPHERE}</collision>')
    )
    builder = record(tmp_path, text)
    x, y, z, plain = (rest for _, _, rest in builder.geometries)
    assert x["material"] == Material(friction=0.3, restitution=0.5)
    assert plain["material"] == Material(friction=1.0)
    assert [(g["group"], g["mask"]) for g in (x, y, z)] == [(65535, 65535), (5, 5), (6, 1)]
    listed = "\n".join(builder.warnings)
    for words in ("<mu2>: a", "friction/ode/slip1", "bounce/threshold", "contact/ode/kp", "min(a, b) in Gazebo"):
        assert words in listed
    ice = Material(friction=0.1)
    assert record(tmp_path, text, material={"b": ice}).geometries[3][2]["material"] == ice


def test_shapes(tmp_path):
    from signorini import Box, Capsule, Cylinder, Ellipsoid, HalfSpace, Sphere

    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    shapes = (
        "<box><size>0.2 0.4 0.6</size></box>",
        "<sphere><radius>0.1</radius></sphere>",
        "<cylinder><radius>0.1</radius><length>0.5</length></cylinder>",
        "<capsule><radius>0.1</radius><length>0.5</length></capsule>",
        "<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>",
        "<plane><normal>0 1 0</normal><size>1 1</size></plane>",
        "<mesh><uri>t.obj</uri><scale>0.1 0.1 -0.1</scale></mesh>",
        "<heightmap><uri>x.png</uri></heightmap>",
        "<empty/>",
    )
    parts = "".join(
        f'<collision name="c{i}"><pose>{i} 0 0 0 0 0</pose><geometry>{shape}</geometry></collision>'
        for i, shape in enumerate(shapes)
    )
    builder = record(tmp_path, sdf(link("a", more=parts)))
    found = [shape for _, shape, _ in builder.geometries]
    assert found[:6] == [
        *(Box((0.1, 0.2, 0.3)), Sphere(0.1), Cylinder(0.1, 0.25), Capsule(0.1, 0.25)),
        *(Ellipsoid((0.1, 0.2, 0.3)), HalfSpace()),
    ]
    np.testing.assert_allclose(builder.geometries[5][2]["orientation"] @ [0, 0, 1], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(found[6].vertices.min(0), [0, 0, -0.1])
    assert [rest["position"][0] for _, _, rest in builder.geometries] == [0, 1, 2, 3, 4, 5, 6]
    assert builder.warnings == ["robot.sdf: collisions with <heightmap> do not collide: a"]


def test_visuals(tmp_path):
    def visual(material):
        return f'<visual name="v"><pose>0 0 1 0 0 0</pose>{SPHERE}{material}</visual>'

    more = visual("<material><ambient>1 1 1 1</ambient><diffuse>0.1 0.2 0.3 1</diffuse></material>")
    more += visual("<transparency>0.25</transparency><material><ambient>0.5 0.5 0.5 1</ambient></material>")
    more += visual("") + '<visual name="w"><geometry><mesh><uri>gone.stl</uri></mesh></geometry></visual>'
    builder = record(tmp_path, sdf(link("a", more=more)))
    assert [rest["color"] for _, _, rest in builder.visuals] == [(0.1, 0.2, 0.3, 1.0), (0.5, 0.5, 0.5, 0.75), None]
    assert builder.visuals[0][2]["position"].tolist() == [0, 0, 1]
    assert any("cannot be drawn" in warning and "gone.stl" in warning for warning in builder.warnings)


def test_what_is_not_read_is_listed(tmp_path):
    text = sdf(
        '<plugin name="p" filename="x.so"/><enable_wind>1</enable_wind><gripper name="g"/>'
        + link(
            "a", more="<gravity>0</gravity><velocity_decay><linear>1</linear></velocity_decay><novel/><light name='l'/>"
        )
        + link("b", inertial=UNIT.replace("</inertial>", "<fluid_added_mass><xx>1</xx></fluid_added_mass></inertial>"))
        + joint("j", "a", "b", "ball", more="<physics><ode><erp>0.1</erp></ode></physics><sensor name='s' type='t'/>")
        + joint("g", "a", "b", "gearbox")
        + link("c", more=f"<collision name='x'><soft/>{SPHERE}</collision>")
        + joint("k", "b", "c", axis="<xyz>1 0 0</xyz><initial_position>0.3</initial_position>")
    )
    listed = "\n".join(record(tmp_path, text).warnings)
    for words in (
        *(
            "<plugin> of <model>",
            "<enable_wind>",
            "<gripper>",
            "links without gravity",
            "<velocity_decay>",
            "<novel> of <link>",
        ),
        *("<fluid_added_mass>", "<axis> of ball joints", "<ode/erp>", "gearbox", "<soft>", "<initial_position>"),
    ):
        assert words in listed, words
    for words in ("light", "sensor", "must be"):
        assert words not in listed


# Cassie


@pytest.fixture(scope="module")
def cassie():
    try:
        return signorini.scenes.robots_folder() / "cassie_description" / "robots" / "cassie_v2.sdf"
    except FileNotFoundError as error:
        pytest.skip(str(error))


def test_cassie(cassie):
    world = load_world(cassie)
    import re

    text = re.sub("<!--.*?-->", "", cassie.read_text(), flags=re.S)
    assert sum(body.mass for body in world.bodies) == pytest.approx(
        sum(float(m) for m in re.findall("<mass>(.*?)</mass>", text)), rel=1e-14
    )
    assert len(world.bodies) == 24
    assert world.num_v == 6 + 22
    one_value = {name for name, kind in re.findall(r'<joint name="(.*?)" type="(.*?)"', text) if kind == "revolute"}
    assert {joint.name for joint in world.joints} == {"root_joint"} | one_value
    knee, foot = world.joint("left-knee-op"), world.joint("right-foot-op")
    assert (knee.lower, knee.upper, knee.damping) == (-2.07694, 0.13963, 1.0)
    assert (foot.lower, foot.upper) == (-2.4435, -0.6109)
    assert world.joint("right-tarsus-spring-joint").stiffness == 1250.0
    assert {c.name for c in world.constraints} == {
        f"{side}-{name}-joint" for side in ("left", "right") for name in ("pitch-rod", "plantar-foot")
    }
    q = world.initial_q
    assert np.abs(world.constraint_gaps()).max() < 1e-8  # the file's own start has feet and cranks outside their limits
    for joint in world.joints:
        if joint.num_q == 1:
            assert joint.lower <= q[joint.q_index] <= joint.upper
    q[7:] = 0.0
    assert np.abs(world.constraint_gaps(q)).max() < 1e-12  # the file's poses close every loop


def test_both_feet_of_cassie_move(cassie):
    """The axes of the right foot's loop are parallel but for 1e-7 rad: as rigid as that, the foot could not turn."""
    world = load_world(cassie, floating_base=False)
    simulator = signorini.Simulator(world)
    q = world.closed_configuration(simulator.state.q + 0.0)
    simulator.state.q = q
    for side in ("left", "right"):
        simulator.applied_force[world.v_slice(f"{side}-foot-op")] = -1.0
    trace = simulator.run(1000, keep_states=True)
    assert trace.solved.all()
    moved = [float((simulator.state.q - q)[world.q_slice(f"{side}-foot-op")][0]) for side in ("left", "right")]
    assert min(np.abs(moved)) > 0.2
    assert moved[0] == pytest.approx(moved[1], abs=0.2)
    assert max(np.abs(world.constraint_gaps(state[: world.num_q])).max() for state in trace.states[::20]) < 1e-6


def test_cassie_drops_with_its_loops_closed(cassie):
    world, q, _ = signorini.scenes.worlds()["cassie"]()
    simulator = signorini.Simulator(world)
    simulator.state.q = q
    before = simulator.energy.total
    trace = simulator.run(2000, keep_states=True)
    assert trace.solved.all()
    assert np.isfinite(trace.states).all()
    gaps = np.array([np.abs(world.constraint_gaps(state[: world.num_q])).max() for state in trace.states])
    assert np.mean(gaps < 1e-5) > 0.98  # in a step with an impact, curved paths leave more until the next one
    assert gaps.max() < 3e-4
    assert simulator.energy.total < before


# Files that are wrong

A, B, C = link("a"), link("b"), link("c")
AB = joint("j", "a", "b")


def shape(text, surface=""):
    return link("a", more=f'<collision name="c"><geometry>{text}</geometry>{surface}</collision>')


def axis(text, kind="revolute"):
    return A + B + joint("j", "a", "b", kind, text)


def moments(**entries):
    inner = "".join(f"<{key}>{value}</{key}>" for key, value in entries.items())
    return link("a", inertial=f"<inertial><mass>1</mass><inertia>{inner}</inertia></inertial>")


MALFORMED = {  # inside of the model: what the message must name
    "no link": ("", ['model "m"', "no <link>"]),
    "link without name": ("<link/>", ["link", "name"]),
    "duplicate link": (A + A, ['link "a"', "already"]),
    "duplicate joint": (A + B + C + AB + joint("j", "a", "c"), ['joint "j"', "already"]),
    "link called world": (link("world"), ['link "world"', "meaning of its own"]),
    "no such parent": (A + B + joint("j", "x", "b"), ['joint "j"/parent', '"x"']),
    "no such child": (A + B + joint("j", "a", "x"), ['"x"']),
    "no such model": (A + B + joint("j", "x::a", "b"), ['joint "j"/parent', '"x::a"']),
    "child is the world": (A + joint("j", "a", "world"), ['joint "j"/child', "world"]),
    "no parent": (A + B + '<joint name="j" type="ball"><child>b</child></joint>', ['joint "j"', "<parent>"]),
    "joint to itself": (A + joint("j", "a", "a"), ['joint "j"', '"a"']),
    "unknown type": (axis("", "hinge"), ['joint "j"', '"hinge"', "revolute"]),
    "no axis": (axis(""), ['joint "j"', "<axis>"]),
    "no second axis": (axis("<xyz>0 0 1</xyz>", "universal"), ['joint "j"', "<axis2>"]),
    "zero axis": (axis("<xyz>0 0 0</xyz>"), ['joint "j"/axis/xyz', "0 0 0"]),
    "axis of two numbers": (axis("<xyz>0 1</xyz>"), ['joint "j"/axis/xyz', "3 numbers"]),
    "axis in no frame": (axis('<xyz expressed_in="q">0 0 1</xyz>'), ['joint "j"/axis/xyz', "expressed_in", '"q"']),
    "limits in wrong order": (axis("<limit><lower>1</lower><upper>0</upper></limit>"), ["axis/limit", "lower"]),
    "limit is a word": (axis("<limit><lower>low</lower></limit>"), ["axis/limit", "lower", '"low"']),
    "limit is NaN": (axis("<limit><upper>nan</upper></limit>"), ["axis/limit", "upper", "nan"]),
    "negative damping": (axis("<dynamics><damping>-1</damping></dynamics>"), ["axis/dynamics", "damping", "-1"]),
    "two dampings": (
        axis("<dynamics><damping>1</damping><damping>2</damping></dynamics>"),
        ["axis/dynamics/damping", "second"],
    ),
    "mimic of nothing": (axis('<mimic joint="x"/>'), ["axis/mimic", '"x"']),
    "mimic of a link": (axis('<mimic joint="a"/>'), ["axis/mimic", '"a"']),
    "mimic of itself": (axis('<mimic joint="j"/>'), ["axis/mimic", '"j"']),
    "mimic of no axis": (axis('<mimic joint="j" axis="axis2"/>'), ["axis/mimic", "axis2"]),
    "prismatic loop": (
        A + B + joint("j", "a", "b", "prismatic") + joint("k", "a", "b", "prismatic"),
        ['joint "k"', "prismatic", "loop"],
    ),
    "pose of five numbers": (link("a", "0 0 0 0 0"), ['link "a"/pose', "6 numbers"]),
    "pose too far": (link("a", "1e300 0 0 0 0 0"), ['link "a"/pose', "1e300"]),
    "pose of NaN": (link("a", "nan 0 0 0 0 0"), ['link "a"/pose', "finite"]),
    "pose in no frame": ('<link name="a"><pose relative_to="q"/></link>', ['link "a"', "relative_to", '"q"']),
    "pose in itself": ('<link name="a"><pose relative_to="a"/></link>', ['link "a"', "relative to itself"]),
    "poses in a ring": (
        '<link name="a"><pose relative_to="b"/></link><link name="b"><pose relative_to="a"/></link>',
        ["link", "relative to itself"],
    ),
    "quaternion 0": (
        '<link name="a"><pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose></link>',
        ['link "a"/pose', "quaternion"],
    ),
    "unknown rotation": ('<link name="a"><pose rotation_format="x"/></link>', ['link "a"/pose', "rotation_format"]),
    "frames in a ring": (
        A + '<frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>' + joint("j", "a", "f"),
        ["frame", "itself"],
    ),
    "no canonical link": (A + '<model name="n"/>' + joint("j", "a", "n"), ["n", "no link that could carry its frame"]),
    "negative mass": (link("a", inertial=INERTIAL.format(-1)), ['link "a"/inertial', "mass", "-1"]),
    "huge mass": (link("a", inertial=INERTIAL.format(1e300)), ['link "a"/inertial', "mass", "1e+300"]),
    "mass is a word": (link("a", inertial=INERTIAL.format("big")), ['link "a"/inertial', "mass", '"big"']),
    "negative inertia": (moments(ixx=-1, iyy=1, izz=1), ['link "a"/inertial', "negative"]),
    "triangle inequality": (moments(ixx=1, iyy=1, izz=9), ['link "a"/inertial', "sum of the other two"]),
    "inertia from shapes": ('<link name="a"><inertial auto="true"/></link>', ['link "a"/inertial', "auto"]),
    "no geometry": (link("a", more='<collision name="c"/>'), ['link "a"/collision "c"', "<geometry>"]),
    "empty geometry": (shape(""), ["geometry", "0 shapes"]),
    "unknown shape": (shape("<torus/>"), ["geometry/torus", "no shape"]),
    "sphere without radius": (shape("<sphere/>"), ["geometry/sphere", "radius"]),
    "flat box": (shape("<box><size>1 1 0</size></box>"), ["geometry/box", "1 1 0", "positive"]),
    "flat ellipsoid": (shape("<ellipsoid><radii>1 1 0</radii></ellipsoid>"), ["geometry/ellipsoid", "positive"]),
    "plane without normal": (shape("<plane><normal>0 0 0</normal></plane>"), ["geometry/plane", "normal"]),
    "mesh without uri": (shape("<mesh/>"), ["geometry/mesh", "uri"]),
    "missing mesh": (shape("<mesh><uri>gone.stl</uri></mesh>"), ["geometry/mesh", "gone.stl", "Looked for at"]),
    "path out of a package": (
        shape("<mesh><uri>model://p/../../etc/passwd</uri></mesh>"),
        ["geometry/mesh", "out of its package"],
    ),
    "friction is negative": (
        shape(BALL, "<surface><friction><ode><mu>-1</mu></ode></friction></surface>"),
        ["collision \"c\"/surface", "mu", "-1"],
    ),
    "bitmask too large": (
        shape(BALL, "<surface><contact><collide_bitmask>1e9</collide_bitmask></contact></surface>"),
        ["collision \"c\"/surface", "collide_bitmask", "65535"],
    ),
    "flag is a word": ("<static>perhaps</static>" + A, ["static", '"perhaps"', "true"]),
    "link in link": (link("a", more=B), ['link "a"/link "b"', "belong"]),
    "mass in link": (link("a", more="<mass>1</mass>"), ['link "a"/mass', "belong"]),
    "limit in model": (A + "<limit/>", ["limit", "belong"]),
    "include without uri": ("<include/>", ["include", "<uri>"]),
    "include of nothing": ("<include><uri>model://gone</uri></include>", ["include", "model://gone", "package_dirs"]),
    "include from the web": ("<include><uri>https://x.org/y</uri></include>", ["include", "https://"]),
    "include out of a package": ("<include><uri>model://p/../../x</uri></include>", ["include", "out of its package"]),
    "include of a long name": (f"<include><uri>{'9' * 400}</uri></include>", ["include", "not there"]),
    "package with a long name": (f"<include><uri>model://{'9' * 400}</uri></include>", ["include", "not there"]),
    "include of itself": ("<include><uri>robot.sdf</uri></include>", ["include", "included by itself"]),
    "include in a ring": ("<include><uri>ring.sdf</uri></include>", ["ring.sdf", "included by itself"]),
    "include of two models": ("<include><uri>two.sdf</uri></include>", ["include", "2 models"]),
    "include of no SDF": ("<include><uri>robot.urdf</uri></include>", ["robot.urdf", "<sdf>"]),
    "config out of its folder": ("<include><uri>evil</uri></include>", ["include", "not in its folder"]),
    "config of nothing": ("<include><uri>hollow</uri></include>", ["include", "names no <sdf>"]),
    "merged include": (A + '<include merge="true"><uri>two.sdf</uri></include>', ["include", "merge"]),
    "thread without pitch": (
        A + B + joint("j", "a", "b", "screw", more="<thread_pitch>0</thread_pitch>"),
        ['joint "j"', "thread_pitch"],
    ),
    "too many models in models": ("<model name='n'>" * 60 + A + "</model>" * 60, ["model", "deep"]),
}  # fmt: skip


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed(tmp_path, case):
    text, names = MALFORMED[case]
    (tmp_path / "ring.sdf").write_text(sdf("<include><uri>robot.sdf</uri></include>"))
    (tmp_path / "two.sdf").write_text('<sdf version="1.6"><model name="x"/><model name="y"/></sdf>')
    (tmp_path / "robot.urdf").write_text('<robot name="r"><link name="l"/></robot>')
    for folder, config in (("evil", '<model><sdf version="1.5">../two.sdf</sdf></model>'), ("hollow", "<model/>")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "model.config").write_text(config)
    begin = time.perf_counter()
    with pytest.raises(InvalidInputError) as error:
        record(tmp_path, sdf(text))
    assert time.perf_counter() - begin < 5.0
    message = str(error.value)
    assert ".sdf:1: " in message or ".urdf:1: " in message, message
    for name in names:
        assert name in message, message


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("<sdf/>", ["sdf", "version"]),
        ('<sdf version="1.3"><model name="m"/></sdf>', ['"1.3"', "1.4 to 1.12"]),
        ('<sdf version="new"><model name="m"/></sdf>', ['"new"', "1.4 to 1.12"]),
        (f'<sdf version="1.{"9" * 5000}"><model name="m"/></sdf>', ['"1.999', "1.4 to 1.12"]),
        ('<sdf version="1.9"/>', ["neither"]),
        ('<sdf version="1.9"><model name="a"/><world name="b"/></sdf>', ["world", "second"]),
        ('<sdf version="1.9"><model/></sdf>', ["model", "name"]),
        ('<sdf version="1.9"><world name="w"><link name="l"/></world></sdf>', ['link "l"', "belong"]),
        ('<sdf version="1.9"><world name="w"><gravity>down</gravity></world></sdf>', ["gravity", '"down"']),
    ],
)
def test_malformed_around_the_model(tmp_path, text, names):
    with pytest.raises(InvalidInputError) as error:
        record(tmp_path, text)
    for name in ("robot.sdf:1", *names):
        assert name in str(error.value)


def test_the_command_line_runs_it(tmp_path):
    from typer.testing import CliRunner

    from signorini.cli.main import app

    (tmp_path / "bar.sdf").write_text(four_bar())
    for options in ([], ["--fixed"], ["--ground"]):
        result = CliRunner().invoke(
            app, ["run", str(tmp_path / "bar.sdf"), "--duration", "0.05", "--json", "-", *options]
        )
        assert result.exit_code == 0, result.output
        assert '"unsolved": 0' in result.output


def test_inclusions_are_bounded(tmp_path, monkeypatch):
    """Each file includes the next ten times: a million models, were it not for the limit."""
    monkeypatch.setattr(_sdf_reader._xml, "MAX_ELEMENTS", 2000)
    for i in range(6):
        inner = "".join(f"<include><uri>{i + 1}.sdf</uri><name>n{k}</name></include>" for k in range(10))
        (tmp_path / f"{i}.sdf").write_text(sdf(inner))
    (tmp_path / "6.sdf").write_text(sdf(A))
    begin = time.perf_counter()
    with pytest.raises(InvalidInputError, match="more than 2000 elements"):
        record(tmp_path, sdf("<include><uri>0.sdf</uri></include>"))
    assert time.perf_counter() - begin < 5.0


def test_the_format_is_told_by_the_root(tmp_path):
    for name in ("a.sdf", "a.world", "a.xml"):
        (tmp_path / name).write_text(sdf(A))
        assert file_format(tmp_path / name) == "sdf"
