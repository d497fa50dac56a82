"""A trot for Solo12: gait, footholds, swinging legs and joint torques around the forces that `_solo_mpc` plans.

State, loads of the feet and terrain are read from the simulator: estimation is perfect. docs/walking.md has the method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from signorini.scenes._solo import FOOT_RADIUS, HEIGHT, KNEES, LEGS, STANCE, Terrain, foothold
from signorini.scenes._solo_mpc import Body, ForcePlanner, Limits, Plan, rotation_vector

if TYPE_CHECKING:
    from signorini._simulation import Simulator

Array = npt.NDArray[np.float64]
WEIGHTS = np.array([20, 20, 10, 0, 20, 200, 0.1, 0.1, 0.1, 5, 5, 5.0])  # rotation, place, spin, velocity


@dataclass(frozen=True)
class Gait:
    """Diagonal pairs take turns: each leg swings for `swing` of every `period` seconds, first at `start`."""

    period: float = 0.40
    swing: float = 0.16
    start: float = 0.2
    offsets: tuple[float, ...] = (0.0, 0.5, 0.5, 0.0)
    patience: float = 0.12  #: how long the clock waits for a foot that is late [s]

    def phase(self, leg: int, clock: float) -> float:
        """Share of the swing done, in [0, 1); negative on the ground."""
        since = clock - self.start - self.offsets[leg] * self.period
        into = since % self.period
        return into / self.swing if since >= 0.0 and into < self.swing else -1.0

    @property
    def stance(self) -> float:
        return self.period - self.swing


@dataclass(frozen=True)
class Gains:
    """clearance: of a swinging foot over the highest ground on its way [m]. swing: frequency of its error [rad/s].

    damping: of a foot on the ground [N s/m]. raibert: of footholds on the error of velocity [s]. torque: limit [N m].
    """

    clearance: float = 0.05
    swing: float = 60.0
    damping: float = 3.0
    raibert: float = 0.12
    torque: float = 2.7


class Trot:
    """Called before every step of a simulator, sets its control so that Solo12 walks along x.

    plan: what is being done; num_plans, unsolved_plans, worst_residual: of all quadratic programs so far.
    """

    plan: Plan

    def __init__(
        self,
        simulator: Simulator,
        terrain: Terrain,
        *,
        friction: float = 0.8,
        speed: float = 0.4,
        gait: Gait | None = None,
        gains: Gains | None = None,
        planner: ForcePlanner | None = None,
        plan_every: int = 10,
        horizon: int = 16,
    ) -> None:
        """friction: of the ground. speed: along x [m/s]. plan_every: steps of the simulator from plan to plan, where no
        foot comes down between; horizon: steps of a plan."""
        self.simulator, self.terrain, self.speed = simulator, terrain, speed
        self.gait, self.gains = gait or Gait(), gains or Gains()
        self.planner = planner or ForcePlanner(0.02, WEIGHTS, 1e-3, Limits(friction / math.sqrt(2.0), 1.0, 25.0))
        self.plan_every, self.horizon = plan_every, horizon
        self.num_plans, self.unsolved_plans, self.worst_residual = 0, 0, 0.0
        self.ticks, self.clock, self.waited = 0, 0.0, 0.0
        world = simulator.world
        names = [[f"{leg}_{joint}" for joint in ("HAA", "HFE", "KFE")] for leg in LEGS]
        self.joints = [[world.joint(name).v_index for name in leg] for leg in names]
        self.drives = [[world.actuator_index(name) for name in leg] for leg in names]
        self.feet = [f"{leg}_FOOT" for leg in LEGS]
        # where feet stand below the base, in its axes
        self.stance = np.array([world.body_placement(f"{leg}_UPPER_LEG")[0] for leg in LEGS])
        self.stance -= world.body_placement("base_link")[0]
        self.stance[:, 1] += [STANCE if leg[1] == "L" else -STANCE for leg in LEGS]
        self.swinging = [False] * 4
        self.unloaded = [0] * 4  # steps without load on the ground
        self._observe()
        self.left = self.places.copy()  # where each foot stood last
        self.goal = self.places.copy()  # where it goes
        self.crest = self.places[:, 2].copy()  # and how high it must be on its way at least

    def __call__(self) -> None:
        self._observe()
        changed = [self._switch(leg) for leg in range(4)]
        if self.ticks % self.plan_every == 0 or any(changed):
            self._refer()
            for leg in range(4):
                phase = self.gait.phase(leg, self.clock)
                if self.swinging[leg] and 0.0 <= phase < 0.6:
                    self.goal[leg] = self._choose(leg, phase)
                    self.crest[leg] = self._crest(leg)
            self.plan = self._plan()
            self.num_plans += 1
            self.unsolved_plans += not self.plan.solved
            self.worst_residual = max(self.worst_residual, self.plan.residual)
        self._drive()
        self.ticks += 1
        self._advance()

    # What is the case

    def _observe(self) -> None:
        simulator = self.simulator
        q, v = simulator.state.q, simulator.state.v
        self.base, self.rotation = simulator.body_placement("base_link")
        self.jacobians = [simulator.world.jacobian(q, foot)[:3] for foot in self.feet]
        self.places = np.array([simulator.body_placement(foot)[0] for foot in self.feet])
        self.speeds = np.array([J @ v for J in self.jacobians])
        forces = [simulator.contact_force("world", foot) for foot in self.feet]
        self.loaded = [float(force @ self.terrain.normal) > 0.2 for force in forces]  # [N]
        # the composite body: M of the base's velocity, in its axes, is [m, -m [c]x; m [c]x, I + m [c]x [c]x']
        M = self.mass_matrix = simulator.mass_matrix
        mass, moment = M[0, 0], M[3:6, 0:3]
        inertia = M[3:6, 3:6] - moment @ moment.T / mass
        R = self.rotation
        self.body = Body(mass, R @ inertia @ R.T, simulator.world.gravity)
        self.centre = self.base + R @ np.array([moment[2, 1], moment[0, 2], moment[1, 0]]) / mass
        self.velocity = R @ (M[:3] @ v) / mass
        self.spin = R @ v[3:6]

    def _switch(self, leg: int) -> bool:
        """Lift-off by the clock, touch-down by the load; a foot that slipped off comes down again."""
        before = self.swinging[leg]
        phase = self.gait.phase(leg, self.clock)
        if not self.swinging[leg] and 0.0 <= phase < 0.5:
            self.swinging[leg], self.left[leg] = True, self.places[leg]
        elif self.swinging[leg] and self.loaded[leg] and not 0.0 <= phase < 0.5:
            self.swinging[leg] = False
        self.unloaded[leg] = 0 if self.swinging[leg] or self.loaded[leg] else self.unloaded[leg] + 1
        if self.unloaded[leg] > 5:
            self.swinging[leg], self.goal[leg] = True, self.places[leg]
        return self.swinging[leg] != before

    def _advance(self) -> None:
        """The clock stands still while a foot would be lifted although another one has not come down."""
        dt = self.simulator.settings.time_step
        late = [self.swinging[leg] and self.gait.phase(leg, self.clock) < 0.0 for leg in range(4)]
        lifts = [not self.swinging[leg] and 0.0 <= self.gait.phase(leg, self.clock + dt) < 0.5 for leg in range(4)]
        if any(late) and any(lifts) and self.waited < self.gait.patience:
            self.waited += dt
            return
        self.clock += dt
        if not any(late):
            self.waited = 0.0

    # What is wanted

    def _refer(self) -> None:
        """Rotation, centre of mass and velocity: over the plane z = a + b x + c y of the last footholds."""
        points = np.where(np.array(self.swinging)[:, None], self.left, self.places)
        a, b, c = np.linalg.lstsq(np.column_stack([np.ones(4), points[:, :2]]), points[:, 2], rcond=None)[0]
        normal = np.array([-b, -c, 1.0]) / math.sqrt(1.0 + b * b + c * c)
        x = np.cross([0.0, 1.0, 0.0], normal)
        x /= np.linalg.norm(x)
        self.wanted_rotation = np.column_stack([x, np.cross(normal, x), normal])
        across = float(np.clip(-self.centre[1], -0.1, 0.1))  # back to the middle
        ahead = self.speed if self.clock >= self.gait.start else 0.0
        self.wanted_velocity = np.array([ahead, across, b * ahead + c * across])
        below = FOOT_RADIUS / math.cos(self.terrain.slope)
        height = a + b * self.base[0] + c * self.base[1] - below + HEIGHT
        self.wanted_centre = np.array([self.centre[0], 0.0, height + self.centre[2] - self.base[2]])

    def _choose(self, leg: int, phase: float) -> Array:
        """Foothold: under the shoulder as it will be at mid-stance, and further where velocity is off (Raibert 1986);
        the nearest one where the foot is off edges, and the shin over them."""
        x, y = (
            self.base
            + self.wanted_rotation @ self.stance[leg]
            + (1.0 - phase) * self.gait.swing * self.velocity
            + 0.5 * self.gait.stance * self.wanted_velocity
            + self.gains.raibert * (self.velocity - self.wanted_velocity)
        )[:2]
        before: Array = self.goal[leg]
        if (
            phase > 0.0
            and math.hypot(before[0] - x, before[1] - y) < 0.03 + 0.1 * phase  # the later, the less it changes its mind
            and self.terrain.free(before[0], before[1], KNEES[leg])
        ):
            return before
        for radius in (0.0, 0.02, 0.04, 0.06, 0.08):
            for angle in np.arange(8 if radius else 1) * math.pi / 4.0:
                at = x + radius * math.cos(angle), y + radius * math.sin(angle)
                if self.terrain.free(*at, KNEES[leg]):
                    return foothold(self.terrain, *at)
        return foothold(self.terrain, x, y)

    def _crest(self, leg: int) -> float:
        """Height of a foot that just touches the highest ground between where it stood and where it goes."""
        start, way = self.left[leg], self.goal[leg] - self.left[leg]
        between = [foothold(self.terrain, *(start + share * way)[:2])[2] for share in np.linspace(0.0, 1.0, 6)]
        return float(max(start[2], *between))

    def _plan(self) -> Plan:
        """Forces over the horizon, with the gait's schedule and the footholds that go with it."""
        step, gait, clock = self.planner.dt, self.gait, self.clock
        turned = rotation_vector(self.rotation @ self.wanted_rotation.T)
        state = np.concatenate([turned, self.centre - self.wanted_centre, self.spin, self.velocity])
        times = (np.arange(self.horizon) + 0.5) * step
        centres = self.wanted_centre + times[:, None] * self.wanted_velocity
        contact = np.zeros((self.horizon, 4), dtype=bool)
        levers = np.zeros((self.horizon, 4, 3))
        for leg in range(4):
            stands, phase = not self.swinging[leg], gait.phase(leg, clock)
            down = np.array([gait.phase(leg, clock + time) < 0.0 for time in times])
            if stands and phase >= 0.0:  # came down early, and stays
                down[times < (1.0 - phase) * gait.swing] = True
            down[0] = stands
            contact[:, leg] = down
            lifts = np.cumsum(np.diff(down, prepend=stands) & ~down)  # until then, from now on
            for k in range(self.horizon):
                at = self.places[leg] if stands else self.goal[leg]
                if lifts[k]:
                    ahead = centres[k] - self.centre + self.base + self.wanted_rotation @ self.stance[leg]
                    at = foothold(self.terrain, ahead[0], ahead[1])
                levers[k, leg] = at - centres[k]
        return self.planner.plan(self.body, state, levers, contact, self.terrain.normal, self.wanted_velocity)

    # Torques

    def _drive(self) -> None:
        """Feet on the ground press as planned, -J' f; others are accelerated along their way; legs carry themselves."""
        M, simulator = self.mass_matrix, self.simulator
        gravity = -M[:, :3] @ (self.rotation.T @ simulator.world.gravity)  # as if the base were accelerated upwards
        forces = self.plan.forces[0]
        for leg in range(4):
            at = self.joints[leg]
            J = self.jacobians[leg][:, at]
            if self.swinging[leg]:
                rates = J.T @ np.linalg.solve(J @ J.T + 1e-5 * np.eye(3), self._swing(leg))
                torque = M[np.ix_(at, at)] @ rates + gravity[at]
            else:
                torque = gravity[at] - J.T @ (forces[leg] - self.gains.damping * self.speeds[leg])
            simulator.control[self.drives[leg]] = np.clip(torque, -self.gains.torque, self.gains.torque)

    def _swing(self, leg: int) -> Array:
        """Acceleration of a foot on its way from where it stood to its foothold: up, ahead, down; then down until it
        meets something."""
        phase, start, goal = self.gait.phase(leg, self.clock), self.left[leg], self.goal[leg]
        place, speed, push = np.zeros(3), np.zeros(3), np.zeros(3)
        if phase < 0.0:
            place[:2], place[2], speed[2] = goal[:2], self.places[leg, 2], -0.5
        else:
            duration = self.gait.swing
            top = self.crest[leg] + self.gains.clearance
            place[:2], speed[:2], push[:2] = _between(start[:2], goal[:2], phase, 0.15, 0.85, duration)
            way = (start[2], top, phase, 0.0, 0.5) if phase < 0.5 else (top, goal[2], phase, 0.5, 1.0)
            place[2], speed[2], push[2] = _between(*way, duration)
        w = self.gains.swing
        pull: Array = w**2 * (place - self.places[leg]) + 2.0 * w * (speed - self.speeds[leg])
        return push + pull


def _between(
    start: npt.ArrayLike, end: npt.ArrayLike, phase: float, first: float, last: float, duration: float
) -> tuple[Array, Array, Array]:
    """Quintic from start to end while phase goes from first to last, at rest at both: place, velocity, acceleration."""
    a, way = np.asarray(start), np.asarray(end) - np.asarray(start)
    s, rate = min(max((phase - first) / (last - first), 0.0), 1.0), 1.0 / ((last - first) * duration)
    return (
        a + way * s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        way * rate * 30.0 * s**2 * (1.0 - s) ** 2,
        way * rate**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )
