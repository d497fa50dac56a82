"""Mesh files and the hulls made of them."""

import itertools
import struct
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from signorini import Box, Convex, InvalidInputError, Joint, Material, Simulator, Sphere, WorldBuilder, load
from signorini.load import _pieces, mesh
from signorini.load._placement import Placement, from_roll_pitch_yaw

CORNERS = np.array(list(itertools.product((0.0, 1.0), (0.0, 2.0), (0.0, 3.0))))
TRIANGLES = mesh.convex_hull(CORNERS).triangles  # winding outwards, as check_hull() finds
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # outwards
VOLUME = 6.0


def binary_stl():
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *CORNERS[t].ravel(), 0) for t in TRIANGLES)
    return b"solid by its name only".ljust(80) + struct.pack("<I", len(TRIANGLES)) + facets


def ascii_stl():
    text = "solid box\n"
    for t in TRIANGLES:
        vertices = "".join("vertex {:g} {:g} {:g}\n".format(*p) for p in CORNERS[t])
        text += f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n"
    return (text + "endsolid box\n").encode()


def obj(stray=""):
    lines = ["v {:g} {:g} {:g}".format(*p) for p in CORNERS]
    lines += ["f " + " ".join(f"{i - 8}/1/1" if i % 2 else f"{i + 1}//1" for i in t) for t in TRIANGLES]
    return (stray + "\n".join(lines)).encode()


def ply(encoding, faces=TRIANGLES):
    header = f"ply\nformat {encoding} 1.0\ncomment x\nelement vertex 8\nproperty uchar red\nproperty float x\n"
    header += f"property float y\nproperty double z\nelement face {len(faces)}\n"
    header += "property list uchar int vertex_indices\nproperty short flags\nend_header\n"
    if encoding == "ascii":
        body = "".join("7 {:g} {:g} {:g}\n".format(*p) for p in CORNERS).encode()
        body += "".join(f"{len(f)} {' '.join(map(str, f))} 5\n" for f in faces).encode()
    else:
        order = "<" if "little" in encoding else ">"
        body = b"".join(struct.pack(order + "Bffd", 7, *p) for p in CORNERS)
        body += b"".join(struct.pack(f"{order}B{len(f)}ih", len(f), *f, 5) for f in faces)
    return header.encode() + body


COLLADA = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
  <source id="s"><float_array id="f" count="24">{numbers}</float_array>
    <technique_common><accessor source="#f" count="8" stride="3"/></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>{faces}</mesh></geometry></library_geometries>
<library_nodes><node id="n"><translate>10 0 0</translate><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="scene"><node><rotate>0 0 1 90</rotate><scale>100 100 100</scale>
  <instance_geometry url="#g"/>{more}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""


INPUTS = '<input semantic="NORMAL" source="#s" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/>'


def corners(faces):
    return " ".join(f"0 {i}" for face in faces for i in face)


def collada(more="", faces=""):
    faces = faces or f"<triangles>{INPUTS}<p>{corners(TRIANGLES)}</p></triangles>"
    return COLLADA.format(numbers=" ".join(f"{x:g}" for x in CORNERS.ravel()), more=more, faces=faces).encode()


TURNED = CORNERS @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # by 90 degrees about z
FILES = {
    "binary.stl": (binary_stl(), CORNERS),
    "ascii.STL": (ascii_stl(), CORNERS),
    "box.obj": (obj(), CORNERS),
    "stray.obj": (obj(), CORNERS),
    "ascii.ply": (ply("ascii"), CORNERS),
    "little.ply": (ply("binary_little_endian"), CORNERS),
    "big.ply": (ply("binary_big_endian"), CORNERS),
    "scene.dae": (collada(), TURNED),
    "nodes.dae": (collada('<instance_node url="#n"/>'), np.vstack([TURNED, TURNED + [0.0, 10.0, 0.0]])),
}


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_box(tmp_path, name):
    data, expected = FILES[name]
    (tmp_path / name).write_bytes(data)
    points = mesh.read_points(tmp_path / name)
    np.testing.assert_allclose(np.unique(np.round(points, 9), axis=0), np.unique(expected, axis=0), atol=1e-9)


