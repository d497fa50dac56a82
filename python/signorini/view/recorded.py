"""What is seen of a recording at a time."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from signorini._core import InvalidInputError
from signorini.view.picture import SIZE, Array, Forces, Stage

if TYPE_CHECKING:
    from signorini._simulation import Simulator
    from signorini._world import World
    from signorini.recording import Recording


class Recorded:
    """Bodies and contact forces of a recording.

    shown = Recorded(recording.read("fall.h5"), world)
    stage = shown.stage()
    row = shown.row(0.5)
    stage.draw(shown.q(row), shown.forces(row), camera=stage.camera([shown.q(row)]))
    """

    def __init__(self, recording: Recording, world: World) -> None:
        """world: the one that was recorded, or an equal one."""
        if recording.q.shape[1:] != world.initial_q.shape:
            raise InvalidInputError(
                f"recording.q: has {recording.q.shape[1]} values a step, the world has {len(world.initial_q)}"
            )
        self._recording, self._world = recording, world

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

    def forces(self, row: int) -> Forces:
        """Contact forces of the step that led there, made again from the state before it; none at the start.

        Where the forces are not unique, as under four feet, they may be shared out otherwise than in the recorded step.
        """
        if row == 0:
            return Forces.of([])
        simulator = self._simulator
        simulator.reset()
        simulator.state.q, simulator.state.v = self._recording.q[row - 1], self._recording.v[row - 1]
        if simulator.control.size:
            simulator.control = self._recording.control[row - 1]
        simulator.step()
        return Forces.of(simulator.contacts)

    @cached_property
    def _simulator(self) -> Simulator:
        from signorini._simulation import Simulator

        return Simulator(self._world, self._recording.settings, on_unsolved="continue")

    def stage(self, *, collision: bool = False, size: tuple[int, int] = SIZE) -> Stage:
        return Stage.of_world(self._world, collision=collision, size=size)


def interval(start: float | None, end: float | None, duration: float) -> tuple[float, float]:
    """Start and length [s] of a part of a film, or InvalidInputError."""
    first = 0.0 if start is None else start
    last = duration if end is None else end
    if not 0.0 <= first <= duration:
        raise InvalidInputError(f"from: is {first}, must be in [0, {duration:g}] s")
    if not first < last <= duration * (1.0 + 1e-9) or not math.isfinite(last):
        raise InvalidInputError(f"to: is {last}, must be in ({first:g}, {duration:g}] s")
    return first, last - first
