"""The URDF reader against Pinocchio's, and the rules of docs/robot_files.md."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from recording_builder import RecordingBuilder

import signorini
from signorini.load import add_file, mesh, srdf
from signorini.load import load as load_world

pin = pytest.importorskip("pinocchio")


@pytest.fixture(scope="module")
def robots() -> Path:
    try:
        return signorini.scenes.robots_folder()
    except FileNotFoundError as error:
        pytest.skip(str(error))


@pytest.fixture
def no_meshes(monkeypatch):
    """Every mesh is one tetrahedron: what meshes are made into is another test's."""
    monkeypatch.setattr(mesh, "read_points", lambda path: np.vstack([np.zeros(3), 0.1 * np.eye(3)]))


ROBOTS = [  # file, floating base, robot to be mended
    ("ur_description/urdf/ur5_robot.urdf", False),
    ("talos_data/robots/talos_reduced.urdf", True),
    ("solo_description/robots/solo12.urdf", True),
    ("allegro_hand_description/urdf/allegro_right_hand.urdf", False),
    ("panda_description/urdf/panda.urdf", False),
    ("double_pendulum_description/urdf/double_pendulum_continuous.urdf", False),
    ("g1_description/urdf/g1_29dof_rev_1_0.urdf", False),
    ("anymal_b_simple_description/robots/anymal.urdf", True),
    ("tiago_description/robots/tiago_no_hand.urdf", True),
]


def configurations(ours, theirs, random):
    """The same random configuration for both models: by joint name, angles of continuous joints as (cos, sin)."""
    q, q_theirs = pin.neutral(ours), pin.neutral(theirs)
    for name in ours.names[1:]:
        a, b = ours.joints[ours.getJointId(name)], theirs.joints[theirs.getJointId(name)]
        if a.nq == 7:
            value = np.concatenate([random.uniform(-1, 1, 3), random.standard_normal(4)])
            value[3:] /= np.linalg.norm(value[3:])
        else:
            value = random.uniform(-1, 1, 1)
        q[a.idx_q : a.idx_q + a.nq] = value
        q_theirs[b.idx_q : b.idx_q + b.nq] = value if b.nq == a.nq else [math.cos(value[0]), math.sin(value[0])]
    return q, q_theirs


@pytest.mark.parametrize(("file", "floating"), ROBOTS, ids=[file.split("/")[-1] for file, _ in ROBOTS])
def test_same_robot_as_pinocchio_reads(robots, no_meshes, file, floating):
    builder = RecordingBuilder()
    add_file(builder, robots / file, floating_base=floating or None)
    ours = builder.pinocchio()
    if floating:
        theirs = pin.buildModelFromUrdf(str(robots / file), pin.JointModelFreeFlyer())
    else:
        theirs = pin.buildModelFromUrdf(str(robots / file))

    assert list(ours.names) == list(theirs.names)  # order included
    a, b = ours.createData(), theirs.createData()
    random = np.random.default_rng(7)
    for _ in range(3):
        q, q_theirs = configurations(ours, theirs, random)
        scale = np.abs(pin.crba(theirs, b, q_theirs)).max()
        np.testing.assert_allclose(np.triu(pin.crba(ours, a, q)), np.triu(b.M), atol=1e-12 * scale)
        gravity = pin.computeGeneralizedGravity(theirs, b, q_theirs)
        np.testing.assert_allclose(
            pin.computeGeneralizedGravity(ours, a, q), gravity, atol=1e-12 * max(1.0, np.abs(gravity).max())
        )
        np.testing.assert_allclose(pin.centerOfMass(ours, a, q), pin.centerOfMass(theirs, b, q_theirs), atol=1e-12)
        pin.forwardKinematics(ours, a, q)
        pin.forwardKinematics(theirs, b, q_theirs)
        for i in range(1, ours.njoints):
            np.testing.assert_allclose(a.oMi[i].homogeneous, b.oMi[i].homogeneous, atol=1e-12)
    assert pin.computeTotalMass(ours) == pytest.approx(pin.computeTotalMass(theirs), rel=1e-13)

    for name, joint in builder.joints.items():
        if joint.type == "free":
            continue
        model = theirs.joints[theirs.getJointId(name)]
        if model.nq == 1:
            assert joint.lower == theirs.lowerPositionLimit[model.idx_q]
            assert joint.upper == theirs.upperPositionLimit[model.idx_q]
        else:
            assert (joint.lower, joint.upper) == (-math.inf, math.inf)
        assert joint.damping == theirs.damping[model.idx_v]
        assert joint.friction == theirs.upperDryFrictionLimit[model.idx_v]
    for (name, joint), rest in builder.called("add_motor"):
        effort = theirs.upperEffortLimit[theirs.joints[theirs.getJointId(joint)].idx_v]
        assert name == joint
        assert rest["force_range"] == ((-effort, effort) if effort > 0 else (-math.inf, math.inf))


@pytest.mark.parametrize("file", ["ur_description/urdf/ur5_robot.urdf", "solo_description/robots/solo12.urdf"])
def test_same_meshes_at_the_same_places_as_pinocchio(robots, file):
    path = robots / file
    builder = RecordingBuilder()
    add_file(builder, path, hull_vertices=None)
    model = pin.buildModelFromUrdf(str(path))
    theirs = pin.buildGeomFromUrdf(model, str(path), pin.COLLISION, package_dirs=[str(robots.parents[1])])
    assert len(builder.geometries) == theirs.ngeoms
    for (body, shape, rest), other in zip(
        sorted(builder.geometries, key=lambda g: g[0]),
        sorted(theirs.geometryObjects, key=lambda g: model.frames[g.parentFrame].name),
        strict=True,
    ):
        frame = model.frames[other.parentFrame]
        assert body == frame.name
        if not hasattr(shape, "vertices"):
            continue
        rotation, position = rest["orientation"], np.array(rest["position"])
        mine = shape.vertices @ rotation.T + position  # in the link
        there = frame.placement.inverse() * other.placement
        points = (other.geometry.vertices() * other.meshScale) @ there.rotation.T + there.translation
        np.testing.assert_allclose(mine.min(0), points.min(0), atol=1e-6)
        np.testing.assert_allclose(mine.max(0), points.max(0), atol=1e-6)


ARM = """<robot name="arm">
  <link name="base"/>
  <link name="tip"><inertial><origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0" iyz="0"/></inertial>
    {tip}</link>
  {more}
  <joint name="j" type="{type}"><parent link="base"/><child link="tip"/><origin xyz="0 0 0.5"/>{joint}</joint>
</robot>"""
LIMIT = '<axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="5" velocity="3"/>'


def read(tmp_path, type="revolute", joint=LIMIT, tip="", more="", name="arm.urdf", **options):
    path = tmp_path / name
    path.write_text(ARM.format(type=type, joint=joint, tip=tip, more=more))
    builder = RecordingBuilder()
    add_file(builder, path, **options)
    return builder


def test_a_joint_with_everything(tmp_path):
    builder = read(tmp_path, joint=LIMIT + '<dynamics damping="0.5" friction="0.25"/>')
    joint = builder.joints["j"]
    assert (joint.type, joint.axis, joint.lower, joint.upper) == ("revolute", [0.0, 1.0, 0.0], -1.0, 2.0)
    assert (joint.damping, joint.friction) == (0.5, 0.25)
    assert builder.called("add_motor") == [(("j", "j"), {"force_range": (-5.0, 5.0)})]
    assert any("velocity limits" in warning for warning in builder.warnings)


def test_planar_joint_is_two_slides_and_a_turn(tmp_path):
    joints = read(tmp_path, "planar", '<axis xyz="0 0 2"/>').bodies["tip"].joints
    assert [(j.name, j.type) for j in joints] == [
        ("j_x", "prismatic"),
        ("j_y", "prismatic"),
        ("j_angle", "revolute"),
    ]
    axes = np.array([j.axis for j in joints])
    np.testing.assert_allclose(axes, np.eye(3), atol=1e-15)


