"""Height fields: bodies on a plane of triangles move as on a half space; rough ground holds what falls on it."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from signorini import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    HeightField,
    InvalidInputError,
    Joint,
    Material,
    Simulator,
    Sphere,
    WorldBuilder,
)

G = 9.81


def pebble(size=0.07, count=20):
    points = np.random.default_rng(3).normal(size=(count, 3))
    points *= size / np.linalg.norm(points, axis=1)[:, None]
    hull = ConvexHull(points)
    vertices = points[hull.vertices]
    triangles = np.searchsorted(hull.vertices, hull.simplices)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    triangles[inwards] = triangles[inwards, ::-1]
    return Convex(vertices, triangles.astype(np.int32))


SHAPES = {
    "sphere": Sphere(0.05),
    "box": Box((0.05, 0.08, 0.03)),
    "capsule": Capsule(0.04, 0.08),
    "cylinder": Cylinder(0.05, 0.04),
    "ellipsoid": Ellipsoid((0.05, 0.07, 0.04)),
    "pebble": pebble(),
}


def add(builder, name, shape, position, orientation=(0, 0, 0, 1), friction=0.3, mass=1.0, inertia=None):
    inertia = np.diag([2e-3, 2.5e-3, 3e-3]) if inertia is None else inertia
    builder.add_body(
        name, mass=mass, inertia=inertia, joints=[Joint(name, "free")], position=position, orientation=orientation
    )
    builder.add_geometry(name, shape, material=Material(friction=friction), name=name)


def on(ground, shape, position, velocity, friction=0.3, orientation=(0, 0, 0, 1), place=(0, 0, 0, 1), **body):
    """A simulator with one body, thrown with a velocity of the world's axes."""
    builder = WorldBuilder()
    builder.add_geometry("world", ground, orientation=place, material=Material(friction=friction))
    add(builder, "body", shape, position, orientation, friction, **body)
    simulator = Simulator(builder.build(), time_step=1e-3)
    simulator.state.v[:3] = Rotation.from_quat(orientation).inv().apply(velocity[:3])
    simulator.state.v[3:] = velocity[3:]
    return simulator


def smooth_noise(seed, samples, amplitude):
    """Noise of two cells' length, fenced in by a wall."""
    noise = np.random.default_rng(seed).normal(size=(samples, samples))
    for _ in range(2):
        noise = (noise + sum(np.roll(noise, shift, axis) for shift in (-1, 1) for axis in (0, 1))) / 5
    noise *= amplitude / noise.std()
    noise[[0, -1]] = noise[:, [0, -1]] = 0.6
    return noise


@pytest.mark.parametrize("name", SHAPES)
def test_flat_ground_is_a_half_space(name):
    orientation = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)) if name == "capsule" else (0.0, 0.0, 0.0, 1.0)
    # Cells of 5 cm, of which the slide crosses several.
    flat = HeightField(np.zeros((41, 61)), (1.5, 1.0))
    thrown = (SHAPES[name], (-0.513, 0.021, 0.09), (1.0, 0.4, 0, 0, 0, 0.5))
    ours = on(flat, *thrown, orientation=orientation)
    plane = on(HalfSpace(), *thrown, orientation=orientation)
    for _ in range(100):
        for simulator in (ours, plane):
            simulator.step(10)
        np.testing.assert_allclose(ours.state.q, plane.state.q, atol=1e-6)
    np.testing.assert_allclose(ours.state.v, plane.state.v, atol=1e-6)
    assert len(ours.contacts) == len(plane.contacts) > 0


def test_nothing_is_felt_of_the_edges_between_cells():
    height = 0.1
    for shape, z in ((Box((0.05, 0.08, 0.03)), 0.03), (Sphere(0.05), 0.05), (Cylinder(0.05, 0.04), 0.04)):
        flat = HeightField(np.full((31, 41), height), (2.0, 1.5))
        simulator = on(flat, shape, (-1.0, 0.013, height + z), (2.0, 0.3, 0, 0, 0, 0), friction=0.0)
        for _ in range(800):
            simulator.step()
            assert abs(simulator.state.q[2] - height - z) < 1e-6
        np.testing.assert_allclose(simulator.state.v[:3], (2.0, 0.3, 0.0), atol=1e-6)


