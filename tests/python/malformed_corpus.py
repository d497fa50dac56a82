"""Files that are wrong in more ways than one can think of, and what loads them: each in a process of its own, with
limits on time and memory.

    python malformed_corpus.py FOLDER    writes one line of JSON a case: name, what came of it, seconds
"""

from __future__ import annotations

import contextlib
import gzip
import itertools
import json
import os
import random
import resource
import signal
import struct
import sys
import time
from pathlib import Path

SECONDS = 30  # after which a case is killed
MEMORY = 3 * 2**30  # [bytes] of address space more than at the start

INERTIA = '<inertia ixx="1" iyy="1" izz="1"/>'
INERTIAL = f'<inertial><mass value="1"/>{INERTIA}</inertial>'
LINK = f'<link name="a">{INERTIAL}</link>'
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY a{i} "{f"&a{i - 1 if i > 1 else str()};" * 10}">' for i in range(1, 10)
)
NOISE = random.Random(0).randbytes(20_000)
PNG = (
    bytes.fromhex("89504e470d0a1a0a0000000d49484452") + struct.pack(">II", 4, 4) + b"\x08\x02\x00\x00\x00" + NOISE[:64]
)
CASES = {}


def case(name, words, **options):
    """Registers what writes the files of a case into a folder and returns the one to load. words: of the message,
    beside the name of that file."""

    def register(make):
        assert name not in CASES, name
        CASES[name] = (make, [words] if isinstance(words, str) else list(words), options)
        return make

    return register


def plain(name, data, words, file="bad.urdf", **options):
    """A case of one file."""

    @case(name, words, **options)
    def _(folder):
        (folder / file).write_bytes(data.encode() if isinstance(data, str) else data)
        return folder / file


# Documents


for word, data, words in (
    ("of zero bytes", b"", "no element"),
    ("of spaces", b" \n\t " * 1000, "no XML"),
    ("of noise", NOISE, "no XML"),
    ("of zeros", bytes(100_000), "no XML"),
    ("compressed", gzip.compress(LINK.encode()), "no XML"),
    ("with a zero byte", f"<robot>\0{LINK}</robot>", "well-formed"),
    ("UTF-16 cut in a character", f"<robot>{LINK}</robot>".encode("utf-16")[:-9], "well-formed"),
    ("UTF-16 by its own account only", f'<?xml version="1.0" encoding="utf-16"?><robot>{LINK}</robot>', "XML"),
    ("Latin-1 called UTF-8", f"<robot>{LINK}<!-- \xe9 --></robot>".encode("latin-1"), "well-formed"),
    ("in overlong UTF-8", b"<robot>\xc0\xbc</robot>", "well-formed"),
    ("with two roots", f"<robot>{LINK}</robot><robot/>", "junk"),
    ("with an open comment", f"<robot>{LINK}<!-- </robot>", "well-formed"),
    ("with open CDATA", f"<robot>{LINK}<![CDATA[ </robot>", "well-formed"),
    ("without quotes", "<robot><link name=a/></robot>", "well-formed"),
    ("with an unknown entity", '<robot><link name="&b;"/></robot>', "entity"),
    ("with a forbidden character", '<robot><link name="&#27;[31m"/></robot>', "well-formed"),
    ("of XML 9", f'<?xml version="9"?><robot>{LINK}', "XML"),
    ("with laughs in attributes", f'{BOMB}]><robot><link name="&a9;"/></robot>', "DOCTYPE"),
    ("with a quadratic entity", f'<!DOCTYPE x [<!ENTITY a "{"a" * 10**5}">]><robot>{"&a;" * 10**5}</robot>', "DOCTYPE"),
    ("with a parameter entity", '<!DOCTYPE r [<!ENTITY % x SYSTEM "file:///etc/passwd"> %x;]><robot/>', "DOCTYPE"),
    ("of 1 100 000 elements", f"<robot>{'<a/>' * 1_100_000}</robot>", "elements"),
    ("of 100 000 levels", "<robot>" + "<link>" * 100_000, "deep"),
    ("with 20 MB of digits", f'<robot><link name="a"><inertial><mass value="{"1" * 20_000_000}"/>', "well-formed"),
    ("with a name of 5 MB", '<robot><link name="' + "n" * 5_000_000 + '"><torus/><link/></link></robot>', "..."),
):
    plain(f"URDF {word}", data, words)