def test_floating_joint_and_floating_base(tmp_path):
    assert read(tmp_path, "floating", "").joints["j"].type == "free"
    builder = read(tmp_path, floating_base=True, prefix="a/")
    assert builder.bodies["a/base"].joints[0].name == "a/root_joint"
    assert builder.bodies["a/base"].joints[0].type == "free"


def test_mimic_is_a_coupling_without_a_motor(tmp_path):
    more = """<link name="other"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
      <joint name="k" type="continuous"><parent link="tip"/><child link="other"/>
      <mimic joint="j" multiplier="-2" offset="0.5"/></joint>"""
    builder = read(tmp_path, more=more, prefix="p/")
    assert builder.called("add_coupling") == [(("p/k", "p/j", (0.5, -2.0)), {"name": "p/k"})]
    assert [args for args, _ in builder.called("add_motor")] == [("p/j", "p/j")]


def test_shapes_materials_and_prefix(tmp_path):
    from signorini import Box, Capsule, Cylinder, Material, Sphere

    tip = "".join(
        f'<collision><origin xyz="{i} 0 0"/><geometry>{shape}</geometry></collision>'
        for i, shape in enumerate(
            [
                '<box size="0.2 0.4 0.6"/>',
                '<sphere radius="0.1"/>',
                '<cylinder radius="0.1" length="0.5"/>',
                '<capsule radius="0.1" length="0.5"/>',
            ]
        )
    )
    rubber = Material(friction=1.5)
    builder = read(tmp_path, tip=tip, material={"t*": rubber}, prefix="r/")
    assert [shape for _, shape, _ in builder.geometries] == [
        Box((0.1, 0.2, 0.3)),
        Sphere(0.1),
        Cylinder(0.1, 0.25),
        Capsule(0.1, 0.25),
    ]
    for i, (body, _, rest) in enumerate(builder.geometries):
        assert (body, rest["name"], rest["material"]) == ("r/tip", f"r/tip_{i}", rubber)
        assert rest["position"] == [i, 0, 0]


def test_a_root_called_world_is_the_world(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(ARM.format(type="revolute", joint=LIMIT, tip="", more="").replace('"base"', '"world"'))
    builder = RecordingBuilder()
    add_file(builder, path, position=(1, 2, 3))
    assert list(builder.bodies) == ["tip"]
    assert builder.bodies["tip"].parent == "world"
    np.testing.assert_allclose(builder.bodies["tip"].position, [1, 2, 3.5])


def test_a_bad_inertia_is_counted_in_what_it_is_fixed_to(tmp_path):
    more = """<link name="foot"><inertial><mass value="0"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4"/></inertial></link>
      <joint name="k" type="fixed"><parent link="tip"/><child link="foot"/><origin xyz="0 0 1"/></joint>"""
    builder = read(tmp_path, more=more)
    assert any("counted" in warning and "foot" in warning for warning in builder.warnings)
    assert builder.bodies["foot"].mass == 0.0
    plain = read(tmp_path)
    np.testing.assert_allclose(
        builder.bodies["tip"].inertia, plain.bodies["tip"].inertia + 1e-4 * np.eye(3), atol=1e-15
    )


def test_an_inertia_is_mended_on_request(tmp_path):
    more = """<link name="o"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="3"/></inertial></link>
      <joint name="k" type="continuous"><parent link="tip"/><child link="o"/></joint>"""
    with pytest.raises(signorini.InvalidInputError, match=r'link "o"/inertial.*repair_inertia'):
        read(tmp_path, more=more)
    builder = read(tmp_path, more=more, repair_inertia=True)
    np.testing.assert_allclose(builder.bodies["o"].inertia, np.diag([1.5, 1.5, 3.0]), atol=1e-14)
    assert any("mended" in warning for warning in builder.warnings)


def test_materials_are_of_bodies_that_there_are(tmp_path):
    tip = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    rubber = signorini.Material(friction=2.0)
    builder = read(tmp_path, tip=tip, material={"tip": rubber, "base": rubber, "*": rubber}, prefix="r/")
    assert builder.geometries[0][2]["material"] == rubber
    for unknown, close in (("tpi", "; did you mean 'tip'"), ("r/tip", "; did you mean 'tip'"), ("leg*", "; did you")):
        message = re.escape(f"material: is {unknown!r}, no body of arm.urdf is called so{close}")
        with pytest.raises(signorini.InvalidInputError, match=message):
            read(tmp_path, tip=tip, material={"tip": rubber, unknown: rubber}, prefix="r/")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"prefix": 3}, "prefix: is 3, must be a string"),
        ({"floating_base": "yes"}, "floating_base: is 'yes', must be True or False"),
        ({"floating_base": 1}, "floating_base: is 1, must be True or False"),
        ({"motors": "no"}, "motors: is 'no'"),
        ({"self_collision": 0}, "self_collision: is 0"),
        ({"repair_inertia": None}, "repair_inertia: is None"),
        ({"compliance": ["all"]}, r"compliance: is \['all'\]"),
        ({"hull_vertices": "many"}, "hull_vertices: is 'many', must be an integer"),
        ({"hull_vertices": 8.5}, r"hull_vertices: is 8\.5"),
        ({"hull_vertices": 3}, r"hull_vertices: is 3, must be in \[4, "),
        ({"package_dirs": 3}, "package_dirs: is 3, must be folders"),
        ({"package_dirs": [3]}, r"package_dirs: is \[3\], must be folders"),
        ({"decompose": 3}, "decompose: is 3, must be"),
        ({"decompose": [3]}, r"decompose: is \[3\], must be"),
        ({"material": 0}, "material: is 0, must be"),
        ({"material": "ice"}, "material: is 'ice', must be"),
        ({"material": {"tip": 0.5}}, r"material\['tip'\]: is 0.5, must be"),
        ({"material": {3: signorini.Material()}}, "material: is 3, must be a string"),
        ({"position": "here"}, "position: is 'here'"),
        ({"position": [0, 0]}, "position: has 2 entries, must have 3"),
        ({"position": [0, 0, float("nan")]}, "position: is .*nan"),
        ({"orientation": "up"}, "orientation: is 'up'"),
        ({"orientation": [0, 0, 0, 0]}, "orientation"),
        ({"srdf": 3}, "srdf: is 3, must be"),
        ({"format": "step"}, "format: is 'step'"),
        ({"ground": "x"}, "ground: is 'x', must be True, False, a height"),
        ({"ground": None}, "ground: is None, must be True, False, a height"),
        ({"ground": float("nan")}, "ground: is nan, must be"),
        ({"ground": 1e10}, "ground: is 10000000000.0, must be"),
        ({"ground": True, "ground_material": 0.5}, "ground_material: is 0.5, must be"),
        ({"exclude_overlapping": "no"}, "exclude_overlapping: is 'no', must be"),
        ({"exclude_overlapping": lambda world: "x"}, "exclude_overlapping: is 'x'"),
        ({"exclude_overlapping": lambda world: [0.0] * 9}, "exclude_overlapping: has 9 entries, must have 1"),
        ({"gravity": "down"}, "gravity: is 'down'"),
        ({"builder": 3}, "builder: is a int, must be a signorini.WorldBuilder"),
    ],
)
def test_options_of_another_type_are_refused(tmp_path, options, message):
    path = tmp_path / "robot.urdf"
    tip = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    path.write_text(ARM.format(type="revolute", joint=LIMIT, tip=tip, more=""))
    with pytest.raises(signorini.InvalidInputError, match=message):
        load_world(path, **options)


def test_a_path_is_a_path():
    for path in (3, None, b"robot.urdf"):
        with pytest.raises(signorini.InvalidInputError, match="path: is "):
            load_world(path)


def test_gazebo_and_transmission_are_listed(tmp_path):
    more = '<gazebo reference="tip"><mu1>1</mu1></gazebo><transmission name="t"/><ros2_control/>'
    text = "\n".join(read(tmp_path, more=more).warnings)
    assert "gazebo" in text
    assert "tip (mu1)" in text
    assert "transmission" in text
    assert "<ros2_control>" in text


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
MESH = '<collision><geometry><mesh filename="{}" scale="0.1 0.1 -0.1"/></geometry></collision>'


