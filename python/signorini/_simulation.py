"""Stepping a world: Simulator, its settings, what it reports, and many at once."""

from __future__ import annotations

import copy
import operator
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from signorini import _arrays, _core, _simulator
from signorini._core import InvalidInputError
from signorini._problem import Constraint, ContactProblem, Equality, FrictionCone, HalfLine, Interval
from signorini._solution import Residual
from signorini._solve import LawName, SolverName
from signorini._world import WORLD, Array, World

OnUnsolved = Literal["continue", "warn", "raise"]
ContactModeName = Literal["open", "stick", "slide"]
_MODES = np.array(("open", "stick", "slide"))
_BLOCK = 1000  # steps between two looks at Ctrl-C


class UnsolvedStepError(RuntimeError):
    """A step's contact problem was not solved to the tolerance, and on_unsolved is "raise". The step was made, with the
    best impulse found."""


class UnsolvedStepWarning(RuntimeWarning):
    """The same, for on_unsolved="warn"."""


@dataclass(frozen=True)
class SimulatorSettings:
    """How a world is stepped.

    time_step: [s], in [1e-6, 0.1].
    law: "ncp", Signorini and Coulomb with maximum dissipation, or "ccp", its convex relaxation.
    solver, tolerance, max_iterations, facets, impedance: as for solve(); tolerance on the certificate's relative
        residual, of the law: the models of other engines ("lcp-pgs", "convex-newton", "bisection") leave many steps
        unsolved.
    on_unsolved: about a step that is not solved: "continue" (and count it in report.unsolved), "warn", "raise".
    baumgarte: share of an overlap of rigid bodies that a step of 1 ms or more takes back, in [0, 1]; shorter ones take
        back less, in proportion.
    max_correction_speed: limit of that [m/s, rad/s].
    restitution_threshold: approach speed below which nothing bounces [m/s].
    contact_margin: points with a gap up to this, or up to 0.1 um, are part of the problem [m]; None: 2 mm and 3 m/s
        times the time step. What may come nearer by more than either in a step is swept (docs/collision.md).
    """

    time_step: float = 1e-3
    law: LawName = "ncp"
    solver: SolverName = "auto"
    tolerance: float = 1e-6
    max_iterations: int | None = None
    on_unsolved: OnUnsolved = "continue"
    baumgarte: float = 0.2
    max_correction_speed: float = 1.0
    restitution_threshold: float = 0.05
    contact_margin: float | None = None
    facets: int = 4
    impedance: float = 0.9

    def _to_core(self) -> Any:
        core = _simulator.SimulatorSettings()
        for key in (
            "time_step", "tolerance", "baumgarte", "max_correction_speed", "restitution_threshold", "impedance",
        ):  # fmt: skip
            setattr(core, key, _arrays.number(key, getattr(self, key)))
        margin = -1.0 if self.contact_margin is None else _arrays.number("contact_margin", self.contact_margin)
        if self.contact_margin is not None and not margin >= 0.0:
            raise InvalidInputError(f"contact_margin: is {self.contact_margin!r}, must be in [0, 1] m, or None")
        core.contact_margin = margin
        if self.law not in ("ncp", "ccp"):
            raise InvalidInputError(f"law: is {self.law!r}, must be 'ncp' or 'ccp'")
        core.law = _core.Law.__members__[self.law]
        solvers = _core.SolverType.__members__
        if not isinstance(self.solver, str) or self.solver not in solvers:
            raise InvalidInputError(f"solver: is {self.solver!r}, must be one of {', '.join(map(repr, solvers))}")
        core.solver = solvers[self.solver]
        if self.max_iterations is not None:
            core.max_iterations = _arrays.count("max_iterations", self.max_iterations, 1)
        core.facets = _arrays.count("facets", self.facets)
        if self.on_unsolved not in ("continue", "warn", "raise"):
            raise InvalidInputError(f"on_unsolved: is {self.on_unsolved!r}, must be 'continue', 'warn' or 'raise'")
        core.validate()
        return core