MIXED = [*QUADS[:3], *(t for a, b, c, d in QUADS[3:] for t in ((a, b, c), (a, c, d)))]
POLYGONS = "".join(f"<p>{corners([face])}</p>" for face in MIXED)
POLYLIST = (
    f"<polylist>{INPUTS}<vcount>{' '.join(str(len(f)) for f in MIXED)}</vcount><p>{corners(MIXED)}</p></polylist>"
)
MIRROR = '<node><scale>1 -1 1</scale><instance_geometry url="#g"/></node>'
CLOSED = {
    **{name: (data, VOLUME * len(expected) / 8) for name, (data, expected) in FILES.items()},
    "quads.obj": ("".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(
        f"f {a + 1} {b + 1} {c + 1} {d + 1}\n" for a, b, c, d in QUADS)).encode(),
    "quads.ply": ply("ascii", QUADS),
    "mixed.ply": ply("ascii", MIXED),
    "quads-little.ply": ply("binary_little_endian", QUADS),
    "mixed-big.ply": ply("binary_big_endian", MIXED),
    "polylist.dae": collada(faces=POLYLIST),
    "polygons.dae": collada(faces=f"<polygons>{INPUTS}{POLYGONS}</polygons>"),
    "mirrored.dae": (collada(MIRROR), 2.0 * VOLUME),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOSED)
def test_every_format_gives_the_same_volume(tmp_path, name):
    data, expected = CLOSED[name] if isinstance(CLOSED[name], tuple) else (CLOSED[name], VOLUME)
    (tmp_path / name).write_bytes(data)
    assert mesh.volume(mesh.read(tmp_path / name)) == pytest.approx(expected)


def solid(faces=TRIANGLES, points=CORNERS):
    return mesh.Mesh(np.asarray(points, dtype=float), np.asarray(faces, dtype=np.int64).reshape(-1, 3))


def test_volume_is_that_of_closed_meshes():
    assert mesh.volume(solid()) == pytest.approx(VOLUME)
    assert mesh.volume(solid(TRIANGLES[:, ::-1])) == pytest.approx(VOLUME)  # inside out
    assert mesh.volume(mesh.Mesh(CORNERS + 1e3, solid().triangles)) == pytest.approx(VOLUME)
    assert mesh.volume(solid(TRIANGLES).scaled(np.array([1.0, -2.0, 1.0]))) == pytest.approx(2.0 * VOLUME)
    for damaged in (TRIANGLES[:-1], [*TRIANGLES[:-1], TRIANGLES[-1][::-1]], [*TRIANGLES, TRIANGLES[0]]):
        assert mesh.volume(solid(damaged)) is None  # open; one turned over; one twice
    assert mesh.volume(mesh.Mesh(CORNERS)) is None
    assert mesh.volume(solid(np.zeros((0, 3)))) is None


def test_volume_of_what_is_odd_but_closed():
    degenerate = [*TRIANGLES, (0, 0, 1), (0, 0, 0), (2, 3, 2)]
    assert mesh.volume(solid(degenerate)) == pytest.approx(VOLUME)
    apart = CORNERS[TRIANGLES].reshape(-1, 3)  # every triangle with points of its own, as in STL; some zeros negative
    apart[::2] = np.where(apart[::2] == 0.0, -0.0, apart[::2])
    assert mesh.volume(solid(np.arange(len(apart)), apart)) == pytest.approx(VOLUME)
    beside = CORNERS + [1.0, 2.0, 0.0]  # shares an edge, which four triangles meet at
    both = solid([*TRIANGLES, *(TRIANGLES + 8)], np.vstack([CORNERS, beside]))
    assert mesh.volume(both) == pytest.approx(2.0 * VOLUME)


def test_a_hull_tells_what_it_adds():
    l_shape, triangles = prism([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)])
    hull = mesh.convex_hull(l_shape, triangles=triangles)
    assert (hull.mesh_volume, hull.volume) == (pytest.approx(3.0), pytest.approx(3.5))
    assert hull.added == pytest.approx(1.0 / 6.0)
    assert hull.mesh_points == 12
    assert mesh.convex_hull(l_shape, triangles=triangles[:-1]).added is None
    twice = np.concatenate([triangles, triangles])  # no solid: more volume than its hull
    assert mesh.convex_hull(l_shape * [1, 1, 1], triangles=twice).added is None
    assert mesh.convex_hull(CORNERS * [1, 1, 0], triangles=TRIANGLES).added is None