@case("URDF of 300 MB", "bytes")
def _(folder):
    with (folder / "bad.urdf").open("wb") as file:
        file.truncate(300 * 2**20)
    return folder / "bad.urdf"


@case("URDF that is a folder", "no regular file")
def _(folder):
    (folder / "bad.urdf").mkdir()
    return folder / "bad.urdf"


@case("URDF that links to itself", ["bad.urdf"])
def _(folder):
    (folder / "bad.urdf").symlink_to("bad.urdf")
    return folder / "bad.urdf"


@case("URDF that is a FIFO", "no regular file")
def _(folder):
    os.mkfifo(folder / "bad.urdf")
    return folder / "bad.urdf"


@case("URDF that is a device", "no regular file")
def _(folder):
    (folder / "bad.urdf").symlink_to("/dev/zero")
    return folder / "bad.urdf"


# Numbers of a URDF


def robot(inside):
    return f'<robot name="r">\n{inside}\n</robot>'


def joint(more, kind="revolute"):
    ends = '<parent link="a"/><child link="b"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    return f'{LINK}<link name="b">{INERTIAL}</link><joint name="ab" type="{kind}">{ends}{more}</joint>'


for word, inside, words in (
    (
        "mass of 5 000 digits",
        f'<link name="a"><inertial><mass value="{"9" * 5000}"/>{INERTIA}</inertial></link>',
        "finite",
    ),
    ("mass in hexadecimal", f'<link name="a"><inertial><mass value="0x10"/>{INERTIA}</inertial></link>', "number"),
    ("mass with a comma", f'<link name="a"><inertial><mass value="1,5"/>{INERTIA}</inertial></link>', "1,5"),
    ("mass too small to count", f'<link name="b"/>{joint("").replace("1", "1e-320", 1)}', ["link"]),
    (
        "inertia that overflows",
        '<link name="a"><inertial><mass value="1"/><inertia ixx="1e200" iyy="1" izz="1"/></inertial></link>',
        "ixx",
    ),
    (
        "inertia of NaN",
        '<link name="a"><inertial><mass value="1"/><inertia ixx="NaN" iyy="1" izz="1"/></inertial></link>',
        "ixx",
    ),
    ("angles without end", joint('<origin rpy="1e300 0 0"/>'), "rpy"),
    ("axis of infinity", joint('<axis xyz="inf 0 0"/>'), "axis"),
    ("axis too small", joint('<axis xyz="1e-30 0 0"/>'), "axis"),
    ("multiplier of NaN", joint('<mimic joint="ab" multiplier="nan"/>'), "multiplier"),
    ("friction of infinity", joint('<dynamics friction="inf"/>'), "friction"),
    ("limits in wrong order", joint("").replace('lower="-1"', 'lower="1e999"'), "lower"),
    ("joint twice", joint("") + joint("").partition("</link>")[2].partition("</link>")[2], "already"),
    ("link twice", joint("") + LINK, "already"),
    (
        "free joint on what moves",
        joint("")
        + f'<link name="c">{INERTIAL}</link><joint name="bc" type="floating">'
        + '<parent link="b"/><child link="c"/></joint>',
        "floating",
    ),
):
    plain(f"URDF, {word}", robot(inside), words)

# Meshes of a URDF


def mesh_case(name, words, data=None, file="m.stl", attributes="", make=None):
    @case(f"mesh {name}", words)
    def _(folder):
        if make is not None:
            make(folder)
        elif data is not None:
            (folder / file).write_bytes(data.encode() if isinstance(data, str) else data)
        mesh = f'<mesh filename="{file}" {attributes}/>'
        collision = f"<collision><geometry>{mesh}</geometry></collision>"
        (folder / "bad.urdf").write_text(robot(f'<link name="a">{INERTIAL}{collision}</link>'))
        return folder / "bad.urdf"


def stl(points, count=None):
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *itertools.chain(*t), 0) for t in zip(*[iter(points)] * 3, strict=False)
    )
    return bytes(80) + struct.pack("<I", len(points) // 3 if count is None else count) + body


TETRAHEDRON = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0)]
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in TETRAHEDRON)
NAN, INF = float("nan"), float("inf")
PLY = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{}end_header\n{}"
FACES = "element face {}\nproperty list {} {} vertex_indices\n"