@dataclass(frozen=True)
class Contact:
    """A contact point of the last step.

    body_a, body_b, geometry_a, geometry_b: names. position: world [m], at the start of the step.
    normal: unit, from a to b. frame: columns (t1, t2, n) in the world, 3 x 3.
    distance: signed gap at the start of the step [m].
    mode: "open" (no force), "stick" or "slide".
    force: on body b, world axes [N], mean over the step; force_local: the same in the contact frame (t1, t2, n).
    moment_local: on body b of torsion and rolling, in the contact frame, mean over the step [N m].
    velocity: of b relative to a at the end of the step, in the contact frame [m/s].
    id: the same from step to step while the point persists.
    """

    body_a: str
    body_b: str
    geometry_a: str
    geometry_b: str
    position: Array
    normal: Array
    frame: Array
    distance: float
    mode: ContactModeName
    force: Array
    force_local: Array
    moment_local: Array
    velocity: Array
    id: int


def checked(world: Any, settings: Any) -> SimulatorSettings:
    """The settings, or the defaults. Raises InvalidInputError when one of the two is something else."""
    if not isinstance(world, World):
        raise InvalidInputError(f"world: is a {type(world).__name__}, must be a signorini.World")
    if settings is not None and not isinstance(settings, SimulatorSettings):
        raise InvalidInputError(f"settings: is a {type(settings).__name__}, must be a SimulatorSettings, or None")
    return settings or SimulatorSettings()


class ContactList(Sequence[Contact]):
    """Contact points of a step: a sequence of Contact, and columns over all n of them, which are far faster to read.

    A slice, mask or array of indices selects a ContactList: contacts[contacts.mode == "slide"].force.
    geometries: (n, 2), of a and b, indices into world.geometries. mode: (n), "open", "stick" or "slide".
    position, normal, force, force_local, moment_local, velocity: (n, 3); frame: (n, 3, 3); distance, id: (n); each as
    Contact has it.
    """

    def __init__(self, world: World, columns: tuple[NDArray[Any], ...]) -> None:
        geometries, numbers, mode, identity = columns
        self._names = world._names_of_geometries  # no world, which cannot be pickled
        self.geometries: NDArray[np.int32] = geometries
        self.position: Array = numbers[:, :3]
        self.frame: Array = numbers[:, 3:12].reshape(-1, 3, 3)
        self.distance: Array = numbers[:, 12]
        self.force_local: Array = numbers[:, 13:16]
        self.moment_local: Array = numbers[:, 16:19]
        self.velocity: Array = numbers[:, 19:22]
        self.id: NDArray[np.uint64] = identity
        self._mode = mode

    @property
    def normal(self) -> Array:
        return self.frame[:, :, 2]

    @property
    def force(self) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self.frame, self.force_local))

    @property
    def mode(self) -> NDArray[np.str_]:
        return np.asarray(_MODES[self._mode])

    def __len__(self) -> int:
        return len(self.id)

    @overload
    def __getitem__(self, k: int | np.integer[Any]) -> Contact: ...
    @overload
    def __getitem__(self, k: slice | list[Any] | NDArray[Any]) -> ContactList: ...
    def __getitem__(self, k: int | np.integer[Any] | slice | list[Any] | NDArray[Any]) -> Contact | ContactList:
        if isinstance(k, (slice, list, np.ndarray)):
            rows = np.arange(len(self))[k]
            if rows.ndim == 1:
                return self._selected(rows)
        i = operator.index(k)  # type: ignore[arg-type]
        (body_a, geometry_a), (body_b, geometry_b) = (self._names[g] for g in self.geometries[i])
        # Copies: a contact that somebody keeps must not keep the arrays of all of them.
        frame, force = self.frame[i].copy(), self.force_local[i].copy()
        return Contact(
            body_a=body_a,
            body_b=body_b,
            geometry_a=geometry_a,
            geometry_b=geometry_b,
            position=self.position[i].copy(),
            normal=frame[:, 2],
            frame=frame,
            distance=float(self.distance[i]),
            mode=cast(ContactModeName, str(_MODES[self._mode[i]])),
            force=frame @ force,
            force_local=force,
            moment_local=self.moment_local[i].copy(),
            velocity=self.velocity[i].copy(),
            id=int(self.id[i]),
        )

    def _selected(self, rows: NDArray[Any]) -> ContactList:
        selected = copy.copy(self)
        for name, column in vars(self).items():
            if name != "_names":
                setattr(selected, name, column[rows])
        return selected

    def __repr__(self) -> str:
        counts = ", ".join(f"{np.count_nonzero(self.mode == mode)} {mode}" for mode in _MODES)
        return f"ContactList({len(self)} contacts: {counts})"


