"""Files that are wrong: each is refused in bounded time, with the file and the element named."""

import importlib.util
import json
import subprocess
import sys
import time

import malformed_corpus
import pytest
from recording_builder import RecordingBuilder

from signorini import InvalidInputError
from signorini.load import add_file, file_format

INERTIA = '<inertia ixx="1" iyy="1" izz="1"/>'
LINK = '<link name="{}"><inertial><mass value="1"/>' + INERTIA + "</inertial></link>"
JOINT = '<joint name="{}" type="continuous"><parent link="{}"/><child link="{}"/></joint>'
A, B, C = (LINK.format(name) for name in "abc")
AB = JOINT.format("ab", "a", "b")


def link(inertial="", collision="", name="b"):
    return f'<link name="{name}">{inertial}{collision}</link>'


def inertial(mass="1", inertia=INERTIA, more=""):
    return f'<inertial><mass value="{mass}"/>{inertia}{more}</inertial>'


def shape(text, more=""):
    return link(inertial(), f"<collision>{more}<geometry>{text}</geometry></collision>")


def joint(inside, type="revolute"):
    return f'<joint name="ab" type="{type}"><parent link="a"/><child link="b"/>{inside}</joint>'


LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
INSIDE = {  # of <robot>: what the message must name
    "no link": ("", ["robot", "no <link>"]),
    "link without name": ("<link/>", ["link", "name"]),
    "link with empty name": ('<link name=" "/>', ["link", "name"]),
    "duplicate link": (A + A, ['link "a"', "already"]),
    "duplicate joint": (A + B + C + AB + JOINT.format("ab", "a", "c"), ['joint "ab"', "already"]),
    "dangling parent": (A + B + JOINT.format("ab", "x", "b"), ['joint "ab"/parent', '"x"']),
    "dangling child": (A + B + JOINT.format("ab", "a", "x"), ['joint "ab"/child', '"x"']),
    "no parent": (A + B + '<joint name="ab" type="fixed"><child link="b"/></joint>', ['joint "ab"', "<parent>"]),
    "joint to itself": (A + JOINT.format("aa", "a", "a"), ['joint "aa"', '"a"']),
    "two roots": (A + B + C + AB, ['link "c"', "root"]),
    "two parents": (A + B + C + JOINT.format("ac", "a", "c") + JOINT.format("bc", "b", "c"), ['joint "bc"', '"c"']),
    "cycle": (A + B + AB + JOINT.format("ba", "b", "a"), ["robot", "loop"]),
    "cycle beside the root": (
        A + B + C + JOINT.format("bc", "b", "c") + JOINT.format("cb", "c", "b"),
        ['link "b"', "loop"],
    ),
    "unknown joint type": (A + B + joint("", "hinge"), ['joint "ab"', '"hinge"', "revolute"]),
    "no limit": (A + B + joint(""), ['joint "ab"', "<limit>"]),
    "limits in wrong order": (A + B + joint('<limit lower="1" upper="-1"/>'), ['joint "ab"/limit', "lower"]),
    "limit is NaN": (A + B + joint('<limit lower="nan" upper="1"/>'), ['joint "ab"/limit', "lower", "nan"]),
    "limit is a word": (A + B + joint('<limit lower="low" upper="1"/>'), ['joint "ab"/limit', '"low"']),
    "negative effort": (A + B + joint('<limit lower="0" upper="1" effort="-3"/>'), ["effort", '"-3"', "at least 0"]),
    "zero axis": (A + B + joint('<axis xyz="0 0 0"/>' + LIMIT), ['joint "ab"/axis', "0 0 0"]),
    "two numbers": (A + B + joint('<axis xyz="0 1"/>' + LIMIT), ['joint "ab"/axis', "3 numbers"]),
    "four numbers": (A + B + joint('<origin xyz="0 1 2 3"/>' + LIMIT), ['joint "ab"/origin', "3 numbers"]),
    "a million numbers": (A + B + joint(f'<origin xyz="{"1 " * 10**6}"/>' + LIMIT), ['joint "ab"/origin', "..."]),
    "two origins": (A + B + joint("<origin/><origin/>" + LIMIT), ['joint "ab"/origin', "second"]),
    "negative damping": (A + B + joint(LIMIT + '<dynamics damping="-1"/>'), ['joint "ab"/dynamics', "damping"]),
    "mimic of nothing": (A + B + joint(LIMIT + '<mimic joint="x"/>'), ['joint "ab"/mimic', '"x"']),
    "mimic of itself": (A + B + joint(LIMIT + '<mimic joint="ab"/>'), ['joint "ab"/mimic', '"ab"']),
    "position too far": (A + B + joint('<origin xyz="1e300 0 0"/>' + LIMIT), ["origin", "1e300", "1e+06"]),
    "position infinite": (A + B + joint('<origin xyz="inf 0 0"/>' + LIMIT), ["origin", "inf", "finite"]),
    "negative mass": (A + link(inertial("-1")) + AB, ['link "b"/inertial/mass', '"-1"', "[0, 1e+12]"]),
    "mass is NaN": (A + link(inertial("nan")) + AB, ['link "b"/inertial/mass', "nan"]),
    "huge mass": (A + link(inertial("1e300")) + AB, ['link "b"/inertial/mass', "1e300"]),
    "no mass": (A + link(f"<inertial>{INERTIA}</inertial>") + AB, ['link "b"/inertial', "<mass>"]),
    "no inertia": (A + link(inertial(inertia="")) + AB, ['link "b"/inertial', "<inertia>"]),
    "inertia without izz": (A + link(inertial(inertia='<inertia ixx="1" iyy="1"/>')) + AB, ["inertia", "izz"]),
    "negative inertia": (
        A + link(inertial(inertia='<inertia ixx="1" iyy="-1" izz="1"/>')) + AB,
        ['link "b"/inertial', "negative"],
    ),
    "triangle inequality": (
        A + link(inertial(inertia='<inertia ixx="1" iyy="1" izz="9"/>')) + AB,
        ['link "b"/inertial', "sum of the other two", "repair_inertia"],
    ),
    "mass in link": (A + link('<mass value="1"/>') + AB, ['link "b"/mass', "belong"]),
    "link in link": (A + link(C) + AB, ['link "b"/link "c"', "belong"]),
    "limit in robot": (A + LIMIT, ["limit", "belong"]),
    "no geometry": (A + link(inertial(), "<collision/>") + AB, ['link "b"/collision', "<geometry>"]),
    "empty geometry": (A + shape("") + AB, ["geometry", "one"]),
    "two shapes": (A + shape('<sphere radius="1"/><sphere radius="1"/>') + AB, ["geometry", "2 shapes"]),
    "unknown shape": (A + shape("<torus/>") + AB, ["geometry/torus", "no shape"]),
    "sphere without radius": (A + shape("<sphere/>") + AB, ["geometry/sphere", "radius"]),
    "negative radius": (A + shape('<sphere radius="-1"/>') + AB, ["geometry/sphere", '"-1"']),
    "no radius": (A + shape('<cylinder radius="0" length="1"/>') + AB, ["geometry/cylinder", "radius", "positive"]),
    "flat box": (A + shape('<box size="1 1 0"/>') + AB, ["geometry/box", "1 1 0", "positive"]),
    "missing mesh": (A + shape('<mesh filename="nope.stl"/>') + AB, ["geometry/mesh", "nope.stl", "Looked for at"]),
    "mesh with a long name": (A + shape(f'<mesh filename="{"9" * 400}.stl"/>') + AB, ["geometry/mesh", "not there"]),
    "missing package": (
        A + shape('<mesh filename="package://nope/x.stl"/>') + AB,
        ["geometry/mesh", "package://nope", "package_dirs"],
    ),
    "path out of a package": (
        A + shape('<mesh filename="package://p/../../../../etc/passwd"/>') + AB,
        ["geometry/mesh", "out of its package"],
    ),
    "package without path": (A + shape('<mesh filename="package://p"/>') + AB, ["geometry/mesh", "NAME/PATH"]),
    "mesh from the web": (A + shape('<mesh filename="http://x.org/x.stl"/>') + AB, ["geometry/mesh", "http://"]),
    "mesh of unknown kind": (A + shape('<mesh filename="bad.urdf"/>') + AB, ["geometry/mesh", ".urdf", ".stl"]),
    "mesh is a folder": (A + shape('<mesh filename="."/>') + AB, ["geometry/mesh", "not there"]),
    "mesh scale zero": (A + shape('<mesh filename="t.obj" scale="0 1 1"/>') + AB, ["geometry/mesh", "scale"]),
    "mesh on a line": (A + shape('<mesh filename="line.obj"/>') + AB, ["geometry/mesh", "line.obj", "one line"]),
    "mesh cut off": (A + shape('<mesh filename="cut.stl"/>') + AB, ["geometry/mesh", "cut.stl", "cut off"]),
    "xacro": ('<xacro:include filename="x"/>', ["xacro", "expand"]),
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 0\n")
    (tmp_path / "cut.stl").write_bytes(b"\0" * 80 + (1000).to_bytes(4, "little") + b"\0" * 100)
    return tmp_path


def refused(path, **options):
    start = time.perf_counter()
    with pytest.raises(InvalidInputError) as caught:
        add_file(RecordingBuilder(), path, **options)
    assert time.perf_counter() - start < 30.0
    message = str(caught.value)
    assert path.name in message
    assert len(message) < 2000
    return message


@pytest.mark.parametrize(("inside", "words"), INSIDE.values(), ids=INSIDE)
def test_malformed_robot(folder, inside, words):
    path = folder / "bad.urdf"
    path.write_text(f'<?xml version="1.0"?>\n<robot name="r">\n{inside}\n</robot>')
    message = refused(path)
    assert message.startswith(f"{path}:")
    for word in words:
        assert word in message


BILLION = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10)
)
DOCUMENTS = {
    "empty": ("", ["no XML"]),
    "not XML": ("solid cube", ["no XML"]),
    "not closed": (f"<robot>{A}", ["no well-formed XML", "robot"]),
    "wrong nesting": ('<robot><link name="a"></robot></link>', ["no well-formed XML", 'link "a"', "mismatched"]),
    "attribute twice": ('<robot><link name="a" name="b"/></robot>', ["no well-formed XML", "duplicate"]),
    "document type": ('<!DOCTYPE robot SYSTEM "http://x.org/x.dtd"><robot/>', ["DOCTYPE"]),
    "billion laughs": (BILLION + "]><robot>&a9;</robot>", ["DOCTYPE"]),
    "external entity": ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot>&x;</robot>', ["DOCTYPE"]),
    "too deep": ("<robot>" + "<a>" * 10_000, ["deep"]),
    "unknown encoding": ('<?xml version="1.0" encoding="klingon"?><robot/>', ["encoding"]),
    "control character": ("<robot>\x01</robot>", ["no well-formed XML"]),
    "sdf without version": ("<sdf/>", ["sdf", "version"]),
    "other root": ("<html/>", ["<html>", "<robot>"]),
}