def dae(geometry="", prolog="", scene=""):
    numbers = " ".join(str(x) for p in TETRAHEDRON for x in p)
    source = f'<source id="s"><float_array id="f" count="18">{numbers}</float_array></source>'
    vertices = '<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>'
    shape = f'<geometry id="g"><mesh>{source}{vertices}{geometry}</mesh></geometry>'
    library = f"<library_geometries>{shape}</library_geometries>"
    return f'<?xml version="1.0"?>{prolog}<COLLADA>{library}{scene}</COLLADA>'


DOUBLING = "".join(
    f'<node id="n{i}"><instance_node url="#n{i + 1}"/><instance_node url="#n{i + 1}"/></node>' for i in range(60)
)
TREE = f'<library_nodes>{DOUBLING}<node id="n60"><instance_geometry url="#g"/></node></library_nodes>'
SCENE = '<visual_scene id="x"><node><instance_node url="#n0"/></node></visual_scene>'
TREE += f"<library_visual_scenes>{SCENE}</library_visual_scenes>"
for name, words, data, file in (
    ("of zero bytes", "m.stl", b"", "m.stl"),
    ("of noise", "m.stl", NOISE, "m.stl"),
    ("that is a text", "m.stl", "This is no mesh.\n" * 1000, "m.stl"),
    ("that says solid and no more", "m.stl", "solid", "m.stl"),
    ("that is a page of the web", "m.stl", "<!DOCTYPE html><html>Not found</html>", "m.stl"),
    (
        "that points to large file storage",
        "m.stl",
        "version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
        "m.stl",
    ),
    ("of 4e9 triangles", "cut off", stl(TETRAHEDRON, 4_000_000_000), "m.stl"),
    ("of no triangles", "no vertices", stl([]), "m.stl"),
    ("cut in a triangle", "cut off", stl(TETRAHEDRON)[:-7], "m.stl"),
    ("with NaN", "finite", stl([*TETRAHEDRON[:5], (NAN, 0, 0)]), "m.stl"),
    ("with infinity", "finite", stl([*TETRAHEDRON[:5], (INF, 0, 0)]), "m.stl"),
    ("out in space", "1e9", stl([*TETRAHEDRON[:5], (1e30, 0, 0)]), "m.stl"),
    ("of one point", "one point", stl([(1, 2, 3)] * 6), "m.stl"),
    ("on a line", "one line", stl([(i, i, i) for i in range(6)]), "m.stl"),
    (
        "of words",
        "number",
        "solid x\nfacet normal 0 0 0\nouter loop\nvertex a b c\nendloop\nendfacet\nendsolid",
        "m.stl",
    ),
    ("that is a picture", "no vertices", PNG, "m.obj"),
    ("of one vertex", "one point", "v 1 2 3\n", "m.obj"),
    ("of two vertices", "one line", "v 1 2 3\nv 2 3 4\n", "m.obj"),
    ("with an index out of range", "not there", OBJ + "f 1 2 7\n", "m.obj"),
    ("with an index of zero", "not there", OBJ + "f 0 1 2\n", "m.obj"),
    ("with an index far below", "not there", OBJ + "f -9999999999 1 2\n", "m.obj"),
    ("with an index of 10 000 digits", "index", OBJ + f"f 1 2 {'9' * 10_000}\n", "m.obj"),
    ("with half a vertex", "line 7", OBJ + "v 1\n", "m.obj"),
    ("with a vertex of 1e400", "finite", OBJ + "v 1e400 0 0\n", "m.obj"),
    ("with a line of 10 MB", "index", OBJ + "f " + "x" * 10_000_000, "m.obj"),
    ("with 1e18 vertices", "cut off", PLY.format("ascii", 10**18, "", "0 0 0"), "m.ply"),
    ("with 1e18 faces", "cut off", PLY.format("ascii", 4, FACES.format(10**18, "uchar", "int"), "0 0 0 " * 4), "m.ply"),
    (
        "with a face of 4e9 corners",
        "cut off",
        PLY.format("binary_little_endian", 4, FACES.format(1, "uint", "int"), "").encode() + bytes(48) + b"\xff" * 8,
        "m.ply",
    ),
    (
        "with a face of -1 corners",
        "cut off",
        PLY.format("binary_little_endian", 4, FACES.format(1, "char", "int"), "").encode() + bytes(48) + b"\xff" * 8,
        "m.ply",
    ),
    ("with minus a face", "m.ply", PLY.format("ascii", -4, "", "0 0 0"), "m.ply"),
    ("with a header without end", "header", "ply\nformat ascii 1.0\n" + "comment x\n" * 100_000, "m.ply"),
    ("with laughs", "DOCTYPE", dae(prolog=BOMB + "]>"), "m.dae"),
    ("with an entity of the system", "DOCTYPE", dae(prolog='<!DOCTYPE x [<!ENTITY e SYSTEM "/etc/passwd">]>'), "m.dae"),
    ("of 2^60 copies", "too many", dae(scene=TREE), "m.dae"),
    ("with a hole in its node", "no such", dae(scene=TREE.replace('"#g"', '"#h"')), "m.dae"),
    (
        "with a corner that is not there",
        "corner",
        dae('<triangles><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 99</p></triangles>'),
        "m.dae",
    ),
    (
        "with polygons of 4e18",
        "m.dae",
        dae(
            '<polylist><input semantic="VERTEX" source="#v" offset="0"/><vcount>4000000000000000000 4000000000000000000'
            "</vcount><p>0 1 2</p></polylist>"
        ),
        "m.dae",
    ),
    ("with too many levels", "deep", "<COLLADA>" + "<node>" * 10_000, "m.dae"),
    ("of a kind that is not read", ".step", OBJ, "m.step"),
    ("without a suffix", "suffix", OBJ, "mesh"),
):
    mesh_case(name, words, data, file)
