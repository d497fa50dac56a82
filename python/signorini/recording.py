"""Recordings: what a simulation did, in one HDF5 file that h5py alone can read; docs/recordings.md has the layout.

A file can be read at any time, by others while it grows and after its writer was killed: _hdf5 has how.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NoReturn

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from signorini import _arrays, _files, _hdf5
from signorini._core import InvalidInputError
from signorini._simulation import Simulator, SimulatorSettings, Trace, joined
from signorini._world import Array

if TYPE_CHECKING:
    from signorini.view.looks import Looks

FORMAT = "signorini recording"
VERSION = 2
KEEP_SECONDS = 2.0  # what a killed writer loses at most
SAMPLE_SECONDS = 0.01  # simulated time between two samples, unless told
_CHUNK_BYTES = 2**17
_STEP_ROWS = ("control", "relative", "num_contacts", "seconds", "penetration")
_SAMPLE_ROWS = ("row", "kinetic", "potential", "last_contact")
_CONTACT_ROWS = ("geometries", "position", "normal", "force", "gap", "friction")
#: Of each data set with rows: numpy kinds, and columns (None: it has one dimension; 0: any).
_LAYOUT: dict[str, tuple[str, int | None]] = {
    "q": ("f", 0), "v": ("f", 0), "time": ("f", None), "control": ("f", 0), "relative": ("f", None),
    "num_contacts": ("iu", None), "seconds": ("f", None), "penetration": ("f", None),
    "samples/row": ("iu", None), "samples/kinetic": ("f", None), "samples/potential": ("f", None),
    "samples/last_contact": ("iu", None),
    "contacts/geometries": ("iu", 2), "contacts/position": ("f", 3), "contacts/normal": ("f", 3),
    "contacts/force": ("f", 3), "contacts/gap": ("f", None), "contacts/friction": ("f", None),
}  # fmt: skip
_TAG_BYTES = 25  # of Simulator.save(): length and text of what names its version
_LARGEST_COMPRESSION = 1032  # deflate cannot do better, so a data set that claims more is damaged


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contact points of one step, open ones within the margin too; n rows each.

    geometries: (n, 2), indices of a and b. position: (n, 3), world [m], at the start of the step. normal: (n, 3), from
    a to b. force: (n, 3), on b, world axes [N], mean over the step. gap: signed [m]. friction: the coefficient.
    """

    geometries: NDArray[np.int32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    force: NDArray[np.float32]
    gap: NDArray[np.float32]
    friction: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.gap)


