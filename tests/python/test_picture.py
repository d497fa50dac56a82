"""Pictures and films: what a pinhole camera sees, in a world whose every corner is known."""

import io
import itertools
import math
import struct
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from signorini import Box, InvalidInputError, Joint, Material, Simulator, Sphere, WorldBuilder, recording
from signorini.cli.main import app
from signorini.view import picture, recorded, video

pytest.importorskip("embreex", reason="the extra view is not installed")
PIL_Image = pytest.importorskip("PIL.Image", reason="the extra view is not installed")

SIZE = (320, 200)
RED, BLUE, WHITE = (0.9, 0.05, 0.05, 1.0), (0.05, 0.1, 0.9, 1.0), (1.0, 1.0, 1.0, 1.0)


def invoke(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def world_of(*boxes, ground=True):
    """Free boxes (centre, half edge, colour)."""
    builder = WorldBuilder()
    if ground:
        builder.add_ground(Material(friction=0.5))
    for i, (center, half, color) in enumerate(boxes):
        name = f"box-{i}"
        builder.add_body(name, joints=[Joint(name, "free")], position=center, mass=1.0, inertia=np.eye(3) / 100)
        builder.add_geometry(name, Box((half, half, half)), material=Material(friction=0.5))
        builder.add_visual(name, Box((half, half, half)), color=color)
    return builder.build()


def pinhole(points, camera, size):
    """Pixels of points, written down a second time."""
    eye, target = np.array(camera.eye), np.array(camera.target)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    away = np.asarray(points) - eye
    focal = size[1] / (2 * math.tan(camera.angle / 2))
    depth = away @ forward
    return np.stack(
        [size[0] / 2 + focal * (away @ right) / depth, size[1] / 2 + focal * (away @ down) / depth], axis=-1
    )


def corners(center, half):
    return np.array(center) + half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def reddish(image):
    r, g, b = (image[..., i].astype(float) for i in range(3))
    return (r > 60) & (r > 2 * g) & (r > 2 * b)


CAMERA = picture.Camera(eye=(3.0, -2.0, 1.5), target=(0.2, 0.1, 0.2), angle=math.radians(30))


@pytest.mark.parametrize("center", [(0.0, 0.0, 0.1), (0.4, 0.5, 0.1), (-0.5, -0.3, 0.3)])
def test_a_red_box_is_where_the_pinhole_camera_says(center):
    world = world_of((center, 0.1, RED))
    image = picture.picture(world, world.initial_q, size=SIZE, camera=CAMERA)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert image.dtype == np.uint8
    x, y = pinhole([center], CAMERA, SIZE)[0]
    assert reddish(image)[int(y), int(x)]
    rows, columns = np.nonzero(reddish(image))
    assert (columns.mean(), rows.mean()) == pytest.approx((x, y), abs=2.0)
    seen = pinhole(corners(center, 0.1), CAMERA, SIZE)
    found = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    assert found == pytest.approx([*seen.min(axis=0), *seen.max(axis=0)], abs=1.5)


def test_project_and_directions_are_each_other_reversed():
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3))
    pixels = CAMERA.project(points, SIZE)
    assert pixels == pytest.approx(pinhole(points, CAMERA, SIZE), abs=1e-9)
    toward = points - CAMERA.eye
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    assert CAMERA.directions(pixels, SIZE) == pytest.approx(toward, abs=1e-5)


def test_the_nearer_box_hides_the_farther():
    eye, target = np.array(CAMERA.eye), np.array(CAMERA.target)
    near, far = (tuple(eye + share * (target - eye)) for share in (0.7, 1.0))
    middle = SIZE[1] // 2, SIZE[0] // 2
    world = world_of((far, 0.08, RED), (near, 0.08, BLUE))
    color = picture.picture(world, world.initial_q, size=SIZE, camera=CAMERA)[middle].astype(int)
    assert color[2] > 2 * color[0]
    alone = world_of((far, 0.08, RED))
    color = picture.picture(alone, alone.initial_q, size=SIZE, camera=CAMERA)[middle].astype(int)
    assert color[0] > 2 * color[2]