mesh_case("with a scale of NaN", "scale", OBJ, "m.obj", 'scale="nan 1 1"')
mesh_case("with a scale of two numbers", "3 numbers", OBJ, "m.obj", 'scale="1 1"')
mesh_case("with a scale that leaves nothing", "one point", OBJ, "m.obj", 'scale="1e-320 1e-320 1e-320"')
mesh_case("with a scale that leaves a line", "one line", OBJ, "m.obj", 'scale="1e6 1e-6 1e-6"')
mesh_case("that is a folder", "not there", make=lambda folder: (folder / "m.stl").mkdir())
mesh_case("that links to itself", "not there", make=lambda folder: (folder / "m.stl").symlink_to("m.stl"))
mesh_case("that is a FIFO", "not there", make=lambda folder: os.mkfifo(folder / "m.stl"))
mesh_case("that is a device", "not there", make=lambda folder: (folder / "m.stl").symlink_to("/dev/zero"))
mesh_case("that cannot be there", "not there", file="x" * 300 + ".stl")
mesh_case("with a name of 5 000 characters", "no name", file="x" * 5000 + ".stl")
mesh_case("out of its package", "out of its package", file="package://p/a/../../../../../../etc/passwd.stl")
mesh_case("of a package called ..", "package://NAME", file="package://../x.stl")
mesh_case("of another model, climbing", "out of its package", file="model://p/../../x.stl")
mesh_case("from the web", "only package://", file="https://example.org/m.stl")
mesh_case("that is the password file", "suffix", file="/etc/passwd")
mesh_case("that is a password file, climbing", "suffix", file="../" * 30 + "etc/passwd")

# MJCF


def mjcf(inside, model="mujoco"):
    return f"<{model}>{inside}</{model}>"


def world(inside, more=""):
    return mjcf(f"{more}<worldbody>{inside}</worldbody>")


def body(inside, attributes=""):
    return world(f'<body name="b" {attributes}><freejoint/><geom name="g" size="0.1"/>{inside}</body>')


def asset(inside):
    return mjcf(f"<asset>{inside}</asset>")


def vertices(text, more=""):
    return world('<geom type="mesh" mesh="m"/>', f'<asset><mesh name="m" vertex="{text}" {more}/></asset>')


for name, text, words in (
    ("of zero bytes", b"", "no element"),
    ("of noise", NOISE, "no XML"),
    ("in UTF-16", body("").encode("utf-16"), "bad.xml"),
    ("cut off", body("")[:-20], "XML"),
    ("with wrong nesting", "<mujoco><worldbody><body></worldbody></body></mujoco>", "XML"),
    ("with another root", "<mujocos/>", "<mujocos>"),
    ("with laughs", BOMB + "]>" + body("", 'childclass="&a9;"'), "DOCTYPE"),
    ("of 100 000 levels", "<mujoco><worldbody>" + "<body>" * 100_000, "deep"),
    ("of 1 000 levels, closed", world("<body>" * 1000 + "</body>" * 1000), "deep"),
    ("with classes of 1 000 levels", mjcf("<default>" * 1000 + "</default>" * 1000), "deep"),
    ("with a name twice", world('<body name="b"/><body name="b"/>'), "repeated name"),
    ("with a joint of the world", world('<joint name="j"/>'), "joint"),
    ("with a free joint on a body", body('<body name="c"><freejoint/><geom size="1"/></body>'), "free joint"),
    ("with a quaternion of zero", body("", 'quat="0 0 0 0"'), "bad.xml"),
    ("with a quaternion of NaN", body("", 'quat="nan 0 0 0"'), "bad.xml"),
    ("with a quaternion of infinity", body("", 'quat="inf 0 0 0"'), "bad.xml"),
    ("with a quaternion of three", body("", 'quat="1 0 0"'), "bad.xml"),
    ("with a position of NaN", body("", 'pos="nan 0 0"'), "bad.xml"),
    ("with a position of 1e300", body("", 'pos="1e300 0 0"'), "bad.xml"),
    ("with a position of 1e999", body("", 'pos="1e999 0 0"'), "bad.xml"),
    ("with two angles", body("", 'euler="1 2"'), "bad.xml"),
    ("with a mass of -1", body('<inertial pos="0 0 0" mass="-1" diaginertia="1 1 1"/>'), "mass"),
    ("with a mass of NaN", body('<inertial pos="0 0 0" mass="nan" diaginertia="1 1 1"/>'), "bad.xml"),
    ("with an inertia nobody has", body('<inertial pos="0 0 0" mass="1" diaginertia="1 1 9"/>'), "inertia"),
    ("with a sphere of -1", world('<geom name="g" size="-1"/>'), "bad.xml"),
    ("with a sphere of NaN", world('<geom name="g" size="nan"/>'), "bad.xml"),
    ("with a sphere of nothing", world('<geom name="g"/>'), "bad.xml"),
    ("with a box of one number", world('<geom name="g" type="box" size="1"/>'), "bad.xml"),
    ("with a shape that is none", world('<geom type="torus"/>'), "torus"),
    ("with friction of -1", body('<geom name="h" size="1" friction="-1"/>'), "bad.xml"),
    (
        "with a range upside down",
        world('<body><joint name="j" range="1 -1" limited="true"/><geom size="1"/></body>'),
        "range",
    ),
    ("with an axis of zero", world('<body><joint name="j" axis="0 0 0"/><geom size="1"/></body>'), "axis"),
    ("with armature of -1", world('<body><joint name="j" armature="-1"/><geom size="1"/></body>'), "bad.xml"),
    ("with an unknown class", world('<geom class="c" size="1"/>'), "c"),
    ("with an unknown attribute", world('<geom colour="red" size="1"/>'), "colour"),
    ("with a motor on nothing", mjcf('<actuator><motor name="m" joint="j"/></actuator>'), "j"),
    ("with an equality of nothing", mjcf('<equality><connect body1="x" anchor="0 0 0"/></equality>'), "x"),
    ("with a tendon of nothing", mjcf('<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>'), "j"),
    ("with an exclude of nothing", mjcf('<contact><exclude body1="x" body2="y"/></contact>'), "x"),
    ("with a plugin that is none", mjcf('<extension><plugin plugin="no.such.plugin"/></extension>'), "no.such.plugin"),
    ("with gravity of NaN", mjcf('<option gravity="nan 0 0"/>'), "gravity"),
    ("with a mesh of one vertex", vertices("0 0 0"), "bad.xml"),
    ("with a mesh of two numbers", vertices("0 0"), "bad.xml"),
    ("with a mesh on a line", vertices("0 0 0  1 1 1  2 2 2  3 3 3"), "bad.xml"),
    ("with a mesh in a plane", vertices("0 0 0  1 0 0  0 1 0  1 1 0"), "bad.xml"),
    ("with a mesh of NaN", vertices("0 0 0  1 0 0  0 1 0  0 0 nan"), "bad.xml"),
    ("with a mesh of 1e300", vertices("0 0 0  1 0 0  0 1 0  0 0 1e300"), "bad.xml"),
    (
        "with a face that is not there",
        vertices("0 0 0  1 0 0  0 1 0  0 0 1", 'face="0 1 2 0 1 3 0 2 3 1 2 99"'),
        "bad.xml",
    ),
    ("with a face below zero", vertices("0 0 0  1 0 0  0 1 0  0 0 1", 'face="0 1 2 0 1 3 0 2 3 1 2 -9"'), "bad.xml"),
    ("with a scale of NaN", vertices("0 0 0  1 0 0  0 1 0  0 0 1", 'scale="nan 1 1"'), "bad.xml"),
    ("without its mesh", asset('<mesh name="m" file="nope.stl"/>'), "nope.stl"),
    ("without its texture", asset('<texture name="t" type="2d" file="nope.png"/>'), "nope.png"),
    ("without its height field", asset('<hfield name="h" file="nope.png" size="1 1 1 1"/>'), "nope.png"),
    ("without its skin", asset('<skin name="s" file="nope.skn"/>'), "nope.skn"),
    ("with a mesh of another folder", asset('<mesh name="m" file="../../../../../../etc/passwd"/>'), "passwd"),
    (
        "with 1e9 copies",
        world('<replicate count="1000000000" offset="1 0 0"><geom size="1"/></replicate>'),
        "makes more than",
    ),
    (
        "with copies of copies",
        world('<replicate count="1000" offset="1 0 0">' * 4 + '<geom size="1"/>' + "</replicate>" * 4),
        "makes more than",
    ),
    (
        "with a cloth of 1e10",
        world('<flexcomp name="f" type="grid" count="100000 100000 1" spacing="1 1 1"/>'),
        "<flexcomp>",
    ),
    (
        "with a chain of 1e9",
        world(
            '<body><composite type="cable" curve="s" count="1000000000 1 1" size="1"><joint kind="main"/>'
            '<geom type="capsule" size="0.1"/></composite></body>'
        ),
        "<composite>",
    ),
    (
        "with a height field of 1e10",
        asset('<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>'),
        "nrow x ncol",
    ),
    (
        "with a texture of 1e10",
        asset('<texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>'),
        "width x height",
    ),
    ("with a sphere mesh of 1e9", asset('<mesh name="m" builtin="sphere" params="1000000"/>'), "bad.xml"),
    (
        "with 1e9 user numbers",
        mjcf('<size nuser_geom="1000000000"/><worldbody><geom size="1"/></worldbody>'),
        "nuser_geom",
    ),
    ("with 2e9 numbers of a user", mjcf('<size nuserdata="2000000000"/>'), "nuserdata"),
    ("with 1e9 keys", mjcf('<size nkey="1000000000"/>'), "nkey"),
    (
        "with a numeric of 1e9",
        mjcf('<custom><numeric name="n" size="1000000000" data="1"/></custom>'),
        "<numeric>: size",
    ),
    ("with a memory of 1000 T", mjcf('<size memory="1000T"/>'), "bad.xml"),
    ("with a stack of -5", mjcf('<size memory="-5"/>'), "bad.xml"),
    (
        "with history of 1e9",
        world(
            '<body><joint name="j"/><geom size="1"/></body>',
            '<actuator><position joint="j" delay="1" nsample="1000000000"/></actuator>',
        ),
        "nsample",
    ),
):
    plain(f"MJCF {name}", text, words, file="bad.xml")


