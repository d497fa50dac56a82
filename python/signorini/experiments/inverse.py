"""Fig. 8: torques that slide a UR5 along a wall, under NCP and CCP, rigid and compliant; and Talos pushing a wall."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import signorini
from signorini import InverseDynamics, Simulator, SimulatorSettings, World, scenes
from signorini.experiments import _plots, inverse_checks
from signorini.experiments._report import Options, Report, Verdict

Array = npt.NDArray[np.float64]

TIME_STEP = 1e-3
PROXIMAL_WEIGHT = 1e-8  # the paper's rho
TOLERANCE = 1e-6  # the paper's, absolute [m/s]
PRESS = 20.0  # wanted normal force [N]
STIFFNESS, DAMPING = 2e4, 200.0  # of the compliant wall [N/m, N s/m]
FRICTION = 0.5
RADIUS, PERIOD = 0.05, 2.0  # of the circle that the tool draws on the wall [m, s]
TALOS_PUSH = 40.0  # [N]


def algorithm_2(
    c: Array, compliance: Array, friction: float, law: str, guess: Array, rho: float, num_iterations: int
) -> Array:
    """The paper's Algorithm 2 as written, for one contact: impulses by iteration (num_iterations + 1, 3).

    s is that of the iterate before, then one projection in the metric of R + rho.
    """
    d = compliance + rho
    root = np.sqrt(d)
    mu = friction * root[0] / root[2]
    impulses = [np.array(guess, dtype=np.float64)]
    for _ in range(num_iterations):
        x = impulses[-1]
        sigma = compliance * x + c
        s = np.array([0.0, 0.0, friction * np.hypot(sigma[0], sigma[1]) if law == "ncp" else 0.0])
        y = -root * ((c + s - rho * x) / d)
        t = math.hypot(y[0], y[1])
        if mu * t <= -y[2]:
            y = np.zeros(3)
        elif t > mu * y[2]:
            normal = (y[2] + mu * t) / (1.0 + mu * mu)
            y = np.array([mu * normal * y[0] / t, mu * normal * y[1] / t, normal])
        impulses.append(y / root)
    return np.array(impulses)


def place_tool(world: World, q: Array, position: Array) -> Array:
    """q (6,) with the UR5's tool at a position, its orientation as before, by Newton's method."""
    orientation = world.body_placement("tool", q)[1]
    for _ in range(20):
        at, turned = world.body_placement("tool", q)
        away = 0.5 * sum(np.cross(turned[:, k], orientation[:, k]) for k in range(3))
        error = np.concatenate([position - at, away])
        if np.abs(error).max() < 1e-14:
            break
        q = q + np.linalg.solve(world.jacobian(q, "tool"), error)
    return q


def slide(stiffness: float, num_samples: int) -> dict[str, Any]:
    """The tool draws a circle on the wall; at each sample of one turn, torques by inverse dynamics, checked by a step
    of forward dynamics from there. Pressed in until tool and wall, two springs in series, push with PRESS newtons."""
    world, q, _ = scenes.worlds()["ur5-wall"](
        stiffness=stiffness, damping=0.0 if math.isinf(stiffness) else DAMPING, friction=FRICTION
    )
    start = world.body_placement("tool", q)[0] + np.array([2.0 * PRESS / stiffness, 0.0, 0.0])
    settings = SimulatorSettings(time_step=TIME_STEP, tolerance=1e-10)
    simulator = Simulator(world, settings)
    inverse = {
        law: InverseDynamics(world, TIME_STEP, law, proximal_weight=PROXIMAL_WEIGHT, tolerance=1e-6)
        for law in ("ncp", "ccp")
    }
    rate = 2.0 * math.pi / PERIOD
    out: dict[str, list[Any]] = {key: [] for key in _SERIES}
    first: dict[str, Any] = {}
    for time in np.linspace(0.0, PERIOD, num_samples, endpoint=False):

        def velocity(t: float) -> Array:
            return RADIUS * rate * np.array([0.0, -math.sin(rate * t), math.cos(rate * t), 0.0, 0.0, 0.0])

        turned = rate * time
        position = start + RADIUS * np.array([0.0, math.cos(turned) - 1.0, math.sin(turned)])
        q = place_tool(world, q, position)
        jacobian = world.jacobian(q, "tool", world.body_placement("tool", q)[1].T @ np.array([0.02, 0.0, 0.0]))
        v = np.linalg.solve(jacobian, velocity(time))
        v_next = np.linalg.solve(jacobian, velocity(time + TIME_STEP))
        guess = np.zeros((len(inverse["ncp"].contacts(q)), 3))
        guess[:, 2] = PRESS * TIME_STEP
        results = {law: one((q, v), v_next, guess) for law, one in inverse.items()}
        ncp = results["ncp"]
        simulator.reset()
        simulator.state.q, simulator.state.v = q, v
        simulator.applied_force = ncp.force
        simulator.step()
        forward = simulator.contacts[0]
        ours = ncp.contacts[0]
        out["time"].append(time)
        out["torque"].append(ncp.torque)
        out["contact_torque"].append(jacobian[:3].T @ _on_robot(ours, ours.force))
        out["inverse_force"].append(ours.force_local)
        out["forward_force"].append(forward.force_local)
        out["error"].append(np.abs(simulator.state.v - v_next).max() / np.abs(v_next).max())
        out["iterations"].append(ncp.iterations)
        out["residual"].append(ncp.residual)
        out["ncp_status"].append(ncp.status)
        out["ccp_status"].append(results["ccp"].status)
        out["ccp_residual"].append(results["ccp"].residual)
        out["ccp_normal"].append(results["ccp"].contacts[0].force_local[2])
        if not first:
            first = {"c": ours.frame.T @ _relative_velocity(jacobian, v_next, ours), "guess": guess[0]}
    arrays: dict[str, Any] = {key: np.array(values) for key, values in out.items()}
    return {**arrays, "first": first}


_SERIES = (
    "time",
    "torque",
    "contact_torque",
    "inverse_force",
    "forward_force",
    "error",
    "iterations",
    "residual",
    "ncp_status",
    "ccp_status",
    "ccp_residual",
    "ccp_normal",
)


def _on_robot(contact: Any, force: Array) -> Array:
    """The part of a contact's force that the tool feels: forces are on body b."""
    return -force if contact.geometry_a == "tool" else force


