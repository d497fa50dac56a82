"""Inverse dynamics of a world: the torques and contact impulses that a wanted motion takes."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from signorini import _arrays, _core, _simulator
from signorini._core import InvalidInputError
from signorini._simulation import Contact, ContactList, Simulator, SimulatorSettings, State, checked
from signorini._solve import LawName, _choice
from signorini._world import Array, World


@dataclass(frozen=True, repr=False, eq=False)
class InverseDynamicsResult:
    """What a wanted motion takes; complete also when there is no solution.

    torque: (num_v,) what the actuated velocities need [N, N m], 0 at the others. Constant during the step; contact,
        gravity, springs, dampers and given controls are taken care of. Of no meaning unless solved.
    contact_impulse: (num_contacts, 3), on body b in the frames of `contacts` (t1, t2, n) [N s].
    root_wrench: what no actuator can give, by the name of the joint it is missing at: generalised forces of its
        velocities [N, N m]; of a free joint, force and moment in the frame of the body. A motion is feasible when these
        are 0. Empty when everything is actuated.
    status: "solved"; "infeasible", no contact impulse allows this motion: it pulls at what does not give, or runs into
        it; "max iterations" or another status of solve(), where the closest motion was asked for.
    iterations: proximal steps.
    residual: how far the motion is from one that the law of contact allows with these impulses [m/s, rad/s], at the
        constraint where it is farthest, `worst` in words.
    relative: residual over the largest speed in sight: of a constraint, or of a fall during the step. At most the
        tolerance when solved, but where the motion is the certified step of the simulator given: that certificate
        counts in impulses.
    contacts: with forces and velocities, as Simulator.contacts would list them after the step.
    v_next: (num_v,) the motion that all this is for: the wanted one, or the closest feasible.
    """

    torque: Array
    contact_impulse: Array
    root_wrench: dict[str, Array]
    status: str
    iterations: int
    residual: float
    relative: float
    worst: str
    contacts: ContactList
    v_next: Array
    force: Array
    """(num_v,) torque and root wrench in one: applied as Simulator.applied_force, it makes the motion."""

    @property
    def solved(self) -> bool:
        """Whether the motion is possible, to the tolerance asked for."""
        return self.status == "solved"

    def __repr__(self) -> str:
        worst = f" at {self.worst}" if self.worst else ""
        return (
            f"InverseDynamicsResult({self.status}, {len(self.contacts)} contacts, "
            f"residual={self.residual:.1e}{worst}, iterations={self.iterations})"
        )


class InverseDynamics:
    """inverse_dynamics() of one world, again and again: memory and collision shapes are kept from call to call.

        inverse = signorini.InverseDynamics(world, dt=1e-3)
        contacts = inverse.contacts(q)
        result = inverse((q, v), v_next)

    Not thread-safe; several may share a world. The GIL is released.
    """

    def __init__(
        self,
        world: World,
        dt: float | None = None,
        law: LawName | None = None,
        *,
        settings: SimulatorSettings | None = None,
        proximal_weight: float = 1e-8,
        tolerance: float = 1e-6,
        max_iterations: int = 100,
    ) -> None:
        """The arguments are those of inverse_dynamics; dt and law: None for those of settings."""
        step = checked(world, settings)
        if dt is not None:
            step = replace(step, time_step=_arrays.number("dt", dt))
            if not 1e-6 <= step.time_step <= 0.1:
                raise InvalidInputError(f"dt: is {dt!r}, must be in [1e-6, 0.1] s")
        if law is not None:
            _choice("law", law, _core.Law)
            step = replace(step, law=law)
        self.world = world
        self.settings = step
        self._core = _simulator.InverseDynamics(
            world._core,
            step._to_core(),
            _core.Law.__members__[step.law],
            _arrays.number("proximal_weight", proximal_weight),
            _arrays.number("tolerance", tolerance),
            _arrays.count("max_iterations", max_iterations, 1),
        )
        self._actuated: npt.NDArray[np.bool_] = np.array(
            _simulator.InverseDynamics.actuated(world._core), dtype=np.bool_
        )

    @property
    def actuated(self) -> npt.NDArray[np.bool_]:
        """(num_v,) velocities that count as actuated unless the call says otherwise: those with an actuator; in a world
        without any, all but those of free joints."""
        return np.array(self._actuated, dtype=np.bool_)

    def contacts(self, q: ArrayLike) -> ContactList:
        """The contact points at q, (num_q,): the order and the frames of impulse_guess and contact_impulse."""
        self._core.set_configuration(_arrays.vector("q", q, self.world.num_q))
        return ContactList(self.world, self._core.points())

    def warm_start(self, simulator: Simulator) -> None:
        """The simulator's next step, if it is from the configuration of the last call, starts from the impulses found
        there. With rigid contacts a step may have several solutions, each certified; this chooses the one of the call.
        """
        if not isinstance(simulator, Simulator) or simulator.world is not self.world:
            raise InvalidInputError("simulator: must be a Simulator of the same world")
        if simulator.settings.time_step != self.settings.time_step:
            raise InvalidInputError(
                f"simulator: has the time step {simulator.settings.time_step} s, must have {self.settings.time_step} s"
            )
        self._core.warm_start(simulator._core)

    def __call__(
        self,
        state: State | Simulator | tuple[ArrayLike, ArrayLike],
        v_next: ArrayLike,
        impulse_guess: ArrayLike | Sequence[Contact] | Simulator | None = None,
        *,
        control: ArrayLike | None = None,
        external_wrench: Mapping[str, ArrayLike] | None = None,
        actuated: ArrayLike | None = None,
        closest: bool = False,
    ) -> InverseDynamicsResult:
        """The arguments are those of inverse_dynamics."""
        world = self.world
        q, v = _state(world, state)
        given = _simulator.InverseInput()
        given.v = v
        given.v_next = _arrays.vector("v_next", v_next, world.num_v)
        self._core.set_configuration(q)
        if control is not None:
            given.control = _arrays.vector("control", control, world.num_controls)
        if external_wrench is not None:
            given.external_wrench = _wrenches(world, external_wrench)
        simulator = None
        if isinstance(impulse_guess, Simulator):
            if impulse_guess._core.report.steps == 0:
                raise InvalidInputError("impulse_guess: is a Simulator that has made no step")
            simulator = impulse_guess._core
        elif impulse_guess is not None:
            given.impulse_guess, given.moment_guess = _guess(
                ContactList(world, self._core.points()), impulse_guess, self.settings.time_step
            )
        has = self._actuated
        if actuated is not None:
            has = np.asarray(actuated)
            if has.dtype != np.bool_ or has.shape != (world.num_v,):
                raise InvalidInputError(f"actuated: has shape {has.shape} {has.dtype}, must be ({world.num_v},) bool")
            given.actuated = [int(one) for one in has]
        given.closest = _arrays.flag("closest", closest)
        out = self._core.solve(given, simulator)
        force = out.force
        missing = {}
        for joint in world.joints:
            rows = slice(joint.v_index, joint.v_index + joint.num_v)
            if not has[rows].all():
                missing[joint.name] = np.where(has[rows], 0.0, force[rows])
        return InverseDynamicsResult(
            torque=np.where(has, force, 0.0),
            contact_impulse=out.contact_impulse.reshape(-1, 3),
            root_wrench=missing,
            status=out.status.name,
            iterations=out.iterations,
            residual=out.residual,
            relative=out.relative,
            worst=self._core.worst(),
            contacts=ContactList(world, self._core.contacts()),
            v_next=out.v_next,
            force=force,
        )


def inverse_dynamics(
    world: World,
    state: State | Simulator | tuple[ArrayLike, ArrayLike],
    v_next: ArrayLike,
    dt: float,
    impulse_guess: ArrayLike | Sequence[Contact] | Simulator | None = None,
    law: LawName = "ncp",
    *,
    control: ArrayLike | None = None,
    external_wrench: Mapping[str, ArrayLike] | None = None,
    actuated: ArrayLike | None = None,
    closest: bool = False,
    settings: SimulatorSettings | None = None,
    proximal_weight: float = 1e-8,
    tolerance: float = 1e-6,
    max_iterations: int = 100,
) -> InverseDynamicsResult:
    """Which torques and contact impulses lead from (q, v) to v_next in one step of Simulator?

        result = signorini.inverse_dynamics(world, simulator.state, v_next, dt=1e-3)
        simulator.applied_force = result.force
        simulator.step()        # simulator.state.v is v_next

    Everything that a step knows is taken into account: rigid and compliant contact, restitution, joint limits, dry
    friction, damping, armature, closed loops. A rigid contact that stays closed may carry many impulses, and each has
    torques of its own: a finger that slides on a wall may press as it likes. The answer is the one next to
    impulse_guess: with 0, the torques carry everything. (Carpentier et al. 2024, section IV; docs/simulation.md, S11 to
    S14.)

    state: q and v now: a pair, or the state of a Simulator.
    v_next: (num_v,) velocity wanted at the end of the step, as Simulator.state.v will have it [m/s, rad/s].
    dt: time step [s], in [1e-6, 0.1].
    impulse_guess: (num_contacts, 3) on body b, in the frames of InverseDynamics.contacts(q) (t1, t2, n) [N s]; or
        contacts of this configuration with forces, as Simulator.contacts has them after a step from it; or the
        Simulator itself, for the impulses of limits, joint friction and loops too; None: 0.
    law: "ncp", Signorini and Coulomb with maximum dissipation, or "ccp", its convex relaxation, for which rigid
        contacts cannot slide without lifting.
    control: (num_controls,) of actuators that act as they do in a step; the answer is what must be added to them. Of
        one with an activation this is its activation. None: they do not act, the answer is what they have to give.
    external_wrench: by name of a body: force at its origin [N] and moment [N m], 6 values, world axes.
    actuated: (num_v,) bool, where torques may act. None: where actuators are, or without any, everywhere but at free
        joints.
    closest: find the motion closest to v_next, in the metric of the mass matrix, that rigid contacts and loops allow
        and that needs no force at unactuated velocities, and what it takes (S13 to S15). A few milliseconds
        with tens of contact points; seconds with hundreds, and then it may end with "max iterations".
    settings: of the step to invert: corrections, margin, restitution threshold; solver of the closest motion. Its time
        step and law are replaced by dt and law.
    proximal_weight: rho [1/kg], in (0, 1e6], stands in where compliance is 0.
    tolerance: on `relative`, in (0, 1). max_iterations: of the proximal iteration, at least 1.

    Raises InvalidInputError, a ValueError, naming the field, its value and what is allowed. No solution is a status.
    """
    arguments = (dt, law, settings, proximal_weight, tolerance, max_iterations)
    key = (world, *arguments, *map(type, arguments))  # 100.0 == 100, but is no count
    try:
        with _lock:
            solver = _kept.pop(key, None)
    except TypeError:  # something that cannot be a key is not valid either: the constructor says what
        solver = None
    if solver is None:
        solver = InverseDynamics(
            world,
            dt,
            law,
            settings=settings,
            proximal_weight=proximal_weight,
            tolerance=tolerance,
            max_iterations=max_iterations,
        )
    result = solver(
        state,
        v_next,
        impulse_guess,
        control=control,
        external_wrench=external_wrench,
        actuated=actuated,
        closest=closest,
    )
    with _lock:
        _kept[key] = solver
        while len(_kept) > _MOST_KEPT:
            del _kept[next(iter(_kept))]
    return result


# Of the last calls, not in use by any thread.
_kept: dict[Any, InverseDynamics] = {}
_MOST_KEPT = 4
_lock = threading.Lock()


def _state(world: World, state: Any) -> tuple[Array, Array]:
    if isinstance(state, Simulator):
        state = state.state
    if isinstance(state, State):
        q, v = state.q, state.v
    else:
        try:
            q, v = state
        except (TypeError, ValueError):
            raise InvalidInputError(
                f"state: is a {type(state).__name__}, must be a pair (q, v), a Simulator or its state"
            ) from None
    return _arrays.vector("q", q, world.num_q), _arrays.vector("v", v, world.num_v)


def _wrenches(world: World, given: Mapping[str, ArrayLike]) -> Array:
    if not isinstance(given, Mapping):
        raise InvalidInputError(f"external_wrench: is a {type(given).__name__}, must be a dict by name of a body")
    all_of_them = np.zeros((6, len(world.bodies)))
    for body, wrench in given.items():
        values = _arrays.vector(f"external_wrench[{body!r}]", wrench, 6)
        if not (np.abs(values) <= 1e100).all():
            raise InvalidInputError(f"external_wrench[{body!r}]: is {values.tolist()}, must be within +-1e100")
        index = world.body_index(body, "external_wrench[body]")
        if index == 0:
            raise InvalidInputError(f"external_wrench[{body!r}]: is on the world, must be on what can move")
        all_of_them[:, index] = values
    return all_of_them


def _guess(points: Sequence[Contact], given: Any, time_step: float) -> tuple[Array, Array]:
    """Impulses of forces and of moments."""
    if isinstance(given, Sequence) and given and all(isinstance(one, Contact) for one in given):
        return _guess_from_contacts(list(points), given, time_step)
    array = _arrays.numbers("impulse_guess", given)
    if array.shape not in ((len(points), 3), (3 * len(points),)):
        raise InvalidInputError(f"impulse_guess: has shape {array.shape}, must be ({len(points)}, 3)")
    return array.ravel(), np.zeros(0)


def _guess_from_contacts(points: list[Contact], given: Sequence[Contact], time_step: float) -> tuple[Array, Array]:
    """Of the contacts that are at the same places, in whatever order."""
    out, moments = np.zeros((len(points), 3)), np.zeros((len(points), 3))
    free = set(range(len(points)))
    for i, one in enumerate(given):
        nearest, at = _SAME_POINT, None
        for k in free:
            point = points[k]
            names = point.geometry_a, point.geometry_b
            away = float(np.linalg.norm(point.position - one.position))
            if (one.geometry_a, one.geometry_b) == names and away < nearest:
                nearest, at = away, k
        if at is not None:
            free.remove(at)
            out[at] = time_step * (points[at].frame.T @ one.force)
            moments[at] = time_step * (points[at].frame.T @ one.frame @ one.moment_local)
        elif np.any(one.force):
            raise InvalidInputError(
                f"impulse_guess[{i}]: is a contact of {one.geometry_a!r} and {one.geometry_b!r} at {one.position}, "
                "where this configuration has none"
            )
    return out.ravel(), moments.ravel()


_SAME_POINT = 1e-5  # [m]