def mjcf_files(name, words, text, make):
    @case(f"MJCF {name}", words)
    def _(folder):
        make(folder)
        (folder / "bad.xml").write_text(text)
        return folder / "bad.xml"


def write(name, data):
    return lambda folder: (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)


def shown(file):
    return world('<geom type="mesh" mesh="m"/>', f'<asset><mesh name="m" file="{file}"/></asset>')


INCLUDE = '<mujoco><include file="{}"/></mujoco>'
DEVICE, FIFO = "/dev/zero", os.mkfifo
nothing = write("other.txt", "")
for name, words, text, make in (
    ("that includes itself", "already included", INCLUDE.format("bad.xml"), nothing),
    ("that includes another, that this", "bad.xml", INCLUDE.format("b.xml"), write("b.xml", INCLUDE.format("bad.xml"))),
    ("that includes itself by another name", "bad.xml", INCLUDE.format("./x/../bad.xml"), lambda f: (f / "x").mkdir()),
    ("that includes itself by a link", "l.xml", INCLUDE.format("l.xml"), lambda f: (f / "l.xml").symlink_to("bad.xml")),
    ("that includes nothing", "include", "<mujoco><include/></mujoco>", nothing),
    ("that includes what is not there", "nope.xml", INCLUDE.format("nope.xml"), nothing),
    ("that includes a folder", "x", INCLUDE.format("x"), lambda f: (f / "x").mkdir()),
    ("that includes a FIFO", "x.xml", INCLUDE.format("x.xml"), lambda f: FIFO(f / "x.xml")),
    ("that includes a device", "x.xml", INCLUDE.format("x.xml"), lambda f: (f / "x.xml").symlink_to(DEVICE)),
    ("that includes noise", "x.xml", INCLUDE.format("x.xml"), write("x.xml", NOISE)),
    (
        "that includes laughs",
        "x.xml",
        INCLUDE.format("x.xml"),
        write("x.xml", BOMB + "]><mujocoinclude>&a9;</mujocoinclude>"),
    ),
    (
        "that includes 100 000 levels",
        "x.xml",
        INCLUDE.format("x.xml"),
        write("x.xml", "<mujocoinclude>" + "<body>" * 100_000),
    ),
    (
        "that attaches itself",
        "bad.xml",
        world('<attach model="m" prefix="p"/>', '<asset><model name="m" file="bad.xml"/></asset>'),
        nothing,
    ),
    (
        "that attaches another, that this",
        "bad.xml",
        mjcf('<asset><model name="m" file="b.xml"/></asset>'),
        write("b.xml", mjcf('<asset><model name="m" file="bad.xml"/></asset>')),
    ),
    (
        "that attaches a FIFO",
        "x.xml",
        mjcf('<asset><model name="m" file="x.xml"/></asset>'),
        lambda f: FIFO(f / "x.xml"),
    ),
    ("with a mesh that is a FIFO", "m.stl", shown("m.stl"), lambda f: FIFO(f / "m.stl")),
    ("with a mesh that is a device", "m.stl", shown("m.stl"), lambda f: (f / "m.stl").symlink_to(DEVICE)),
    ("with a mesh that is a folder", "m.stl", shown("m.stl"), lambda f: (f / "m.stl").mkdir()),
    ("with a mesh that links to itself", "m.stl", shown("m.stl"), lambda f: (f / "m.stl").symlink_to("m.stl")),
    ("with a mesh of zero bytes", "m.stl", shown("m.stl"), write("m.stl", b"")),
    ("with a mesh of noise", "m.stl", shown("m.stl"), write("m.stl", NOISE)),
    ("with a mesh that is a text", "m.stl", shown("m.stl"), write("m.stl", "no mesh\n" * 100)),
    ("with a mesh of 4e9 triangles", "m.stl", shown("m.stl"), write("m.stl", stl(TETRAHEDRON, 4_000_000_000))),
    ("with a mesh of one triangle", "'m'", shown("m.stl"), write("m.stl", stl(TETRAHEDRON[:3]))),
    ("with a mesh of NaN in a file", "'m'", shown("m.stl"), write("m.stl", stl([*TETRAHEDRON[:5], (NAN, 0, 0)] * 2))),
    (
        "with a mesh of a bad index",
        "'m'",
        shown("m.obj"),
        write("m.obj", OBJ + "f 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 99\n"),
    ),
    ("with a mesh of an index of zero", "m.obj", shown("m.obj"), write("m.obj", OBJ + "f 0 2 3\nf 1 2 4\n")),
    ("with a mesh of words", "m.obj", shown("m.obj"), write("m.obj", "v a b c\n" * 9 + "f x y z\n")),
    (
        "with a mesh of MuJoCo's own, cut",
        "m.msh",
        shown("m.msh"),
        write("m.msh", struct.pack("<4i", 2_000_000_000, 0, 0, 2_000_000_000)),
    ),
    ("with a Collada mesh", "m.dae", shown("m.dae"), write("m.dae", dae())),
    (
        "with a height field cut off",
        "h.bin",
        asset('<hfield name="h" file="h.bin" size="1 1 1 1"/>'),
        write("h.bin", struct.pack("<2i", 1000, 1000) + bytes(100)),
    ),
    (
        "with a height field of 1e18",
        "'h'",
        asset('<hfield name="h" file="h.bin" size="1 1 1 1"/>'),
        write("h.bin", struct.pack("<2i", 2**30, 2**30)),
    ),
    (
        "with a height field of -1",
        "h.bin",
        asset('<hfield name="h" file="h.bin" size="1 1 1 1"/>'),
        write("h.bin", struct.pack("<2i", -1, -1)),
    ),
    (
        "with a height field that is no picture",
        "h.png",
        asset('<hfield name="h" file="h.png" size="1 1 1 1"/>'),
        write("h.png", NOISE),
    ),
    (
        "with a height field that is a cut picture",
        "h.png",
        asset('<hfield name="h" file="h.png" size="1 1 1 1"/>'),
        write("h.png", PNG),
    ),
    (
        "with a height field that is a FIFO",
        "h.png",
        asset('<hfield name="h" file="h.png" size="1 1 1 1"/>'),
        lambda f: FIFO(f / "h.png"),
    ),
    (
        "with a texture that is no picture",
        "t.png",
        asset('<texture name="t" type="2d" file="t.png"/>'),
        write("t.png", NOISE),
    ),
    (
        "with a texture that is a FIFO",
        "t.png",
        asset('<texture name="t" type="2d" file="t.png"/>'),
        lambda f: FIFO(f / "t.png"),
    ),
    (
        "with a skin cut off",
        "s.skn",
        asset('<skin name="s" file="s.skn"/>'),
        write("s.skn", struct.pack("<4i", 2_000_000_000, 1, 1, 2_000_000_000)),
    ),
    (
        "in a folder of meshes that is a FIFO",
        "m.stl",
        mjcf('<compiler meshdir="d"/>' + shown("m.stl")[8:-9]),
        lambda f: ((f / "d").mkdir(), FIFO(f / "d" / "m.stl")),
    ),
):
    mjcf_files(name, words, text, make)


