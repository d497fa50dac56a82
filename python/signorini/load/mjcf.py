"""MJCF -> bodies, joints, geometries, actuators and equalities, by way of MuJoCo's own compiler.

MuJoCo reads the file; the arrays of its compiled model are converted. What they hold and a World has not is told to
builder.warn. Which is which, and the rules: docs/robot_files.md. In MuJoCo quaternions are (w, x, y, z).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini.load import mesh
from signorini.load._options import Added, Options, Warnings
from signorini.load._placement import Placement, from_quaternion

if TYPE_CHECKING:
    from signorini._world import HeightField, Joint, Material, Shape, World, WorldBuilder

Array = npt.NDArray[np.float64]
Result = TypeVar("Result")

WORLD = "world"
_SOLREF, _SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
#: Flags of <option> that change the physics, by what switching them off does.
_FLAGS = {
    "mjDSBL_CONSTRAINT": "constraint",
    "mjDSBL_EQUALITY": "equality",
    "mjDSBL_FRICTIONLOSS": "frictionloss",
    "mjDSBL_LIMIT": "limit",
    "mjDSBL_CONTACT": "contact",
    "mjDSBL_SPRING": "spring",
    "mjDSBL_DAMPER": "damper",
    "mjDSBL_CLAMPCTRL": "clampctrl",
    "mjDSBL_FILTERPARENT": "filterparent",
    "mjDSBL_ACTUATION": "actuation",
}
#: Arrays over all that differ from their default only when the file asks for something that is not carried over.
_NOT_CARRIED: tuple[tuple[str, str, str, float], ...] = (
    ("body", "body_gravcomp", "gravity compensation of bodies", 0.0),
    ("jnt", "jnt_stiffnesspoly", "springs of higher order of joints", 0.0),
    ("jnt", "jnt_springyield", "springs that yield of joints", 0.0),
    ("jnt", "jnt_actgravcomp", "gravity compensation by actuators of joints", 0.0),
    ("jnt", "jnt_margin", "margins of limits of joints", 0.0),
    ("actuator", "actuator_delay", "delays of actuators", 0.0),
    ("actuator", "actuator_damping", "damping of actuators", 0.0),
    ("actuator", "actuator_dampingpoly", "damping of higher order of actuators", 0.0),
    ("actuator", "actuator_armature", "armature of actuators", 0.0),
)
_GEOM_NOT_CARRIED: tuple[tuple[str, str, float], ...] = (
    ("geom_condim", "condim (contacts have 3 dimensions) of geoms", 3.0),
    ("geom_priority", "priority of geoms", 0.0),
    ("geom_margin", "margin of geoms", 0.0),
    ("geom_gap", "gap of geoms", 0.0),
    ("geom_adhesion", "adhesion of geoms", 0.0),
    ("geom_surfacevel", "surface velocity of geoms", 0.0),
)


def read(path: Path) -> Mjcf:
    """Compiles a file with MuJoCo. Raises InvalidInputError with what the compiler says, ImportError without it."""
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(f"{path}: MJCF is compiled by MuJoCo: pip install signorini[mjcf] ({error})") from None
    if not path.is_file():
        raise InvalidInputError(f"{path}: there is no such file")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidInputError(f"{path}: {' '.join(str(error).split())}") from None
    return Mjcf(path, mujoco, model)


class Mjcf:
    """A compiled file. model: mujoco.MjModel."""

    def __init__(self, path: Path, mujoco: Any, model: Any) -> None:
        self.path, self.model, self._mujoco = path, model, mujoco
        self._names: dict[str, list[str]] = {}

    @property
    def gravity(self) -> tuple[float, float, float] | None:
        if self.model.opt.disableflags & self._mujoco.mjtDisableBit.mjDSBL_GRAVITY:
            return 0.0, 0.0, 0.0
        x, y, z = self.model.opt.gravity
        return float(x), float(y), float(z)

    def names(self, kind: str) -> list[str]:
        """Names of all "body", "jnt", "geom", "actuator" or "eq"; made up where the file has none, without repeats."""
        if kind not in self._names:
            model = self.model
            addresses = getattr(model, f"name_{kind}adr")
            given = [model.names[a : model.names.index(b"\0", a)].decode(errors="replace") for a in addresses]
            taken = set(given)
            for i, name in enumerate(given):
                if not name:
                    name = self._made_up(kind, i)
                    while name in taken:
                        name += "_"
                    taken.add(name)
                    given[i] = name
            if kind == "body":
                given[0] = WORLD
            self._names[kind] = given
        return self._names[kind]

    def _made_up(self, kind: str, index: int) -> str:
        model = self.model
        if kind == "jnt":
            body = int(model.jnt_bodyid[index])
            types = ("free", "ball", "slide", "hinge")
            number = index - int(model.body_jntadr[body])
            return f"{self.names('body')[body]}_{types[model.jnt_type[index]]}" + (f"_{number}" if number else "")
        if kind == "geom":
            body = int(model.geom_bodyid[index])
            number = index - int(model.body_geomadr[body])
            return f"{self.names('body')[body]}_geom" + (f"_{number}" if number else "")
        if kind == "actuator" and model.actuator_trntype[index] <= 1:
            return f"{self.names('jnt')[model.actuator_trnid[index, 0]]}_actuator"
        return f"{kind}_{index}"

    def add(self, builder: WorldBuilder, options: Options) -> Added:
        """Adds what was compiled to a builder. Raises InvalidInputError for what the builder refuses."""
        return _Adder(builder, self, self._mujoco, options).add()


class _Adder:
    def __init__(self, builder: WorldBuilder, source: Mjcf, mujoco: Any, options: Options) -> None:
        if options.floating_base is not None:
            raise InvalidInputError(f"{source.path}: floating_base must not be given, MJCF says itself what is free")
        self._builder, self._source, self._mujoco, self._options = builder, source, mujoco, options
        self._model = source.model
        self._warnings = Warnings(source.path)
        self._added = Added(source.path)
        self._bodies, self._joints = source.names("body"), source.names("jnt")
        self._geoms, self._actuators, self._equalities = (source.names(kind) for kind in ("geom", "actuator", "eq"))

    def add(self) -> Added:
        for body in range(1, self._model.nbody):
            self._add_body(body)
        for geom in self._colliding():
            self._add_geometry(geom)
        for geom in range(self._model.ngeom):
            self._add_visual(geom)
        for signature in self._model.exclude_signature:
            self._builder.exclude(self._body(int(signature) >> 16), self._body(int(signature) & 0xFFFF))
        if self._options.motors:
            for actuator in range(self._model.nactuator):
                reason = self._add_actuator(actuator)
                if reason:
                    self._warnings.add(f"actuators that are not carried over, {reason}", self._actuators[actuator])
        for equality in range(self._model.neq):
            self._add_equality(equality)
        self._list_the_rest()
        self._warnings.tell(self._builder)
        return self._added

    def _fail(self, kind: str, name: str, reason: object) -> NoReturn:
        raise InvalidInputError(f'{self._source.path}: {kind} "{name}": {reason}') from None

    def _call(self, kind: str, name: str, function: Callable[[], Result]) -> Result:
        try:
            return function()
        except InvalidInputError as error:
            self._fail(kind, name, error)

    def _name(self, name: str) -> str:
        return self._options.prefix + name

    def _body(self, body: int) -> str:
        return WORLD if body == 0 else self._name(self._bodies[body])

    def _placed(self, body: int, position: Array, quaternion: Array) -> Placement:
        """In `body`, the world being where the caller put it."""
        placement = Placement(_rotation(quaternion), np.asarray(position, dtype=np.float64))
        return self._options.placement @ placement if body == 0 else placement

    # Bodies and joints

    def _add_body(self, body: int) -> None:
        model, name = self._model, self._body(body)
        parent = int(model.body_parentid[body])
        placement = self._placed(parent, model.body_pos[body], model.body_quat[body])
        axes = _rotation(model.body_iquat[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = [self._joint(joint) for joint in range(first, first + count)]
        self._call(
            "body",
            name,
            lambda: self._builder.add_body(
                name,
                parent=self._body(parent),
                position=placement.position.tolist(),
                orientation=placement.rotation,
                joints=joints,
                mass=float(model.body_mass[body]),
                center=model.body_ipos[body].tolist(),
                inertia=axes @ np.diag(model.body_inertia[body]) @ axes.T,
            ),
        )
        self._added.bodies.append(name)
        if model.body_mocapid[body] >= 0:
            self._warnings.add("mocap bodies do not move", name)

    def _joint(self, joint: int) -> Joint:
        from signorini._world import Joint

        model, types, name = self._model, self._mujoco.mjtJoint, self._name(self._joints[joint])
        kind, dof, adr = int(model.jnt_type[joint]), int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        losses: dict[str, Any] = {
            "armature": float(model.dof_armature[dof]),
            "damping": float(model.dof_damping[dof]),
            "friction": float(model.dof_frictionloss[dof]),
        }
        if np.any(model.dof_dampingpoly[dof] if hasattr(model, "dof_dampingpoly") else 0.0):
            self._warnings.add("damping of higher order of joints", name)
        if kind in (types.mjJNT_FREE, types.mjJNT_BALL):
            if model.jnt_stiffness[joint] != 0.0:
                self._warnings.add("springs of free and ball joints", name)
            if model.jnt_limited[joint]:
                self._warnings.add("limits of ball joints", name)
            if kind == types.mjJNT_FREE:
                return Joint(name, "free", **losses)
            return Joint(name, "ball", anchor=model.jnt_pos[joint].tolist(), **losses)
        limits = model.jnt_range[joint] if model.jnt_limited[joint] else (-math.inf, math.inf)
        return Joint(
            name,
            "revolute" if kind == types.mjJNT_HINGE else "prismatic",
            axis=model.jnt_axis[joint].tolist(),
            anchor=model.jnt_pos[joint].tolist(),
            reference=float(model.qpos0[adr]),
            lower=float(limits[0]),
            upper=float(limits[1]),
            stiffness=float(model.jnt_stiffness[joint]),
            spring_reference=float(model.qpos_spring[adr]) if model.jnt_stiffness[joint] != 0.0 else 0.0,
            **losses,
        )

    # Geometries

    def _colliding(self) -> list[int]:
        model = self._model
        return [geom for geom in range(model.ngeom) if model.geom_contype[geom] or model.geom_conaffinity[geom]]

    def _add_geometry(self, geom: int) -> None:
        model = self._model
        body, name = int(model.geom_bodyid[geom]), self._name(self._geoms[geom])
        shape = self._shape(geom)
        if shape is None:
            return
        placement = self._placed(body, model.geom_pos[geom], model.geom_quat[geom])
        index = self._call(
            "geom",
            name,
            lambda: self._builder.add_geometry(
                self._body(body),
                shape,
                position=placement.position.tolist(),
                orientation=placement.rotation,
                material=self._material(geom),
                name=name,
                group=int(model.geom_contype[geom]) & 0xFFFFFFFF,
                mask=int(model.geom_conaffinity[geom]) & 0xFFFFFFFF,
            ),
        )
        self._added.geometries.append(index)
        self._added.body_of_geometry[index] = self._body(body)

    def _add_visual(self, geom: int) -> None:
        """What MuJoCo's own viewer shows at first: groups 0 to 2."""
        from signorini._visual import TriangleMesh

        model, mj = self._model, self._mujoco
        color = tuple(float(x) for x in self._color(geom))
        if model.geom_group[geom] > 2 or color[3] == 0.0:
            return
        shape: Shape | TriangleMesh | None
        if model.geom_type[geom] in (mj.mjtGeom.mjGEOM_MESH, mj.mjtGeom.mjGEOM_SDF):
            number = int(model.geom_dataid[geom])
            first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
            face, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
            vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
            shape = TriangleMesh(vertices, np.asarray(model.mesh_face[face : face + faces], dtype=np.int32))
        elif model.geom_type[geom] == mj.mjtGeom.mjGEOM_HFIELD:
            shape = self._height_field(geom)
        else:
            shape = self._shape(geom)
        if shape is None:
            return
        body = int(model.geom_bodyid[geom])
        placement = self._placed(body, model.geom_pos[geom], model.geom_quat[geom])
        self._builder.add_visual(
            self._body(body),
            shape,
            position=placement.position,
            orientation=placement.rotation,
            color=(color[0], color[1], color[2], color[3]),
        )

    def _color(self, geom: int) -> Array:
        """The geom's own, unless it has the default and a material."""
        model = self._model
        own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
        if material >= 0 and np.allclose(own, (0.5, 0.5, 0.5, 1.0)):
            return np.asarray(model.mat_rgba[material], dtype=np.float64)
        return np.asarray(own, dtype=np.float64)

    def _material(self, geom: int) -> Material:
        from signorini._world import Material

        asked = self._options.material_of(self._bodies[self._model.geom_bodyid[geom]])
        return asked or Material(friction=float(self._model.geom_friction[geom, 0]))

    def _shape(self, geom: int) -> Shape | None:
        from signorini import _world

        model, types, name = self._model, self._mujoco.mjtGeom, self._geoms[geom]
        kind, size = int(model.geom_type[geom]), [float(x) for x in model.geom_size[geom]]
        if kind == types.mjGEOM_SPHERE:
            return _world.Sphere(size[0])
        if kind == types.mjGEOM_CAPSULE:
            return _world.Capsule(size[0], size[1])
        if kind == types.mjGEOM_CYLINDER:
            return _world.Cylinder(size[0], size[1])
        if kind == types.mjGEOM_BOX:
            return _world.Box((size[0], size[1], size[2]))
        if kind == types.mjGEOM_ELLIPSOID:
            return _world.Ellipsoid((size[0], size[1], size[2]))
        if kind == types.mjGEOM_PLANE:
            return _world.HalfSpace()
        if kind == types.mjGEOM_MESH:
            number = int(model.geom_dataid[geom])
            first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
            vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
            hull = self._call("geom", name, lambda: mesh.convex_hull(vertices, self._options.hull_vertices))
            for note in hull.notes:
                self._warnings.add("meshes", f"of {name} {note}")
            return _world.Convex(hull.vertices, hull.triangles)
        if kind == types.mjGEOM_HFIELD and model.body_weldid[model.geom_bodyid[geom]] == 0:
            return self._height_field(geom)
        label = {int(types.mjGEOM_HFIELD): "height fields that move", int(types.mjGEOM_SDF): "signed distance fields"}
        self._warnings.add(f"{label.get(int(kind), f'geoms of type {int(kind)}')} do not collide", name)
        return None

    def _height_field(self, geom: int) -> HeightField:
        """MuJoCo keeps heights from 0 to 1, and their scale in the third size."""
        from signorini._world import HeightField

        model, number = self._model, int(self._model.geom_dataid[geom])
        rows, columns, first = (int(of[number]) for of in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
        x, y, top, base = (float(size) for size in model.hfield_size[number])
        heights = np.asarray(model.hfield_data[first : first + rows * columns], dtype=np.float64)
        return HeightField(top * heights.reshape(rows, columns), (x, y), base)

    # Actuators

    def _add_actuator(self, actuator: int) -> str | None:
        """Adds one; or returns why it has no equal here."""
        model, mj = self._model, self._mujoco
        transmission = int(model.actuator_trntype[actuator])
        if transmission not in (mj.mjtTrn.mjTRN_JOINT, mj.mjtTrn.mjTRN_JOINTINPARENT):
            return "they act on no joint"
        dynamics, gain, bias = (
            int(getattr(model, f"actuator_{name}type")[actuator]) for name in ("dyn", "gain", "bias")
        )
        if dynamics != mj.mjtDyn.mjDYN_NONE:
            return "they have a state of their own"
        if gain != mj.mjtGain.mjGAIN_FIXED or bias not in (mj.mjtBias.mjBIAS_NONE, mj.mjtBias.mjBIAS_AFFINE):
            return "their force is no affine function"
        if any(int(getattr(model, f"actuator_{name}num", np.ones(model.nu))[actuator]) > 1 for name in ("ctrl", "out")):
            return "they have several controls"
        joint = int(model.actuator_trnid[actuator, 0])
        component, gear = self._component(joint, transmission, model.actuator_gear[actuator])
        if component is None:
            return "their gear turns several axes, or none, or pushes a free body"
        factor = float(model.actuator_gainprm[actuator, 0])
        offset, slope, rate = model.actuator_biasprm[actuator, :3] if bias else (0.0, 0.0, 0.0)
        control, force = self._ranges(actuator, joint, gear)
        name, target = self._name(self._actuators[actuator]), self._name(self._joints[joint])
        common: dict[str, Any] = {"control_range": control}
        one_value = int(model.jnt_type[joint]) in (mj.mjtJoint.mjJNT_SLIDE, mj.mjtJoint.mjJNT_HINGE)
        if offset == slope == rate == 0.0 and factor != 0.0:
            scaled = sorted((force[0] / factor, force[1] / factor))
            common |= {"component": component, "gear": gear * factor, "force_range": (scaled[0], scaled[1])}
            add = partial(self._builder.add_motor, name, target, **common)
        elif one_value and offset == 0.0 and slope == -factor and factor > 0.0 and rate <= 0.0:
            common |= {"kp": factor, "kv": -float(rate), "gear": gear, "force_range": force}
            add = partial(self._builder.add_position_actuator, name, target, **common)
        elif one_value and offset == slope == 0.0 and rate == -factor and factor > 0.0:
            common |= {"kv": factor, "gear": gear, "force_range": force}
            add = partial(self._builder.add_velocity_actuator, name, target, **common)
        else:
            return "they are no motor, position or velocity actuator"
        self._call("actuator", name, add)
        return None

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

    def _ranges(self, actuator: int, joint: int, gear: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Of the control, and of the force before the gear; the joint's own range of force counts where one actuator
        drives it alone."""
        model = self._model
        control, force = (-math.inf, math.inf), (-math.inf, math.inf)
        if model.actuator_ctrllimited[actuator]:
            control = float(model.actuator_ctrlrange[actuator, 0]), float(model.actuator_ctrlrange[actuator, 1])
        if model.actuator_forcelimited[actuator]:
            force = float(model.actuator_forcerange[actuator, 0]), float(model.actuator_forcerange[actuator, 1])
        if model.jnt_actfrclimited[joint]:
            on_joint = (model.actuator_trntype <= 1) & (model.actuator_trnid[:, 0] == joint)
            if on_joint.sum() == 1:
                low, high = sorted(float(x) / gear for x in model.jnt_actfrcrange[joint])
                force = max(force[0], low), min(force[1], high)
            else:
                self._warnings.add("actuatorfrcrange of joints that several actuators drive", self._joints[joint])
        return control, force

    # Equalities

    def _add_equality(self, equality: int) -> None:
        model, types, name = self._model, self._mujoco.mjtEq, self._name(self._equalities[equality])
        kind, data = int(model.eq_type[equality]), np.asarray(model.eq_data[equality], dtype=np.float64)
        first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        if not model.eq_active0[equality]:
            self._warnings.add("equalities that are not active at the start", name)
            return
        self._soft("equality constraints are rigid here; solref, solimp of", "eq", equality, name)
        if kind in (types.mjEQ_CONNECT, types.mjEQ_WELD):
            body_a, a, body_b, b = self._ends(equality, kind, data, first, second)
            if kind == types.mjEQ_CONNECT:
                points = a.position.tolist(), b.position.tolist()
                add = partial(self._builder.add_connect, body_a, body_b, *points, name=name)
            else:
                add = partial(
                    self._builder.add_weld,
                    body_a,
                    body_b,
                    position_a=a.position.tolist(),
                    orientation_a=a.rotation,
                    position_b=b.position.tolist(),
                    orientation_b=b.rotation,
                    name=name,
                )
        elif kind == types.mjEQ_JOINT:
            add = partial(
                self._builder.add_coupling,
                self._name(self._joints[first]),
                self._name(self._joints[second]) if second >= 0 else None,
                data[:5].tolist(),
                reference=float(model.qpos0[model.jnt_qposadr[first]]),
                driver_reference=float(model.qpos0[model.jnt_qposadr[second]]) if second >= 0 else 0.0,
                name=name,
            )
        else:
            self._warnings.add("equalities other than connect, weld and joint", name)
            return
        self._call("equality", name, add)

    def _ends(
        self, equality: int, kind: int, data: Array, first: int, second: int
    ) -> tuple[str, Placement, str, Placement]:
        """Of a connect or weld: two bodies and a frame in each."""
        model, mj = self._model, self._mujoco
        if int(model.eq_objtype[equality]) == mj.mjtObj.mjOBJ_SITE:
            bodies = [int(model.site_bodyid[site]) for site in (first, second)]
            ends = [
                self._placed(body, model.site_pos[site], model.site_quat[site])
                for body, site in zip(bodies, (first, second), strict=True)
            ]
        else:
            bodies = [first, second]
            identity = np.array([1.0, 0.0, 0.0, 0.0])
            if kind == mj.mjtEq.mjEQ_CONNECT:
                ends = [self._placed(first, data[:3], identity), self._placed(second, data[3:6], identity)]
            else:  # the point data[3:6] of body 1 is data[:3] of body 2, whose axes are data[6:10] in body 1
                ends = [self._placed(first, data[3:6], data[6:10]), self._placed(second, data[:3], identity)]
        return self._body(bodies[0]), ends[0], self._body(bodies[1]), ends[1]

    # What is not carried over

    def _soft(self, reason: str, kind: str, index: int, name: str) -> None:
        solref, solimp = getattr(self._model, f"{kind}_solref")[index], getattr(self._model, f"{kind}_solimp")[index]
        if not (np.allclose(solref, _SOLREF) and np.allclose(solimp, _SOLIMP)):
            self._warnings.add(reason, name)

    def _list_the_rest(self) -> None:
        model, warnings = self._model, self._warnings
        colliding = self._colliding()
        for kind, array, label, default in _NOT_CARRIED:
            for index in _unlike(model, array, default):
                warnings.add(f"not carried over: {label}", self._source.names(kind)[index])
        for array, label, default in _GEOM_NOT_CARRIED:
            for index in _unlike(model, array, default):
                if index in colliding:
                    warnings.add(f"not carried over: {label}", self._geoms[index])
        for geom in colliding:
            self._soft("contacts are rigid here; solref, solimp of geoms", "geom", geom, self._geoms[geom])
        for joint in range(model.njnt):
            if model.jnt_limited[joint]:
                self._soft("limits are rigid here; solref, solimp of joints", "jnt", joint, self._joints[joint])
        frictions = sorted({float(f"{model.geom_friction[geom, 0]:.6g}") for geom in colliding})
        if len(frictions) > 1 and self._options.material is None:
            listed = [f"{friction:g}" for friction in frictions]
            warnings.add("a contact's friction is sqrt(a b) here, max(a, b) in MuJoCo; the geoms have", *listed)
        for count, label in (
            ("ntendon", "tendons"),
            ("nflex", "flexes"),
            ("nplugin", "plugins"),
            ("npair", "contact pairs with parameters of their own"),
        ):
            if getattr(model, count, 0):
                warnings.add(f"not carried over: {getattr(model, count)} {label}", *self._listed(count))
        self._list_options()

    def _listed(self, count: str) -> Iterator[str]:
        if count == "npair":
            for a, b in zip(self._model.pair_geom1, self._model.pair_geom2, strict=True):
                yield f"{self._geoms[a]} with {self._geoms[b]}"
        elif count == "ntendon":
            yield from self._source.names("tendon")

    def _list_options(self) -> None:
        model, mj = self._model, self._mujoco
        for flag, label in _FLAGS.items():
            if model.opt.disableflags & int(getattr(mj.mjtDisableBit, flag)):
                self._warnings.add("option flags that are not carried over", f'{label}="disable"')
        if model.opt.enableflags & int(mj.mjtEnableBit.mjENBL_OVERRIDE):
            self._warnings.add("option flags that are not carried over", 'override="enable"')
        fluid = [name for name in ("density", "viscosity") if getattr(model.opt, name) != 0.0]
        if fluid:
            self._warnings.add("the medium has no drag here; options", *fluid)
        if np.any(model.opt.wind):
            self._warnings.add("the medium has no drag here; options", "wind")


def _rotation(quaternion: Array) -> Array:
    w, x, y, z = quaternion
    return from_quaternion((x, y, z, w))


def _unlike(model: Any, array: str, default: float) -> list[int]:
    """Rows of an array of the model, which an older MuJoCo may not have, that are not its default."""
    values = getattr(model, array, None)
    if values is None or not values.size:
        return []
    rows = np.asarray(values).reshape(len(values), -1)
    return [int(i) for i in np.flatnonzero((rows != default).any(axis=1))]


def keyframe(path: Path | str, world: World, number: int | str = 0, prefix: str = "") -> tuple[Array, Array]:
    """Configuration (nq,) and velocity (nv,) of a world loaded from this file at a keyframe, by number or name.

    Raises InvalidInputError when there is no such keyframe. Velocities of free joints turn from the world's axes, which
    MuJoCo has, to the body's.
    """
    source = read(Path(path))
    model = source.model
    names = source.names("key")
    index = names.index(number) if number in names else number
    if not isinstance(index, int) or not 0 <= index < model.nkey:
        raise InvalidInputError(f"{path}: has no keyframe {number!r}; there are {', '.join(names) or 'none'}")
    return state(source, world, model.key_qpos[index], model.key_qvel[index], prefix)


def state(
    source: Mjcf, world: World, qpos: npt.ArrayLike, qvel: npt.ArrayLike, prefix: str = ""
) -> tuple[Array, Array]:
    """MuJoCo's qpos and qvel as configuration (nq,) and velocity (nv,) of a world that the file was loaded into."""
    model = source.model
    position, velocity = np.asarray(qpos, dtype=np.float64), np.asarray(qvel, dtype=np.float64)
    q, v = np.array(world.initial_q), np.zeros(world.num_v)
    joints = {joint.name: joint for joint in world.joints}
    for i, name in enumerate(source.names("jnt")):
        joint = joints[prefix + name]
        a, b, kind = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i]), int(model.jnt_type[i])
        p, r = joint.q_index, joint.v_index
        if kind == 0:
            w, x, y, z = position[a + 3 : a + 7]
            q[p : p + 7] = *position[a : a + 3], x, y, z, w
            v[r : r + 3] = from_quaternion((x, y, z, w)).T @ velocity[b : b + 3]
            v[r + 3 : r + 6] = velocity[b + 3 : b + 6]
        elif kind == 1:
            w, x, y, z = position[a : a + 4]
            q[p : p + 4] = x, y, z, w
            v[r : r + 3] = velocity[b : b + 3]
        else:
            q[p], v[r] = position[a], velocity[b]
    return q, v
