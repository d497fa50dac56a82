"""MJCF -> bodies, joints, geometries, actuators and equalities, by way of MuJoCo's own compiler.

MuJoCo reads the file; the arrays of its compiled model are converted. What they hold and a World has not is told to
builder.warn. Which is which, and the rules: docs/robot_files.md. In MuJoCo quaternions are (w, x, y, z).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError
from signorini.load import _mjcf_drives, _mjcf_scan, mesh
from signorini.load._mjcf_softness import is_default
from signorini.load._options import Added, Options, Warnings
from signorini.load._placement import Placement, from_quaternion

if TYPE_CHECKING:
    from signorini._simulation import Simulator
    from signorini._world import HeightField, Joint, Material, Shape, World, WorldBuilder

Array = npt.NDArray[np.float64]
Result = TypeVar("Result")

WORLD = "world"
#: Flags of <option> that, disabled, take something away: the arrays that are 0 then.
_FLAGS: dict[str, tuple[str, ...]] = {
    "mjDSBL_EQUALITY": ("eq_active0",),
    "mjDSBL_FRICTIONLOSS": ("dof_frictionloss", "tendon_frictionloss"),
    "mjDSBL_LIMIT": ("jnt_limited", "tendon_limited"),
    "mjDSBL_CONTACT": ("geom_contype", "geom_conaffinity"),
    "mjDSBL_SPRING": ("jnt_stiffness", "tendon_stiffness"),
    "mjDSBL_DAMPER": ("dof_damping", "tendon_damping", "actuator_damping"),
    "mjDSBL_CLAMPCTRL": ("actuator_ctrllimited",),
}
_CONSTRAINTS = ("mjDSBL_EQUALITY", "mjDSBL_FRICTIONLOSS", "mjDSBL_LIMIT", "mjDSBL_CONTACT")
#: Arrays over all that differ from their default only when the file asks for something that is not carried over.
_NOT_CARRIED: tuple[tuple[str, str, str, float], ...] = (
    ("jnt", "jnt_stiffnesspoly", "springs of higher order of joints", 0.0),
    ("jnt", "jnt_springyield", "springs that yield of joints", 0.0),
    ("jnt", "jnt_actgravcomp", "gravity compensation by actuators of joints", 0.0),
    ("jnt", "jnt_margin", "margins of limits of joints", 0.0),
    ("actuator", "actuator_delay", "delays of actuators", 0.0),
    ("actuator", "actuator_dampingpoly", "damping of higher order of actuators", 0.0),
    ("tendon", "tendon_armature", "armature of tendons", 0.0),
    ("tendon", "tendon_stiffnesspoly", "springs of higher order of tendons", 0.0),
    ("tendon", "tendon_dampingpoly", "damping of higher order of tendons", 0.0),
    ("tendon", "tendon_springyield", "springs that yield of tendons", 0.0),
    ("tendon", "tendon_margin", "margins of limits of tendons", 0.0),
)
_GEOM_NOT_CARRIED: tuple[tuple[str, str, float], ...] = (
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
        raise ImportError(f"{path}: MJCF is compiled by MuJoCo: pip install 'signorini[mjcf]' ({error})") from None
    if not path.is_file():
        raise InvalidInputError(f"{path}: there is no such file")
    _mjcf_scan.scan(path)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InvalidInputError(f"{path}: {' '.join(str(error).split())}") from None
    return Mjcf(path, mujoco, model)


class Mjcf:
    """A compiled file. model: mujoco.MjModel."""

    def __init__(self, path: Path, mujoco: Any, model: Any) -> None:
        self.path, self.model, self._mujoco = path, model, mujoco
        self._names: dict[str, list[str]] = {}
        for flag, arrays in _FLAGS.items():
            if self.disables(flag) or (self.disables("mjDSBL_CONSTRAINT") and flag in _CONSTRAINTS):
                for array in arrays:
                    if hasattr(model, array):
                        getattr(model, array)[:] = 0

    def disables(self, flag: str) -> bool:
        return bool(self.model.opt.disableflags & int(getattr(self._mujoco.mjtDisableBit, flag)))

    @property
    def gravity(self) -> tuple[float, float, float] | None:
        if self.disables("mjDSBL_GRAVITY"):
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
        self.builder, self._source, self.mujoco, self.options = builder, source, mujoco, options
        self.model = source.model
        #: False: the file disables all contact
        self.collides = not (source.disables("mjDSBL_CONTACT") or source.disables("mjDSBL_CONSTRAINT"))
        self.warnings = Warnings(source.path)
        self.geometries_of: dict[int, list[int]] = {}  # of a geom
        self._added = Added(source.path)
        self._bodies, self._joints, self._geoms = (source.names(kind) for kind in ("body", "jnt", "geom"))
        self._losses = _mjcf_drives.drive_losses(self.model, mujoco)

    def add(self) -> Added:
        for body in range(1, self.model.nbody):
            self._add_body(body)
        for geom in self._colliding():
            self._add_geometry(geom)
        for geom in range(self.model.ngeom):
            self._add_visual(geom)
        for signature in self.model.exclude_signature:
            self.builder.exclude(self.body(int(signature) >> 16), self.body(int(signature) & 0xFFFF))
        _mjcf_drives.add(self)
        self._list_the_rest()
        self.warnings.tell(self.builder)
        return self._added

    def _fail(self, kind: str, name: str, reason: object) -> NoReturn:
        raise InvalidInputError(f'{self._source.path}: {kind} "{name}": {reason}') from None

    def call(self, kind: str, name: str, function: Callable[[], Result]) -> Result:
        try:
            return function()
        except InvalidInputError as error:
            self._fail(kind, name, error)

    def name(self, kind: str, index: int) -> str:
        """Of an element in the world."""
        return self.options.prefix + self._source.names(kind)[index]

    def body(self, body: int) -> str:
        return WORLD if body == 0 else self.name("body", body)

    def placed(self, body: int, position: Array, quaternion: Array) -> Placement:
        """In `body`, the world being where the caller put it."""
        placement = Placement(_rotation(quaternion), np.asarray(position, dtype=np.float64))
        return self.options.placement @ placement if body == 0 else placement

    # Bodies and joints

    def _add_body(self, body: int) -> None:
        model, name = self.model, self.body(body)
        parent = int(model.body_parentid[body])
        placement = self.placed(parent, model.body_pos[body], model.body_quat[body])
        axes = _rotation(model.body_iquat[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = [self._joint(joint) for joint in range(first, first + count)]
        self.call(
            "body",
            name,
            lambda: self.builder.add_body(
                name,
                parent=self.body(parent),
                position=placement.position.tolist(),
                orientation=placement.rotation,
                joints=joints,
                mass=float(model.body_mass[body]),
                center=model.body_ipos[body].tolist(),
                inertia=axes @ np.diag(model.body_inertia[body]) @ axes.T,
                gravity_compensation=float(model.body_gravcomp[body]),
            ),
        )
        self._added.bodies.append(name)
        if model.body_mocapid[body] >= 0:
            self.warnings.add("mocap bodies do not move", name)

    def _joint(self, joint: int) -> Joint:
        from signorini._world import Joint

        model, types, name = self.model, self.mujoco.mjtJoint, self.name("jnt", joint)
        kind, dof, adr = int(model.jnt_type[joint]), int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        losses: dict[str, Any] = {
            "armature": float(model.dof_armature[dof] + self._losses[1][dof]),
            "damping": float(model.dof_damping[dof] + self._losses[0][dof]),
            "friction": float(model.dof_frictionloss[dof]),
        }
        held = _mjcf_drives.joint_spring(self, joint)
        limit: dict[str, Any] = {}
        if model.jnt_limited[joint]:
            limit = {"limit_stiffness": held.stiffness, "limit_damping": held.damping}
        if np.any(model.dof_dampingpoly[dof] if hasattr(model, "dof_dampingpoly") else 0.0):
            self.warnings.add("damping of higher order of joints", name)
        if kind in (types.mjJNT_FREE, types.mjJNT_BALL):
            if model.jnt_stiffness[joint] != 0.0:
                self.warnings.add("springs of free and ball joints", name)
            if kind == types.mjJNT_FREE:
                return Joint(name, "free", **losses)
            largest = float(model.jnt_range[joint].max()) if model.jnt_limited[joint] else math.inf
            largest = largest if largest < math.pi else math.inf
            return Joint(name, "ball", anchor=model.jnt_pos[joint].tolist(), upper=largest, **limit, **losses)
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
            **limit,
            **losses,
        )

    # Geometries

    def _colliding(self) -> list[int]:
        model = self.model
        if not self.collides:
            return []
        paired = {int(geom) for geom in (*model.pair_geom1, *model.pair_geom2)}
        return [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g] or g in paired]

    def _add_geometry(self, geom: int) -> None:
        model = self.model
        body, name = int(model.geom_bodyid[geom]), self.name("geom", geom)
        placement = self.placed(body, model.geom_pos[geom], model.geom_quat[geom])
        if model.geom_type[geom] == self.mujoco.mjtGeom.mjGEOM_MESH:
            hulls = self._mesh_hulls(geom)
            for part, hull in enumerate(hulls):
                shape, inner = mesh.shape(hull)
                part_name = name if len(hulls) == 1 else f"{name}_{part}"
                self._added.hulls[self._add_shape(geom, shape, placement @ inner, part_name)] = hull
            return
        other = self._shape(geom)
        if other is not None:
            self._add_shape(geom, other, placement, name)

    def _add_shape(self, geom: int, shape: Shape, placement: Placement, name: str) -> int:
        model = self.model
        body = int(model.geom_bodyid[geom])
        index = self.call(
            "geom",
            name,
            lambda: self.builder.add_geometry(
                self.body(body),
                shape,
                position=placement.position.tolist(),
                orientation=placement.rotation,
                material=self._material(geom),
                name=name,
                group=int(model.geom_contype[geom]) & 0xFFFFFFFF,
                mask=int(model.geom_conaffinity[geom]) & 0xFFFFFFFF,
            ),
        )
        self.geometries_of.setdefault(geom, []).append(index)
        self._added.geometries.append(index)
        self._added.body_of_geometry[index] = self.body(body)
        return index

    def _triangles(self, geom: int) -> tuple[Array, npt.NDArray[np.int32]]:
        """Vertices and triangles of a mesh, in the frame of the geom."""
        model, number = self.model, int(self.model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
        face, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
        vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
        return vertices, np.asarray(model.mesh_face[face : face + faces], dtype=np.int32)

    def _mesh_hulls(self, geom: int) -> list[mesh.Hull]:
        name, body = self._geoms[geom], self._bodies[self.model.geom_bodyid[geom]]
        vertices, triangles = self._triangles(geom)
        solid = mesh.Mesh(vertices, triangles.astype(np.int64))
        split = self.options.splits(body)
        hulls = self.call("geom", name, lambda: mesh.hulls(solid, self.options.hull_vertices, split))
        self.warnings.add_hulls(f"of {name}", hulls)
        return hulls

    def _add_visual(self, geom: int) -> None:
        """What MuJoCo's own viewer shows at first: groups 0 to 2."""
        from signorini._visual import TriangleMesh

        model, mj = self.model, self.mujoco
        color = tuple(float(x) for x in self._color(geom))
        if model.geom_group[geom] > 2 or color[3] == 0.0:
            return
        shape: Shape | TriangleMesh | None
        if int(model.geom_type[geom]) in (mj.mjtGeom.mjGEOM_MESH, mj.mjtGeom.mjGEOM_SDF):
            shape = TriangleMesh(*self._triangles(geom))
        elif model.geom_type[geom] == mj.mjtGeom.mjGEOM_HFIELD:
            shape = self._height_field(geom)
        else:
            shape = self._shape(geom)
        if shape is None:
            return
        body = int(model.geom_bodyid[geom])
        placement = self.placed(body, model.geom_pos[geom], model.geom_quat[geom])
        self.builder.add_visual(
            self.body(body),
            shape,
            position=placement.position,
            orientation=placement.rotation,
            color=(color[0], color[1], color[2], color[3]),
        )

    def _color(self, geom: int) -> Array:
        """The geom's own, unless it has the default and a material."""
        model = self.model
        own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
        if material >= 0 and np.allclose(own, (0.5, 0.5, 0.5, 1.0)):
            return np.asarray(model.mat_rgba[material], dtype=np.float64)
        return np.asarray(own, dtype=np.float64)

    def _material(self, geom: int) -> Material:
        from signorini._world import Material

        model = self.model
        asked = self.options.material_of(self._bodies[model.geom_bodyid[geom]])
        if asked is not None:
            return asked
        held = _mjcf_drives.geom_spring(self, geom)
        soft = self.options.compliance != "rigid" and not is_default(model.geom_solref[geom], model.geom_solimp[geom])
        if soft and model.geom_priority[geom] > 0 and math.isinf(held.stiffness):
            self.warnings.add("solref and solimp of geoms with priority that are fixed to the world", self._geoms[geom])
        return Material(
            friction=float(model.geom_friction[geom, 0]),
            stiffness=held.stiffness,
            damping=held.damping,
            friction_mix="maximum",
            priority=int(model.geom_priority[geom]),
            torsion=float(model.geom_friction[geom, 1]),
            rolling=float(model.geom_friction[geom, 2]),
            condim=_mjcf_drives.condim(model.geom_condim[geom]),
        )

    def _shape(self, geom: int) -> Shape | None:
        from signorini import _world

        model, types, name = self.model, self.mujoco.mjtGeom, self._geoms[geom]
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
        if kind == types.mjGEOM_HFIELD and model.body_weldid[model.geom_bodyid[geom]] == 0:
            return self._height_field(geom)
        label = {int(types.mjGEOM_HFIELD): "height fields that move", int(types.mjGEOM_SDF): "signed distance fields"}
        self.warnings.add(f"{label.get(int(kind), f'geoms of type {int(kind)}')} do not collide", name)
        return None

    def _height_field(self, geom: int) -> HeightField:
        """MuJoCo keeps heights from 0 to 1, and their scale in the third size."""
        from signorini._world import HeightField

        model, number = self.model, int(self.model.geom_dataid[geom])
        rows, columns, first = (int(of[number]) for of in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
        x, y, top, base = (float(size) for size in model.hfield_size[number])
        heights = np.asarray(model.hfield_data[first : first + rows * columns], dtype=np.float64)
        return HeightField(top * heights.reshape(rows, columns), (x, y), base)

    # What is not carried over

    def _list_the_rest(self) -> None:
        model, warnings = self.model, self.warnings
        colliding = self._colliding()
        for kind, array, label, default in _NOT_CARRIED:
            for index in _unlike(model, array, default):
                if array.endswith("_margin") and not getattr(model, f"{kind}_limited")[index]:
                    continue
                warnings.add(f"not carried over: {label}", self._source.names(kind)[index])
        for array, label, default in _GEOM_NOT_CARRIED:
            for index in _unlike(model, array, default):
                if index in colliding:
                    warnings.add(f"not carried over: {label}", self._geoms[index])
        for count, label in (("nflex", "flexes"), ("nplugin", "plugins")):
            if getattr(model, count, 0):
                warnings.add(f"not carried over: {getattr(model, count)} {label}")
        self._list_options()

    def _list_options(self) -> None:
        model, mj = self.model, self.mujoco
        if not self.collides and model.ngeom:
            self.warnings.add("the file disables contact, nothing of it collides")
        if self._source.disables("mjDSBL_FILTERPARENT"):
            self.warnings.add("option flags that are not carried over", 'filterparent="disable"')
        if model.opt.enableflags & int(mj.mjtEnableBit.mjENBL_OVERRIDE):
            self.warnings.add("option flags that are not carried over", 'override="enable"')
        fluid = [name for name in ("density", "viscosity") if getattr(model.opt, name) != 0.0]
        if fluid:
            self.warnings.add("the medium has no drag here; options", *fluid)
        if np.any(model.opt.wind):
            self.warnings.add("the medium has no drag here; options", "wind")


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


class Keyframe(NamedTuple):
    """A state that a file keeps: q (nq,), v (nv,), control and activation (num_controls,), time [s]."""

    q: Array
    v: Array
    control: Array
    activation: Array
    time: float

    def apply(self, simulator: Simulator) -> None:
        """Puts a simulator of the world there."""
        simulator.state.q, simulator.state.v, simulator.state.time = self.q, self.v, self.time
        simulator.control, simulator.state.activation = self.control, self.activation


def keyframe(path: Path | str, world: World, number: int | str = 0, prefix: str = "") -> Keyframe:
    """A keyframe, by number or name, for a world loaded from this file.

    Raises InvalidInputError when there is no such keyframe. Velocities of free joints turn from the world's axes, which
    MuJoCo has, to the body's.
    """
    source = read(Path(path))
    model = source.model
    names = source.names("key")
    index = names.index(number) if number in names else number
    if not isinstance(index, int) or not 0 <= index < model.nkey:
        raise InvalidInputError(f"{path}: has no keyframe {number!r}; there are {', '.join(names) or 'none'}")
    q, v = state(source, world, model.key_qpos[index], model.key_qvel[index], prefix)
    control, activation = np.zeros(world.num_controls), np.zeros(world.num_controls)
    for actuator, name in enumerate(source.names("actuator")):
        if prefix + name not in world.actuator_names:
            continue  # not carried over
        at = world.actuator_index(prefix + name)
        control[at] = model.key_ctrl[index, model.actuator_ctrladr[actuator]]
        if model.actuator_actnum[actuator]:
            activation[at] = model.key_act[index, model.actuator_actadr[actuator]]
    return Keyframe(q, v, control, activation, float(model.key_time[index]))


def state(
    source: Mjcf, world: World, qpos: npt.ArrayLike, qvel: npt.ArrayLike, prefix: str = ""
) -> tuple[Array, Array]:
    """MuJoCo's qpos and qvel as configuration (nq,) and velocity (nv,) of a world that the file was loaded into.

    source: read(path).
    """
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
