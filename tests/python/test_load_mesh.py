"""Mesh files and the hulls made of them."""

import itertools
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from signorini import InvalidInputError
from signorini.load import mesh

CORNERS = np.array(list(itertools.product((0.0, 1.0), (0.0, 2.0), (0.0, 3.0))))
TRIANGLES = ConvexHull(CORNERS).simplices


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


def ply(encoding):
    header = f"ply\nformat {encoding} 1.0\ncomment x\nelement vertex 8\nproperty uchar red\nproperty float x\n"
    header += (
        "property float y\nproperty double z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    if encoding == "ascii":
        body = "".join("7 {:g} {:g} {:g}\n".format(*p) for p in CORNERS).encode()
    else:
        order = "<" if "little" in encoding else ">"
        body = b"".join(struct.pack(order + "Bffd", 7, *p) for p in CORNERS)
    return header.encode() + body


COLLADA = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
  <source id="s"><float_array id="f" count="24">{numbers}</float_array>
    <technique_common><accessor source="#f" count="8" stride="3"/></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#s"/></vertices></mesh></geometry></library_geometries>
<library_nodes><node id="n"><translate>10 0 0</translate><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="scene"><node><rotate>0 0 1 90</rotate><scale>100 100 100</scale>
  <instance_geometry url="#g"/>{more}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""


def collada(more=""):
    return COLLADA.format(numbers=" ".join(f"{x:g}" for x in CORNERS.ravel()), more=more).encode()


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
    good = {".stl": binary_stl(), ".obj": obj(), ".ply": ply("binary_little_endian"), ".dae": collada()}[suffix]
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damaged") / f"a{suffix}"
    path.write_bytes(bytes(damaged[: data.draw(st.integers(0, len(good)))]))
    try:
        points = mesh.read_points(path)
        mesh.convex_hull(points)
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
