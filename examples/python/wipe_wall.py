"""A UR5 wipes a wall in circles and presses it with 20 N: computed torque by inverse dynamics, in the simulator.

    python wipe_wall.py [FOLDER]    writes wipe_wall.h5 (a recording) and wipe_wall.png there (default: results)

The contact is rigid, so the motion says nothing of the force: a wall that does not give carries any. The controller
says both, the motion as v_next, the force as impulse_guess. Needs the extras "robots" and "plots".
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from signorini import InverseDynamics, Simulator, scenes
from signorini.recording import Recorder

FORCE = 20.0  # N
RADIUS, TURNS, DURATION = 0.05, 2, 2.0  # m, -, s
GAIN = 20.0  # 1/s, of errors of place and orientation
PRESSING = 0.01  # m/s, wanted into the wall; the closest feasible motion is along it
DT = 1e-3

world, q, v = scenes.worlds()["ur5-wall"]()
simulator = Simulator(world, time_step=DT)
simulator.state.q, simulator.state.v = q, v
inverse = InverseDynamics(world, dt=DT)
start, level = world.body_placement("tool", q)


def reference(t):
    """Place of the tool and its velocity: circles, from rest to rest."""
    x = t / DURATION
    angle = 2.0 * np.pi * TURNS * (3.0 * x**2 - 2.0 * x**3)
    rate = 2.0 * np.pi * TURNS * (6.0 * x - 6.0 * x**2) / DURATION
    place = start + RADIUS * np.array([0.0, np.cos(angle) - 1.0, np.sin(angle)])
    return place, RADIUS * rate * np.array([0.0, -np.sin(angle), np.cos(angle)])


def wanted_velocity(t):
    """Joint velocities that bring the tool to the reference, and keep it level."""
    goal, speed = reference(t + DT)
    at, orientation = world.body_placement("tool", simulator.state.q)
    turn = 0.5 * np.cross(orientation.T, level.T).sum(axis=0)  # small rotation from orientation to level
    linear = speed + GAIN * (goal - at)
    linear[0] = PRESSING
    twist = np.concatenate([linear, GAIN * turn])
    return np.linalg.solve(world.jacobian(simulator.state.q, "tool"), twist)


steps = round(DURATION / DT)
place, velocity, force, torque = (np.zeros((steps, width)) for width in (3, 3, 3, 6))
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results")
folder.mkdir(parents=True, exist_ok=True)
with Recorder(folder / "wipe_wall.h5", simulator, source={"scene": "ur5-wall"}) as recorder:
    for k in range(steps):
        state = simulator.state.q, simulator.state.v
        guess = np.zeros((len(inverse.contacts(state[0])), 3))
        guess[:, 2] = FORCE * DT
        result = inverse(state, wanted_velocity(k * DT), guess, closest=True)
        assert result.solved, result
        simulator.control = result.torque  # motors, one a joint
        recorder.run(1, simulator.control[None, :])
        contact = simulator.contacts[0]
        place[k] = world.body_placement("tool", simulator.state.q)[0]
        velocity[k], force[k], torque[k] = contact.velocity, contact.force_local, result.torque

slides = np.linalg.norm(velocity, axis=1) > 1e-3
friction = np.linalg.norm(force[:, :2], axis=1) / force[:, 2]
off = np.linalg.norm(place - np.array([reference((k + 1) * DT)[0] for k in range(steps)]), axis=1)
print(f"normal force {force[:, 2].min():.6f} to {force[:, 2].max():.6f} N, wanted {FORCE:g} N")
print(f"friction over normal force where it slides: {friction[slides].min():.6f} to {friction[slides].max():.6f}")
print(f"off the circle: at most {1e3 * off.max():.3f} mm; steps not solved: {simulator.report.unsolved}")
assert np.abs(force[:, 2] - FORCE).max() < 0.01 * FORCE
assert np.abs(friction[slides] - 0.5).max() < 1e-6
assert off.max() < 1e-3
assert simulator.report.unsolved == 0

time = DT * np.arange(steps)
figure = Figure(figsize=(12.0, 3.6), layout="constrained")
wall, forces, torques = figure.subplots(1, 3)
turned = np.linspace(0.0, 2.0 * np.pi, 200)
wall.plot(start[1] + RADIUS * (np.cos(turned) - 1.0), start[2] + RADIUS * np.sin(turned), color="0.8", linewidth=4)
wall.plot(place[:, 1], place[:, 2], color="#c0392b")
wall.set(xlabel="y [m]", ylabel="z [m]", title="path on the wall", aspect="equal")
for values, label in zip(force.T, ("tangent 1", "tangent 2", "normal"), strict=True):
    forces.plot(time, values, label=label)
forces.set(xlabel="time [s]", ylabel="contact force [N]", title=f"wanted: {FORCE:g} N")
forces.legend(frameon=False, fontsize=7, loc="center left")
torques.plot(time, torque, label=list(world.joint_names))
torques.set(xlabel="time [s]", ylabel="torque [N m]", title="computed torque")
torques.legend(frameon=False, fontsize=7)
figure.savefig(folder / "wipe_wall.png", dpi=150)
print(f"wrote {folder / 'wipe_wall.h5'}, {folder / 'wipe_wall.png'}")
