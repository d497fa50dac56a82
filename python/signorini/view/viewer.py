"""Recordings and running simulations as web pages: a server for several browsers at once, or one HTML file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from os import PathLike
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from signorini import _files
from signorini._core import InvalidInputError
from signorini.recording import ContactReader, Contacts, Recording
from signorini.view.looks import Looks
from signorini.view.stage import Extent, Stage, new_server, stop_server

if TYPE_CHECKING:
    from typing_extensions import Self

    from signorini._simulation import Simulator, Trace

Array = npt.NDArray[np.float64]

FRAME_SECONDS = 1.0 / 30.0
_PLOT_SECONDS = 0.2  # between two drawings of the plots
_PLOT_POINTS = 400
_SPEEDS = {"1/100": 0.01, "1/10": 0.1, "1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0, "4": 4.0}
_FASTEST = "as fast as it gets"
_NEVER = -1.0
_HOLD_SECONDS = 1.5  # an HTML file shows its last frame, before it starts again


class Timeline(Protocol):
    """States in order of time: row 0 is the start."""

    time: Any  # of each row [s]; a sequence that may grow
    time_step: float

    def q(self, row: int) -> npt.ArrayLike: ...
    def contacts(self, row: int) -> Contacts: ...
    def facts(self, row: int) -> tuple[int, float, float]:
        """Steps made, certificate of the last one, its deepest overlap [m]; nan where there is none."""

    def certificates(self) -> tuple[Array, Array]:
        """Times [s], certificates."""

    def energies(self) -> tuple[Array, Array, Array]:
        """Times [s], kinetic and potential energy [J]."""


class RecordedTimeline:
    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.time: Array = recording.time
        self.time_step = recording.settings.time_step

    def q(self, row: int) -> npt.ArrayLike:
        q: Array = self._recording.q[row]
        return q

    def contacts(self, row: int) -> Contacts:
        samples = self._recording.samples
        return samples.contacts_of(samples.at(row))

    def facts(self, row: int) -> tuple[int, float, float]:
        if row == 0:
            return 0, float("nan"), float("nan")
        return row, float(self._recording.relative[row - 1]), float(self._recording.penetration[row - 1])

    def certificates(self) -> tuple[Array, Array]:
        return self.time[1:], self._recording.relative

    def energies(self) -> tuple[Array, Array, Array]:
        samples = self._recording.samples
        return self.time[samples.row], samples.kinetic, samples.potential


class LiveTimeline:
    """What a running simulation showed: a row whenever add() is called."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._read = ContactReader(simulator)
        self.time: list[float] = []
        self.time_step = simulator.settings.time_step
        self._rows: list[tuple[Array, Contacts, int, float, float]] = []
        self._energies: list[tuple[float, float]] = []
        self.add(None)

    def add(self, trace: Trace | None) -> None:
        """The present state; trace: of the steps since the last row."""
        simulator = self._simulator
        energy = simulator.energy
        relative = float(trace.relative.max()) if trace is not None else float("nan")
        overlap = float(trace.penetration[-1]) if trace is not None else float("nan")
        self.time.append(simulator.state.time)
        self._rows.append(
            (simulator.state.q.copy(), self._read(), int(simulator._core.report.steps), relative, overlap)
        )
        self._energies.append((energy.kinetic, energy.potential))

    def q(self, row: int) -> npt.ArrayLike:
        return self._rows[row][0]

    def contacts(self, row: int) -> Contacts:
        return self._rows[row][1]

    def facts(self, row: int) -> tuple[int, float, float]:
        return self._rows[row][2:]

    def certificates(self) -> tuple[Array, Array]:
        return np.array(self.time[1:]), np.array([row[3] for row in self._rows[1:]])

    def energies(self) -> tuple[Array, Array, Array]:
        energies = np.array(self._energies)
        return np.array(self.time), energies[:, 0], energies[:, 1]