class ContactReader:
    """Reads the contacts of a simulator's last step into arrays."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._friction: dict[tuple[int, int], float] = {}

    def __call__(self) -> Contacts:
        contacts = self._simulator.contacts
        pairs = map(tuple, contacts.geometries.tolist())
        return Contacts(
            geometries=contacts.geometries,
            position=contacts.position.astype(np.float32),
            normal=contacts.normal.astype(np.float32),
            force=contacts.force.astype(np.float32),
            gap=contacts.distance.astype(np.float32),
            friction=np.array([self._friction_of(pair) for pair in pairs], dtype=np.float32),
        )

    def _friction_of(self, pair: tuple[int, int]) -> float:
        if pair not in self._friction:
            self._friction[pair] = float(self._simulator.world._core.material(*pair).friction)
        return self._friction[pair]


@dataclass(frozen=True, eq=False)
class _Block:
    """Rows that belong together, by data set, and where the recording is with them: what came before the block and what
    comes after is whole without it.

    last_row: of q, v and time. last_contact: as in samples. state_hash: of the simulator in the last row.
    """

    rows: dict[str, NDArray[Any]]
    last_row: int
    last_contact: int
    state_hash: str


class Recorder:
    """Writes a recording while a simulator runs.

    with Recorder("fall.h5", simulator, source={"scene": "humanoid"}) as recorder:
        recorder.run(100)

    What was written before an interruption stays readable, also when the process is killed: all but the last two
    seconds [wall time].
    """

    def __init__(
        self,
        path: str | PathLike[str],
        simulator: Simulator,
        source: Mapping[str, Any],
        contacts_every: int | None = None,
    ) -> None:
        """source: what the world came from, kept as JSON for `replay`. contacts_every: steps between two samples of
        contacts and energy; default: 10 ms of simulated time.

        Raises OSError where the file cannot be written, InvalidInputError on a bad source or contacts_every.
        """
        self._every = max(1, round(SAMPLE_SECONDS / simulator.settings.time_step))
        if contacts_every is not None:
            self._every = _arrays.count("contacts_every", contacts_every, 1)
        self._simulator = simulator
        self._contacts = ContactReader(simulator)
        self._path = _files.checked(path)
        if self._path.exists() and (kind := _files.special(self._path)):
            raise InvalidInputError(f"{self._path}: is {kind}, must be a file")
        try:
            kept = {"source": json.dumps(dict(source)), "settings": json.dumps(asdict(simulator.settings))}
        except (TypeError, ValueError) as error:
            raise InvalidInputError(f"source: is {source!r}, must be a mapping that JSON can hold ({error})") from None
        state = simulator.state
        first = {"q": state.q[None].copy(), "v": state.v[None].copy(), "time": np.array([state.time])}
        first |= self._sample(0, 0)
        self._blocks = [_Block(first, 0, 0, simulator.state_hash)]  # the first of them is in the file
        _files.write(self._path, _hdf5.made(lambda file: self._begin(file, kept)))
        self._file = self._path.open("r+b", buffering=0)
        self._kept = time.monotonic()

    def _begin(self, file: h5py.File, kept: Mapping[str, str]) -> None:
        from signorini.view.looks import Looks

        simulator, attributes = self._simulator, file.attrs
        attributes["format"], attributes["version"] = FORMAT, VERSION
        for name, words in kept.items():
            attributes[name] = words
        attributes["time_step"] = simulator.settings.time_step
        attributes["contacts_every"] = self._every
        attributes["complete"], attributes["state_hash"] = 0, ""
        file["start"] = np.frombuffer(simulator.save(), np.uint8)
        for name, values in Looks.of(simulator.world).arrays().items():
            file.create_dataset(
                f"looks/{name}", data=values, **({"shuffle": True, "compression": "gzip"} if values.size else {})
            )
        real, small = np.float64, np.float32
        columns: list[tuple[str, int | None, Any]] = [
            ("q", simulator.state.q.size, real), ("v", simulator.state.v.size, real), ("time", None, real),
            ("control", simulator.control.size, real), ("relative", None, real), ("num_contacts", None, np.int32),
            ("seconds", None, real), ("penetration", None, real),
            ("samples/row", None, np.int64), ("samples/kinetic", None, real), ("samples/potential", None, real),
            ("samples/last_contact", None, np.int64),
            ("contacts/geometries", 2, np.int32), ("contacts/position", 3, small), ("contacts/normal", 3, small),
            ("contacts/force", 3, small), ("contacts/gap", None, small), ("contacts/friction", None, small),
        ]  # fmt: skip
        for name, width, kind in columns:
            row_bytes = np.dtype(kind).itemsize * max(1, width or 1)
            shape = (0,) if width is None else (0, width)
            most = (None, *(extent or None for extent in shape[1:]))  # without actuators, control has width 0
            chunks = (int(np.clip(_CHUNK_BYTES // row_bytes, 1, 512)), *(max(1, extent) for extent in shape[1:]))
            file.create_dataset(
                name, shape, kind, maxshape=most, chunks=chunks, shuffle=True, compression="gzip", compression_opts=1
            )
        _append(file, self._blocks)

    def run(
        self, num_steps: int, controls: ArrayLike | None = None, *, controller: Callable[[], None] | None = None
    ) -> Trace:
        """Simulator.run(), recorded. controls: num_steps x num_controls, or None: the control as it is, or as the
        controller sets it.

        Raises as that does; InvalidInputError where the simulator is no longer as the last recorded step left it, which
        would leave a hole; OSError where the file cannot be written, which keeps what was written before.
        """
        num_steps = _arrays.count("num_steps", num_steps, 0)
        if self._file.closed:
            raise InvalidInputError("recorder: is closed")
        if self._simulator.state_hash != self._blocks[-1].state_hash:
            raise InvalidInputError(
                f"simulator: is no longer as after step {self._blocks[-1].last_row} of {self._path}; a recording has "
                "every step, and ends there"
            )
        given = None if controls is None else _arrays.numbers("controls", controls)
        if given is not None and given.shape[:1] != (num_steps,):
            width = self._simulator.control.size
            raise InvalidInputError(f"controls: has shape {given.shape}, must be ({num_steps}, {width})")
        traces: list[Trace] = []
        done = 0
        while done < num_steps or not traces:
            count = min(num_steps - done, self._every - self._blocks[-1].last_row % self._every)
            applied = None if given is None else given[done : done + count]
            parts: list[Trace] = []
            try:
                for part in self._simulator._traces(count, applied, controller, True):
                    parts.append(part)
                    self._simulator._check_solved()
            finally:
                if parts:
                    traces.append(joined(parts))
                    self._add(traces[-1])
            done += count
            if time.monotonic() - self._kept > KEEP_SECONDS:
                with _hdf5.signals_later():
                    self._keep()
        return joined(traces)

    def _add(self, trace: Trace) -> None:
        states, controls = trace.states, trace.controls
        assert states is not None
        steps, num_q = len(states), self._simulator.state.q.size
        if steps == 0:
            return
        time_step, last = self._simulator.settings.time_step, self._blocks[-1]
        rows = {
            "q": states[:, :num_q],
            "v": states[:, num_q:],
            "time": self._simulator.state.time - time_step * np.arange(steps - 1, -1, -1),
            "control": np.tile(self._simulator.control, (steps, 1)) if controls is None else controls,
            **{name: getattr(trace, name) for name in _STEP_ROWS[1:]},
        }
        row, contact = last.last_row + steps, last.last_contact
        if row % self._every == 0:
            contacts = self._contacts()
            contact += len(contacts)
            rows |= {f"contacts/{name}": getattr(contacts, name) for name in _CONTACT_ROWS}
            rows |= self._sample(row, contact)
        self._blocks.append(_Block(rows, row, contact, self._simulator.state_hash))

    def _sample(self, row: int, last_contact: int) -> dict[str, NDArray[Any]]:
        energy = self._simulator.energy
        values = row, energy.kinetic, energy.potential, last_contact
        return {f"samples/{name}": np.array([value]) for name, value in zip(_SAMPLE_ROWS, values, strict=True)}

    def _keep(self, complete: int | None = None) -> None:
        """Writes the blocks that the file has not; later, if others read it just now and there is time."""
        patient = complete is None and time.monotonic() - self._kept < 10.0 * KEEP_SECONDS

        def write(file: h5py.File) -> None:
            there = len(file["time"]) - 1  # also of a change that an error came after
            _append(file, [block for block in self._blocks if block.last_row > there])
            if complete is not None:
                file.attrs["complete"], file.attrs["state_hash"] = complete, self._blocks[-1].state_hash

        try:
            if _hdf5.change(self._file.fileno(), write, patient=patient):
                del self._blocks[:-1]
                self._kept = time.monotonic()
        except OSError as error:
            error.filename = error.filename or str(self._path)
            raise

    def close(self, *, complete: bool = True) -> None:
        """Writes what is left. complete: whether the run ended as planned. Raises OSError."""
        with _hdf5.signals_later():
            if self._file.closed:
                return
            try:
                self._keep(int(complete))
            finally:
                self._file.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close(complete=kind is None)
        finally:
            self.close(complete=False)  # an interruption came before it had begun


def _append(file: h5py.File, blocks: Sequence[_Block]) -> None:
    for name in _LAYOUT:
        rows = [block.rows[name] for block in blocks if name in block.rows]
        if rows:
            data, added = file[name], np.concatenate(rows)
            size = len(data)
            data.resize(size + len(added), axis=0)
            data[size:] = added


@dataclass(frozen=True, eq=False)
class Samples:
    """Of the start and of every contacts_every-th step. row: of q, v and time, which it belongs to; kinetic, potential:
    energy of that state [J]; last_contact: one past its last contact; contacts: of all samples, one after the other,
    the start having none."""

    row: NDArray[np.int64]
    kinetic: Array
    potential: Array
    last_contact: NDArray[np.int64]
    contacts: Contacts

    def at(self, row: int) -> int:
        """The last sample at or before a row."""
        return max(0, int(np.searchsorted(self.row, row, side="right")) - 1)

    def contacts_of(self, sample: int) -> Contacts:
        first = int(self.last_contact[sample - 1]) if sample > 0 else 0
        part = slice(first, int(self.last_contact[sample])) if len(self.last_contact) else slice(0)
        return Contacts(**{name: getattr(self.contacts, name)[part] for name in _CONTACT_ROWS})


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """A recording read back: docs/recordings.md has the fields. Step k leads from q[k], v[k] to q[k + 1], v[k + 1].

    state_hash: of the last state; empty when the writer was killed. samples: empty in version 1.
    """

    source: dict[str, Any]
    settings: SimulatorSettings
    state_hash: str
    complete: bool
    start: bytes
    q: Array
    v: Array
    time: Array
    control: Array
    relative: Array
    num_contacts: NDArray[np.int32]
    seconds: Array
    penetration: Array
    samples: Samples
    looks_arrays: dict[str, NDArray[Any]]

    @property
    def num_steps(self) -> int:
        return len(self.relative)

    @cached_property
    def looks(self) -> Looks | None:
        """Meshes and joints, to draw it; None in files of version 1. Raises InvalidInputError when they are damaged."""
        from signorini.view.looks import Looks

        if not self.looks_arrays:
            return None
        try:
            looks = Looks.from_arrays(self.looks_arrays)
            num_q = looks.num_q
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
            raise InvalidInputError(f"looks: are damaged ({error})") from None
        if self.q.shape[1] != num_q:
            raise InvalidInputError(f"looks: are damaged (for {num_q} values of q, not {self.q.shape[1]})")
        touching = self.samples.contacts.geometries
        if touching.size and not 0 <= touching.min() <= touching.max() < len(looks.geometries):
            raise InvalidInputError("contacts/geometries: name geometries that are not there")
        return looks


def read(path: str | PathLike[str]) -> Recording:
    """Reads a recording, also one that is still being written or whose writer was killed.

    Raises InvalidInputError naming file and defect: not HDF5, damaged, not a recording, newer.
    """
    path = Path(path)
    if not path.is_file():
        raise InvalidInputError(f"{path}: {'is no file' if path.exists() else 'there is no such file'}")
    try:
        with _hdf5.opened(path) as file:
            return _read(path, file)
    except (OSError, LookupError, ValueError, TypeError, RuntimeError, ArithmeticError, MemoryError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{path}: is not a readable recording ({error})") from None


def is_recording(path: str | PathLike[str]) -> bool:
    """Whether a file is HDF5 that says it is a recording of signorini; it may be damaged all the same."""
    try:
        with _hdf5.opened(Path(path)) as file:
            return bool(file.attrs.get("format") == FORMAT)
    except (OSError, LookupError, ValueError, TypeError, RuntimeError):
        return False


def _read(path: Path, file: h5py.File) -> Recording:
    held = _Held(path, file)
    if file.attrs.get("format") != FORMAT:
        raise InvalidInputError(f"{path}: is an HDF5 file, but not a recording of signorini")
    version = held.integer("version", 1)
    if version > VERSION:
        raise InvalidInputError(f"{path}: has version {version}, this program reads up to {VERSION}")
    complete = bool(held.integer("complete", 0, 1))
    # What earlier writers left may hold more of one data set than of another: as many steps count as all of them have.
    per_state = ["q", "v"] if version == 1 else ["q", "v", "time"]
    per_step = [name for name in _STEP_ROWS if version > 1 or name != "penetration"]
    data = {name: held.rows(name) for name in per_state + per_step}
    lengths = {name: len(values) for name, values in data.items()}
    steps = lengths["relative"]
    if not complete and version > 1:
        steps = min([lengths[name] - 1 for name in per_state] + [lengths[name] for name in per_step])
    if steps < 0:
        raise InvalidInputError(f"{path}: holds no state yet")
    rows: dict[str, Any] = {}
    for name, length in lengths.items():
        wanted = steps + 1 if name in per_state else steps
        if length < wanted or (complete and length > wanted):
            raise InvalidInputError(f"{path}: is damaged: {name} has {length} rows, must have {wanted}")
        rows[name] = data[name][:wanted]
    settings = held.settings()
    if version == 1:
        rows["time"], rows["penetration"] = settings.time_step * np.arange(steps + 1), np.full(steps, np.nan)
    else:
        held.integer("contacts_every", 1)
        bad = np.flatnonzero(~np.isfinite(rows["time"]))
        if bad.size:
            held.fail(f"time[{bad[0]}]", f"is {rows['time'][bad[0]]}, must be finite")
    return Recording(
        source=held.json("source"),
        settings=settings,
        state_hash=held.text("state_hash"),
        complete=complete,
        start=held.array("start", "u", 1)[()].tobytes(),
        samples=_read_samples(held, steps, complete),
        looks_arrays={name: held.array(f"looks/{name}", "iuf")[()] for name in file["looks"]} if version > 1 else {},
        **rows,
    )


class _Held:
    """An open recording whose every claim is checked before it is used."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self._path = path
        self._file = file

    def fail(self, field: str, message: str) -> NoReturn:
        raise InvalidInputError(f"{self._path}: is damaged, not a readable recording: {field}: {message}")

    def has(self, name: str) -> bool:
        return name in self._file

    def _attribute(self, name: str) -> Any:
        if name not in self._file.attrs:
            self.fail(name, "is missing")
        return self._file.attrs[name]

    def integer(self, name: str, lowest: int, highest: int = 2**31 - 1) -> int:
        value = self._attribute(name)
        if not isinstance(value, np.integer) or not lowest <= value <= highest:
            self.fail(name, f"is {value!r}, must be an integer in [{lowest}, {highest}]")
        return int(value)

    def text(self, name: str) -> str:
        value = self._attribute(name)
        if not isinstance(value, str) or not value.isprintable():
            self.fail(name, f"is {value!r}, must be printable text")
        return value

    def json(self, name: str) -> dict[str, Any]:
        try:
            value = json.loads(self.text(name))
        except (ValueError, RecursionError) as error:
            if isinstance(error, InvalidInputError):
                raise
            self.fail(name, f"is not JSON ({error})")
        if not isinstance(value, dict):
            self.fail(name, f"is {value!r}, must be a JSON object")
        return value

    def settings(self) -> SimulatorSettings:
        time_step = self._attribute("time_step")
        known = {field.name for field in fields(SimulatorSettings)}
        given = {key: value for key, value in self.json("settings").items() if key in known}
        settings = SimulatorSettings(**{"time_step": time_step, **given})
        try:
            settings._to_core()
        except InvalidInputError as error:
            self.fail("settings", str(error))
        if settings.time_step != time_step:
            self.fail("time_step", f"is {time_step!r}, must be {settings.time_step}, that of the settings")
        return settings

    def array(self, name: str, kinds: str, dimensions: int | None = None, width: int | None = None) -> h5py.Dataset:
        """A data set of numbers whose numpy kind is among `kinds`."""
        data = self._file.get(name)
        if not isinstance(data, h5py.Dataset):
            self.fail(name, "is missing" if data is None else "is not a data set")
        if data.shape is None or (dimensions is not None and len(data.shape) != dimensions):
            self.fail(name, f"has shape {data.shape}, must have {dimensions or 'some'} dimensions")
        if width is not None and data.shape[1] != width:
            self.fail(name, f"has shape {data.shape}, must have {width} columns")
        if data.dtype.kind not in kinds:
            self.fail(name, f"has entries of type {data.dtype}, must be {'numbers' if 'f' in kinds else 'integers'}")
        if data.is_virtual or data.external:
            self.fail(name, "keeps its data in another file, which is not supported")
        if data.size * data.dtype.itemsize > _LARGEST_COMPRESSION * data.id.get_storage_size():
            self.fail(name, f"claims {data.size} entries, more than the file holds")
        return data

    def rows(self, name: str) -> h5py.Dataset:
        """A data set as the layout has it, one row a state, step, sample or contact."""
        kinds, width = _LAYOUT[name]
        return self.array(name, kinds, 1 if width is None else 2, width or None)