def test_what_is_behind_a_transparent_box_shines_through():
    eye, target = np.array(CAMERA.eye), np.array(CAMERA.target)
    near, far = (tuple(eye + share * (target - eye)) for share in (0.7, 1.0))
    middle = SIZE[1] // 2, SIZE[0] // 2

    def seen(*boxes):
        world = world_of(*boxes, ground=False)
        return picture.picture(world, world.initial_q, size=SIZE, camera=CAMERA)[middle].astype(int)

    blue, red = seen((near, 0.08, BLUE)), seen((far, 0.08, RED))
    through = seen((far, 0.08, RED), (near, 0.08, (*BLUE[:3], 0.3)))
    assert linear(through) == pytest.approx(0.3 * linear(blue) + 0.7 * linear(red), abs=0.01)


def linear(color):
    """Of sRGB in [0, 255], IEC 61966-2-1."""
    c = np.asarray(color) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def test_boxes_stand_out_and_cast_a_shadow_on_the_ground():
    world = world_of(((0.2, 0.1, 0.3), 0.2, WHITE))
    empty = world_of(((0.2, 0.1, -50.0), 0.2, WHITE))
    with_box, without = (
        picture.picture(w, w.initial_q, size=SIZE, camera=CAMERA).astype(int).sum(axis=2) / 3 for w in (world, empty)
    )
    seen = pinhole(corners((0.2, 0.1, 0.3), 0.2), CAMERA, SIZE)
    low, high = seen.min(axis=0), seen.max(axis=0)
    inside = np.zeros_like(with_box, dtype=bool)
    inside[int(low[1]) - 1 : int(high[1]) + 2, int(low[0]) - 1 : int(high[0]) + 2] = True
    assert (np.abs(with_box - without)[inside] > 10).mean() > 0.5
    shadow = (without - with_box > 25) & ~inside
    assert shadow.sum() > 200
    # Not larger than the sun is low, and in one place.
    rows, columns = np.nonzero(shadow)
    assert np.ptp(columns) < 2.5 * (high - low)[0]
    assert np.ptp(rows) < 2.0 * (high - low)[1]
    assert (with_box - without)[~inside].max() < 4  # nothing outside is brighter for it


def test_the_same_call_gives_the_same_picture():
    world = world_of(((0, 0, 0.1), 0.1, RED), ((0.1, 0.2, 0.5), 0.15, BLUE))
    first, second = (picture.picture(world, world.initial_q, size=SIZE) for _ in range(2))
    assert (first == second).all()
    stage = picture.Stage.of_world(world, size=SIZE)
    moved = world.initial_q.copy()
    moved[0] += 0.1
    again = [stage.draw(q, camera=stage.camera([q])) for q in (world.initial_q, moved, world.initial_q)]
    assert (again[0] == first).all()
    assert (again[2] == first).all()
    assert (again[1] != first).any()