class Viewer:
    """A page at http://HOST:PORT/ that shows a timeline; every browser that opens it sees the same.

    The page's buttons only say what is wanted; the thread that calls serve(), or allow() of a LiveViewer, draws.
    """

    def __init__(
        self,
        timeline: Timeline,
        looks: Looks,
        extent: Extent,
        typical_force: float,
        title: str,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        shadows: bool = True,
        speeds: tuple[str, ...] = tuple(_SPEEDS),
    ) -> None:
        self._timeline = timeline
        self._row = 0
        self._wanted: float | None = None  # time [s] that somebody asked for with the slider
        self._steps = 0  # asked for with the buttons
        self._playing = False
        self._stopped = False
        self._dirty = True
        self._changed = threading.Event()
        self._clock = (time.monotonic(), float(timeline.time[0]))  # playing: wall time and the time shown then
        self._plots_drawn = _NEVER
        self.server = new_server(host, port)
        self.stage = Stage(self.server, looks, extent, typical_force, shadows=shadows)
        self.stage.aim(aside=0.14)  # beside the panel
        self._build_panel(title, speeds)
        self._draw()

    @property
    def url(self) -> str:
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"

    # The page

    def _build_panel(self, title: str, speeds: tuple[str, ...]) -> None:
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(41, 98, 176), control_width="large")
        gui.set_panel_label(title)
        self._text = gui.add_markdown("")
        self._slider = gui.add_slider(
            "time [s]",
            float(self._timeline.time[0]),
            max(float(self._timeline.time[-1]), float(self._timeline.time[0]) + self._timeline.time_step),
            self._timeline.time_step,
            float(self._timeline.time[0]),
        )
        self._buttons = gui.add_button_group("", ("step back", "play", "step"))
        self._speed = gui.add_dropdown("speed", speeds, initial_value="1")
        with gui.add_folder("Show"):
            points = gui.add_checkbox("contact points", True)
            forces = gui.add_checkbox("forces", True)
            scale = gui.add_slider("length of forces", -1.0, 1.0, 0.05, 0.0, hint="Power of ten")
            cones = gui.add_checkbox("friction cones", False)
            hulls = gui.add_checkbox("collision shapes", False)
            shade = gui.add_checkbox("shadows", self.stage.shadows, hint="Slow without a graphics card")
        with gui.add_folder("Certificate, log10 of the relative residual"):
            self._certificate_plot = self._add_plot((("certificate", "#2962b0"),))
        with gui.add_folder("Energy [J]"):
            self._energy_plot = self._add_plot((("kinetic", "#e87722"), ("potential", "#2962b0"), ("total", "#444444")))

        self._slider.on_update(self._slider_moved)
        self._buttons.on_click(self._button_pressed)
        self._speed.on_update(lambda event: self._set_playing(self._playing))
        shade.on_update(lambda event: self.stage.set_shadows(bool(shade.value)))
        self._bind(points, "contacts")
        self._bind(forces, "forces")
        self._bind(cones, "cones")
        self._bind(hulls, "hulls")
        self._bind(scale, "force_scale", lambda exponent: 10.0**exponent)

    def _slider_moved(self, event: Any) -> None:
        if event.client is not None:  # a person; otherwise it is us
            self._playing, self._wanted = False, float(self._slider.value)
            self._notify()

    def _button_pressed(self, event: Any) -> None:
        pressed = self._buttons.value
        if pressed == "play":
            self._set_playing(not self._playing)
        else:
            self._playing = False
            self._steps += 1 if pressed == "step" else -1
            self._notify()

    def _bind(self, handle: Any, field: str, convert: Callable[[Any], Any] = bool) -> None:
        def changed(event: Any) -> None:
            setattr(self.stage, field, convert(handle.value))
            self._notify()

        handle.on_update(changed)

    def _add_plot(self, lines: tuple[tuple[str, str], ...]) -> Any:
        series: list[dict[str, Any]] = [{"label": "time [s]"}]
        series += [{"label": label, "stroke": color, "width": 1.5, "points": {"show": False}} for label, color in lines]
        series.append({"label": "now", "stroke": "#c81e2d", "width": 1.5, "points": {"show": False}})
        empty = tuple(np.zeros(2) for _ in series)
        return self.server.gui.add_uplot(
            empty, tuple(series), scales={"x": {"time": False}}, legend={"show": len(lines) > 1}, height=110
        )

    def _notify(self) -> None:
        self._dirty = True
        self._changed.set()

    def _set_playing(self, playing: bool) -> None:
        times = self._timeline.time
        if playing and not self._playing and self._row >= len(times) - 1 and not self._goes_on():
            self._row = 0
        self._playing = playing
        self._clock = (time.monotonic(), float(times[self._row]))
        self._notify()

    def _goes_on(self) -> bool:
        """Whether there can be more than the timeline has."""
        return False

    # Drawing

    def play(self) -> None:
        self._set_playing(True)

    def stop(self) -> None:
        """Ends serve(); from any thread."""
        self._stopped = True
        self._changed.set()

    def serve(self) -> None:
        """Shows the page until stop()."""
        while not self._stopped:
            self._turn()

    def _turn(self) -> None:
        """Waits for the next frame, or for somebody who wants something, and draws it."""
        started = time.monotonic()
        self._take_wishes()
        if self._playing:
            self._advance()
        if self._dirty:
            self._draw()
        spent = time.monotonic() - started
        self._changed.wait(max(FRAME_SECONDS - spent, 0.5 * spent) if self._playing else None)
        self._changed.clear()

    def _take_wishes(self) -> None:
        last = len(self._timeline.time) - 1
        wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._row = int(np.clip(np.searchsorted(self._timeline.time, wanted - 1e-9), 0, last))
        steps, self._steps = self._steps, 0
        target = self._row + steps
        self._row = int(np.clip(target, 0, last))
        self._wish_beyond(max(0, target - last))

    def _wish_beyond(self, steps: int) -> None:
        pass

    def _advance(self) -> None:
        """Playing back: to the row that is due."""
        times = self._timeline.time
        wall, shown = self._clock
        due = shown + (time.monotonic() - wall) * _SPEEDS.get(str(self._speed.value), np.inf)
        row = int(np.searchsorted(times, due, side="right")) - 1
        if row >= len(times) - 1:
            row = len(times) - 1
            self._playing = self._goes_on()
        if row != self._row:
            self._row = row
            self._dirty = True

    def _draw(self) -> None:
        self._dirty = False
        row, timeline = self._row, self._timeline
        now = float(timeline.time[row])
        contacts = timeline.contacts(row)
        self.stage.show(timeline.q(row), contacts)
        step, relative, overlap = timeline.facts(row)
        with self.server.atomic():
            last = max(float(timeline.time[-1]), float(timeline.time[0]) + timeline.time_step)
            if self._slider.max != last:
                self._slider.max = last
            self._slider.value = now
            self._text.content = _described(step, now, contacts, relative, overlap, self._playing)
            wall = time.monotonic()
            if not self._playing or wall - self._plots_drawn > _PLOT_SECONDS:
                self._plots_drawn = wall
                self._draw_plots(now)

    def _draw_plots(self, now: float) -> None:
        when, relative = self._timeline.certificates()
        if len(when):
            when, worst = _thinned(when, np.nan_to_num(relative, nan=1.0), np.max)
            self._certificate_plot.data = _marked(when, (np.log10(np.maximum(worst, 1e-16)),), now)
        when, kinetic, potential = self._timeline.energies()
        if len(when) > 1:
            thin = np.unique(np.linspace(0, len(when) - 1, _PLOT_POINTS).astype(int))
            when, kinetic, potential = when[thin], kinetic[thin], potential[thin]
            self._energy_plot.data = _marked(when, (kinetic, potential, kinetic + potential), now)

    def close(self) -> None:
        self._stopped = True
        self._changed.set()
        stop_server(self.server)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class LiveViewer(Viewer):
    """The page of a running simulation. Its loop asks the page when to go on:

        with LiveViewer(simulator, "title") as viewer:
            while True:
                count = viewer.allow(100)
                viewer.add(simulator.run(count))

    Playing at the end of what there is means simulating; the slider goes back.
    """

    def __init__(
        self, simulator: Simulator, title: str, *, host: str = "127.0.0.1", port: int = 8080, shadows: bool = True
    ) -> None:
        self._live = LiveTimeline(simulator)
        self._single = 0
        self._over = False
        self._rate = 0.0  # steps a second of wall time
        self._started = _NEVER
        world = simulator.world
        looks = Looks.of(world)
        weight = float(np.linalg.norm(world.gravity)) * sum(body.mass for body in world.bodies)
        moving = max(1, sum(bool(body.joints) for body in world.bodies))
        free = sum(joint.type.name == "free" for joint in world.joints)
        extent = Extent.of(looks, [simulator.state.q])
        super().__init__(
            self._live, looks, extent, weight / max(1, min(moving, free)), title, host=host, port=port,
            shadows=shadows, speeds=(*_SPEEDS, _FASTEST),
        )  # fmt: skip

    def _goes_on(self) -> bool:
        return not self._over

    def _wish_beyond(self, steps: int) -> None:
        self._single += steps if not self._over else 0

    def allow(self, most: int) -> int:
        """Waits until the page wants to see more; returns the number of steps to make, at most `most`."""
        while True:
            self._take_wishes()
            at_end = self._row == len(self._live.time) - 1
            if at_end and self._single > 0:
                self._single -= 1
                return self._begin(1)
            if at_end and self._playing:
                count = self._due()
                if count > 0:
                    return self._begin(min(count, most))
            self._turn()

    def _due(self) -> int:
        speed = _SPEEDS.get(str(self._speed.value))
        if speed is None:
            return max(1, int(self._rate * FRAME_SECONDS))
        wall, shown = self._clock
        due = (time.monotonic() - wall) * speed + shown - self._live.time[-1]
        count = int(due / self._live.time_step)
        affordable = max(1, int(2.0 * self._rate * FRAME_SECONDS))
        if count > affordable:  # slower than wanted: forget what is owed
            count = affordable
            self._clock = (time.monotonic(), self._live.time[-1] + count * self._live.time_step)
        return count

    def _begin(self, count: int) -> int:
        self._started = time.monotonic()
        return count

    def add(self, trace: Trace) -> None:
        """What the steps did, to be shown."""
        if self._started > 0.0:
            self._rate = len(trace.relative) / max(1e-6, time.monotonic() - self._started)
        follow = self._row == len(self._live.time) - 1
        self._live.add(trace)
        if follow:
            self._row += 1
            self._draw()

    def finish(self) -> None:
        """No more steps come; the page plays back what was."""
        self._over, self._playing = True, False
        self._notify()


def view(
    recording: Recording,
    looks: Looks,
    title: str,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    shadows: bool = True,
) -> Viewer:
    """The page of a recording; call serve() of what is returned. Raises InvalidInputError when it has no finite state,
    ImportError without viser, OSError when the port is taken."""
    timeline = RecordedTimeline(recording)
    return Viewer(timeline, looks, *_measures(recording, looks), title, host=host, port=port, shadows=shadows)


def write_html(
    recording: Recording,
    looks: Looks,
    path: str | PathLike[str],
    *,
    fps: float = 30.0,
    shadows: bool = True,
    progress: Callable[[float], None] = lambda share: None,
) -> int:
    """Writes one HTML file that plays a recording, without a network or a server; returns its size in bytes.

    fps: frames a second of simulated time, in (0, 240]. progress: called with the share that is done.
    """
    if not 0.0 < fps <= 240.0:
        raise InvalidInputError(f"fps: is {fps}, must be in (0, 240]")
    server = new_server("127.0.0.1", 0)
    try:
        timeline = RecordedTimeline(recording)
        stage = Stage(server, looks, *_measures(recording, looks), shadows=shadows)
        stage.show(timeline.q(0), timeline.contacts(0))
        serializer = server.get_scene_serializer()
        times = recording.time
        count = max(1, int(np.floor((times[-1] - times[0]) * fps + 1e-9)))
        for k in range(1, count + 1):
            serializer.insert_sleep(1.0 / fps)
            row = int(np.clip(np.searchsorted(times, times[0] + k / fps - 1e-9), 0, len(times) - 1))
            stage.show(timeline.q(row), timeline.contacts(row))
            progress(k / count)
        serializer.insert_sleep(_HOLD_SECONDS)
        text = serializer.as_html()
    finally:
        stop_server(server)
    content = text.encode()
    _files.write(path, content)
    return len(content)


def _measures(recording: Recording, looks: Looks) -> tuple[Extent, float]:
    rows = np.unique(np.linspace(0, recording.num_steps, 40).astype(int))
    finite = [recording.q[row] for row in rows if np.isfinite(recording.q[row]).all()]
    if not finite:
        raise InvalidInputError("recording.q: has no finite row, nothing can be drawn")
    samples = recording.samples
    force = np.linalg.norm(np.nan_to_num(samples.contacts.force), axis=1)
    largest = [
        force[a:b].max() for a, b in zip(samples.last_contact[:-1], samples.last_contact[1:], strict=True) if b > a
    ]
    largest = [value for value in largest if value > 0.0]
    typical = float(np.median(largest)) if largest else 1.0
    return Extent.of(looks, finite), typical


def _described(step: int, now: float, contacts: Contacts, relative: float, overlap: float, playing: bool) -> str:
    def shown(value: float) -> str:
        return f"{value:.1e}" if np.isfinite(value) else "–"

    pressing = int((np.abs(contacts.force).max(axis=1, initial=0.0) > 0.0).sum()) if len(contacts) else 0
    return (
        f"| {'playing' if playing else 'paused'} | {now:.4f} s |\n| :--- | ---: |\n"
        f"| steps made | {step} |\n| contact points, pressing | {len(contacts)}, {pressing} |\n"
        f"| certificate | {shown(relative)} |\n| deepest overlap | {shown(overlap)} m |\n"
    )


def _thinned(when: Array, values: Array, keep: Any) -> tuple[Array, Array]:
    """At most _PLOT_POINTS values: of each stretch, its worst."""
    if len(when) <= _PLOT_POINTS:
        return when, values
    starts = np.linspace(0, len(when), _PLOT_POINTS, endpoint=False).astype(int)
    return when[starts], np.maximum.reduceat(values, starts)


def _marked(when: Array, lines: tuple[Array, ...], now: float) -> tuple[Array, ...]:
    """Lines and, as one more, an upright at the present time: three points at one place, where the lines go on."""
    now = float(np.clip(now, when[0], when[-1]))
    place = int(np.searchsorted(when, now))
    low = min(float(line.min()) for line in lines)
    high = max(float(line.max()) for line in lines)
    if high <= low:
        low, high = low - 0.5, low + 0.5
    mark = np.full(len(when) + 3, low)
    mark[place + 1] = high
    at = [np.interp(now, when, line) for line in lines]
    return (
        np.insert(when, place, [now] * 3),
        *(np.insert(line, place, [value] * 3) for line, value in zip(lines, at, strict=True)),
        mark,
    )