def _relative_velocity(jacobian: Array, v: npt.NDArray[Any], contact: Any) -> Array:
    return _on_robot(contact, jacobian[:3] @ v)


def by_iteration(first: dict[str, Any], num_iterations: int = 12) -> dict[str, Any]:
    """Algorithm 2 as the paper writes it, at the first sample of the rigid wall: normal force by iteration, and how
    many iterations it takes to the paper's tolerance (None: never)."""
    out = {}
    for law in ("ncp", "ccp"):
        for label, guess in (("pressed", first["guess"]), ("zero", np.zeros(3))):
            impulses = algorithm_2(first["c"], np.zeros(3), FRICTION, law, guess, PROXIMAL_WEIGHT, num_iterations)
            residuals = [signorini.inverse_residual(x, first["c"], friction=FRICTION, law=law) for x in impulses]
            done = [k for k, residual in enumerate(residuals) if residual <= TOLERANCE]
            out[f"{law}, {label}"] = {
                "force": np.linalg.norm(impulses, axis=1) / TIME_STEP,
                "iterations": done[0] if done else None,
            }
    return out


def talos(num_steps: int) -> dict[str, Any]:
    """Talos keeps standing and pushes the wall, from 0 to TALOS_PUSH and back: torques of the joints alone, feet and
    hand find their forces; each step is made by the simulator."""
    world, q, _ = scenes.worlds()["talos-wall"]()
    settings = SimulatorSettings(time_step=TIME_STEP, tolerance=1e-9)
    simulator = Simulator(world, settings)
    inverse = InverseDynamics(world, settings=settings, tolerance=1e-5)
    simulator.state.q = q
    out: dict[str, list[Any]] = {key: [] for key in ("time", "wanted", "inverse", "forward", "status", "root", "speed")}
    guess: Array | None = None
    for k in range(num_steps):
        wanted = TALOS_PUSH * math.sin(math.pi * (k + 0.5) / num_steps) ** 2
        state = (simulator.state.q.copy(), simulator.state.v.copy())
        contacts = inverse.contacts(state[0])
        hand = np.array(["wall" in (c.geometry_a, c.geometry_b) for c in contacts])
        touching = hand & (contacts.distance < 1e-6)
        if guess is None or len(guess) != len(contacts):
            guess = np.zeros((len(contacts), 3))
        still = np.zeros(world.num_v)
        for _ in range(200):  # the answer is next to the guess: ask again with the hand's part as wanted
            guess[touching, 2] = wanted * TIME_STEP / max(1, int(touching.sum()))
            result = inverse(state, still, guess, closest=True)
            guess = result.contact_impulse.copy()
            push = guess[hand, 2].sum() / TIME_STEP
            if abs(push - wanted) < 1e-3 * TALOS_PUSH:
                break
        simulator.applied_force = result.torque
        inverse.warm_start(simulator)
        simulator.step()
        pushed = sum(c.force_local[2] for c in simulator.contacts if "wall" in (c.geometry_a, c.geometry_b))
        out["time"].append(k * TIME_STEP)
        out["wanted"].append(wanted)
        out["inverse"].append(push)
        out["forward"].append(pushed)
        out["status"].append(result.status)
        out["root"].append(max(float(np.abs(x).max()) for x in result.root_wrench.values()))
        out["speed"].append(float(np.abs(simulator.state.v).max()))
    arrays: dict[str, Any] = {key: np.array(values) for key, values in out.items()}
    arrays["moved"] = float(np.abs(simulator.state.q - q).max())
    return arrays