def prism(outline):
    """(points, triangles) of an outline, star-shaped about its first point, between z = 0 and 1."""
    n = len(outline)
    points = np.array([(x, y, z) for z in (0.0, 1.0) for x, y in outline], dtype=float)
    triangles = [t for i in range(1, n - 1) for t in ((0, i + 1, i), (n, n + i, n + i + 1))]
    triangles += [t for i in range(n) for j in [(i + 1) % n] for t in ((i, j, j + n), (i, j + n, i + n))]
    return points, np.array(triangles)


BAD = {
    "cut.stl": (binary_stl()[:-10], "cut off"),
    "empty.stl": (b"", "neither"),
    "words.stl": (ascii_stl().replace(b"vertex 1", b"vertex one", 1), "number"),
    "nan.stl": (ascii_stl().replace(b"vertex 1", b"vertex nan", 1), "finite"),
    "short.obj": (b"v 1 2\n", "line 1"),
    "index.obj": (b"v 1 2 3\nf 1 2 3\n", "not there"),
    "words.obj": (b"v 1 2 3\nf a b c\n", "index"),
    "nothing.obj": (b"# nothing\n", "no vertices"),
    "far.obj": (b"v 1e30 0 0\n", "1e9"),
    "none.ply": (b"plywood", "header"),
    "cut.ply": (ply("binary_little_endian")[:-40], "cut off"),
    "many.ply": (ply("ascii").replace(b"vertex 8", b"vertex 99999999999999"), "cut off"),
    "odd.ply": (ply("ascii").replace(b"ascii", b"morse"), "morse"),
    "list.ply": (ply("ascii").replace(b"uchar red", b"list uchar int red"), "type"),
    "other.dae": (b"<html/>", "COLLADA"),
    "dangling.dae": (collada('<instance_geometry url="#x"/>'), '"#x"'),
    "loop.dae": (
        collada('<instance_node url="#n"/>').replace(b'<node id="n">', b'<node id="n"><instance_node url="#n"/>'),
        "contain",
    ),
    "few.dae": (collada().replace(b'count="8"', b'count="80"'), "too few"),
    "number.dae": (collada().replace(b"0 0 1 90", b"0 1 90"), "4 finite"),
    "corner.dae": (collada(faces=f"<triangles>{INPUTS}<p>0 0 0 1 0 8</p></triangles>"), "not there"),
    "corners.dae": (collada(faces=f"<triangles>{INPUTS}<p>0 0 0 1 0 2 0 3</p></triangles>"), "do not fit"),
    "stride.dae": (collada(faces=f"<triangles>{INPUTS}<p>0 0 0</p></triangles>"), "multiple of 2"),
    "word.dae": (collada(faces=f"<triangles>{INPUTS}<p>0 one 0 1 0 2</p></triangles>"), "whole number"),
    "vcount.dae": (collada(faces=f"<polylist>{INPUTS}<vcount>-1 4</vcount><p>0 0 0 1 0 2</p></polylist>"), "not fit"),
    "faces.ply": (ply("ascii")[:-8], "cut off"),
    "faces-binary.ply": (ply("binary_big_endian")[:-4], "cut off"),
    "many-faces.ply": (ply("ascii").replace(b"face 12", b"face 999999999999"), "cut off"),
    "face.ply": (ply("ascii", [(0, 1, 8)]), "not there"),
    "word.ply": (ply("ascii").replace(b" 5\n3 ", b" 5\n3 x", 1), "whole number"),
    "huge-index.obj": (b"v 1 2 3\nf 1 2 99999999999999999999\n", "not there"),
    "before.obj": (b"v 1 2 3\nf -1 -2 -3\n", "not there"),
    "odd.stl": (ascii_stl().replace(b"endsolid", b"vertex 1 2 3\nendsolid"), "three a triangle"),
    "box.step": (b"", "suffix"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_named_with_its_fault(tmp_path, name):
    data, word = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InvalidInputError, match=name.replace(".", r"\.")) as caught:
        mesh.read_points(tmp_path / name)
    assert word in str(caught.value)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".dae"])
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_files_are_refused_or_read(tmp_path_factory, suffix, data):
    plys = ply("binary_little_endian"), ply("ascii", MIXED)
    good = {".stl": binary_stl(), ".obj": obj(), ".ply": data.draw(st.sampled_from(plys)), ".dae": collada()}[suffix]
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damaged") / f"a{suffix}"
    path.write_bytes(bytes(damaged[: data.draw(st.integers(0, len(good)))]))
    try:
        found = mesh.read(path)
        points = found.points
        mesh.hulls(found)
    except InvalidInputError:
        return
    assert np.isfinite(points).all()


def check_hull(hull):
    """Closed, outwards, convex."""
    edges = np.concatenate([hull.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    assert sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1]))
    a, b, c = (hull.vertices[hull.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    volume = np.einsum("ij,ij->i", a, normals).sum() / 6.0
    assert volume == pytest.approx(ConvexHull(hull.vertices).volume)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    heights = np.einsum("fi,vi->fv", normals, hull.vertices) - np.einsum("fi,fi->f", normals, a)[:, None]
    assert heights.max() < 1e-9 * np.abs(hull.vertices).max()


def test_hull_of_a_box_has_its_corners():
    inside = np.random.default_rng(0).uniform(0.1, 0.9, (5000, 3)) * [1, 2, 3]
    hull = mesh.convex_hull(np.vstack([inside, CORNERS, CORNERS]))
    check_hull(hull)
    np.testing.assert_array_equal(np.unique(hull.vertices, axis=0), np.unique(CORNERS, axis=0))
    assert hull.volume_share == 1.0
    assert hull.notes == ()


@pytest.mark.parametrize(("limit", "share"), [(16, 0.4), (64, 0.85), (256, 0.96)])
def test_a_hull_with_many_vertices_is_reduced(limit, share):
    points = np.random.default_rng(1).standard_normal((20_000, 3))
    points *= np.array([0.1, 0.2, 0.3]) / np.linalg.norm(points, axis=1, keepdims=True)
    hull = mesh.convex_hull(points, limit)
    check_hull(hull)
    assert len(hull.vertices) <= limit
    assert share < hull.volume_share < 1.0
    assert len(mesh.convex_hull(points, None).vertices) > 10_000
    again = mesh.convex_hull(points, limit)
    np.testing.assert_array_equal(hull.vertices, again.vertices)


def test_flat_meshes_get_a_thickness_and_thinner_ones_are_refused():
    plate = CORNERS * [1, 1, 0]
    hull = mesh.convex_hull(plate)
    check_hull(hull)
    np.testing.assert_allclose(np.ptp(hull.vertices, axis=0), [1, 2, mesh.THICKNESS])
    assert "flat" in hull.notes[0]
    with pytest.raises(InvalidInputError, match="one line"):
        mesh.convex_hull(CORNERS * [1, 0, 0])
    with pytest.raises(InvalidInputError, match="one point"):
        mesh.convex_hull(np.ones((5, 3)))
    with pytest.raises(InvalidInputError, match="one point"):
        mesh.convex_hull(np.ones((1, 3)))


def test_a_wrong_unit_is_noticed():
    assert "millimetres" in mesh.convex_hull(CORNERS * 300.0).notes[0]
    assert "millimetres" in mesh.convex_hull(CORNERS * 1e-4).notes[0]


def test_hull_triangles_without_area_wind_as_their_neighbours():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 0]], dtype=float)  # the last on an edge
    simplices = np.array([[0, 4, 2], [4, 1, 2], [0, 1, 3], [0, 4, 1], [0, 2, 3], [1, 2, 3]])  # the fourth: that edge
    normals = np.array([[0, 0, -1], [0, 0, -1], [0, -1, 0], [0, -1, 0], [-1, 0, 0], [1, 1, 1]])
    shared = [[len({*s} & {*t}) == 2 for t in simplices] for s in simplices]
    neighbors = [np.flatnonzero(row) for row in shared]
    for flips in itertools.product((1, -1), repeat=6):
        turned = np.array([t[::flip] for t, flip in zip(simplices, flips, strict=True)])
        hull = SimpleNamespace(vertices=range(5), simplices=turned, equations=normals, neighbors=neighbors)
        vertices, triangles = mesh._wound(points, hull)
        assert mesh.volume(mesh.Mesh(vertices, triangles.astype(np.int64))) == pytest.approx(1.0 / 6.0)


# Boxes


HALF = np.array([0.1, 0.15, 0.05])
EIGHT = (CORNERS / [1.0, 2.0, 3.0] - 0.5) * 2.0 * HALF
GRID = np.linspace(-1.0, 1.0, 14)
THOUSAND = np.array([p for p in itertools.product(GRID, repeat=3) if np.abs(p).max() == 1.0]) * HALF
TURN = from_roll_pitch_yaw((0.3, -0.7, 1.1))
OFFSET = np.array([0.3, -0.2, 0.1])


def as_stl(points):
    """With the digits of a binary STL in millimetres."""
    return (1e3 * points).astype(np.float32).astype(np.float64) * 1e-3


BOXES = {
    "corners": (EIGHT, np.eye(3), np.zeros(3)),
    "subdivided": (THOUSAND, np.eye(3), np.zeros(3)),
    "turned": (THOUSAND @ TURN.T + OFFSET, TURN, OFFSET),
    "turned, few digits": (as_stl(THOUSAND @ TURN.T + OFFSET), TURN, OFFSET),
}


def five(shapes):
    """A stack of five boxes, a little out of line and dropped from a little above each other; 2 s of it."""
    builder = WorldBuilder()
    builder.add_ground(Material(friction=0.5))
    a, b, c = HALF
    for i, (shape, placement) in enumerate(shapes):
        body = f"box{i}"
        inertia = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 3.0
        position = (0.01 * (i % 2), 0.02 * (i % 3), c * (2 * i + 1) + 0.01 * i)
        builder.add_body(body, joints=[Joint(body, "free")], position=position, mass=1.0, inertia=inertia)
        place = {"position": placement.position, "orientation": placement.rotation}
        builder.add_geometry(body, shape, material=Material(friction=0.5), **place)
    simulator = Simulator(builder.build())
    trace = simulator.run(2000, keep_states=True)
    assert trace.solved.all()
    return simulator, trace.states


@pytest.mark.parametrize("name", BOXES)
def test_a_box_given_as_a_mesh_behaves_as_a_box(name):
    points, turn, offset = BOXES[name]
    frame = Placement(turn, offset).inverse()  # of the mesh in the body, so that the box is where the other is
    shape, inner = mesh.shape(mesh.convex_hull(points))
    digits = 1e-7 if "digits" in name else 1e-12
    assert isinstance(shape, Box)
    np.testing.assert_allclose(np.sort(shape.half_extents), np.sort(HALF), atol=digits)
    expected, truth = five([(Box(tuple(HALF)), Placement(np.eye(3), np.zeros(3)))] * 5)
    simulator, states = five([(shape, frame @ inner)] * 5)
    assert len(simulator.contacts) == len(expected.contacts) == 20
    num_q = simulator.world.num_q
    np.testing.assert_allclose(states[:, :num_q], truth[:, :num_q], atol=1e-6 if "digits" in name else 1e-9)
    np.testing.assert_allclose(states[-1], truth[-1], atol=1e-6 if "digits" in name else 1e-9)
    for i in range(5):  # forces of a patch are not unique, their sum is
        below, above = ("world", "box0") if i == 0 else (f"box{i - 1}", f"box{i}")
        force = simulator.contact_force(below, above)
        np.testing.assert_allclose(force, [0.0, 0.0, 9.81 * (5 - i)], atol=1e-5)


def test_a_polyhedron_of_eight_corners_rests_like_a_box():
    hull = mesh.convex_hull(EIGHT)
    here = Placement(np.eye(3), np.zeros(3))
    _, truth = five([(Box(tuple(HALF)), here)] * 5)
    _, states = five([(Convex(hull.vertices, hull.triangles), here)] * 5)
    np.testing.assert_allclose(states, truth, atol=1e-8)