@pytest.mark.parametrize(
    "name",
    [
        "package://robot/meshes/a.obj",
        "package:///robot/meshes/a.obj",
        "package://declared/meshes/a.obj",
        "meshes/../meshes/a.obj",
        "file://{}/robot/meshes/a.obj",
        "{}/robot/meshes/a.obj",
    ],
)
def test_meshes_are_found(tmp_path, name):
    folder = tmp_path / "robot"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "a.obj").write_text(TETRAHEDRON)
    (folder / "package.xml").write_text("<package><name>declared</name></package>")
    (folder / "urdf").mkdir()
    target = folder if "://" not in name and "{" not in name else folder / "urdf"
    builder = read(target, tip=MESH.format(name.format(tmp_path)))
    ((_, hull, _rest),) = builder.geometries
    np.testing.assert_allclose(sorted(hull.vertices.tolist()), [[0, 0, -0.1], [0, 0, 0], [0, 0.1, 0], [0.1, 0, 0]])


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", None])
def test_packages_are_found_by_environment_and_argument(tmp_path, monkeypatch, variable):
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    share = tmp_path / "install" / ("share" if variable and "PREFIX" in variable else "")
    (share / "robot").mkdir(parents=True)
    (share / "robot" / "a.obj").write_text(TETRAHEDRON)
    if variable:
        monkeypatch.setenv(variable, f"/nowhere:{tmp_path / 'install'}")
    (tmp_path / "urdf").mkdir()
    tip = MESH.format("package://robot/a.obj")
    assert read(tmp_path / "urdf", tip=tip, package_dirs=[] if variable else [share]).geometries


def test_self_collision_can_be_off(tmp_path):
    tip = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    builder = read(tmp_path, tip=tip, self_collision=False)
    assert builder.called("exclude") == []  # one body has shapes
    more = f'<link name="other">{tip}</link><joint name="k" type="fixed"><parent link="base"/><child link="other"/>'
    more += "</joint>"
    ((pair, _),) = read(tmp_path, tip=tip, more=more, self_collision=False).called("exclude")
    assert set(pair) == {"other", "tip"}


def test_srdf_states_and_disabled_pairs(tmp_path):
    path = tmp_path / "r.srdf"
    path.write_text(
        """<robot name="r"><group_state name="home" group="all"><joint name="j" value="0.5"/>
        <joint name="root_joint" value="0 0 1 0 0 0 1"/></group_state>
        <disable_collisions link1="base" link2="tip" reason="Never"/>
        <disable_collisions link1="base" link2="gone" reason="Never"/></robot>"""
    )
    read_back = srdf.read(path)
    assert read_back.states["home"]["j"] == [0.5]
    assert len(read_back.states["home"]["root_joint"]) == 7
    builder = read(tmp_path, prefix="p/", srdf=path)
    assert [pair for pair, _ in builder.called("exclude")] == [("p/base", "p/tip")]
    path.write_text('<robot><group_state name="home"><joint name="j" value="up"/></group_state></robot>')
    with pytest.raises(signorini.InvalidInputError, match=r'group_state "home"/joint "j".*"up"'):
        srdf.read(path)


def test_the_real_builder_takes_it(robots, no_meshes):
    world = load_world(
        robots / "talos_data/robots/talos_reduced.urdf", floating_base=True, ground=True, exclude_overlapping=False
    )
    model = pin.Model()
    model.loadFromString(world.pinocchio_model())
    theirs = pin.buildModelFromUrdf(str(robots / "talos_data/robots/talos_reduced.urdf"), pin.JointModelFreeFlyer())
    assert list(model.names) == list(theirs.names)
    q = pin.randomConfiguration(theirs, -np.ones(theirs.nq), np.ones(theirs.nq))
    a, b = model.createData(), theirs.createData()
    np.testing.assert_allclose(np.triu(pin.crba(model, a, q)), np.triu(pin.crba(theirs, b, q)), atol=1e-10)
    assert world.num_controls == theirs.nv - 6