@pytest.mark.parametrize(("text", "words"), DOCUMENTS.values(), ids=DOCUMENTS)
def test_malformed_document(tmp_path, text, words):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    message = refused(path)
    for word in words:
        assert word in message


def test_missing_file_folder_and_device(tmp_path):
    assert "no such file" in refused(tmp_path / "nope.urdf")
    assert "XML" not in refused(tmp_path / "nope.urdf")
    (tmp_path / "folder.urdf").mkdir()
    assert "no regular file" in refused(tmp_path / "folder.urdf")
    (tmp_path / "robot.step").write_text("")
    with pytest.raises(InvalidInputError, match=r"\.step"):
        file_format(tmp_path / "robot.step")


def test_options_are_checked(folder):
    path = folder / "ok.urdf"
    path.write_text(f"<robot>{A}{B}{AB}</robot>")
    for options, word in (
        ({"position": (0, 0, float("nan"))}, "position"),
        ({"orientation": (0, 0, 0, 2)}, "orientation"),
        ({"hull_vertices": 3}, "hull_vertices"),
        ({"format": "step"}, "format"),
    ):
        with pytest.raises(InvalidInputError, match=word):
            add_file(RecordingBuilder(), path, **options)


def test_a_long_chain_is_read_in_bounded_time(tmp_path):
    n = 3000
    path = tmp_path / "chain.urdf"
    links = "".join(LINK.format(f"l{i}") for i in range(n))
    joints = "".join(JOINT.format(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(n - 1))
    path.write_text(f"<robot>{links}{joints}</robot>")
    start = time.perf_counter()
    builder = RecordingBuilder()
    add_file(builder, path)
    assert len(builder.bodies) == n
    assert time.perf_counter() - start < 60.0


MJCF = {  # what MuJoCo's compiler refuses is told with the file
    "broken": ("<mujoco><worldbody></mujoco>", ["XML"]),
    "missing include": ('<mujoco><include file="nope.xml"/></mujoco>', ["nope.xml"]),
    "missing mesh": ('<mujoco><asset><mesh name="m" file="nope.stl"/></asset></mujoco>', ["nope.stl"]),
    "negative mass": (
        '<mujoco><worldbody><body><joint/><geom size="1" mass="-1"/></body></worldbody></mujoco>',
        ["mass"],
    ),
    "no mass": ('<mujoco><worldbody><body name="b"><joint/></body></worldbody></mujoco>', ["mass"]),
    "duplicate name": (
        '<mujoco><worldbody><body name="b"/><body name="b"/></worldbody></mujoco>',
        ["repeated name 'b'"],
    ),
    "unknown element": ("<mujoco><robot/></mujoco>", ["robot"]),
}


@pytest.mark.parametrize(("text", "words"), MJCF.values(), ids=MJCF)
def test_malformed_mjcf(tmp_path, monkeypatch, text, words):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)  # MuJoCo logs into the current folder
    path = tmp_path / "bad.xml"
    path.write_text(text)
    message = refused(path)
    for word in words:
        assert word in message


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What came of each file of the corpus."""
    command = [sys.executable, malformed_corpus.__file__, str(tmp_path_factory.mktemp("corpus"))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {line["name"]: line for line in map(json.loads, done.stdout.splitlines())}


CASES = list(malformed_corpus.CASES)


@pytest.mark.parametrize("name", CASES, ids=[f"{i} of {len(CASES)}, {name}" for i, name in enumerate(CASES, 1)])
def test_malformed_corpus(outcomes, name):
    if name.startswith("MJCF") and importlib.util.find_spec("mujoco") is None:
        pytest.skip("needs mujoco")
    result = outcomes[name]
    assert result["outcome"] == "InvalidInputError", result
    for word in (result["file"], *malformed_corpus.CASES[name][1]):
        assert word in result["message"]
    assert result["length"] < 3000
    assert result["seconds"] < 5.0  # of the processor; the longest takes 2


def test_a_good_mjcf_of_many_files_is_let_through(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "part").mkdir()
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "t.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    (tmp_path / "part" / "bad.xml").write_text(
        '<mujoco><worldbody><body name="p"><geom size="1"/></body></worldbody></mujoco>'
    )
    (tmp_path / "more.xml").write_text('<mujocoinclude><compiler meshdir="meshes"/></mujocoinclude>')
    path = tmp_path / "bad.xml"
    path.write_text("""<mujoco><include file="more.xml"/> <!-- -- a line that XML has not -- -->
        <asset><model name="m" file="part/bad.xml"/><mesh name="t" file="t.obj"/></asset>
        <worldbody><attach model="m" body="p" prefix="a/"/><geom type="mesh" mesh="t"/>
        <replicate count="3" offset="1 0 0"><geom size="0.1"/></replicate></worldbody></mujoco>""")
    builder = RecordingBuilder()
    add_file(builder, path)
    assert len(builder.geometries) == 5
    assert list(builder.bodies) == ["a/p"]
