"""Pages of recordings and of running simulations: what is put on them, and how a headless Chromium shows it."""

import re
import signal
import socket
import subprocess
import sys
import threading
import time

import browser
import numpy as np
import pytest
from typer.testing import CliRunner

from signorini import InvalidInputError, Simulator, recording, scenes
from signorini.cli.main import app
from signorini.view.looks import Mesh

pytest.importorskip("viser")
from signorini.view import stage, viewer

needs_browser = pytest.mark.skipif(browser.find() is None, reason="there is no Chromium here")
SIZE = (960, 600), 0.4  # few pixels, since a processor draws them
SIGNORINI = [sys.executable, "-c", "from signorini.cli.main import main; main()"]


@pytest.fixture(scope="module")
def falling(tmp_path_factory):
    """Two cubes, the upper one sliding off the lower one: 0.5 s."""
    path = tmp_path_factory.mktemp("view") / "cubes.h5"
    start = scenes.worlds()["cube-stack"](num_cubes=2, mass_ratio=3.0, friction=0.1, slip=1.0)
    simulator = Simulator(start.world)
    simulator.state.v = start.v
    with recording.Recorder(path, simulator, {"scene": "cube-stack"}) as recorder:
        recorder.run(500)
    return path


@pytest.fixture(scope="module")
def chromium():
    with browser.Browser(offline=True) as opened:  # what it shows needs no network
        yield opened


def shown(page):
    """Pixels of bodies: the rest of a page is grey. Left of the panel, right of viser's word about software rendering.

    Chromium without a graphics card takes a while until they are there."""
    pixels = page.picture()[:200, 120:228].astype(int)
    return np.ptp(pixels, axis=2) > 25


def wait_for_bodies(page):
    browser.wait_for(lambda: shown(page).sum() > 300, 90)
    return shown(page)


class Served:
    """A viewer that serves from a thread of its own."""

    def __init__(self, path):
        held = recording.read(path)
        self.viewer = viewer.view(held, held.looks, "cubes", port=0, shadows=False)
        self._thread = threading.Thread(target=self.viewer.serve)
        self._thread.start()

    def __enter__(self):
        return self.viewer

    def __exit__(self, *_):
        self.viewer.close()
        self._thread.join(20)
        assert not self._thread.is_alive()


def says(page, words):
    return re.search(rf"^{words}$", re.sub(r"\t+|(?<=\d)\n", " ", page.text()), re.MULTILINE) is not None


def steps(page):
    found = re.search(r"steps made\s+(\d+)", page.text())
    return int(found[1]) if found else None


@needs_browser
def test_a_recording_is_shown_to_several_browsers(falling, chromium):
    with Served(falling) as served:
        first, second = (chromium.page(served.url, *SIZE) for _ in range(2))
        before = wait_for_bodies(first)
        browser.wait_for(lambda: steps(second) == 0, 60)
        assert "play" in first.text()
        first.click("step")
        first.click("step")
        browser.wait_for(lambda: steps(first) == steps(second) == 2, 20)  # the same for all
        second.click("step back")
        browser.wait_for(lambda: steps(first) == 1, 20)
        second.close()
        first.click("play")
        browser.wait_for(lambda: (steps(first) or 0) == 500, 60)  # and stops there
        browser.wait_for(lambda: "paused" in first.text(), 20)
        time.sleep(2.0)
        after = shown(first)
        assert (before != after).mean() > 0.02  # the upper cube slid away
        third = chromium.page(served.url, *SIZE)
        browser.wait_for(lambda: steps(third) == 500, 60)  # who comes late sees the same
        assert not first.errors()
        assert all(url.startswith(served.url.replace("localhost", "")[:4]) for url in first.requests())
        first.close()
        third.close()


@needs_browser
def test_an_exported_page_needs_no_network(falling, chromium, tmp_path):
    file = tmp_path / "cubes.html"
    result = CliRunner().invoke(app, ["view", str(falling), "--html", str(file), "--fps", "10", "--no-shadows"])
    assert result.exit_code == 0, result.output
    assert re.search(r"cubes.html: \d+\.\d MB", result.output)
    assert file.stat().st_size < 3e6
    page = chromium.page(file.as_uri(), *SIZE)
    browser.wait_for(lambda: page.place_of("[class*=Slider-track]") is not None, 60)
    wait_for_bodies(page)

    def start_and_end_differ():
        pictures = []
        for share in (0.01, 0.9):
            page.press_at("[class*=Slider-track]", share)  # stops there; going back takes long without a graphics card
            time.sleep(4.0)
            pictures.append(shown(page))
        return (pictures[0] != pictures[1]).mean() > 0.05

    browser.wait_for(start_and_end_differ, 90)
    assert not page.errors()
    assert page.requests() == [file.as_uri()]
    page.close()


