"""What is seen of a recording at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from signorini._core import InvalidInputError
from signorini.view.drawables import Drawable
from signorini.view.picture import SIZE, Array, Forces, Stage

if TYPE_CHECKING:
    from signorini.recording import Recording
    from signorini.view.looks import Looks


class Recorded:
    """Bodies and contact forces of a recording.

    held = recording.read("fall.h5")
    shown = Recorded(held, held.looks)
    stage = shown.stage()
    row = shown.row(0.5)
    stage.draw(shown.q(row), shown.forces(row), camera=stage.camera([shown.q(row)]))
    """

    def __init__(self, recording: Recording, looks: Looks) -> None:
        """looks: the recording's own; of those of version 1, which have none, the world's."""
        self._recording, self._looks = recording, looks

    @property
    def time_step(self) -> float:
        """[s]"""
        return self._recording.settings.time_step

    @property
    def duration(self) -> float:
        """[s]"""
        return self._recording.num_steps * self.time_step

    def row(self, time: float | None) -> int:
        """The state nearest to a time [s]; None: the last. Raises InvalidInputError when it is not in [0, duration]."""
        if time is None:
            return self._recording.num_steps
        if not 0.0 <= time <= self.duration * (1.0 + 1e-9):
            raise InvalidInputError(f"time: is {time}, must be in [0, {self.duration:g}] s")
        return min(self._recording.num_steps, round(time / self.time_step))

    def q(self, row: int) -> Array:
        """Configuration."""
        return np.asarray(self._recording.q[row])

    def forces(self, row: int) -> Forces | None:
        """Contact forces of the last sample there; None where the recording holds none (version 1)."""
        samples = self._recording.samples
        if not len(samples.row):
            return None
        contacts = samples.contacts_of(samples.at(row))
        body = np.array([geometry["body"] for geometry in self._looks.geometries], dtype=np.int64)
        sign = np.where(body[contacts.geometries[:, 1]] == 0, -1.0, 1.0)[:, None]
        return Forces(contacts.position.astype(np.float64), sign * contacts.force)

    def stage(self, *, collision: bool = False, size: tuple[int, int] = SIZE) -> Stage:
        looks = self._looks
        parts = [
            Drawable(
                name=str(i),
                body=int(looks.body[i]),
                vertices=looks.center[i] + looks.scale[i] * looks.meshes[mesh].vertices,
                triangles=looks.meshes[mesh].triangles,
                color=tuple(looks.color[i]),
                collision=bool(looks.collision[i]),
                flat=bool(looks.flat[i]),
            )
            for i, mesh in enumerate(looks.mesh)
        ]
        return Stage(parts, looks.placements, collision=collision, size=size)


def interval(start: float | None, end: float | None, duration: float) -> tuple[float, float]:
    """Start and length [s] of a part of a film, or InvalidInputError."""
    first = 0.0 if start is None else start
    last = duration if end is None else end
    if not 0.0 <= first <= duration:
        raise InvalidInputError(f"from: is {first}, must be in [0, {duration:g}] s")
    if not first < last <= duration * (1.0 + 1e-9) or not math.isfinite(last):
        raise InvalidInputError(f"to: is {last}, must be in ({first:g}, {duration:g}] s")
    return first, last - first