def test_what_is_nearly_a_box_is_none():
    for dent in (1e-3, 1e-5):
        dented = EIGHT.copy()
        dented[0] *= 1.0 - dent
        assert isinstance(mesh.shape(mesh.convex_hull(dented))[0], Convex)
    sheared = EIGHT + 1e-4 * EIGHT[:, [2, 0, 1]] * [1, 0, 0]
    assert isinstance(mesh.shape(mesh.convex_hull(sheared))[0], Convex)
    edge_cut = np.vstack([THOUSAND[THOUSAND.sum(1) < HALF.sum() - 1e-3]])  # one corner is missing
    assert isinstance(mesh.shape(mesh.convex_hull(edge_cut))[0], Convex)
    for n in (3, 6, 64):
        prism_points, _ = prism([(np.cos(t), np.sin(t)) for t in 2.0 * np.pi * np.arange(n) / n])
        assert isinstance(mesh.shape(mesh.convex_hull(prism_points))[0], Convex)


@settings(max_examples=50, deadline=None)
@given(
    half=st.tuples(*[st.floats(1e-3, 1e3)] * 3),
    angles=st.tuples(*[st.floats(-4.0, 4.0)] * 3),
    offset=st.tuples(*[st.floats(-2.0, 2.0)] * 3),
)
def test_boxes_are_recognised_in_any_place(half, angles, offset):
    turn = from_roll_pitch_yaw(angles)
    corners = (EIGHT / HALF * half) @ turn.T + offset
    if min(half) < 1e-5 * max(half):
        return  # flat: it gets a thickness
    shape, inner = mesh.shape(mesh.convex_hull(corners))
    assert isinstance(shape, Box)
    assert np.linalg.det(inner.rotation) == pytest.approx(1.0)
    back = (EIGHT / HALF * shape.half_extents) @ inner.rotation.T + inner.position
    distance = np.linalg.norm(back[:, None] - corners[None], axis=2)
    assert distance.min(axis=0).max() < 1e-9 * max(half)


# Odd meshes