@case("MJCF of 2^30 bodies that are attached", "copies")
def _(folder):
    for i in range(30):
        below = f'<asset><model name="m" file="{i + 1}.xml"/></asset>'
        twice = "".join(f'<frame><attach model="m" body="b" prefix="{side}"/></frame>' for side in "lr")
        inside = (
            f'<body name="b"><geom size="1"/>{twice}</body>' if i < 29 else '<body name="b"><geom size="1"/></body>'
        )
        (folder / ("bad.xml" if i == 0 else f"{i}.xml")).write_text(world(inside, below if i < 29 else ""))
    return folder / "bad.xml"


@case("MJCF that is a URDF", "bad.urdf", format="mjcf")
def _(folder):
    (folder / "bad.urdf").write_text(robot(LINK.replace("1", "-1")))
    return folder / "bad.urdf"


@case("URDF that is an MJCF", "robot", format="urdf")
def _(folder):
    (folder / "bad.xml").write_text(body(""))
    return folder / "bad.xml"


# The process that loads them


def attempt(name, folder, answer):
    """In a child: loads, and says what came of it."""
    import signorini

    make, _, options = CASES[name]
    folder.mkdir(parents=True)
    os.chdir(folder)  # MuJoCo logs there
    path = make(folder)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.alarm(SECONDS)
    start = time.process_time()
    try:
        signorini.load(path, **options)
        outcome, message = "loaded", ""
    except BaseException as error:
        outcome, message = type(error).__name__, str(error)
    signal.alarm(0)
    content = {"outcome": outcome, "message": message[:5000], "length": len(message), "file": path.name}
    answer.write_text(json.dumps({**content, "seconds": time.process_time() - start}))


def main(folder):
    import signorini
    import signorini.load.mjcf
    import signorini.load.urdf  # noqa: F401

    with contextlib.suppress(ImportError):
        import mujoco  # noqa: F401
    for number, name in enumerate(CASES):
        answer = folder / f"{number}.json"
        child = os.fork()
        if child == 0:
            try:
                attempt(name, folder / str(number), answer)
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        if answer.exists():
            content = json.loads(answer.read_text())
        else:
            content = {"outcome": f"died of {signal.Signals(os.WTERMSIG(status)).name}" if status else "no answer"}
        print(json.dumps({"name": name, **content}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
