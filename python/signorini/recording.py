"""Recordings: what a simulation did, in one HDF5 file that h5py alone can read.

Layout, version 1. Attributes of the root: format ("signorini recording"), version, source (JSON: scene or file, and its
options), settings (JSON), time_step [s], state_hash (of the last state), complete (1 when the run ended as planned).
Data sets: start (bytes of Simulator.save() before the first step), q (steps + 1, num_q) and v (steps + 1, num_v), the
first row being the start, control (steps, num_controls), relative (steps; the certificate), num_contacts (steps),
seconds (steps; wall time). Compressed, except start.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from signorini._core import InvalidInputError
from signorini._simulation import Simulator, SimulatorSettings, Trace
from signorini._world import Array

FORMAT = "signorini recording"
VERSION = 1
_ROWS = ("q", "v", "control", "relative", "num_contacts", "seconds")


class Recorder:
    """Writes a recording while a simulator runs; what was written before an interruption stays readable.

    with Recorder("fall.h5", simulator, source={"scene": "humanoid"}) as recorder:
        recorder.add(simulator.run(100, keep_states=True))
    """

    def __init__(self, path: str | PathLike[str], simulator: Simulator, source: Mapping[str, Any]) -> None:
        """source: what the world came from, kept as JSON for `replay`. Raises OSError where it cannot be written."""
        self._simulator = simulator
        self._file = h5py.File(Path(path), "w")
        attributes = self._file.attrs
        attributes["format"], attributes["version"] = FORMAT, VERSION
        attributes["source"] = json.dumps(dict(source))
        attributes["settings"] = json.dumps(asdict(simulator.settings))
        attributes["time_step"] = simulator.settings.time_step
        attributes["complete"] = 0
        self._file["start"] = np.frombuffer(simulator.save(), np.uint8)
        widths = {
            "q": simulator.state.q.size,
            "v": simulator.state.v.size,
            "control": simulator.control.size,
            "relative": None,
            "num_contacts": None,
            "seconds": None,
        }
        for name, width in widths.items():
            shape = (0,) if width is None else (0, width)
            chunks = (1024,) if width is None else (64, max(1, width))
            kind = np.int32 if name == "num_contacts" else np.float64
            most = (None, *(extent or None for extent in shape[1:]))  # without actuators, control has width 0
            self._file.create_dataset(
                name, shape, kind, maxshape=most, chunks=chunks, compression="gzip", compression_opts=4
            )
        self._append("q", simulator.state.q[None])
        self._append("v", simulator.state.v[None])
        self._keep()

    def add(self, trace: Trace) -> None:
        """Appends what run(..., keep_states=True) returned; what had no controls of its own, under the control as it is
        now."""
        if trace.states is None:
            raise InvalidInputError("trace.states: is None, must be kept: run(..., keep_states=True)")
        num_q = self._simulator.state.q.size
        self._append("q", trace.states[:, :num_q])
        self._append("v", trace.states[:, num_q:])
        same = np.tile(self._simulator.control, (len(trace.states), 1))
        self._append("control", same if trace.controls is None else trace.controls)
        self._append("relative", trace.relative)
        self._append("num_contacts", trace.num_contacts)
        self._append("seconds", trace.seconds)
        self._keep()

    def _append(self, name: str, rows: NDArray[Any]) -> None:
        data = self._file[name]
        before = data.shape[0]
        data.resize(before + len(rows), axis=0)
        data[before:] = rows

    def _keep(self) -> None:
        self._file.attrs["state_hash"] = self._simulator.state_hash
        self._file.flush()

    def close(self, *, complete: bool = True) -> None:
        if self._file:
            self._file.attrs["complete"] = int(complete)
            self._file.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(complete=kind is None)


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording read back: see the module for the fields. states(k) of step k are q[k], v[k]; row 0 is the start."""

    source: dict[str, Any]
    settings: SimulatorSettings
    state_hash: str
    complete: bool
    start: bytes
    q: Array
    v: Array
    control: Array
    relative: Array
    num_contacts: NDArray[np.int32]
    seconds: Array

    @property
    def num_steps(self) -> int:
        return len(self.relative)


def read(path: str | PathLike[str]) -> Recording:
    """Reads a recording. Raises InvalidInputError naming file and defect: not HDF5, damaged, not a recording, newer."""
    path = Path(path)
    if not path.is_file():
        raise InvalidInputError(f"{path}: there is no such file")
    try:
        with h5py.File(path, "r") as file:
            return _read(path, file)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{path}: is not a readable recording ({error})") from None


def _read(path: Path, file: h5py.File) -> Recording:
    if file.attrs.get("format") != FORMAT:
        raise InvalidInputError(f"{path}: is an HDF5 file, but not a recording of signorini")
    version = int(file.attrs["version"])
    if version > VERSION:
        raise InvalidInputError(f"{path}: has version {version}, this program reads up to {VERSION}")
    rows = {name: file[name][()] for name in _ROWS}
    steps = len(rows["relative"])
    for name, data in rows.items():
        wanted = steps + 1 if name in ("q", "v") else steps
        if len(data) < wanted:
            raise InvalidInputError(f"{path}: is damaged: {name} has {len(data)} rows, must have {wanted}")
        rows[name] = data[:wanted]
    known = {field.name for field in fields(SimulatorSettings)}
    settings = {k: v for k, v in json.loads(file.attrs["settings"]).items() if k in known}
    return Recording(
        source=json.loads(file.attrs["source"]),
        settings=SimulatorSettings(**settings),
        state_hash=str(file.attrs["state_hash"]),
        complete=bool(file.attrs["complete"]),
        start=file["start"][()].tobytes(),
        **rows,
    )


def replay(recording: Recording, simulator: Simulator) -> int | None:
    """Runs a recording again; returns the first step whose state differs in a bit, or None when all are the same.

    simulator: of an equal world, with the recording's settings.
    """
    simulator.restore(recording.start)
    num_q = simulator.state.q.size
    if recording.q.shape[1:] != (num_q,):
        raise InvalidInputError(f"recording.q: has {recording.q.shape[1]} values a step, the world has {num_q}")
    step = 0
    while step < recording.num_steps:
        count = min(256, recording.num_steps - step)
        controls = recording.control[step : step + count] if simulator.control.size else None
        states = simulator.run(count, controls, keep_states=True).states
        assert states is not None
        wanted = np.hstack([recording.q[step + 1 : step + count + 1], recording.v[step + 1 : step + count + 1]])
        different = np.flatnonzero((states.view(np.uint64) != wanted.view(np.uint64)).any(axis=1))
        if different.size:
            return step + int(different[0])
        step += count
    return None