@needs_browser
def test_a_running_simulation_is_shown(chromium, tmp_path):
    file = tmp_path / "live.h5"
    command = [*SIGNORINI, "run", "cube-stack", "--option", "num-cubes=2", "--view"]
    command += ["--port", "0", "--no-open", "--no-shadows", "--duration", "1000", "--record", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url = process.stdout.readline().split()[0]
            page = chromium.page(url, *SIZE)
            wait_for_bodies(page)
            browser.wait_for(lambda: (steps(page) or 0) > 100, 60)
            page.click("play")  # pauses
            browser.wait_for(lambda: "paused" in page.text(), 20)
            at = steps(page)
            time.sleep(0.5)
            assert steps(page) == at
            page.click("step")
            browser.wait_for(lambda: steps(page) == at + 1, 20)
            page.click("step back")  # to what was shown before
            browser.wait_for(lambda: steps(page) == at, 20)
            page.close()
        finally:
            process.send_signal(signal.SIGINT)
        output = process.stdout.read()
    assert process.returncode == 0, output
    held = recording.read(file)
    assert (held.complete, held.num_steps) == (False, at + 1)
    assert "steps not solved" in output


def test_view_serves_until_interrupted(falling):
    from urllib.request import urlopen

    command = [*SIGNORINI, "view", str(falling), "--port", "0", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url = process.stdout.readline().split()[0]
            assert re.fullmatch(r"http://localhost:\d+", url)
            assert b"<html" in urlopen(url, timeout=20).read()[:200]
            process.send_signal(signal.SIGINT)
            process.wait(20)
        finally:
            process.kill()
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.h5"], "no such file"),
        (["FILE", "--html", "x.html", "--fps", "0"], "fps: is 0.0, must be in"),
        (["FILE", "--html", "/nowhere/x.html"], "nowhere"),
    ],
)
def test_bad_input_exits_with_2(falling, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["view", *[str(falling) if a == "FILE" else a for a in arguments]])
    assert result.exit_code == 2
    assert message in result.output


def test_forces_cones_and_points(falling):
    """Before anything slid off: the ground carries both cubes and the lower cube carries the upper one, as arrows that
    point up; the cones stand on the contacts with the slope of the coefficient."""
    held = recording.read(falling)
    server = stage.new_server("127.0.0.1", 0)
    try:
        shown = stage.Stage(server, held.looks, stage.Extent.of(held.looks, [held.q[0]]), typical_force=10.0)
        shown.cones = shown.hulls = True
        contacts = held.samples.contacts_of(held.samples.at(20))
        shown.show(held.q[20], contacts)
        arrows = shown._arrows.points.copy()
        force = (arrows[:, 1] - arrows[:, 0]) * 10.0 / (0.2 * shown.extent.size)
        lower = arrows[:, 0, 2] < 0.1
        assert force[lower].sum(axis=0)[2] == pytest.approx(9.81 * 4.0, rel=1e-4)
        assert force[~lower].sum(axis=0)[2] == pytest.approx(9.81 * 3.0, rel=1e-4)
        assert np.linalg.norm(force[~lower].sum(axis=0)[:2]) == pytest.approx(0.1 * 9.81 * 3.0, rel=1e-4)
        assert np.allclose(shown._cones.batched_scales, [0.1, 0.1, 1.0])

        ground = (contacts.position[:, 2] < 0.1)[:, None]  # said the other way round, it looks the same
        turned = recording.Contacts(
            geometries=np.where(ground, contacts.geometries[:, ::-1], contacts.geometries),
            position=contacts.position, gap=contacts.gap, friction=contacts.friction,
            normal=np.where(ground, -contacts.normal, contacts.normal),
            force=np.where(ground, -contacts.force, contacts.force),
        )  # fmt: skip
        shown.show(held.q[20], turned)
        assert np.array_equal(shown._arrows.points, arrows)
        assert np.allclose(np.sort(shown._points.batched_positions[:, 2]), [0.0] * 4 + [0.2] * 4, atol=1e-5)
        assert (shown._points.batched_colors == stage._SLIDE).all()
        assert [group.handle.visible for group in shown._hulls] == [True]
        positions = np.sort(shown._bodies[0].handle.batched_positions[:, 2])
        assert np.allclose(positions, [0.1, 0.3], atol=1e-5)

        shown.hulls = shown.forces = False
        shown.show(held.q[20], contacts)
        assert not shown._arrows.visible
        assert not shown._hulls[0].handle.visible
        shown.show(held.q[0], held.samples.contacts_of(0))  # none
        assert not shown._points.visible
        assert not shown._cones.visible
    finally:
        stage.stop_server(server)