def run(options: Options) -> Report:
    """Everything of Fig. 8 beside forward dynamics, then round trips, MuJoCo's inverse and times."""
    samples, steps = (20, 50) if options.quick else (200, 500)
    work = 3 + inverse_checks.WORK
    options.progress(0, work, "UR5 on a rigid wall")
    rigid = slide(math.inf, samples)
    options.progress(1, work, "UR5 on a compliant wall")
    soft = slide(STIFFNESS, samples)
    options.progress(2, work, "Talos at a wall")
    standing = talos(steps)
    iterations = by_iteration(rigid["first"])
    scale = float(np.abs(rigid["inverse_force"]).max())
    verdicts = [
        Verdict(
            "rigid wall, NCP: proximal steps to 1e-6",
            f"{int(rigid['iterations'].max())} at most, all solved: {bool((rigid['ncp_status'] == 'solved').all())}",
            "paper: 1",
            bool((rigid["ncp_status"] == "solved").all() and rigid["iterations"].max() <= 2),
        ),
        Verdict(
            "Algorithm 2 as written, NCP: iterations to 1e-6",
            ", ".join(f"{iterations[f'ncp, {key}']['iterations']} ({key})" for key in ("pressed", "zero")),
            "paper: 1",
            all(iterations[f"ncp, {key}"]["iterations"] in (0, 1, 2) for key in ("pressed", "zero")),
        ),
        Verdict(
            "rigid wall, CCP: infeasible, and said so",
            f"{int((rigid['ccp_status'] == 'infeasible').sum())} of {samples}; Algorithm 2 as written reaches "
            f"{iterations['ccp, pressed']['force'][-1]:.1e} N after {len(iterations['ccp, pressed']['force']) - 1}",
            "paper: diverges",
            bool((rigid["ccp_status"] == "infeasible").all()),
        ),
        *(
            Verdict(
                f"{name} wall: forces of forward dynamics, largest difference",
                f"{np.abs(one['inverse_force'] - one['forward_force']).max() / scale:.1e} of the largest, "
                f"velocity {one['error'].max():.1e}",
                "consistent (< 1e-6)",
                bool(np.abs(one["inverse_force"] - one["forward_force"]).max() < 1e-6 * scale),
            )
            for name, one in (("rigid", rigid), ("compliant", soft))
        ),
        Verdict(
            "compliant wall, CCP: normal force beside the NCP's",
            f"{soft['ccp_normal'].mean():.0f} N, {soft['inverse_force'][:, 2].mean():.1f} N",
        ),
        Verdict(
            "Talos: wrench missing at the root, and how far it moved",
            f"{standing['root'].max():.1e} N, N m; {standing['moved']:.1e} m, rad in {steps} steps",
            "< 1e-6",
            bool(standing["root"].max() < 1e-6),
        ),
        Verdict(
            "Talos: push of the hand, forward over wanted",
            f"off by {np.abs(standing['forward'] - standing['wanted']).max():.2g} N of {TALOS_PUSH:g}",
            "< 1 % of the largest",
            bool(np.abs(standing["forward"] - standing["wanted"]).max() < 0.01 * TALOS_PUSH),
        ),
    ]
    checks = inverse_checks.run(options, 3)
    options.progress(work, work, "")
    for one in (rigid, soft):
        one.pop("first")
    numbers = {
        "time_step": TIME_STEP,
        "rigid": rigid,
        "compliant": soft,
        "by_iteration": iterations,
        "talos": standing,
        **checks.numbers,
    }
    report = Report("inverse", numbers, verdicts + checks.verdicts, checks.tables, checks.notes)
    if _plots.available():
        report.files.append(_plot(rigid, soft, iterations, standing, options.output / "inverse.png"))
    report.write(options, checks.versions)
    return report