@dataclass(frozen=True)
class StepReport:
    """What the last step did, and counts since the simulator was made or reset.

    status: "solved" when the certificate holds at the tolerance. residual: that certificate. solver: what found
    the answer. deepest_overlap: at the start of the step [m]. steps, unsolved: counts.
    iterations, factorizations: over all rounds (docs/simulation.md, S18) of the step.
    """

    status: str
    residual: Residual
    solver: str
    iterations: int
    factorizations: int
    num_contacts: int
    num_constraints: int
    deepest_overlap: float
    steps: int
    unsolved: int


@dataclass(frozen=True)
class Energy:
    """[J]; potential: of gravity and joint springs, zero at z = 0."""

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        return self.kinetic + self.potential


class State:
    """Configuration, velocity and time of a simulator, and the activation of actuators that have one; q, v and
    activation are views that can be written to."""

    def __init__(self, core: Any) -> None:
        self._core = core
        self._q, self._v, self._activation = core.q, core.v, core.activation

    def __repr__(self) -> str:
        return f"State(time={self.time:.6g}, q={self._q!r}, v={self._v!r})"

    @property
    def q(self) -> Array:
        """num_q values."""
        return self._q  # type: ignore[no-any-return]

    @q.setter
    def q(self, value: ArrayLike) -> None:
        _fill("q", self._q, value)

    @property
    def v(self) -> Array:
        """num_v values; of a free joint: linear and angular velocity in the frame of the body."""
        return self._v  # type: ignore[no-any-return]

    @v.setter
    def v(self, value: ArrayLike) -> None:
        _fill("v", self._v, value)

    @property
    def activation(self) -> Array:
        """num_controls values; 0 of actuators that have none."""
        return self._activation  # type: ignore[no-any-return]

    @activation.setter
    def activation(self, value: ArrayLike) -> None:
        _fill("activation", self._activation, value)

    @property
    def time(self) -> float:
        """[s]"""
        return float(self._core.time)

    @time.setter
    def time(self, value: float) -> None:
        self._core.time = _arrays.number("time", value)


def _fill(field: str, target: Array, value: ArrayLike) -> None:
    target[:] = _arrays.finite(field, value, target.shape)


@dataclass(frozen=True, eq=False)
class Trace:
    """What run() kept of each step; arrays of num_steps values.

    seconds: wall time. relative: the certificate. penetration: deepest overlap at the start of the step [m].
    states: num_steps x (num_q + num_v), after each step, or None. controls: num_steps x num_controls, under which the
    steps were made, or None: all under the same.
    """

    seconds: Array
    relative: Array
    penetration: Array
    iterations: NDArray[np.int32]
    factorizations: NDArray[np.int32]
    num_contacts: NDArray[np.int32]
    solved: NDArray[np.bool_]
    states: Array | None
    controls: Array | None = None


def joined(traces: Sequence[Trace]) -> Trace:
    """One trace of several, at least one, that follow each other."""
    columns: dict[str, Any] = {}
    for field in fields(Trace):
        values = [getattr(trace, field.name) for trace in traces]
        columns[field.name] = None if values[0] is None else np.concatenate(values)
    return Trace(**columns)