def _read_samples(held: _Held, steps: int, complete: bool) -> Samples:
    if not held.has("samples"):
        return Samples(
            np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0, np.int64), Contacts(**_no_contacts())
        )
    rows = {name: held.rows(f"samples/{name}")[()] for name in _SAMPLE_ROWS}
    points = {name: held.rows(f"contacts/{name}")[()] for name in _CONTACT_ROWS}
    have = min(len(values) for values in points.values())
    count = min(len(values) for values in rows.values())
    count = int(np.count_nonzero((rows["row"][:count] <= steps) & (rows["last_contact"][:count] <= have)))
    if complete and any(len(values) != count for values in rows.values()):
        held.fail("samples", "or contacts have too few rows")
    rows = {name: values[:count] for name, values in rows.items()}
    row, last = rows["row"].astype(np.int64), rows["last_contact"].astype(np.int64)
    if (np.diff(row, prepend=-1) <= 0).any() or (np.diff(last, prepend=0) < 0).any():
        held.fail("samples", "has rows that do not grow")
    return Samples(contacts=Contacts(**points), **{**rows, "row": row, "last_contact": last})


def _no_contacts() -> dict[str, Any]:
    none = np.zeros(0, np.float32)
    vectors = np.zeros((0, 3), np.float32)
    return {
        "geometries": np.zeros((0, 2), np.int32), "position": vectors, "normal": vectors, "force": vectors,
        "gap": none, "friction": none,
    }  # fmt: skip


