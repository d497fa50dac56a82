"""signorini check: what it finds in a robot file, and its exit status."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import signorini
from signorini.cli.main import app

A, B, C = 0.2, 0.3, 0.1  # edges of a box [m]
INERTIA = '<inertia ixx="{:.12g}" iyy="{:.12g}" izz="{:.12g}"/>'.format(
    *(2.0 / 12.0 * np.array([B * B + C * C, A * A + C * C, A * A + B * B]))
)
BOX = f'<box size="{A} {B} {C}"/>'


def link(name="base", shape=BOX, mass="2", inertia=INERTIA, place=""):
    inertial = f'<inertial><mass value="{mass}"/>{inertia}</inertial>'
    return f'<link name="{name}">{inertial}<collision>{place}<geometry>{shape}</geometry></collision></link>'


def joint(child, xyz, kind="fixed"):
    limit = '<limit lower="-1" upper="2" effort="3" velocity="0"/>'
    origin = f'<origin xyz="{xyz}"/><axis xyz="0 0 1"/>'
    return f'<joint name="to_{child}" type="{kind}"><parent link="base"/><child link="{child}"/>{origin}{limit}</joint>'


def urdf(folder, *parts):
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return path


def mjcf(folder, world, more=""):
    pytest.importorskip("mujoco")
    path = folder / "robot.xml"
    path.write_text(f"<mujoco>{more}<worldbody>{world}</worldbody></mujoco>")
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["check", *map(str, arguments)])


def checked(*arguments, status=0):
    result = run(*arguments, "--json", "-")
    assert result.exit_code == status, result.output
    return json.loads(result.stdout)


def test_a_good_robot(tmp_path):
    result = checked(urdf(tmp_path, link()), "--floating", "--ground")
    assert result["problems"] == result["warnings"] == result["overlaps"] == []
    assert result["version"] == signorini.__version__
    assert result["total_mass_kg"] == 2.0
    (body,) = result["bodies"]
    moments = 2.0 / 12.0 * np.sort([B * B + C * C, A * A + C * C, A * A + B * B])
    np.testing.assert_allclose(body["moments_kg_m2"], moments, rtol=1e-9)
    assert body["triangle_share"] == pytest.approx(moments[2] / (moments[0] + moments[1]))
    assert result["ground_m"] == pytest.approx(-0.5 * C)
    first = result["first_step"]
    # Four corners; three rows each, of a body that has six velocities.
    assert (first["contacts"], first["rows"], first["rank"], first["status"]) == (4, 12, 6, "solved")
    assert first["relative"] <= 1e-6
    # G = J M^-1 J^T has the eigenvalues of M^-1/2 J^T J M^-1/2; by symmetry that is in closed form for this box.
    corners = np.array([[x, y, -0.5 * C] for x in (-0.5 * A, 0.5 * A) for y in (-0.5 * B, 0.5 * B)])
    rows = [np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]]) for x, y, z in corners]
    own = 2.0 / 12.0 * np.array([B * B + C * C, A * A + C * C, A * A + B * B])
    whitened = np.concatenate(rows) / np.sqrt([2.0, 2.0, 2.0, *own])
    assert first["condition"] == pytest.approx(np.linalg.cond(whitened) ** 2, rel=1e-6)
    assert result["mass_matrix_condition"] == pytest.approx(1.0)


def test_the_table_names_everything(tmp_path):
    path = urdf(tmp_path, link(), link("hand[x]"), joint("hand[x]", "0 0 1", "revolute"))
    result = run(path)
    assert result.exit_code == 0, result.output
    for word in ("base", "hand[x]", "to_hand[x]", "revolute", "-1 to 2", "-3 to 3", "motor", "2 box", "no problems"):
        assert word in result.stdout


SHAPES = {
    "box": BOX,
    "sphere": '<sphere radius="0.1"/>',
    "cylinder": '<cylinder radius="0.1" length="0.5"/>',
    "capsule": '<capsule radius="0.1" length="0.5"/>',
    "mesh": '<mesh filename="tetrahedron.obj"/>',
}


@pytest.mark.parametrize("name", [*SHAPES, "ellipsoid"])
def test_the_floor_just_touches(tmp_path, name):
    (tmp_path / "tetrahedron.obj").write_text("v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.4\n")
    if name == "ellipsoid":
        geom = '<geom type="ellipsoid" size="0.1 0.2 0.3" pos="0.1 0 0" euler="40 -60 20"/>'
        path, options = mjcf(tmp_path, f'<body pos="0 0 1" euler="10 0 0"><freejoint/>{geom}</body>'), []
    else:
        place = '<origin xyz="0.1 -0.2 0.3" rpy="0.7 -1.1 0.3"/>'
        base = link(shape='<sphere radius="0.01"/>', place='<origin xyz="0 0 3"/>')
        path = urdf(tmp_path, base, link("tip", SHAPES[name], place=place), joint("tip", '1 2 -3" rpy="0.5 -0.4 2'))
        options = ["--floating"]
    height = checked(path, "--ground", *options)["ground_m"]
    world = signorini.load(path, floating_base=True if options else None, ground=height)
    ((_, _, distance),) = world.touching_pairs(margin=1e-3)
    assert abs(distance) < 1e-8


def test_hulls_against_their_meshes(tmp_path):
    corners = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]  # an L of three cubes
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in corners]
    lines += ["f 4 3 2 1", "f 6 5 4 1", "f 7 8 9 10", "f 7 10 11 12"]
    lines += [f"f {i + 1} {(i + 1) % 6 + 1} {(i + 1) % 6 + 7} {i + 7}" for i in range(6)]
    (tmp_path / "l.obj").write_text("\n".join(lines))
    (tmp_path / "open.obj").write_text("\n".join(lines[:-1]))
    shapes = [f'<mesh filename="{name}.obj" scale="0.1 -0.1 0.1"/>' for name in ("l", "open")]
    path = urdf(tmp_path, link(shape=shapes[0]), link("b", shapes[1]), joint("b", "1 0 0"))
    closed, opened = checked(path)["hulls"]
    assert (closed["geometry"], closed["mesh_points"], closed["vertices"]) == ("base", 12, 10)
    assert closed["mesh_volume_m3"] == pytest.approx(3e-3)
    assert closed["volume_m3"] == opened["volume_m3"] == pytest.approx(3.5e-3)
    assert closed["added_share"] == pytest.approx(1.0 / 6.0)
    assert opened["mesh_volume_m3"] is opened["added_share"] is None
    assert "not closed" in run(path).stdout


def test_an_impossible_inertia_is_a_problem_where_it_matters(tmp_path):
    bad = link("arm", inertia='<inertia ixx="1" iyy="1" izz="9"/>')
    path = urdf(tmp_path, link(), bad, joint("arm", "0 0 1", "revolute"))
    (problem,) = checked(path, status=1)["problems"]
    assert '"arm"' in problem
    assert "repair_inertia" in problem
    assert '"arm"' in run(path).stdout
    checked(urdf(tmp_path, link(), bad, joint("arm", "0 0 1")))  # fixed to the world


@pytest.mark.parametrize("moments", ["1 1 9", "1 -1 1"])
def test_an_inertia_that_is_mended_where_it_does_not_matter_is_a_warning(tmp_path, moments):
    x, y, z = moments.split()
    bad = link("arm", inertia=f'<inertia ixx="{x}" iyy="{y}" izz="{z}"/>')
    path = urdf(tmp_path, link(), bad, joint("arm", "0 0 1"))
    result = checked(path)
    assert result["problems"] == []
    (warning,) = result["warnings"]
    assert warning.endswith("fixed to the world: arm")
    assert "mended" in warning
    checked(path, "--strict", status=1)
    assert "warning: robot.urdf: inertias that no body can have are mended" in run(path, "--strict").stdout


def test_an_overlap_at_the_start_is_a_problem(tmp_path):
    bodies = "".join(
        f'<body name="{name}" pos="0 0 {z}"><freejoint/><geom name="{name} geom" size="0.1"/></body>'
        for name, z in (("a", 1.0), ("b", 1.198), ("c", 1.3975))
    )
    result = checked(mjcf(tmp_path, bodies), status=1)
    (overlap,) = result["overlaps"]  # 2 mm; the other one is half a millimetre
    assert (overlap["a"], overlap["b"]) == ("a geom", "b geom")
    assert overlap["overlap_m"] == pytest.approx(2e-3)
    (problem,) = result["problems"]
    assert '"a geom" and "b geom" overlap by 2 mm' in problem


def test_a_first_step_without_solution_is_a_problem(tmp_path):
    planes = '<geom type="plane" size="1 1 1"/><geom type="plane" size="1 1 1" pos="0 0 0.199" euler="180 0 0"/>'
    box = '<body name="b" pos="0 0 0.0995"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>'
    result = checked(mjcf(tmp_path, planes + box), status=1)  # rigid, and too big for the gap
    assert result["first_step"]["status"] != "solved"
    assert any("first step" in problem for problem in result["problems"])


def test_masses_out_of_proportion_are_a_problem(tmp_path):
    tiny = '<inertia ixx="1e-7" iyy="1e-7" izz="1e-7"/>'
    parts = [link(shape='<sphere radius="0.01"/>', mass="1e-4", inertia=tiny), link("heavy", mass="1e8")]
    result = checked(urdf(tmp_path, *parts, joint("heavy", "0 0 1", "revolute")), "--floating", status=1)
    assert "mass matrix" in result["problems"][0]
    assert 'mostly on "root_joint"' in result["problems"][0]
    assert result["mass_matrix_condition"] is None or result["mass_matrix_condition"] > 1e10


def test_strict_counts_warnings(tmp_path):
    path = urdf(tmp_path, link(), '<transmission name="t"/>')
    assert len(checked(path)["warnings"]) == 1
    checked(path, "--strict", status=1)
    assert "warning: robot.urdf: <transmission>" in run(path, "--strict").stdout
    checked(urdf(tmp_path, link()), "--strict")


def test_packages_are_looked_for(tmp_path):
    folder = tmp_path / "elsewhere" / "things"
    folder.mkdir(parents=True)
    (folder / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    path = urdf(tmp_path, link(shape='<mesh filename="package://things/t.obj"/>'))
    result = run(path)
    assert result.exit_code == 2
    assert "package://things/t.obj" in result.stderr
    checked(path, "--package-dir", tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("robot.urdf", None, "no such file"),
        ("robot.urdf", "solid", "no XML"),
        ("robot.step", "x", ".step"),
        ("robot.urdf", f'<robot name="r">{link(shape="<torus/>")}</robot>', "torus"),
        ("robot.urdf", f'<robot name="r">{link()}{link("b", mass="-1")}{joint("b", "0 0 1")}</robot>', '"-1"'),
    ],
)
def test_what_cannot_be_loaded(tmp_path, name, text, word):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    result = run(path)
    assert result.exit_code == 2
    assert word in result.stderr
    assert name in result.stderr
    assert result.stdout == ""


def test_bad_use(tmp_path):
    assert run(tmp_path).exit_code == 2
    assert run(urdf(tmp_path, link()), "--json", tmp_path / "no" / "folder.json").exit_code == 2
    assert "nothing that collides" in run(urdf(tmp_path, '<link name="a"/>'), "--ground").stderr


def test_a_floor_that_nothing_touches_is_warned_of_as_by_run(tmp_path):
    file = urdf(tmp_path, f'<link name="a"><inertial><mass value="1"/>{INERTIA}</inertial></link>')
    for command in (["check", file], ["run", file, "--floating", "--duration", "0.01"]):
        for options, warned in (([], False), (["--ground"], True)):
            result = CliRunner().invoke(app, [str(part) for part in [*command, *options]])
            assert result.exit_code == 0, result.output
            assert ("the ground touches nothing; it is at z = 0" in result.stderr) == warned
    assert checked(file, "--ground")["ground_m"] == 0.0
    assert run(file, "--ground", "--strict").exit_code == 1


def test_json_has_these_fields(tmp_path):
    target = tmp_path / "result.json"
    assert run(urdf(tmp_path, link(), link("b"), joint("b", "0 0 1", "revolute")), "--json", target).exit_code == 0
    result = json.loads(target.read_text())
    fields = "version file bodies total_mass_kg joints num_q num_v actuators constraints geometries hulls ground_m"
    fields += " mass_matrix_condition overlaps first_step warnings problems"
    assert set(result) == set(fields.split())
    assert result["joints"] == [{"name": "to_b", "type": "revolute", "lower": -1.0, "upper": 2.0}]
    (motor,) = result["actuators"]
    assert motor == {
        "name": "to_b",
        "type": "motor",
        "acts_on": "joint to_b",
        "control_range": [None, None],
        "force_range": [-3.0, 3.0],
    }
    assert set(result["bodies"][0]) == {"name", "mass_kg", "moments_kg_m2", "triangle_share"}
    assert set(result["first_step"]) == {"contacts", "rows", "rank", "condition", "status", "relative"}
    assert result["geometries"] == {"box": 2}