class Simulator:
    """Steps a world.

        simulator = Simulator(world)
        for _ in range(1000):
            simulator.step()
        simulator.state.q, simulator.contacts, simulator.report

    One step of length time_step: velocity without contact; contacts, joint limits, joint friction and equalities as one
    contact problem; its solution, certified; velocity and position (docs/simulation.md; Carpentier et al. 2024, II).
    Not thread-safe; many simulators may share a world. Stepping releases the GIL.
    """

    def __init__(self, world: World, settings: SimulatorSettings | None = None, **changes: Any) -> None:
        """settings: a SimulatorSettings; changes: fields of it by name, e.g. time_step=2e-3.

        Raises InvalidInputError naming the field, its value and what is allowed.
        """
        given = checked(world, settings)
        try:
            self.settings = replace(given, **changes)
        except TypeError:
            known = ", ".join(SimulatorSettings.__dataclass_fields__)
            raise InvalidInputError(f"settings: {', '.join(changes)}: must be among {known}") from None
        self.world = world
        self._core = _simulator.Simulator(world._core, self.settings._to_core())
        self._state = State(self._core)
        self._control = self._core.control
        self._applied_force = self._core.applied_force
        self._external_wrench = self._core.external_wrench
        self._unsolved = 0

    def __repr__(self) -> str:
        report = self._core.report
        return (
            f"Simulator({self.world!r}, time={self.state.time:.6g} s, steps={report.steps}, "
            f"unsolved={report.unsolved}, contacts={report.num_contacts})"
        )

    @property
    def state(self) -> State:
        """q, v and time, readable and writable."""
        return self._state

    @property
    def control(self) -> Array:
        """One value an actuator, writable; world.actuators says in which unit. Kept from step to step."""
        return self._control  # type: ignore[no-any-return]

    @control.setter
    def control(self, value: ArrayLike) -> None:
        _fill("control", self._control, value)

    @property
    def applied_force(self) -> Array:
        """Generalised force on each velocity [N, N m], num_v values, writable; added to everything else."""
        return self._applied_force  # type: ignore[no-any-return]

    @applied_force.setter
    def applied_force(self, value: ArrayLike) -> None:
        _fill("applied_force", self._applied_force, value)

    def set_external_wrench(self, body: str, force: ArrayLike = (0, 0, 0), moment: ArrayLike = (0, 0, 0)) -> None:
        """force [N] at a body's origin and moment [N m], (3,) each, world axes, kept until set again."""
        if body == WORLD:
            raise InvalidInputError('body: is "world", which does not move')
        row = self._external_wrench[self.world.body_index(body)]
        row[:3], row[3:] = _arrays.finite("force", force, (3,)), _arrays.finite("moment", moment, (3,))

    def step(self, num_steps: int = 1) -> None:
        """Makes num_steps time steps.

        Raises InvalidInputError when state, control or a force is not finite, leaving the state; UnsolvedStepError as
        settings.on_unsolved says.
        """
        count = _arrays.count("num_steps", num_steps, 0)
        at_once = _BLOCK if self.settings.on_unsolved == "continue" else 1
        for done in range(0, count, at_once):
            self._core.step(min(at_once, count - done))
            self._check_solved()

    def run(
        self,
        num_steps: int,
        controls: ArrayLike | None = None,
        *,
        controller: Callable[[], None] | None = None,
        keep_states: bool = False,
    ) -> Trace:
        """The same in one go, keeping what each step reported.

        controls: num_steps x num_controls, or None. controller: instead, called before every step to set `control`.
        keep_states: fill Trace.states. Raises as step() does, and for controls of another shape.
        """
        _arrays.flag("keep_states", keep_states)
        traces = []
        for trace in self._traces(num_steps, controls, controller, keep_states):
            traces.append(trace)
            self._check_solved()
        return joined(traces)

    def _traces(
        self, num_steps: int, controls: ArrayLike | None, controller: Callable[[], None] | None, keep_states: bool
    ) -> Iterator[Trace]:
        """The parts of the trace of run(): when it raises, those of all steps before were given."""
        count = _arrays.count("num_steps", num_steps, 0)
        if controller is None:
            yield self._run(count, controls, keep_states)
            return
        if controls is not None:
            raise InvalidInputError("controls: are given, must be None where there is a controller")
        if not callable(controller):
            raise InvalidInputError(f"controller: is a {type(controller).__name__}, must be a function, or None")
        yield replace(self._run(0, None, keep_states), controls=np.empty((0, len(self._control))))
        for _ in range(count):
            controller()
            control = self._control.copy()
            yield replace(self._run(1, None, keep_states), controls=control[None])

    def _run(self, count: int, controls: ArrayLike | None, keep_states: bool) -> Trace:
        given = np.zeros((0, 0)) if controls is None else _arrays.numbers("controls", controls)
        if given.ndim != 2:
            raise InvalidInputError(f"controls: has shape {given.shape}, must be ({count}, {len(self._control)})")
        seconds, relative, penetration = np.empty(count), np.empty(count), np.empty(count)
        iterations, factorizations, num_contacts = (np.empty(count, np.int32) for _ in range(3))
        solved = np.empty(count, np.bool_)
        reports = seconds, relative, penetration, iterations, factorizations, num_contacts, solved
        states = self._core.run(count, given, keep_states, *reports)
        return Trace(*reports, states, None if controls is None else given)

    def _check_solved(self) -> None:
        if self.settings.on_unsolved == "continue":
            return
        count = self._core.report.unsolved
        if count <= self._unsolved:
            return
        self._unsolved = count
        report = self.report
        message = (
            f"contact problem not solved at time {self.state.time:.6g} s ({report.status}): relative residual "
            f"{report.residual.relative:.1e}, over the free velocity {report.residual.against_free_velocity:.1e}, "
            f"tolerance {self.settings.tolerance:.1e}, {report.num_contacts} contacts"
        )
        if self.settings.on_unsolved == "raise":
            raise UnsolvedStepError(message)
        warnings.warn(message, UnsolvedStepWarning, stacklevel=3)

    @property
    def contacts(self) -> ContactList:
        """The contact points of the last step, open ones within the margin too; none after reset() and restore()."""
        return ContactList(self.world, self._core.contacts())

    def contact_force(self, body_a: str, body_b: str) -> Array:
        """Total contact force of body_a on body_b in the last step, world axes [N], (3,)."""
        a, b = self.world.body_index(body_a, "body_a"), self.world.body_index(body_b, "body_b")
        return np.array(self._core.contact_force(a, b))

    @property
    def energy(self) -> Energy:
        """Of the present state."""
        return Energy(self._core.kinetic_energy(), self._core.potential_energy())

    @property
    def momentum(self) -> Array:
        """Linear [kg m/s] and angular about the world's origin [kg m^2/s], 6 values."""
        return np.array(self._core.momentum())

    @property
    def mass_matrix(self) -> Array:
        """num_v x num_v, armature included."""
        return np.array(self._core.mass_matrix())

    @property
    def report(self) -> StepReport:
        """Of the last step, and counts."""
        r = self._core.report
        return StepReport(
            status=r.status.name,
            residual=Residual._from_core(r.residual),
            solver=r.solver.name,
            iterations=r.iterations,
            factorizations=r.factorizations,
            num_contacts=r.num_contacts,
            num_constraints=r.num_constraints,
            deepest_overlap=r.deepest_overlap,
            steps=r.steps,
            unsolved=r.unsolved,
        )

    def body_placement(self, body: str) -> tuple[Array, Array]:
        """(position [m], 3 x 3 rotation) of a body's frame in the world, now."""
        b = self.world.bodies[self.world.body_index(body)]
        frame = self._core.frames()[b.frame]
        return frame.rotation @ b.in_frame.translation + frame.translation, frame.rotation @ b.in_frame.rotation

    def contact_problem(self) -> ContactProblem:
        """The problem of the last step, for solve(), a file (fclib.write), or another solver."""
        arrays = self._core.problem_arrays()
        constraints: list[Constraint] = []
        for kind, first, second in zip(arrays["types"], arrays["first"], arrays["second"], strict=True):
            if kind == 0:
                constraints.append(FrictionCone(first))
            elif kind == 1:
                constraints.append(HalfLine())
            elif kind == 2:
                constraints.append(Interval(first, second))
            else:
                constraints.append(Equality())
        return ContactProblem(
            arrays["delassus"],
            arrays["free_velocity"],
            compliance=arrays["compliance"],
            constraints=constraints,
            name=f"step-{self.report.steps}",
            check=False,
        )

    def reset(self) -> None:
        """Back to the world's initial configuration, at rest, time 0, without controls and forces."""
        self._core.reset()
        self._unsolved = 0

    def save(self) -> bytes:
        """Everything that the next step depends on, warm starts included."""
        return bytes(self._core.save())

    def restore(self, saved: bytes) -> None:
        """Goes on from what save() of an equal simulator returned (saved), bit for bit. Other bytes, damaged ones too,
        raise InvalidInputError and leave the simulator as it is."""
        if not isinstance(saved, bytes):
            raise InvalidInputError(f"saved: is a {type(saved).__name__}, must be bytes from save()")
        self._core.restore(saved)
        self._unsolved = self._core.report.unsolved

    @property
    def state_hash(self) -> str:
        """64 bits of q, v and time, as 16 hexadecimal digits: equal states, equal hash."""
        return f"{self._core.state_hash:016x}"


@dataclass(frozen=True, eq=False)
class Rollout:
    """states: simulations x steps x (num_q + num_v), after each step; unsolved: steps not solved, by simulation."""

    states: Array
    unsolved: NDArray[np.int64]


def rollout(
    world: World,
    states: ArrayLike,
    controls: ArrayLike | None = None,
    *,
    num_steps: int | None = None,
    threads: int = 0,
    settings: SimulatorSettings | None = None,
) -> Rollout:
    """Steps many simulations of one world on threads of the C++ core; each bit-equal to stepping it alone.

    states: where each starts, simulations x (num_q + num_v), as a step takes it; activations start at 0. controls:
    simulations x steps x num_controls or None (then num_steps says how many). threads: 0 for as many as the machine
    has. settings: of all; None: the defaults. A simulation that leaves the range of finite numbers fills the rest of
    its states with NaN and counts as unsolved.

    Raises InvalidInputError naming the field, its value and what is allowed.
    """
    its_settings = checked(world, settings)
    start = _arrays.numbers("states", states)
    width = world.num_q + world.num_v
    if start.ndim != 2 or start.shape[1] != width:
        raise InvalidInputError(f"states: has shape {start.shape}, must be (simulations, {width})")
    if controls is None:
        given = np.zeros((0, 0, 0))
        if num_steps is None:
            raise InvalidInputError("num_steps: is missing, must be given where there are no controls")
        steps = _arrays.count("num_steps", num_steps, 0)
    else:
        given = _arrays.numbers("controls", controls)
        if given.ndim != 3 or given.shape[0] != start.shape[0] or given.shape[2] != world.num_controls:
            raise InvalidInputError(
                f"controls: has shape {given.shape}, must be ({start.shape[0]}, steps, {world.num_controls})"
            )
        steps = given.shape[1]
        if num_steps not in (None, steps):
            raise InvalidInputError(f"num_steps: is {num_steps}, must be the {steps} of the controls, or None")
    out, unsolved = _simulator.rollout(
        world._core,
        its_settings._to_core(),
        start,
        given,
        steps,
        _arrays.count("threads", threads),
    )
    return Rollout(out, unsolved)