def test_a_world_without_bodies():
    sky = picture.picture(world_of(ground=False), [], size=SIZE)
    ground = picture.picture(world_of(), [], size=SIZE)
    assert np.ptp(sky[:, SIZE[0] // 2], axis=0).max() > 5  # lighter towards the horizon
    assert np.ptp(sky, axis=1).max() < 20
    assert np.ptp(ground[-1].astype(int), axis=0).max() > 10  # chequers


def test_the_camera_sees_all_that_moves_and_no_more():
    world = world_of(((0, 0, 0.1), 0.1, RED))
    stage = picture.Stage.of_world(world, size=SIZE)
    states = [world.initial_q + [x, 0, x, 0, 0, 0, 0] for x in (0.0, 0.7, 2.0)]
    camera = stage.camera(states)
    everywhere = np.concatenate([corners((x, 0, 0.1 + x), 0.1) for x in (0.0, 0.7, 2.0)])
    pixels = pinhole(everywhere, camera, SIZE)
    assert (pixels > 0).all()
    assert (pixels < SIZE).all()
    share = np.ptp(pixels, axis=0) / SIZE
    assert 0.6 < share.max() < 0.85


def resting_ball():
    builder = WorldBuilder()
    builder.add_ground(Material(friction=0.5))
    builder.add_body("ball", joints=[Joint("ball", "free")], position=(0, 0, 0.1), mass=1.0, inertia=np.eye(3) / 100)
    builder.add_geometry("ball", Sphere(0.1), material=Material(friction=0.5))
    builder.add_visual("ball", Sphere(0.1), color=WHITE)
    simulator = Simulator(builder.build(), time_step=1e-3)
    simulator.step(5)
    return simulator


def test_an_arrow_starts_at_the_contact_and_is_as_long_as_the_force_is_large():
    simulator = resting_ball()
    forces = picture.Forces.of(simulator.contacts)
    assert forces.force == pytest.approx(np.array([[0, 0, 9.81]]), abs=1e-6)
    stage = picture.Stage.of_world(simulator.world, size=SIZE)
    q = simulator.state.q.copy()
    camera = picture.Camera(eye=(1.5, -1.0, 0.6), target=(0, 0, 0.15))
    without = stage.draw(q, camera=camera).astype(int)
    for length in (0.3, 0.15):
        image = stage.draw(q, forces, camera=camera, force_scale=length / 9.81).astype(int)
        rows, columns = np.nonzero(np.abs(image - without).sum(axis=2) > 60)
        (x, low), (_, high) = pinhole([[0, 0, 0], [0, 0, length]], camera, SIZE)
        assert (rows.min(), rows.max()) == pytest.approx((high, low), abs=2.5)
        assert columns.mean() == pytest.approx(x, abs=1.5)


def test_forces_are_those_on_what_moves():
    simulator = resting_ball()
    (contact,) = simulator.contacts
    assert {contact.body_a, contact.body_b} == {"world", "ball"}
    mirrored = type(contact)(**{**vars(contact), "body_a": "ball", "body_b": "world", "force": -contact.force})
    assert picture.Forces.of([mirrored]).force == pytest.approx(picture.Forces.of([contact]).force)


def test_collision_shapes_on_demand():
    builder = WorldBuilder()
    builder.add_body("b", joints=[Joint("b", "free")], mass=1.0, inertia=np.eye(3) / 100)
    builder.add_geometry("b", Sphere(0.3), material=Material(friction=0.5))
    builder.add_visual("b", Sphere(0.1), color=RED)
    world = builder.build()

    def width(collision):
        arguments = {"size": SIZE, "camera": CAMERA, "collision": collision}
        image, empty = (
            picture.picture(world, world.initial_q + [x, 0, 0, 0, 0, 0, 0], **arguments).astype(int)
            for x in (0.0, 100.0)
        )
        return np.ptp(np.nonzero(np.abs(image - empty).sum(axis=2) > 60)[1])

    assert width(True) == pytest.approx(3 * width(False), rel=0.1)


@pytest.mark.parametrize("change", [math.nan, math.inf])
def test_a_state_that_is_not_finite_is_refused(change):
    world = world_of(((0, 0, 0.1), 0.1, RED))
    with pytest.raises(InvalidInputError, match="q: is not finite"):
        picture.picture(world, world.initial_q + change, size=SIZE)


def test_far_from_the_origin_all_is_the_same():
    """In single precision, 10 km is known to 1 mm."""
    pictures = []
    for x in (0.0, 10000.0):
        world = world_of(((x, x, 0.1), 0.1, WHITE), ((x + 0.15, x, 0.4), 0.05, RED))
        camera = picture.Camera(eye=(x + 0.8, x - 0.6, 0.6), target=(x, x, 0.15))
        pictures.append(picture.picture(world, world.initial_q, size=SIZE, camera=camera).astype(int))
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"eye": (0, 0, math.inf), "target": (0, 0, 0)}, r"eye: is \(0, 0, inf\), must be three finite numbers"),
        ({"eye": (0, 0, 1), "target": (0, 0)}, r"target: is \(0, 0\), must be three finite numbers"),
        ({"eye": (0, 0, 1), "target": (0, 0, 1)}, r"target: is \(0, 0, 1\), must not be the eye"),
        ({"eye": (0, 0, 1), "target": (0, 0, 0), "angle": 4.0}, r"angle: is 4.0, must be in \(0, pi\) rad"),
    ],
)
def test_bad_cameras_are_refused(arguments, words):
    with pytest.raises(InvalidInputError, match=words):
        picture.Camera(**arguments)