def sphere(rings):
    """About 2 rings^2 triangles."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, rings, endpoint=False), np.linspace(-1, 1, rings))
    radius = np.sqrt(1.0 - height**2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(rings), indexing="ij")
    a, b, c, d = (r * rings + k % rings for r, k in ((i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)))
    return points, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def write_stl(path, points, triangles):
    record = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    record["corners"] = points[triangles]
    path.write_bytes(bytes(80) + struct.pack("<I", len(triangles)) + record.tobytes())


def test_very_many_triangles_are_read_in_bounded_time(tmp_path):
    points, triangles = sphere(400)
    write_stl(tmp_path / "huge.stl", points, triangles)
    start = time.process_time()
    found = mesh.read(tmp_path / "huge.stl")
    (hull,) = mesh.hulls(found)
    assert time.process_time() - start < 30.0  # takes 2
    assert len(found.triangles) == len(triangles) > 300_000
    check_hull(hull)
    # The poles are circles of points at one place: closed all the same.
    assert hull.mesh_volume == pytest.approx(4.0 / 3.0 * np.pi, rel=1e-4)
    assert len(hull.vertices) == 256


def test_odd_meshes_survive():
    box = ConvexHull(CORNERS)
    doubled = mesh.Mesh(np.vstack([CORNERS, CORNERS]), np.vstack([TRIANGLES, TRIANGLES[:, ::-1] + 8]))  # both sides
    no_area = solid([*TRIANGLES, *[(i, i, i) for i in range(8)], (0, 1, 1)])
    needle = mesh.Mesh(np.vstack([CORNERS, [[0.5, 1.0, 1e-9]]]), TRIANGLES)
    strewn = mesh.Mesh(CORNERS[TRIANGLES].reshape(-1, 3) + 1e-7 * np.arange(36)[:, None] % 3e-7)
    for odd in (doubled, no_area, needle, strewn, solid(TRIANGLES[:-3])):
        (hull,) = mesh.hulls(odd)
        check_hull(hull)
        assert hull.volume == pytest.approx(box.volume, rel=1e-5)


# Pieces


@pytest.fixture
def cache(tmp_path, monkeypatch):
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "signorini" / "pieces"


def u_shape():
    outline = [(0.5, 0), (1, 0), (1, 2), (0.75, 2), (0.75, 0.25), (-0.75, 0.25), (-0.75, 2), (-1, 2), (-1, 0)]
    n = len(outline)
    points = np.array([(x, y, z) for z in (0.0, 0.5) for x, y in outline])
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 5), (0, 5, 8), (8, 5, 7), (5, 6, 7)]
    triangles = [t for a, b, c in faces for t in ((a, c, b), (a + n, b + n, c + n))]
    triangles += [t for i in range(n) for j in [(i + 1) % n] for t in ((i, j, j + n), (i, j + n, i + n))]
    return mesh.Mesh(points, np.array(triangles))


def test_a_concave_mesh_becomes_pieces(cache):
    whole = u_shape()
    volume = 0.5 * (2.0 * 2.0 - 1.5 * 1.75)
    assert mesh.volume(whole) == pytest.approx(volume)
    assert mesh.hulls(whole)[0].volume == pytest.approx(2.0)
    pieces = mesh.hulls(whole, split=True)
    assert len(pieces) >= 3
    assert sum(piece.volume for piece in pieces) == pytest.approx(volume, rel=0.05)
    for piece in pieces:
        check_hull(piece)
        inside = (np.abs(piece.vertices[:, 0]) < 0.74) & (piece.vertices[:, 1] > 0.26)
        assert not inside.any()  # the gap stays open
    assert len(list(cache.iterdir())) == 1


def test_pieces_are_kept_and_bad_ones_ignored(cache, monkeypatch):
    first = [piece.vertices for piece in mesh.hulls(u_shape(), split=True)]
    calls = []
    monkeypatch.setattr(_pieces.subprocess, "run", lambda *a, **k: calls.append(a) or pytest.fail("asked again"))
    for a, b in zip(first, [piece.vertices for piece in mesh.hulls(u_shape(), split=True)], strict=True):
        np.testing.assert_array_equal(a, b)
    monkeypatch.undo()
    (kept,) = cache.iterdir()
    good = kept.read_bytes()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache.parent.parent))
    kept.write_bytes(good[:100])
    again = [piece.vertices for piece in mesh.hulls(u_shape(), split=True)]
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))  # the same without the cache
    assert list(cache.iterdir()) == [kept]


def test_what_is_no_file_of_pieces(tmp_path):
    path = tmp_path / "a.npz"
    for sizes, points in (([4], EIGHT), ([9, -1], EIGHT), ([8.0], EIGHT), ([8], EIGHT * np.nan), ([8], EIGHT[:, :2])):
        np.savez(path, sizes=np.array(sizes), points=points)
        assert _pieces._load(path) is None
    np.savez(path, sizes=[8], joints=EIGHT)
    assert _pieces._load(path) is None
    np.savez(path, sizes=[8], points=np.array([object()] * 8))  # a pickle
    assert _pieces._load(path) is None
    for data in (b"", b"x" * 1000, b"PK\x03\x04" + bytes(100)):
        path.write_bytes(data)
        assert _pieces._load(path) is None
    np.savez(path, sizes=[3, 5], points=EIGHT)
    assert [len(piece) for piece in _pieces._load(path)] == [3, 5]


def test_pieces_without_a_cache_folder(cache, monkeypatch):
    cache.parent.parent.mkdir()
    cache.parent.write_text("in the way")
    assert len(mesh.hulls(u_shape(), split=True)) >= 3


def test_only_concave_meshes_are_split(cache, monkeypatch):
    assert len(mesh.hulls(solid(), split=True)) == 1
    assert not cache.exists()
    (points_only,) = mesh.hulls(mesh.Mesh(u_shape().points), split=True)
    assert "no triangles" in points_only.notes[0]
    monkeypatch.setattr(_pieces, "_WORKER", "import os; os.abort()")
    with pytest.raises(InvalidInputError, match="CoACD cannot decompose"):
        mesh.hulls(u_shape(), split=True)
    monkeypatch.setattr(_pieces, "_WORKER", "import time; time.sleep(60)")
    monkeypatch.setattr(_pieces, "TIMEOUT", 0.2)
    with pytest.raises(InvalidInputError, match="within"):
        mesh.hulls(u_shape(), split=True)
    monkeypatch.setattr(_pieces.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"signorini\[meshes\]"):
        mesh.hulls(u_shape(), split=True)


def test_of_an_open_mesh_it_is_said(monkeypatch):
    monkeypatch.setattr(_pieces, "pieces", lambda points, triangles: [EIGHT, EIGHT * [1, 0, 0], EIGHT + 1.0])
    whole = u_shape()
    first, second = mesh.hulls(mesh.Mesh(whole.points, whole.triangles[:-2]), split=True)  # no hull of a sliver
    assert "not closed" in first.notes[0]
    assert second.volume == pytest.approx(8.0 * HALF.prod())


def write_obj(path, solid):
    lines = [f"v {x} {y} {z}" for x, y, z in solid.points.tolist()]
    path.write_text("\n".join(lines + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in solid.triangles.tolist()]))


def cup(folder, format):
    """A file of a cup, u_shape() upright and fixed."""
    write_obj(folder / "u.obj", u_shape())
    path = folder / f"robot.{format}"
    if format == "urdf":
        mesh_file = '<geometry><mesh filename="u.obj"/></geometry>'
        upright = '<origin rpy="1.5707963267948966 0 0"/>'
        path.write_text(f'<robot name="r"><link name="cup"><collision>{upright}{mesh_file}</collision></link></robot>')
    else:
        pytest.importorskip("mujoco")
        geom = '<body name="cup"><geom name="cup" type="mesh" mesh="u" euler="90 0 0"/></body>'
        path.write_text(f'<mujoco><asset><mesh name="u" file="u.obj"/></asset><worldbody>{geom}</worldbody></mujoco>')
    return path


@pytest.mark.parametrize("format", ["urdf", "xml"])
def test_a_ball_falls_into_a_cup_that_is_decomposed(cache, tmp_path, format):
    for decompose, height in ((False, 2.2), (["cu*"], 0.45)):
        builder = WorldBuilder()
        builder.add_body("ball", joints=[Joint("ball", "free")], position=(0, -0.25, 2.5), mass=1, inertia=np.eye(3))
        builder.add_geometry("ball", Sphere(0.2))
        world = load(cup(tmp_path, format), builder=builder, decompose=decompose)
        names = [name for name in world.geometry_names if name.startswith("cup")]
        assert names == (["cup"] if not decompose else [f"cup_{i}" for i in range(len(names))])
        simulator = Simulator(world)
        trace = simulator.run(1500)
        assert trace.solved.all()
        # On the hull's lid; or on the ground of the cup, to CoACD's precision.
        assert simulator.state.q[2] == pytest.approx(height, abs=0.06 if decompose else 1e-4)


def test_decompose_is_checked(tmp_path, cache):
    for unknown in ("cap", ["cu*", "cap"]):
        with pytest.raises(InvalidInputError, match="decompose: is 'cap', no body of robot.urdf.* did you mean 'cup'"):
            load(cup(tmp_path, "urdf"), decompose=unknown)
    with pytest.raises(InvalidInputError, match="decompose: is 'cap', no body of robot.urdf"):
        load(cup(tmp_path, "urdf"), decompose="cap")
    assert len(load(cup(tmp_path, "urdf"), decompose="cup", prefix="my/").geometries) > 1


@pytest.mark.parametrize("format", ["urdf", "xml"])
def test_what_hulls_add_is_said(tmp_path, format):
    (warning,) = [w for w in load(cup(tmp_path, format)).warnings if "add more than 20%" in w]
    volume = 0.5 * (2.0 * 2.0 - 1.5 * 1.75)
    assert f"({2.0 / volume - 1.0:.0%})" in warning


@pytest.mark.parametrize("format", ["urdf", "xml"])
def test_a_box_as_the_mesh_of_a_file_is_a_box(tmp_path, format):
    path = cup(tmp_path, format)
    write_obj(tmp_path / "u.obj", mesh.Mesh(EIGHT + OFFSET, TRIANGLES))
    world = load(path)
    (geometry,) = world.geometries
    assert geometry.shape.type.name == "box"
    corners = (EIGHT / HALF * geometry.shape.size) @ geometry.placement.rotation.T + geometry.placement.translation
    expected = (EIGHT + OFFSET) @ from_roll_pitch_yaw((np.pi / 2, 0, 0)).T
    distance = np.linalg.norm(corners[:, None] - expected[None], axis=2)
    assert distance.min(axis=0).max() < 1e-7