def test_the_camera_looks_at_what_moves():
    start = scenes.worlds()["cube-stack"](num_cubes=10)
    looks = stage.Looks.of(start.world)
    extent = stage.Extent.of(looks, [start.q])
    assert extent.center[2] == pytest.approx(1.0, abs=0.1)
    assert extent.size == pytest.approx(2.0, rel=0.15)
    far = start.q.copy()
    far[start.world.q_slice("cube-9")][:1] = 1.0
    assert stage.Extent.of(looks, [start.q, far, np.full_like(far, np.nan)]).size < 2.5


def test_a_live_page_goes_at_the_speed_that_is_wanted():
    simulator = Simulator(scenes.worlds()["cube-stack"](num_cubes=1).world)
    with viewer.LiveViewer(simulator, "cube", port=0) as page:
        page.play()
        started, done = time.monotonic(), 0
        while done < 200:
            count = page.allow(1000)
            page.add(simulator.run(count))
            done += count
        assert time.monotonic() - started > 0.19  # 200 steps of 1 ms
        assert simulator.state.time == pytest.approx(done * 1e-3)
        page._button_pressed(type("Event", (), {}))  # nothing was pressed last: a step back, and a pause
        page._take_wishes()
        assert page._row == len(page._live.time) - 2
        page._steps = 2  # to the end of what there is, and one beyond
        assert page.allow(1000) == 1
        page.finish()
        page._steps = 1
        page._take_wishes()
        assert page._single == 0
        threading.Timer(0.2, page.stop).start()
        page.serve()


def test_sharp_edges_are_doubled_and_round_ones_are_not():
    from signorini.view.drawables import _box, _half_circle, _turned

    def count(vertices, triangles):
        mesh = Mesh(np.asarray(vertices, np.float32), triangles)
        new, faces = stage.creased(mesh, np.ones(3))
        assert np.array_equal(new[faces], mesh.vertices[mesh.triangles])
        return len(new)

    assert count(*_box(np.ones(3))) == 24
    ball = _turned(_half_circle(1.0, 0.0))
    assert count(*ball) == len(ball[0])
    vertices, triangles = _turned(np.array([[0.0, -1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 1.0]]), count=24)
    assert count(vertices, triangles) == 2 * 24 + 2 * 25  # a cylinder: its side, and two lids with their centres


def test_cones_stand_on_any_normal():
    from scipy.spatial.transform import Rotation

    normals = np.random.default_rng(0).standard_normal((50, 3))
    normals = np.vstack([normals / np.linalg.norm(normals, axis=1, keepdims=True), [[0, 0, 1], [0, 0, -1]]])
    turned = Rotation.from_quat(np.roll(stage._from_z(normals), -1, axis=1)).apply([0.0, 0.0, 1.0])
    assert np.allclose(turned, normals, atol=1e-5)


def test_the_present_time_is_an_upright_in_the_plots():
    when, lines = np.linspace(0.0, 1.0, 11), (np.arange(11.0) ** 2,)
    for now in (0.0, 0.25, 0.3, 1.0, 7.0):
        time_of, line, mark = viewer._marked(when, lines, now)
        assert (np.diff(time_of) >= 0.0).all()
        assert np.allclose(line, np.interp(time_of, when, lines[0]))
        assert np.flatnonzero(mark == 100.0).tolist() == [int(np.argmax(mark))]
        assert time_of[np.argmax(mark)] == min(now, 1.0)
    many = np.random.default_rng(0).random(10_000)
    thin, worst = viewer._thinned(np.linspace(0.0, 1.0, 10_000), many, np.max)
    assert len(thin) == len(worst) <= 400
    assert worst.max() == many.max()  # no step that went wrong gets lost


def test_nothing_finite_cannot_be_drawn(falling, tmp_path):
    held = recording.read(falling)
    held.q[:] = np.nan
    with pytest.raises(InvalidInputError, match="no finite row"):
        viewer.write_html(held, held.looks, tmp_path / "x.html")


def test_a_taken_port_or_a_foreign_address_is_an_error():
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(OSError, match="cannot listen"):
        stage.new_server("127.0.0.1", taken.getsockname()[1])
    with pytest.raises(OSError, match="cannot listen"):
        stage.new_server("192.0.2.1", 0)  # RFC 5737: nobody's