def _plot(rigid: Any, soft: Any, iterations: Any, standing: Any, path: Path) -> Path:
    made, axes = _plots.figure(2, 3)
    ours, other = _plots.COLORS["ours"], _plots.COLORS["paper"]
    axis = axes[0, 0]
    for law, color in (("ncp", ours), ("ccp", other)):
        axis.semilogy(iterations[f"{law}, pressed"]["force"], "o-", color=color, markersize=3, label=law.upper())
    axis.set(xlabel="iteration of Algorithm 2", ylabel="contact force [N]", title="UR5, rigid: NCP and CCP")
    axis.legend(frameon=False)
    axis = axes[0, 1]
    axis.plot(rigid["time"], np.linalg.norm(rigid["torque"], axis=1), color=ours, label="torque")
    axis.plot(rigid["time"], np.linalg.norm(rigid["contact_torque"], axis=1), color=other, label="contact torque")
    axis.set(xlabel="time [s]", ylabel="norm [N m]", title="UR5, rigid, NCP")
    axis.legend(frameon=False)
    for axis, one, name in ((axes[0, 2], rigid, "rigid"), (axes[1, 0], soft, "compliant")):
        for k, (label, color) in enumerate((("t1", other), ("t2", _plots.COLORS["other"]), ("n", ours))):
            axis.plot(one["time"], one["inverse_force"][:, k], color=color, label=f"{label} inverse")
            axis.plot(one["time"], one["forward_force"][:, k], ":", color="black", label="forward" if k == 2 else None)
        axis.set(xlabel="time [s]", ylabel="contact force [N]", title=f"UR5, {name}: inverse and forward")
        axis.legend(frameon=False, fontsize=7)
    axis = axes[1, 1]
    axis.plot(soft["time"], soft["ccp_normal"], color=other, label="CCP")
    axis.plot(soft["time"], soft["inverse_force"][:, 2], color=ours, label="NCP")
    axis.set_ylim(bottom=0.0)
    axis.set(xlabel="time [s]", ylabel="normal force [N]", title="UR5, compliant: NCP and CCP")
    axis.legend(frameon=False)
    axis = axes[1, 2]
    axis.plot(standing["time"], standing["wanted"], color=other, label="wanted")
    axis.plot(standing["time"], standing["inverse"], color=ours, label="inverse")
    axis.plot(standing["time"], standing["forward"], ":", color="black", label="forward")
    axis.set(xlabel="time [s]", ylabel="push of the hand [N]", title="Talos at a wall")
    axis.legend(frameon=False)
    return _plots.save(made, path)