@pytest.mark.parametrize(("friction", "share"), [(0.6, 5 / 7), (0.0, 1.0)])
def test_a_sphere_runs_down_a_slope(friction, share):
    angle, radius = 0.25, 0.1
    rise = -np.tan(angle) * np.linspace(-3, 3, 41)
    start = np.array([-2.0 + radius * np.sin(angle), 0.013, 2.0 * np.tan(angle) + radius * np.cos(angle)])
    simulator = on(
        HeightField(np.tile(rise, (11, 1)), (3.0, 1.0), 2.0),
        Sphere(radius),
        start,
        np.zeros(6),
        friction,
        inertia=0.4 * radius**2 * np.eye(3),
    )
    simulator.step(1000)
    travelled = simulator.state.q[:3] - start
    fall = (np.cos(angle), 0.0, -np.sin(angle))
    # Semi-implicit Euler: half a step further than a t^2 / 2.
    assert travelled @ fall == pytest.approx(0.5 * share * G * np.sin(angle) * 1.0 * 1.001, rel=1e-3)
    assert np.linalg.norm(travelled - (travelled @ fall) * np.array(fall)) < 1e-6


def test_a_small_sphere_follows_waves_and_keeps_its_energy():
    radius, amplitude, length = 0.005, 0.05, 1.0
    x = np.linspace(-1.0, 1.0, 801)
    waves = amplitude * np.cos(2.0 * np.pi * x / length)
    field = HeightField(np.tile(waves, (3, 1)), (1.0, 0.5))
    start = (0.1, 0.013, amplitude * np.cos(0.2 * np.pi) + 1.3 * radius)
    simulator = on(field, Sphere(radius), start, np.zeros(6), friction=0.0, inertia=1e-5 * np.eye(3))
    simulator.step(50)
    lowest = -G * (amplitude - radius)
    energy = simulator.energy.total - lowest
    assert 0.7 < energy < 1.0
    gaps = []
    for _ in range(1500):  # to the other side of the valley, and back
        simulator.step()
        gaps.append(min(contact.distance for contact in simulator.contacts))
    # What hills of chords lose: the square of each turn of the valley, of 0.003 pi^2 rad at most.
    assert 0.97 * energy < simulator.energy.total - lowest <= energy
    assert np.abs(gaps).max() < 1e-5


