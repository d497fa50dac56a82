"""A trot for Solo12: gait, footholds, swinging legs and joint torques around the forces that `_solo_mpc` plans.

State, contact and terrain are read from the simulator: estimation is perfect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini.scenes._solo import HEIGHT, LEGS, STANCE, Terrain, foothold
from signorini.scenes._solo_mpc import Body, ForcePlanner, Limits, Plan

if TYPE_CHECKING:
    from signorini._simulation import Simulator

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Gait:
    """Diagonal pairs take turns: each leg swings for `swing` of every `period` seconds. start: of the first swing [s]."""

    period: float = 0.40
    swing: float = 0.16
    start: float = 0.2
    offsets: tuple[float, ...] = (0.0, 0.5, 0.5, 0.0)

    def phase(self, leg: int, time: float) -> float:
        """Share of the swing done, in [0, 1); negative on the ground."""
        if time < self.start:
            return -1.0
        into = (time - self.start) % self.period - self.offsets[leg] * self.period
        return into / self.swing if 0.0 <= into < self.swing else -1.0

    @property
    def stance(self) -> float:
        return self.period - self.swing


@dataclass(frozen=True)
class Gains:
    """clearance: of a foot over the highest ground on its way [m]. swing: natural frequency of the feet's error [rad/s].
    damping: of a foot on the ground [N s/m]. raibert: of the foothold on the error of velocity [s]. torque: limit of
    the drives [N m]."""

    clearance: float = 0.05
    swing: float = 60.0
    damping: float = 3.0
    raibert: float = 0.12
    torque: float = 2.7


class Trot:
    """Called before every step of a simulator, sets its control so that Solo12 walks along x at `speed` [m/s]."""

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
        steps: int = 16,
    ) -> None:
        """plan_every: steps of the simulator from plan to plan; steps: of a plan."""
        self.simulator, self.terrain, self.speed = simulator, terrain, speed
        self.gait, self.gains = gait or Gait(), gains or Gains()
        weights = np.array([20, 20, 10, 0, 20, 200, 0.1, 0.1, 0.1, 5, 5, 5.0])
        self.planner = planner or ForcePlanner(0.02, weights, 1e-3, Limits(friction / math.sqrt(2.0), 0.0, 25.0))
        self.plan_every, self.steps = plan_every, steps
        world = simulator.world
        self.world, self.dt, self.ticks = world, simulator.settings.time_step, 0
        self.joints = [
            [world.joint(f"{leg}_{name}").v_index for name in ("HAA", "HFE", "KFE")] for leg in LEGS
        ]
        self.drives = [[world.actuator_index(f"{leg}_{name}") for name in ("HAA", "HFE", "KFE")] for leg in LEGS]
        self.feet = [f"{leg}_FOOT" for leg in LEGS]
        self.shoulders = np.array([world.body_placement(f"{leg}_UPPER_LEG")[0] for leg in LEGS])
        self.shoulders -= world.body_placement("base_link")[0]
        self.shoulders += np.array([[0.0, STANCE if leg[1] == "L" else -STANCE, 0.0] for leg in LEGS])
        places = [world.body_placement(foot, simulator.state.q)[0] for foot in self.feet]
        self.held = np.array(places)  # where feet stand, or stood last
        self.goal = self.held.copy()
        self.lifted = np.zeros(4)  # highest ground on the way of a swinging foot
        self.swinging = [False] * 4
        self.touched = [True] * 4
        self.plans: list[Plan] = []
        self.plan: Plan | None = None

    def __call__(self) -> None:
        time = self.ticks * self.dt
        self._observe()
        for leg in range(4):
            self._switch(leg, time)
        if self.ticks % self.plan_every == 0:
            self.plan = self._make_plan(time)
            self.plans.append(self.plan)
        self._drive(time)
        self.ticks += 1

    # What is the case

    def _observe(self) -> None:
        simulator = self.simulator
        q, v = simulator.state.q, simulator.state.v
        self.position, self.rotation = simulator.body_placement("base_link")
        M = self.M = simulator.mass_matrix
        self.jacobians = [self.world.jacobian(q, foot)[:3] for foot in self.feet]
        self.places = np.array([simulator.body_placement(foot)[0] for foot in self.feet])
        self.speeds = np.array([J @ v for J in self.jacobians])
        mass = M[0, 0]
        offset = np.array([M[4, 2], M[5, 0], M[3, 1]]) * -1.0 / mass  # M[:3, 3:6] = -m [c]x
        offset = np.array([M[2, 4], M[0, 5], M[1, 3]]) / mass if False else self._offset(M, mass)
        self.centre = self.position + self.rotation @ offset
        self.velocity = self.rotation @ (M[:3] @ v) / mass
        self.spin = self.rotation @ v[3:6]
        c = np.array([[0, -offset[2], offset[1]], [offset[2], 0, -offset[0]], [-offset[1], offset[0], 0]])
        about_centre = M[3:6, 3:6] + mass * c @ c
        self.body = Body(mass, self.rotation @ about_centre @ self.rotation.T, self.world.gravity)
        self.loaded = [simulator.contact_force("world", foot) @ self.terrain.normal > 0.2 for foot in self.feet]

    @staticmethod
    def _offset(M: Array, mass: float) -> Array:
        block = -M[:3, 3:6] / mass  # [c]x
        return np.array([block[2, 1], block[0, 2], block[1, 0]])

    def _switch(self, leg: int, time: float) -> None:
        """Lift-off and touch-down."""
        phase = self.gait.phase(leg, time)
        if phase >= 0.0 and not self.swinging[leg] and (phase < 0.5):
            self.swinging[leg], self.touched[leg] = True, False
            self.held[leg] = self.places[leg]
        if self.swinging[leg] and self.loaded[leg] and (phase > 0.5 or phase < 0.0):
            self.swinging[leg], self.touched[leg] = False, True
            self.held[leg] = self.places[leg]
        if self.swinging[leg] and phase < 0.0 :
            self.late = True
        if self.swinging[leg] and phase >= 0.0 and phase < 0.7:
            self.goal[leg] = self._choose(leg, (1.0 - phase) * self.gait.swing)
        
    def _choose(self, leg: int, left: float) -> Array:
        """Foothold: below the shoulder as it will be at mid-stance, and beyond where velocity is off (Raibert 1986)."""
        wanted = self._reference()[2]
        shoulder = self.centre + self._aligned() @ self.shoulders[leg]
        shoulder = shoulder + self.velocity * left + 0.5 * self.gait.stance * wanted
        shoulder = shoulder + self.gains.raibert * (self.velocity - wanted)
        best = None
        for radius in (0.0, 0.02, 0.04, 0.06):
            for k in range(8 if radius else 1):
                x, y = shoulder[0] + radius * math.cos(k * math.pi / 4), shoulder[1] + radius * math.sin(k * math.pi / 4)
                if self.terrain.flat(x, y, 0.025):
                    return foothold(self.terrain, x, y)
        return foothold(self.terrain, shoulder[0], shoulder[1])

    # What is wanted

    def _ground(self) -> tuple[Array, Array]:
        """Plane through the last footholds: z = a + b x + c y; returns (a, b, c) and its normal."""
        points = np.where(np.array(self.swinging)[:, None], self.held, self.places)
        rows = np.column_stack([np.ones(4), points[:, :2]])
        plane = np.linalg.lstsq(rows, points[:, 2], rcond=None)[0]
        normal = np.array([-plane[1], -plane[2], 1.0])
        return plane, normal / np.linalg.norm(normal)

    def _aligned(self) -> Array:
        """Rotation with z along the normal of the ground and x ahead."""
        normal = self._ground()[1]
        x = np.cross([0.0, 1.0, 0.0], normal)
        x /= np.linalg.norm(x)
        return np.column_stack([x, np.cross(normal, x), normal])

    def _reference(self) -> tuple[Array, Array, Array]:
        """Rotation, centre and velocity wanted now."""
        plane, _ = self._ground()
        across = float(np.clip(-1.0 * self.centre[1], -0.1, 0.1))
        velocity = np.array([self.speed, across, 0.0]) if self.ticks * self.dt > self.gait.start else np.zeros(3)
        velocity[2] = plane[1:] @ velocity[:2]
        height = plane @ [1.0, *self.centre[:2]] + HEIGHT - 0.016
        return self._aligned(), np.array([self.centre[0], 0.0, height]), velocity

    def _make_plan(self, time: float) -> Plan:
        rotation, centre, velocity = self._reference()
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_matrix(self.rotation @ rotation.T).as_rotvec()
        state = np.concatenate([turned, self.centre - centre, self.spin, self.velocity])
        step = self.planner.dt
        contact = np.zeros((self.steps, 4), dtype=bool)
        levers = np.zeros((self.steps, 4, 3))
        for leg in range(4):
            stood = self.places[leg]
            flown = self.swinging[leg]
            for k in range(self.steps):
                down = self.gait.phase(leg, time + (k + 0.5) * step) < 0.0
                if k == 0:
                    down = not self.swinging[leg]
                elif not self.swinging[leg] and self.gait.phase(leg, time) > 0.5 and not flown and k * step < 0.5 * self.gait.swing:
                    down = True
                contact[k, leg] = down
                flown = flown or not down
                place = self.goal[leg] if self.swinging[leg] and flown else stood
                levers[k, leg] = place - (centre + velocity * (k + 0.5) * step)
                if not self.swinging[leg] and flown:  # a later step: at the same place below the shoulder
                    at = centre + velocity * (k + 0.5) * step
                    levers[k, leg] = rotation @ self.shoulders[leg]
                    levers[k, leg, 2] = self.terrain.height(*(at + levers[k, leg])[:2]) + 0.016 - at[2]
        plan = self.planner.plan(self.body, state, levers, contact, self.terrain.normal, velocity)
        return plan

    # Torques

    def _drive(self, time: float) -> None:
        gravity = -self.M[:, :3] @ (self.rotation.T @ self.world.gravity)
        forces = self.plan.forces[0]
        control = self.simulator.control
        for leg in range(4):
            at = self.joints[leg]
            J = self.jacobians[leg][:, at]
            if self.swinging[leg]:
                acceleration = self._swing(leg, time)
                rates = J.T @ np.linalg.solve(J @ J.T + 1e-5 * np.eye(3), acceleration)
                torque = self.M[np.ix_(at, at)] @ rates + gravity[at]
            else:
                force = forces[leg] - self.gains.damping * self.speeds[leg]
                torque = gravity[at] - J.T @ force
            control[self.drives[leg]] = np.clip(torque, -self.gains.torque, self.gains.torque)

    def _swing(self, leg: int, time: float) -> Array:
        """Acceleration of a foot that follows its way from where it stood to its foothold."""
        phase, duration = self.gait.phase(leg, time), self.gait.swing
        start, goal = self.held[leg], self.goal[leg]
        w = self.gains.swing
        if phase < 0.0:  # late: further down
            place, speed, push = self.places[leg].copy(), np.array([0.0, 0.0, -0.3]), np.zeros(3)
            place[:2] = goal[:2]
        else:
            ahead = _smooth((phase - 0.15) / 0.7)
            place, speed, push = (start + (goal - start) * ahead[0], (goal - start) * ahead[1] / (0.7 * duration),
                                  (goal - start) * ahead[2] / (0.7 * duration) ** 2)
            top = max(start[2], goal[2]) + self.gains.clearance
            if phase < 0.5:
                rise, base, sign = _smooth(phase / 0.5), start[2], 1.0
                height = top - start[2]
            else:
                rise, base, sign = _smooth((phase - 0.5) / 0.5), top, 1.0
                height = goal[2] - top
            place[2] = base + height * rise[0]
            speed[2] = height * rise[1] / (0.5 * duration)
            push[2] = height * rise[2] / (0.5 * duration) ** 2
        return push + w**2 * (place - self.places[leg]) + 2.0 * w * (speed - self.speeds[leg])


def _smooth(s: float) -> tuple[float, float, float]:
    """Quintic from 0 to 1 with its two derivatives, at rest at both ends."""
    s = min(max(s, 0.0), 1.0)
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )
