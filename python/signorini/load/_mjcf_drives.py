"""MJCF's tendons, actuators, equalities and contact pairs: what ties bodies and joints of a compiled model together."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np
import numpy.typing as npt

from signorini.load._mjcf_softness import RIGID, Spring, spring
from signorini.load._options import Options, Warnings
from signorini.load._placement import Placement

if TYPE_CHECKING:
    from signorini._world import WorldBuilder

Array = npt.NDArray[np.float64]
Range = tuple[float, float]
_FREE: Range = (-math.inf, math.inf)


class Source(Protocol):
    """What is shared with the reader of bodies and geometries, _Adder in mjcf.py."""

    builder: WorldBuilder
    model: Any
    mujoco: Any
    options: Options
    warnings: Warnings
    geometries_of: dict[int, list[int]]
    collides: bool

    def name(self, kind: str, index: int) -> str: ...
    def body(self, body: int) -> str: ...
    def placed(self, body: int, position: Array, quaternion: Array) -> Placement: ...
    def call(self, kind: str, name: str, function: Callable[[], Any]) -> Any: ...


def add(source: Source) -> None:
    """Adds all of them to the builder; what has no equal here is told to source.warnings."""
    drives = _Drives(source)
    for tendon in range(source.model.ntendon):
        drives.add_tendon(tendon)
    if source.options.motors:
        for actuator in range(source.model.nactuator):
            reason = drives.add_actuator(actuator)
            if reason:
                source.warnings.add(f"actuators that are not carried over, {reason}", source.name("actuator", actuator))
        drives.list_ranges()
    drives.list_losses()
    for equality in range(source.model.neq):
        drives.add_equality(equality)
    for pair in range(source.model.npair if source.collides else 0):
        drives.add_pair(pair)


def joint_spring(source: Source, joint: int) -> Spring:
    """Of a joint's limits."""
    model = source.model
    inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
    return spring(model.jnt_solref[joint], model.jnt_solimp[joint], inverse, source.options.compliance)


def geom_spring(source: Source, geom: int) -> Spring:
    """Of a geom's surface; what is fixed is rigid."""
    model = source.model
    inverse = float(model.body_invweight0[model.geom_bodyid[geom], 0])
    return spring(model.geom_solref[geom], model.geom_solimp[geom], inverse, source.options.compliance)


def drive_losses(model: Any, mujoco: Any) -> tuple[Array, Array]:
    """Damping and armature that actuators add to the velocities of joints of one value."""
    damping, armature = np.zeros(model.nv), np.zeros(model.nv)
    for name, total in (("damping", damping), ("armature", armature)):
        values = getattr(model, f"actuator_{name}", None)
        if values is None:
            continue
        for actuator in np.flatnonzero(values):
            joint = int(model.actuator_trnid[actuator, 0])
            if model.actuator_trntype[actuator] <= 1 and model.jnt_type[joint] >= 2:
                total[model.jnt_dofadr[joint]] += model.actuator_gear[actuator, 0] ** 2 * values[actuator]
    return damping, armature


class _Drives:
    def __init__(self, source: Source) -> None:
        self._source, self._model, self._mujoco = source, source.model, source.mujoco
        self._builder, self._warnings = source.builder, source.warnings
        self._tendons: set[int] = set()

    def _spring(self, kind: str, index: int, inverse_inertia: float) -> Spring:
        solref, solimp = (getattr(self._model, f"{kind}_{name}")[index] for name in ("solref", "solimp"))
        return spring(solref, solimp, inverse_inertia, self._source.options.compliance)

    # Tendons

    def add_tendon(self, tendon: int) -> None:
        model, name = self._model, self._source.name("tendon", tendon)
        first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        wraps = range(first, first + count)
        if any(model.wrap_type[w] != self._mujoco.mjtWrap.mjWRAP_JOINT for w in wraps):
            self._warnings.add("spatial tendons are not carried over", name)
            return
        joints: dict[str, float] = {}
        for wrap in wraps:
            joint = self._source.name("jnt", int(model.wrap_objid[wrap]))
            joints[joint] = joints.get(joint, 0.0) + float(model.wrap_prm[wrap])
        limits = model.tendon_range[tendon] if model.tendon_limited[tendon] else _FREE
        limit = RIGID
        if model.tendon_limited[tendon]:
            solref, solimp = model.tendon_solref_lim[tendon], model.tendon_solimp_lim[tendon]
            inverse = float(model.tendon_invweight0[tendon])
            limit = spring(solref, solimp, inverse, self._source.options.compliance)
        damping = float(model.tendon_damping[tendon])
        values = getattr(model, "actuator_damping", None)
        if values is not None:
            driven = (model.actuator_trntype == self._mujoco.mjtTrn.mjTRN_TENDON) & (
                model.actuator_trnid[:, 0] == tendon
            )
            damping += float((model.actuator_gear[driven, 0] ** 2 * values[driven]).sum())
        low, high = (float(x) for x in model.tendon_lengthspring[tendon])
        self._source.call(
            "tendon",
            name,
            lambda: self._builder.add_tendon(
                name,
                joints,
                lower=float(limits[0]),
                upper=float(limits[1]),
                limit_stiffness=limit.stiffness,
                limit_damping=limit.damping,
                stiffness=float(model.tendon_stiffness[tendon]),
                spring_range=(low, high),
                damping=damping,
                friction=float(model.tendon_frictionloss[tendon]),
            ),
        )
        self._tendons.add(tendon)

    # Actuators

    def add_actuator(self, actuator: int) -> str | None:
        """Adds one; or returns why it has no equal here."""
        model, mj = self._model, self._mujoco
        if model.opt.disableflags & int(mj.mjtDisableBit.mjDSBL_ACTUATION):
            return "actuation is disabled"
        group = int(model.actuator_group[actuator])
        if 0 <= group < 31 and model.opt.disableactuator >> group & 1:
            return "their group is disabled"
        if any(int(getattr(model, f"actuator_{n}num", np.ones(model.nu))[actuator]) > 1 for n in ("ctrl", "out")):
            return "they have several controls"
        dynamics, gain, bias = (int(getattr(model, f"actuator_{n}type")[actuator]) for n in ("dyn", "gain", "bias"))
        if gain not in (mj.mjtGain.mjGAIN_FIXED, mj.mjtGain.mjGAIN_AFFINE) or bias not in (
            mj.mjtBias.mjBIAS_NONE,
            mj.mjtBias.mjBIAS_AFFINE,
        ):
            return "their force is no affine function"
        target = self._transmission(actuator)
        if isinstance(target, str):
            return target
        gains, biases = np.zeros(3), np.zeros(3)
        gains[: 3 if gain == mj.mjtGain.mjGAIN_AFFINE else 1] = model.actuator_gainprm[
            actuator, : 3 if gain == mj.mjtGain.mjGAIN_AFFINE else 1
        ]
        if bias == mj.mjtBias.mjBIAS_AFFINE:
            biases[:] = model.actuator_biasprm[actuator, :3]
        joint = int(model.actuator_trnid[actuator, 0])
        if "joint" in target and model.jnt_type[joint] < 2 and (gains[1] or biases[1]):
            return "they depend on the angle of a ball or free joint"
        if "body" in target and (gains[1:].any() or biases[1:].any()):
            return "they depend on the motion of a site"
        state = self._activation(actuator, dynamics)
        if isinstance(state, str):
            return state
        name = self._source.name("actuator", actuator)
        ranges: dict[str, Any] = {"force_range": self._force_range(actuator, target)}
        if model.actuator_ctrllimited[actuator]:
            ranges["control_range"] = _pair(model.actuator_ctrlrange[actuator])
        add = partial(self._builder.add_actuator, name, gain=gains, bias=biases, **target, **state, **ranges)
        self._source.call("actuator", name, add)
        return None

    def _transmission(self, actuator: int) -> dict[str, Any] | str:
        """What an actuator acts on, as arguments of add_actuator(); or why that is not possible."""
        model, kinds = self._model, self._mujoco.mjtTrn
        kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        gear = model.actuator_gear[actuator]
        if kind == kinds.mjTRN_TENDON:
            if target not in self._tendons:
                return "they pull spatial tendons"
            if gear[0] == 0.0:
                return "their gear is 0"
            return {"tendon": self._source.name("tendon", target), "gear": float(gear[0])}
        if kind == kinds.mjTRN_SITE:
            if model.actuator_trnid[actuator, 1] >= 0:
                return "they act between two sites"
            body = int(model.site_bodyid[target])
            placement = self._source.placed(body, model.site_pos[target], model.site_quat[target])
            return {
                "body": self._source.body(body),
                "position": placement.position,
                "orientation": placement.rotation,
                "wrench": gear,
            }
        if kind not in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
            return "they act on no joint, fixed tendon or site"
        component, factor = self._component(target, kind, gear)
        if component is None:
            return "their gear turns several axes, or none, or pushes a free body"
        return {"joint": self._source.name("jnt", target), "component": component, "gear": factor}

    def _component(self, joint: int, transmission: int, gear: Array) -> tuple[int | None, float]:
        """Which velocity of the joint is driven, and by what gear."""
        types = self._mujoco.mjtJoint
        kind = int(self._model.jnt_type[joint])
        if kind in (types.mjJNT_HINGE, types.mjJNT_SLIDE):
            return (0, float(gear[0])) if gear[0] != 0.0 else (None, 0.0)
        used = np.flatnonzero(gear[: 3 if kind == types.mjJNT_BALL else 6])
        in_child = transmission == self._mujoco.mjtTrn.mjTRN_JOINT
        if len(used) != 1 or not in_child or (kind == types.mjJNT_FREE and used[0] < 3):
            return None, 0.0  # MuJoCo pushes free bodies along the axes of the world
        return int(used[0]), float(gear[used[0]])

    def _activation(self, actuator: int, dynamics: int) -> dict[str, Any] | str:
        model, kinds = self._model, self._mujoco.mjtDyn
        if dynamics == kinds.mjDYN_NONE:
            return {}
        if dynamics == kinds.mjDYN_INTEGRATOR:
            state: dict[str, Any] = {"activation": "integrator"}
        elif dynamics in (kinds.mjDYN_FILTER, kinds.mjDYN_FILTEREXACT):
            state = {"activation": "filter", "time_constant": max(float(model.actuator_dynprm[actuator, 0]), 1e-10)}
        else:
            return "their state is not that of an integrator or filter"
        if model.actuator_actlimited[actuator]:
            state["activation_range"] = _pair(model.actuator_actrange[actuator])
        if model.actuator_actearly[actuator]:
            name = self._source.name("actuator", actuator)
            self._warnings.add("actearly: activations count from the next step", name)
        return state

    def _force_range(self, actuator: int, target: dict[str, Any]) -> Range:
        """Before the gear. The range of a joint or tendon counts where one actuator drives it alone."""
        model = self._model
        force = _pair(model.actuator_forcerange[actuator]) if model.actuator_forcelimited[actuator] else _FREE
        if "body" in target:
            return force
        kind = "tendon" if "tendon" in target else "jnt"
        index = int(model.actuator_trnid[actuator, 0])
        if not getattr(model, f"{kind}_actfrclimited")[index] or self._drivers(kind, index) != [actuator]:
            return force
        low, high = sorted(float(x) / target["gear"] for x in getattr(model, f"{kind}_actfrcrange")[index])
        return min(max(force[0], low), high), min(max(force[1], low), high)

    def list_ranges(self) -> None:
        """Ranges of what is not driven by one actuator of its own."""
        model, trn = self._model, self._mujoco.mjtTrn
        for kind, own in (("jnt", (trn.mjTRN_JOINT, trn.mjTRN_JOINTINPARENT)), ("tendon", (trn.mjTRN_TENDON,))):
            for index in np.flatnonzero(getattr(model, f"{kind}_actfrclimited")):
                drivers = self._drivers(kind, int(index))
                if drivers and (len(drivers) > 1 or int(model.actuator_trntype[drivers[0]]) not in own):
                    self._warnings.add(
                        "actuatorfrcrange is carried over only for what one actuator drives, itself",
                        self._source.name(kind, int(index)),
                    )

    def _drivers(self, kind: str, index: int) -> list[int]:
        """Actuators whose force a joint or tendon feels."""
        return [a for a in range(self._model.nactuator) if index in self._driven(kind, a)]

    def _driven(self, kind: str, actuator: int) -> set[int]:
        model, trn = self._model, self._mujoco.mjtTrn
        transmission, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if transmission == trn.mjTRN_TENDON:
            first = int(model.tendon_adr[target])
            wraps = range(first, first + int(model.tendon_num[target]))
            joints = {
                int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == self._mujoco.mjtWrap.mjWRAP_JOINT
            }
            return {target} if kind == "tendon" else joints
        if kind == "tendon":
            return set()
        if transmission == trn.mjTRN_SITE:
            body, moved = int(model.site_bodyid[target]), set[int]()
            while body:
                first = int(model.body_jntadr[body])
                moved.update(range(first, first + int(model.body_jntnum[body])))
                body = int(model.body_parentid[body])
            return moved
        return {target} if transmission in (trn.mjTRN_JOINT, trn.mjTRN_JOINTINPARENT) else set()

    def list_losses(self) -> None:
        """Damping and armature that drive_losses() and tendons do not have."""
        model, trn = self._model, self._mujoco.mjtTrn
        for name in ("damping", "armature"):
            for actuator in np.flatnonzero(getattr(model, f"actuator_{name}", np.zeros(0))):
                kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
                if kind in (trn.mjTRN_JOINT, trn.mjTRN_JOINTINPARENT) and model.jnt_type[target] >= 2:
                    continue
                if kind != trn.mjTRN_TENDON or name == "armature":
                    label = f"not carried over: {name} of actuators on tendons, ball and free joints"
                    self._warnings.add(label, self._source.name("actuator", int(actuator)))

    # Equalities

    def add_equality(self, equality: int) -> None:
        model, types = self._model, self._mujoco.mjtEq
        name, kind = self._source.name("eq", equality), int(model.eq_type[equality])
        data = np.asarray(model.eq_data[equality], dtype=np.float64)
        first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        if not model.eq_active0[equality]:
            self._warnings.add("equalities that are not active at the start", name)
            return
        if kind in (types.mjEQ_CONNECT, types.mjEQ_WELD):
            add = self._tie(equality, kind, name, data, first, second)
        elif kind == types.mjEQ_JOINT:
            add = self._couple("jnt", equality, name, data, first, second)
        elif kind == types.mjEQ_TENDON and all(t < 0 or t in self._tendons for t in (first, second)):
            add = self._couple("tendon", equality, name, data, first, second)
        else:
            self._warnings.add("equalities other than connect, weld, joint and fixed tendon", name)
            return
        self._source.call("equality", name, add)

    def _couple(self, kind: str, equality: int, name: str, data: Array, first: int, second: int) -> Callable[[], None]:
        model = self._model
        both = [index for index in (first, second) if index >= 0]
        if kind == "jnt":
            references = [float(model.qpos0[model.jnt_qposadr[index]]) for index in both]
            inverse = sum(float(model.dof_invweight0[model.jnt_dofadr[index]]) for index in both)
        else:
            references = [float(model.tendon_length0[index]) for index in both]
            inverse = sum(float(model.tendon_invweight0[index]) for index in both)
        held = self._spring("eq", equality, inverse)
        return partial(
            self._builder.add_coupling,
            self._source.name(kind, first),
            self._source.name(kind, second) if second >= 0 else None,
            data[:5].tolist(),
            reference=references[0],
            driver_reference=references[1] if second >= 0 else 0.0,
            name=name,
            stiffness=held.stiffness,
            damping=held.damping,
            kind="joint" if kind == "jnt" else "tendon",
        )

    def _tie(self, equality: int, kind: int, name: str, data: Array, first: int, second: int) -> Callable[[], None]:
        model = self._model
        body_a, a, body_b, b = self._ends(equality, kind, data, first, second)
        both = [body_a, body_b]
        moved, turned = (float(model.body_invweight0[both, k].sum()) for k in (0, 1))
        held = self._spring("eq", equality, moved)
        names = self._source.body(body_a), self._source.body(body_b)
        common: dict[str, Any] = {"name": name, "stiffness": held.stiffness, "damping": held.damping}
        if kind == self._mujoco.mjtEq.mjEQ_CONNECT:
            return partial(self._builder.add_connect, *names, a.position.tolist(), b.position.tolist(), **common)
        turn = self._spring("eq", equality, turned)
        return partial(
            self._builder.add_weld,
            *names,
            position_a=a.position.tolist(),
            orientation_a=a.rotation,
            position_b=b.position.tolist(),
            orientation_b=b.rotation,
            turn_stiffness=turn.stiffness,
            turn_damping=turn.damping,
            **common,
        )

    def _ends(
        self, equality: int, kind: int, data: Array, first: int, second: int
    ) -> tuple[int, Placement, int, Placement]:
        """Of a connect or weld: two bodies and a frame in each."""
        model, mj, placed = self._model, self._mujoco, self._source.placed
        if int(model.eq_objtype[equality]) == mj.mjtObj.mjOBJ_SITE:
            bodies = [int(model.site_bodyid[site]) for site in (first, second)]
            ends = [
                placed(body, model.site_pos[site], model.site_quat[site])
                for body, site in zip(bodies, (first, second), strict=True)
            ]
            return bodies[0], ends[0], bodies[1], ends[1]
        identity = np.array([1.0, 0.0, 0.0, 0.0])
        if kind == mj.mjtEq.mjEQ_CONNECT:
            return first, placed(first, data[:3], identity), second, placed(second, data[3:6], identity)
        # the point data[3:6] of body 1 is data[:3] of body 2, whose axes are data[6:10] in body 1
        return first, placed(first, data[3:6], data[6:10]), second, placed(second, data[:3], identity)

    # Contact pairs

    def add_pair(self, pair: int) -> None:
        from signorini._world import Material

        model = self._model
        geoms = int(model.pair_geom1[pair]), int(model.pair_geom2[pair])
        name = " with ".join(self._source.name("geom", geom) for geom in geoms)
        if any(geom not in self._source.geometries_of for geom in geoms):
            self._warnings.add("contact pairs of geoms that do not collide", name)
            return
        dimensions, friction = int(model.pair_dim[pair]), model.pair_friction[pair]
        if (dimensions >= 3 and friction[0] != friction[1]) or (dimensions == 6 and friction[3] != friction[4]):
            self._warnings.add("contact pairs have one friction here, their first", name)
        for array, label in (("pair_margin", "margin"), ("pair_gap", "gap")):
            if getattr(model, array)[pair] != 0.0:
                self._warnings.add(f"not carried over: {label} of contact pairs", name)
        bodies = [int(model.geom_bodyid[geom]) for geom in geoms]
        held = self._spring("pair", pair, float(model.body_invweight0[bodies, 0].sum()))
        asked = self._source.options.material
        material = Material(
            friction=float(friction[0]),
            stiffness=held.stiffness,
            damping=held.damping,
            torsion=float(friction[2]),
            rolling=float(friction[3]),
            condim=condim(dimensions),
        )
        if isinstance(asked, Material):
            material = asked
        for a, b in product(*(self._source.geometries_of[geom] for geom in geoms)):
            self._builder.set_pair_material(a, b, material)


def condim(value: int) -> Literal[1, 3, 4, 6]:
    """MuJoCo's compiler allows no other."""
    return cast("Literal[1, 3, 4, 6]", int(value))


def _pair(values: Any) -> Range:
    return float(values[0]), float(values[1])