def test_rough_ground_holds_fifty_bodies():
    rng = np.random.default_rng(1)
    builder = WorldBuilder()
    builder.add_geometry("world", HeightField(smooth_noise(1, 41, 0.05), (2.0, 2.0)), material=Material(0.8))
    for k in range(50):
        position = np.array([(k % 7 - 3) * 0.45, (k // 7 - 3) * 0.45, 0.5]) + rng.uniform(-0.1, 0.1, 3)
        orientation = Rotation.random(random_state=rng).as_quat()
        add(builder, f"body {k}", list(SHAPES.values())[k % len(SHAPES)], position, orientation, friction=0.8)
    simulator = Simulator(builder.build(), time_step=1e-3)
    energy, deepest = simulator.energy.total, 0.0
    for k in range(2000):
        simulator.step()
        assert simulator.report.status == "solved"
        if k % 5 == 0:
            assert simulator.energy.total <= energy + 1e-6
            energy = simulator.energy.total
            deepest = min([deepest, *(contact.distance for contact in simulator.contacts)])
    assert deepest > -1e-3
    q, v = simulator.state.q.reshape(50, 7), simulator.state.v.reshape(50, 6)
    assert np.abs(q[:, :2]).max() < 2.0
    assert q[:, 2].min() > -0.25
    # Spheres and other round things go on rolling about; with flat sides, they lie still.
    edged = [k for k in range(50) if k % 6 in (1, 5)]
    assert np.median(np.abs(v[edged]).max(axis=1)) < 1e-4


@pytest.mark.parametrize("name", SHAPES)
def test_what_falls_fast_is_caught(name):
    rng = np.random.default_rng(5)
    field = HeightField(rng.uniform(-0.03, 0.03, (31, 31)), (1.0, 1.0))
    for _ in range(5):
        orientation = Rotation.random(random_state=rng).as_quat()
        position = (*rng.uniform(-0.5, 0.5, 2), 0.3)
        simulator = on(field, SHAPES[name], position, (0, 0, -10.0, 0, 0, 0), orientation=orientation)
        for _ in range(100):
            simulator.step()
            assert simulator.state.q[2] > 0.0
    tiny = on(HeightField(np.zeros((31, 31)), (1.0, 1.0)), Sphere(0.003), (0.013, 0.02, 0.3), (0, 0, -10.0, 0, 0, 0))
    tiny.step(200)
    assert tiny.state.q[2] == pytest.approx(0.003, abs=1e-5)


def test_a_body_leaves_the_field_over_its_border():
    for name, shape in SHAPES.items():
        orientation = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)) if name == "capsule" else (0.0, 0.0, 0.0, 1.0)
        field = HeightField(np.zeros((11, 11)), (0.5, 0.5))
        simulator = on(field, shape, (0.35, 0.02, 0.1), (0.8, 0, 0, 0, 0, 0), 0.1, orientation)
        energy = simulator.energy.total
        for _ in range(1000):
            simulator.step()
            assert simulator.energy.total <= energy + 1e-4, name
            energy = simulator.energy.total
            assert all(contact.distance > -1e-3 for contact in simulator.contacts), name
        assert simulator.state.q[2] < -1.0, name


def test_walls_and_bottom_are_solid():
    field = HeightField(np.zeros((11, 11)), (0.5, 0.5), 0.3)
    for name, shape in SHAPES.items():
        for position, velocity in (
            ((0.8, 0.02, -0.15), (-2.0, 0, 0, 0, 0, 0)),
            ((0.03, -0.8, -0.15), (0, 2.0, 0, 0, 0, 0)),
            ((0.1, 0.02, -0.6), (0, 0, 4.0, 0, 0, 0)),
            ((0.75, 0.75, -0.15), (-2.0, -2.0, 0, 0, 0, 0)),
        ):
            simulator = on(field, shape, position, velocity)
            for _ in range(300):
                simulator.step()
                x, y, z = simulator.state.q[:3]
                assert abs(x) > 0.5 or abs(y) > 0.5 or z < -0.3, name
                assert all(contact.distance > -5e-3 for contact in simulator.contacts), name


def test_a_field_has_rows_along_y_and_columns_along_x():
    heights = np.zeros((3, 5))
    heights[2, 1] = 0.2  # y = 1, x = -1
    field = HeightField(heights, (2.0, 1.0))
    high = on(field, Sphere(0.01), (-1.0, 1.0, 0.213), np.zeros(6))
    high.step()
    assert min(c.distance for c in high.contacts) == pytest.approx(0.003, abs=2e-5)
    low = on(field, Sphere(0.01), (1.0, -0.9, 0.215), np.zeros(6))
    low.step()
    assert not low.contacts


def test_bad_fields_are_refused():
    good = HeightField(np.zeros((3, 4)), (1.0, 1.0))
    bad = {
        "rows": {"heights": np.zeros((1, 4))},
        "columns": {"heights": np.zeros((2, 5000))},
        "heights": {"heights": np.zeros(4)},
        r"heights\[1\]": {"heights": np.array([[0.0, np.nan], [0.0, 0.0]])},
        r"heights\[2\]": {"heights": np.array([[0.0, 0.0], [-1.5, 0.0]])},
        "half_extents": {"half_extents": (1.0, 1.0, 1.0)},
        "half_x": {"half_extents": (0.0, 1.0)},
        "base": {"base": 0.0},
    }
    for field, change in bad.items():
        with pytest.raises(InvalidInputError, match=field):
            WorldBuilder().add_geometry("world", dataclasses.replace(good, **change))
    builder = WorldBuilder()
    builder.add_body("cart", mass=1.0, inertia=np.eye(3), joints=[Joint("cart", "prismatic")])
    with pytest.raises(InvalidInputError, match="height field, must be fixed to the world"):
        builder.add_geometry("cart", good)


# Files and pictures

MJCF = """<mujoco>
  <asset><hfield name="hills" nrow="3" ncol="4" size="1.5 1 0.5 0.2"
    elevation="0 2 4 1  3 8 5 2  1 6 7 0"/></asset>
  <worldbody>
    <geom name="ground" type="hfield" hfield="hills" pos="0.3 -0.2 0.1" euler="0 0 30"/>
    <body name="ball" pos="0 0 2"><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>"""


def ray(vertices, triangles, start, direction):
    """Distance to the first of some triangles; infinity if none is hit."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("ij,ij->i", normal, a - start) / (normal @ direction)
    hit = start + t[:, None] * direction
    sides = [np.einsum("ij,ij->i", normal, np.cross(q - p, hit - p)) for p, q in ((a, b), (b, c), (c, a))]
    inside = (np.min(sides, axis=0) >= 0.0) & (t > 0.0)
    return t[inside].min() if inside.any() else np.inf


def test_a_field_of_an_mjcf_file_is_that_of_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    from signorini import load
    from signorini.view.drawables import drawables

    path = tmp_path / "hills.xml"
    path.write_text(MJCF)
    world = load(path)
    assert not any("height" in warning for warning in world.warnings)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ground = next(d for d in drawables(world) if d.body == 0 and d.collision)
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(200):
        start = rng.uniform((-1.5, -1.5, 0.8), (1.8, 1.5, 1.5))
        direction = rng.normal(size=3) - (0, 0, 2)
        expected = mujoco.mj_rayHfield(model, data, 0, start, direction)
        expected = expected[0] if isinstance(expected, tuple) else expected
        ours = ray(ground.vertices, ground.triangles, start, direction)
        if expected >= 0.0:
            assert ours == pytest.approx(expected, rel=1e-6)
            hits += 1
    assert hits > 50


def test_a_field_is_drawn_closed_and_outwards():
    from signorini.view.drawables import drawables

    builder = WorldBuilder()
    heights = np.random.default_rng(0).uniform(0.0, 0.3, (4, 6))
    builder.add_geometry("world", HeightField(heights, (1.0, 2.0), 0.5))
    (seen, colliding) = drawables(builder.build())
    for drawn in (seen, colliding):
        edges = {(int(t[k]), int(t[(k + 1) % 3])) for t in drawn.triangles for k in range(3)}
        open_edges = [(a, b) for a, b in edges if (b, a) not in edges]
        # The bottom is two triangles along many edges of walls; all others close up.
        assert all(drawn.vertices[a][2] == drawn.vertices[b][2] == -0.5 for a, b in open_edges)
        a, b, c = (drawn.vertices[drawn.triangles[:, k]] for k in range(3))
        x, y = np.diff(np.linspace(-1, 1, 6))[0], np.diff(np.linspace(-2, 2, 4))[0]
        first, last = heights[:-1, :-1] + heights[1:, 1:], heights[:-1, 1:] + heights[1:, :-1]
        above = x * y * (first / 3.0 + last / 6.0).sum()
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
        assert volume == pytest.approx(above + 2.0 * 4.0 * 0.5, rel=1e-12)
        assert not drawn.smooth
        assert not drawn.flat
