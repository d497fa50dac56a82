"""Inverse dynamics against what it has to agree with: forward dynamics, MuJoCo's inverse, and Pinocchio's speed."""

from __future__ import annotations

import math
import time
import timeit
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

import signorini
from signorini import InverseDynamics, Material, Simulator, SimulatorSettings, World, _simulator, scenes
from signorini.experiments._report import Options, Verdict
from signorini.scenes._worlds import gymnasium_file

Array = npt.NDArray[np.float64]

TIME_STEP = 1e-3
STATES, QUICK_STATES = 1000, 20
STIFFNESS, DAMPING = 1e5, 200.0  # of the compliant contacts [N/m, N s/m]
ROUND_TRIP, BACK = 1e-9, 1e-8  # goals
MUJOCO_GOAL = 1e-8
OVERLAP = 2e-4  # contacts have gaps and overlaps up to this [m]
#: How well the wanted motions are known, how well they are asked for, and the forward steps that check them.
MADE, ASKED, CHECKED = 1e-14, 1e-8, 1e-12


@dataclass
class Checks:
    """What run() hands to the report of the experiment `inverse`."""

    numbers: dict[str, Any] = field(default_factory=dict)
    verdicts: list[Verdict] = field(default_factory=list)
    tables: dict[str, tuple[list[str], list[list[str]]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)


def robots() -> dict[str, Callable[[Material], World]]:
    """Robots by name, their contacts of one material; those with a floating base fall on a ground."""

    def file(*path: str) -> Any:
        return scenes.robots_folder().joinpath(*path)

    def ur5(material: Material) -> World:
        path = file("ur_description", "urdf", "ur5_robot.urdf")
        return signorini.load(path, ground=True, material=material, ground_material=material)

    def allegro(material: Material) -> World:
        return signorini.load(file("allegro_hand_description", "urdf", "allegro_right_hand.urdf"), material=material)

    def talos(material: Material) -> World:
        return signorini.load(
            file("talos_data", "robots", "talos_reduced.urdf"),
            floating_base=True,
            ground=True,
            material=material,
            ground_material=material,
            srdf=file("talos_data", "srdf", "talos.srdf"),
        )

    def humanoid(material: Material) -> World:
        return signorini.load(gymnasium_file("humanoid.xml"), material=material)

    return {"UR5": ur5, "Allegro": allegro, "Talos": talos, "humanoid": humanoid}


def touching_configurations(world: World, random: np.random.Generator) -> Iterator[Array]:
    """Random configurations in which something just touches: floating robots the ground, in any orientation; others the
    first thing on the way from a free configuration to a random one."""
    floating = [joint for joint in world.joints if joint.num_q == 7]
    margin = 1.0 if floating else 0.01
    far = InverseDynamics(world, TIME_STEP, settings=SimulatorSettings(contact_margin=margin))
    fixed = np.array([g.body == 0 for g in world.geometries])
    free = world.initial_q
    if "shoulder_lift_joint" in world.joint_names:  # UR5: straight up, not along the ground
        free[world.q_slice("shoulder_lift_joint")] = -0.5 * math.pi

    def gaps(q: Array) -> list[tuple[float, bool]]:
        points = far.contacts(q)
        with_fixed = np.any(fixed[points.geometries], axis=1, keepdims=True)
        return [(float(distance), bool(one)) for distance, one in zip(points.distance, with_fixed[:, 0], strict=True)]

    def smallest(q: Array) -> float:
        return min((distance for distance, _ in gaps(q)), default=margin)

    while True:
        q = world.initial_q
        for joint in world.joints:
            if joint.num_q == 1:
                lower, upper = max(joint.lower, -3.0), min(joint.upper, 3.0)
                q[joint.q_index] = 0.5 * (lower + upper) + 0.45 * (upper - lower) * random.uniform(-1.0, 1.0)
        goal = OVERLAP * random.uniform(-1.0, 1.0)
        if floating:
            at = floating[0].q_index
            orientation = random.standard_normal(4)
            q[at + 3 : at + 7] = orientation / np.linalg.norm(orientation)
            q[at + 2] = 1.0
            q[at + 2] -= min(distance for distance, ground in gaps(q) if ground) - goal
        else:
            way = np.linspace(0.0, 1.0, 20)
            hit = next((t for t in way if smallest(free + t * (q - free)) < 0.0), 0.0)
            if hit == 0.0:
                continue
            low, high = hit - way[1], hit
            for _ in range(30):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if smallest(free + middle * (q - free)) < goal else (middle, high)
            q = free + low * (q - free)
        if smallest(q) > -2.0 * OVERLAP:  # links may run into each other elsewhere
            yield q


def round_trips(make: Callable[[Material], World], stiffness: float, num_states: int, seed: int = 0) -> dict[str, Any]:
    """Random states of a robot in contact; largest errors of
    - forward(inverse(v)) = v for a motion that forward dynamics made: from a random guess, the forward step starting
      from the impulses of inverse dynamics (cold, a rigid contact may find another solution, which is counted); and
      without a guess, cold; relative to the fastest joint, or a fall of one step;
    - the same for any v where contact is compliant;
    - inverse(forward(torque)) = torque, relative to the largest torque.
    """
    rigid = math.isinf(stiffness)
    world = make(Material(friction=0.8, stiffness=stiffness, damping=0.0 if rigid else DAMPING))
    random = np.random.default_rng(seed)
    exact, check = (Simulator(world, time_step=TIME_STEP, tolerance=tolerance) for tolerance in (MADE, CHECKED))
    inverse = InverseDynamics(world, TIME_STEP, tolerance=ASKED)
    inertia = exact.mass_matrix.diagonal()
    counts = dict.fromkeys(("states", "in contact", "not solved", "refused", "another solution"), 0)
    worst = {"warm": 0.0, "zero guess": 0.0, "any motion": 0.0, "torque": 0.0}

    def forward(simulator: Simulator, q: Array, v: Array, force: Array, warm: bool = False) -> Array:
        simulator.reset()
        simulator.state.q, simulator.state.v, simulator.applied_force = q, v, force
        if warm:
            inverse.warm_start(simulator)
        simulator.step()
        return np.array(simulator.state.v)

    def error(found: Array, wanted: Array, v: Array) -> float:
        largest = max(np.abs(wanted).max(), np.abs(v).max(), 9.81 * TIME_STEP)
        return float(np.abs(found - wanted).max() / largest)

    for q in touching_configurations(world, random):
        if counts["states"] == num_states:
            break
        v = random.standard_normal(world.num_v) * random.choice([0.0, 0.1, 1.0])
        torque = inertia * random.standard_normal(world.num_v) * random.choice([1.0, 10.0, 100.0])
        v_next = forward(exact, q, v, torque)
        if exact.report.status != "solved":
            counts["not solved"] += 1
            continue
        back = inverse((q, v), v_next, exact)
        if not back.relative <= ASKED:  # a step that its certificate lets pass, but that moves into something
            counts["refused"] += 1
            continue
        counts["states"] += 1
        counts["in contact"] += any(c.mode != "open" for c in exact.contacts)
        worst["torque"] = max(worst["torque"], float(np.abs(back.force - torque).max() / np.abs(torque).max()))
        push = random.uniform(size=(len(inverse.contacts(q)), 3)) * [0.3, 0.3, 1.0] * random.choice([0.01, 0.1, 1.0])
        push *= TIME_STEP * inertia.sum()
        for key, guess in (("warm", push), ("zero guess", None)):
            found = inverse((q, v), v_next, guess)
            reached = forward(check, q, v, found.force, warm=key == "warm")
            off = error(reached, v_next, v)
            worst[key] = max(worst[key], math.inf if found.status != "solved" else off)
            if key == "warm" and error(forward(check, q, v, found.force), v_next, v) > ROUND_TRIP:
                counts["another solution"] += check.report.status == "solved"
        if not rigid:
            any_motion = v_next + random.standard_normal(world.num_v) * random.choice([1e-3, 1e-2, 1e-1])
            found = inverse((q, v), any_motion, push)
            off = error(forward(exact, q, v, found.force), any_motion, v)
            worst["any motion"] = max(worst["any motion"], math.inf if found.status != "solved" else off)
    return {"counts": counts, "worst": worst}


def against_mujoco(num_states: int, seed: int = 0) -> dict[str, Any]:
    """mj_inverse of the humanoid, elliptic cones, at random states on the ground: MuJoCo's own rows, compliances and
    reference accelerations go into inverse_contact with law="ccp"; the torque is that of InverseDynamics in the air
    less MuJoCo's J^T times our forces. Largest differences, relative to the largest force and torque of the state."""
    import mujoco

    path = gymnasium_file("humanoid.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    data = mujoco.MjData(model)
    world = signorini.load(path)
    inverse = InverseDynamics(world, TIME_STEP)
    damping, stiffness = np.zeros((2, world.num_v))
    for joint in world.joints:
        damping[joint.v_index : joint.v_index + joint.num_v] = joint.damping
        stiffness[joint.v_index : joint.v_index + joint.num_v] = joint.stiffness
    random = np.random.default_rng(seed)
    configurations = touching_configurations(world, random)
    worst = {"force": 0.0, "torque": 0.0}
    num_contacts = num_rows = 0
    for _ in range(num_states):
        q = next(configurations)
        q[2] -= random.uniform(0.0, 5e-3)  # MuJoCo's contacts push where they overlap
        v, acceleration = random.standard_normal(world.num_v), 10.0 * random.standard_normal(world.num_v)
        data.qpos[:] = q
        data.qpos[3:7] = np.roll(q[3:7], 1)
        data.qvel[:], data.qacc[:] = v, acceleration  # a free joint's linear part: along the world's axes
        mujoco.mj_inverse(model, data)
        rows = data.nefc
        order, constraints = _constraints(mujoco, model, data)
        c = data.efc_J.reshape(rows, model.nv) @ acceleration - data.efc_aref[:rows]
        ours = signorini.inverse_contact(
            c[order], data.efc_R[:rows][order], constraints=constraints, law="ccp", tolerance=1e-12
        )
        force = np.zeros(rows)
        force[order] = ours.impulse
        num_contacts += data.ncon
        num_rows += rows
        theirs = data.efc_force[:rows]
        worst["force"] = max(worst["force"], np.abs(force - theirs).max(initial=0.0) / np.abs(theirs).max(initial=1.0))

        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        rotation = turn.reshape(3, 3)
        in_air = np.array(q)
        in_air[2] += 10.0
        body_v, body_a = v.copy(), acceleration.copy()
        body_v[:3], body_a[:3] = rotation.T @ v[:3], rotation.T @ acceleration[:3]
        v_next = body_v + TIME_STEP * body_a  # in the frame held still; then into the frame at the end of the step
        v_next[:3] = _turned(-TIME_STEP * v_next[3:6]) @ v_next[:3]
        torque = inverse((in_air, body_v), v_next).force
        # MuJoCo's dampers and springs are those of the start, ours of the end of the step.
        torque -= damping * (v_next - body_v) + stiffness * TIME_STEP * v_next
        torque[:3] = rotation @ torque[:3]
        torque -= data.efc_J.reshape(rows, model.nv).T @ force
        difference = np.abs(torque - data.qfrc_inverse).max() / np.abs(data.qfrc_inverse).max()
        worst["torque"] = max(worst["torque"], float(difference))
    return {"worst": worst, "states": num_states, "contacts": num_contacts, "rows": num_rows}


def _turned(rotation_vector: Array) -> Array:
    """exp of a rotation vector, by its series to rounding for small angles."""
    x, y, z = rotation_vector
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = term = np.eye(3)
    for n in range(1, 20):
        term = term @ k / n
        out = out + term
    return out


def _constraints(mujoco: Any, model: Any, data: Any) -> tuple[list[int], list[Any]]:
    """MuJoCo's rows in our order (tangents before the normal), and what they are."""
    order: list[int] = []
    constraints: list[Any] = []
    kinds = mujoco.mjtConstraint
    cone = int(kinds.mjCNSTR_CONTACT_ELLIPTIC)
    half_lines = {
        int(kinds.mjCNSTR_LIMIT_JOINT), int(kinds.mjCNSTR_LIMIT_TENDON), int(kinds.mjCNSTR_CONTACT_FRICTIONLESS)
    }  # fmt: skip
    row = 0
    while row < data.nefc:
        kind = int(data.efc_type[row])
        if kind == cone:
            contact = data.contact[data.efc_id[row]]
            if contact.dim != 3:
                raise ValueError(f"contact of dimension {contact.dim}, must be 3")
            order += [row + 1, row + 2, row]
            constraints.append(signorini.FrictionCone(float(contact.friction[0])))
            row += 3
        elif kind in half_lines:
            order.append(row)
            constraints.append(signorini.HalfLine())
            row += 1
        else:
            raise ValueError(f"constraint of type {kind} in MuJoCo's humanoid")
    return order, constraints


def times(repetitions: int) -> list[dict[str, Any]]:
    """Microseconds of one call, least of several rounds, beside Pinocchio's RNEA (whose call from Python is timed on an
    empty model and taken off): placements, contact impulses and torques, contact points given; and detection."""
    import pinocchio

    from signorini._pinocchio import to_pinocchio

    def best(call: Callable[[], Any]) -> float:
        return min(timeit.repeat(call, number=repetitions, repeat=15)) / repetitions * 1e6

    nothing, none = pinocchio.Model(), np.zeros(0)
    empty = nothing.createData()
    overhead = best(partial(pinocchio.rnea, nothing, empty, none, none, none))
    rows = []
    for name, make in robots().items():
        world = make(Material(friction=0.8, stiffness=STIFFNESS, damping=DAMPING))
        random = np.random.default_rng(1)
        configurations = touching_configurations(world, random)
        q, elsewhere = next(configurations), next(configurations)
        v, acceleration = random.standard_normal((2, world.num_v))
        model = to_pinocchio(world)
        data = model.createData()
        rnea = best(partial(pinocchio.rnea, model, data, q, v, acceleration)) - overhead
        inverse = InverseDynamics(world, TIME_STEP)
        given = _simulator.InverseInput()
        given.v, given.v_next = v, v + TIME_STEP * acceleration
        inverse._core.set_configuration(q)
        ours = min(inverse._core.seconds(q, given, repetitions) for _ in range(15)) * 1e6
        began = time.perf_counter()
        for k in range(50):
            inverse._core.set_configuration(q if k % 2 else elsewhere)  # the last one is q
        detection = (time.perf_counter() - began) / 50 * 1e6
        result = inverse._core.solve(given, None)
        contacts = len(inverse.contacts(q))
        rows.append(
            {
                "robot": name,
                "num_v": world.num_v,
                "contacts": contacts,
                "rnea": rnea,
                "ours": ours,
                "allowed": 2.0 * rnea + contacts,
                "detection": detection,
                "status": result.status.name,
                "residual": result.residual,
            }
        )
    return rows


WORK = 10  # steps of progress that run() makes


def run(options: Options, done: int) -> Checks:
    """All of the above; what needs a package that is missing is left out with a note."""
    out = Checks()
    num_states = QUICK_STATES if options.quick else STATES
    total = done + WORK
    table: list[list[str]] = []
    trips: dict[str, Any] = {}
    for k, (name, make) in enumerate(robots().items()):
        for j, (kind, stiffness) in enumerate((("rigid", math.inf), ("compliant", STIFFNESS))):
            options.progress(done + 2 * k + j, total, f"round trips: {name}, {kind}")
            one = round_trips(make, stiffness, num_states)
            trips[f"{name}, {kind}"] = one
            worst, counts = one["worst"], one["counts"]
            measured = {**worst, "any motion": math.nan} if kind == "rigid" else worst
            errors = ["" if math.isnan(value) else f"{value:.1e}" for value in measured.values()]
            table.append([name, kind, *map(str, counts.values()), *errors])
            trip = max(worst["warm"], worst["zero guess"], worst["any motion"])
            out.verdicts.append(
                Verdict(
                    f"{name}, {kind}: forward(inverse(v)) = v, {counts['states']} states",
                    f"{trip:.1e}",
                    f"< {ROUND_TRIP:g}",
                    trip < ROUND_TRIP,
                )
            )
            if kind == "compliant":
                out.verdicts.append(
                    Verdict(
                        f"{name}, {kind}: inverse(forward(torque)) = torque",
                        f"{worst['torque']:.1e}",
                        f"< {BACK:g}",
                        worst["torque"] < BACK,
                    )
                )
    out.numbers["round_trips"] = trips
    columns = ["robot", "contact", "states", "in contact", "not solved", "refused", "another solution"]
    out.tables["Round trips: states and largest errors"] = (
        [*columns, "from a guess", "from 0", "any motion", "torque"],
        table,
    )

    options.progress(done + 8, total, "MuJoCo's inverse")
    try:
        import mujoco

        out.versions["mujoco"] = mujoco.__version__
        mujoco_numbers = against_mujoco(QUICK_STATES if options.quick else 200)
        out.numbers["mujoco"] = mujoco_numbers
        off = max(mujoco_numbers["worst"].values())
        out.verdicts.append(
            Verdict(
                f"MuJoCo's inverse, humanoid, {mujoco_numbers['states']} states, {mujoco_numbers['contacts']} contacts",
                f"forces {mujoco_numbers['worst']['force']:.1e}, torques {mujoco_numbers['worst']['torque']:.1e}",
                f"< {MUJOCO_GOAL:g}",
                off < MUJOCO_GOAL,
            )
        )
    except ImportError:
        out.notes.append("MuJoCo is missing (pip install 'signorini[mjcf]'): not compared")

    options.progress(done + 9, total, "times")
    try:
        import pinocchio

        out.versions["pinocchio"] = pinocchio.__version__
        timed = times(200 if options.quick else 2000)
        out.numbers["times"] = timed
        out.tables["Microseconds a call"] = (
            ["robot", "velocities", "contacts", "Pinocchio RNEA", "ours", "allowed", "detection", "status", "residual"],
            [
                [
                    one["robot"],
                    str(one["num_v"]),
                    str(one["contacts"]),
                    *(f"{one[key]:.2f}" for key in ("rnea", "ours", "allowed", "detection")),
                    one["status"],
                    f"{one['residual']:.1e}",
                ]
                for one in timed
            ],
        )
        out.verdicts += [
            Verdict(
                f"{one['robot']}, {one['contacts']} contacts: time over 2 RNEA + 1 us a contact",
                f"{one['ours'] / one['allowed']:.2f} ({one['ours'] / one['rnea']:.2f} RNEA)",
                "< 1",
                one["ours"] < one["allowed"],
            )
            for one in timed
        ]
    except ImportError:
        out.notes.append("Pinocchio is missing (pip install 'signorini[peers]'): not timed")
    return out