def replay(recording: Recording, simulator: Simulator) -> int | None:
    """Runs a recording again; returns the first step after which a state differs in a bit, or its time, certificate or
    number of contacts is another (certificates: not of version 1); -1 for the start, num_steps where only the hash of
    the last state differs, None when all are the same.

    simulator: of an equal world, with the recording's settings. Raises InvalidInputError where it is of another, and
    for recordings by versions of signorini whose states this one cannot read.
    """
    tag = simulator.save()[:_TAG_BYTES]
    if recording.start[:_TAG_BYTES] != tag:
        raise InvalidInputError("was recorded by another version of signorini, which alone can replay it")
    simulator.restore(recording.start)
    for name, size in (("q", simulator.state.q.size), ("v", simulator.state.v.size)):
        has = getattr(recording, name).shape[1]
        if has != size:
            raise InvalidInputError(f"recording.{name}: has {has} values a state, the world has {size}")
    time_step, first = recording.settings.time_step, simulator.state.time
    # But for rounding: recorder and replay sum times up in other blocks.
    apart = 1e-3 * time_step + recording.num_steps * np.spacing(abs(first) + recording.num_steps * time_step)
    states = np.hstack([recording.q, recording.v]).astype(np.float64)
    start = np.concatenate([simulator.state.q, simulator.state.v])
    if start.tobytes() != states[0].tobytes() or abs(recording.time[0] - first) > apart:
        return -1
    certified = len(recording.samples.row) > 0
    step = 0
    while step < recording.num_steps:
        count = min(256, recording.num_steps - step)
        part = slice(step, step + count)
        trace = simulator.run(count, recording.control[part] if simulator.control.size else None, keep_states=True)
        assert trace.states is not None
        now = simulator.state.time - time_step * np.arange(count - 1, -1, -1)
        different = (trace.states.view(np.uint64) != states[step + 1 : step + count + 1].view(np.uint64)).any(axis=1)
        different |= ~(np.abs(recording.time[step + 1 : step + count + 1] - now) <= apart)
        if certified:
            for name in ("relative", "penetration", "num_contacts"):
                ours, theirs = getattr(trace, name), getattr(recording, name)[part]
                different |= (ours != theirs) & ~((ours != ours) & (theirs != theirs))  # NaN is NaN
        if different.any():
            return step + int(np.flatnonzero(different)[0])
        step += count
    if recording.complete and recording.state_hash and simulator.state_hash != recording.state_hash:
        return recording.num_steps
    return None