def test_bad_framings_and_sizes_are_refused():
    with pytest.raises(InvalidInputError, match="direction: is"):
        picture.Camera.framing([[0, 0, 0]], direction=(0, 0, 0))
    with pytest.raises(InvalidInputError, match=r"margin: is 0.5, must be in \[0, 0.5\)"):
        picture.Camera.framing([[0, 0, 0]], margin=0.5)
    world = world_of()
    with pytest.raises(InvalidInputError, match=r"size: width is 100.5, must be a whole number in \[16, 4096\]"):
        picture.picture(world, [], size=(100.5, 50))


# Films


def boxes(data, start=0, end=None):
    """Type and content of ISO/IEC 14496-12 boxes."""
    end = len(data) if end is None else end
    while start < end:
        length, kind = struct.unpack_from(">I4s", data, start)
        assert 8 <= length <= end - start
        yield kind.decode(), data[start + 8 : start + length]
        start += length


def inside(data, path):
    for name in path.split("/"):
        data = dict(boxes(data))[name]
    return data


def decoded(path):
    """Pictures of a film: the same samples, called an AVIF sequence, which Pillow reads."""
    data = bytearray(path.read_bytes())
    data[8:12] = b"avis"
    data[16:20] = b"avis"
    data[20:24] = b"mif1"
    handler = data.index(b"hdlr")
    assert data[handler + 12 : handler + 16] == b"vide"
    data[handler + 12 : handler + 16] = b"pict"
    image = PIL_Image.open(io.BytesIO(bytes(data)))
    result = []
    for k in range(image.n_frames):
        image.seek(k)
        result.append(np.asarray(image.convert("RGB")).astype(int))
    return result


def falling():
    simulator = Simulator(world_of(((0, 0, 0.8), 0.1, RED)), time_step=1e-3)
    trace = simulator.run(400, keep_states=True)
    return simulator.world, np.concatenate([simulator.world.initial_q[None], trace.states[:, :7]])


def test_a_film_holds_the_pictures_in_order(tmp_path):
    world, q = falling()
    stage = picture.Stage.of_world(world, size=SIZE)
    rows = video.rows(0.4, 1e-3, fps=25.0)
    assert rows == [0, 40, 80, 120, 160, 200, 240, 280, 320, 360]
    states = [q[row] for row in rows]
    count = []
    video.film(tmp_path / "fall.mp4", stage, states, fps=25.0, progress=lambda: count.append(1))
    assert len(count) == 10
    data = (tmp_path / "fall.mp4").read_bytes()
    assert [kind for kind, _ in boxes(data)] == ["ftyp", "moov", "mdat"]
    scale, duration = struct.unpack(">II", inside(data, "moov/mvhd")[12:20])
    assert duration / scale == pytest.approx(0.4)
    table = inside(data, "moov/trak/mdia/minf/stbl")
    assert struct.unpack(">I", inside(table, "stsz")[8:12]) == (10,)
    width, height = struct.unpack(">II", inside(data, "moov/trak/tkhd")[76:84])
    assert (width / 65536, height / 65536) == SIZE
    pictures = decoded(tmp_path / "fall.mp4")
    assert len(pictures) == 10
    camera = stage.camera(states)
    for state, shown in zip(states, pictures, strict=True):
        drawn = stage.draw(state, camera=camera).astype(int)
        assert np.abs(shown - drawn).mean() < 3.0
        rows_of_box, columns = np.nonzero(reddish(shown.astype(np.uint8)))
        place = pinhole([state[:3]], camera, SIZE)[0]
        assert (columns.mean(), rows_of_box.mean()) == pytest.approx(place, abs=2.5)
    assert all((np.abs(a - b) > 30).sum() > 50 for a, b in itertools.pairwise(pictures))


@pytest.mark.parametrize(
    ("duration", "fps", "speed", "count"), [(2.0, 30.0, 1.0, 60), (2.0, 30.0, 0.5, 120), (1.0, 60.0, 4.0, 15)]
)
def test_a_film_has_duration_times_fps_pictures(duration, fps, speed, count):
    rows = video.rows(duration, 1e-3, fps, speed, start=0.5)
    assert len(rows) == count
    assert rows == [round(1000 * (0.5 + k * speed / fps)) for k in range(count)]


# The command line


@pytest.fixture(scope="module")
def dropped(tmp_path_factory):
    """A box that falls, recorded: state and contact force are unique."""
    folder = tmp_path_factory.mktemp("dropped")
    (folder / "box.urdf").write_text(
        '<robot name="ball"><link name="ball"><inertial><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<visual><geometry><sphere radius="0.1"/></geometry>'
        '<material name="m"><color rgba="0.9 0 0 1"/></material></visual>'
        '<collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>'
    )
    result = invoke(
        "run", folder / "box.urdf", "--floating", "--ground", "--duration", 0.2, "--record", folder / "r.h5",
        "--picture", folder / "last.png", "--video", folder / "film.mp4", "--size", "160x96",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return folder


def read_png(path):
    return np.asarray(PIL_Image.open(path))


def test_a_picture_of_a_recording_is_that_of_the_simulation(dropped):
    held = recording.read(dropped / "r.h5")
    from signorini.cli.run import load_source

    world, q, v = load_source(held.source)
    simulator = Simulator(world, held.settings)
    simulator.state.q, simulator.state.v = q, v
    for time in (0.05, 0.2):
        simulator.step(round(time / 1e-3) - simulator.report.steps)
        result = invoke("picture", dropped / "r.h5", dropped / "at.png", "--time", time, "--size", "160x96")
        assert result.exit_code == 0, result.output
        drawn = picture.picture(world, simulator.state.q, simulator.contacts, size=(160, 96)).astype(int)
        assert np.abs(read_png(dropped / "at.png").astype(int) - drawn).mean() < 0.1  # meshes of 16 bits a coordinate
    assert (read_png(dropped / "last.png") == drawn).all()
    forces = recorded.Recorded(held, held.looks).forces(200).force
    assert forces == pytest.approx(picture.Forces.of(simulator.contacts).force, rel=1e-6, abs=1e-6)


def test_the_film_of_a_run_is_the_film_of_its_recording(dropped):
    result = invoke("video", dropped / "r.h5", dropped / "again.mp4", "--size", "160x96")
    assert result.exit_code == 0, result.output
    run, again = decoded(dropped / "film.mp4"), decoded(dropped / "again.mp4")
    assert len(run) == len(again) == 6
    assert all(np.abs(a - b).mean() < 1.0 for a, b in zip(run, again, strict=True))


def test_a_part_of_a_recording_at_another_speed(dropped):
    result = invoke(
        "video", dropped / "r.h5", dropped / "part.mp4", "--size", "160x96", "--from", 0.1, "--to", 0.2,
        "--speed", 0.25, "--fps", 20, "--no-forces", "--collision",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert len(decoded(dropped / "part.mp4")) == 8


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["picture", "r.h5", "x.jpg"], "x.jpg: must end in .png"),
        (["picture", "r.h5", "nowhere/x.png"], "there is no such folder"),
        (["picture", "none.h5", "x.png"], "there is no such file"),
        (["picture", "r.h5", "x.png", "--time", "0.3"], "time: is 0.3, must be in [0, 0.2] s"),
        (["picture", "r.h5", "x.png", "--time", "nan"], "time: is nan, must be in [0, 0.2] s"),
        (["picture", "r.h5", "x.png", "--size", "big"], "size: is 'big', must be WIDTHxHEIGHT"),
        (["picture", "r.h5", "x.png", "--size", "8x100"], "size: width is 8, must be a whole number in [16, 4096]"),
        (["picture", "r.h5", "x.png", "--size", "100x9000"], "size: height is 9000"),
        (["video", "r.h5", "x.avi"], "x.avi: must end in .mp4"),
        (["video", "r.h5", "x.mp4", "--size", "161x96"], "size: width is 161, must be an even number in [16, 4096]"),
        (["video", "r.h5", "x.mp4", "--fps", "0"], "fps: is 0.0, must be in [1, 240]"),
        (["video", "r.h5", "x.mp4", "--speed", "-1"], "speed: is -1.0, must be in [0.001, 1000]"),
        (["video", "r.h5", "x.mp4", "--from", "0.3"], "from: is 0.3, must be in [0, 0.2] s"),
        (["video", "r.h5", "x.mp4", "--from", "0.1", "--to", "0.1"], "to: is 0.1, must be in (0.1, 0.2] s"),
        (["run", "cube-stack", "--duration", "0.1", "--picture", "x.gif"], "x.gif: must end in .png"),
        (["run", "cube-stack", "--duration", "0.1", "--video", "x.png"], "x.png: must end in .mp4"),
        (["run", "cube-stack", "--picture-time", "0.1"], "--picture-time: has no effect without --picture"),
        (
            ["run", "cube-stack", "--duration", "0.1", "--picture", "x.png", "--picture-time", "2"],
            "picture-time: is 2.0, must be in [0, 0.1] s",
        ),
    ],
)
def test_bad_input_is_refused_by_name_and_range(dropped, monkeypatch, arguments, words):
    monkeypatch.chdir(dropped)
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())
    assert not (dropped / arguments[-1]).with_name("x.png").exists()


@pytest.mark.parametrize(("missing", "command"), [("embreex", "picture"), ("PIL", "picture"), ("PIL", "video")])
def test_a_missing_package_is_named(dropped, monkeypatch, missing, command):
    for name in list(sys.modules):
        if name == missing or name.startswith(missing + "."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    output = dropped / f"missing.{'png' if command == 'picture' else 'mp4'}"
    result = invoke(command, dropped / "r.h5", output, "--size", "32x32")
    assert result.exit_code == 2
    assert "pip install 'signorini[view]'" in " ".join(result.output.split())
    assert not output.exists()


@pytest.mark.parametrize(
    ("images", "count", "words"),
    [
        ([], 0, "count: is 0, must be at least 1"),
        ([(200, 320, 3)], 2, "images: are 1, must be 2"),
        ([(100, 100, 3)], 1, r"images: one has shape \(100, 100, 3\), must be \(200, 320, 3\)"),
    ],
)
def test_pictures_that_are_no_film_are_refused(tmp_path, images, count, words):
    with pytest.raises(InvalidInputError, match=words):
        video.write_mp4(tmp_path / "x.mp4", [np.zeros(shape, np.uint8) for shape in images], count, SIZE)
    assert not (tmp_path / "x.mp4").exists()


def test_a_film_of_one_picture(tmp_path):
    video.write_mp4(tmp_path / "x.mp4", [np.full((200, 320, 3), (200, 30, 60), np.uint8)], 1, SIZE)
    data = (tmp_path / "x.mp4").read_bytes()
    assert struct.unpack(">I", inside(data, "moov/trak/mdia/minf/stbl/stsz")[8:12]) == (1,)
    scale, duration = struct.unpack(">II", inside(data, "moov/mvhd")[12:20])
    assert duration / scale == pytest.approx(1 / 30)
