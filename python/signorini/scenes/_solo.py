"""The quadruped Solo12 on a slope, or on random steps: terrain, world, and the scene `solo-terrain`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from signorini._simulation import Simulator
    from signorini._world import Material, World, WorldBuilder
    from signorini.scenes._solo_trot import Trot
    from signorini.scenes._worlds import Start

Array = npt.NDArray[np.float64]
LEGS = ("FL", "FR", "HL", "HR")
KNEES = (-1.0, -1.0, 1.0, 1.0)  # behind their feet, or ahead of them
FOOT_RADIUS = 0.016  # [m] of the mesh, a wheel
HEIGHT = 0.23  # [m] base above the ground, along the vertical
STANCE = 0.045  # [m] feet outside the shoulders


def solo_terrain(
    slope: float = 15.0, steps: float = 0.0, seed: int = 0, *, friction: float = 0.8, speed: float = 0.4
) -> Start:
    """The quadruped Solo12 on a slope, and random steps if wanted; its controller makes it walk uphill, along x.

    slope: angle [degrees], in [-25, 25]. steps: largest height of the tiles [m], in [0, 0.1]. seed: of their heights.
    speed: of the walk [m/s], in [0, 0.5].
    """
    from signorini.scenes._worlds import Start

    world, q = solo_world(_terrain(slope, steps, seed, friction, speed), friction)
    return Start(world, q, np.zeros(world.num_v))


def solo_controller(simulator: Simulator, start: Start, options: dict[str, Any]) -> Callable[[], None]:
    """The walk: see `_solo_trot`."""
    return trot(simulator, **options)


def trot(
    simulator: Simulator,
    slope: float = 15.0,
    steps: float = 0.0,
    seed: int = 0,
    *,
    friction: float = 0.8,
    speed: float = 0.4,
) -> Trot:
    """A controller for a simulator of solo_terrain() with the same options."""
    from signorini.scenes._solo_trot import Trot

    return Trot(simulator, _terrain(slope, steps, seed, friction, speed), friction=friction, speed=speed)


def _terrain(slope: float, steps: float, seed: int, friction: float, speed: float) -> Terrain:
    from signorini.scenes._worlds import _check

    _check(slope=(slope, -25.0, 25.0), steps=(steps, 0.0, 0.1), seed=(seed, 0, 2**63))
    _check(friction=(friction, 0.1, 10.0), speed=(speed, 0.0, 0.5))
    return Terrain.random(math.radians(slope), steps, seed)


@dataclass(frozen=True)
class Terrain:
    """A plane that rises along x through the world's origin, with tiles of random heights on it.

    slope: angle [rad]. tops: (n, m) heights of the tiles above the plane [m]; rows of m tiles, centred across, one row
    after the other from `start` on, along the plane. edge: of a tile [m].
    """

    slope: float
    tops: Array = field(default_factory=lambda: np.zeros((0, 1)))
    edge: float = 0.3
    start: float = 0.45

    @staticmethod
    def random(slope: float, steps: float, seed: int, *, length: float = 8.0, width: float = 1.8) -> Terrain:
        """Tiles with heights uniform in [0, steps] [m]; none if steps is 0."""
        if steps == 0.0:
            return Terrain(slope)
        shape = math.ceil(length / Terrain.edge), math.ceil(width / Terrain.edge)
        return Terrain(slope, np.random.default_rng(seed).uniform(0.0, steps, shape))

    @property
    def rotation(self) -> Array:
        """Columns: along the slope, across, normal."""
        c, s = math.cos(self.slope), math.sin(self.slope)
        return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])

    @property
    def normal(self) -> Array:
        return self.rotation[:, 2]

    def height(self, x: float, y: float) -> float:
        """z of the surface above (x, y) in the world [m]."""
        c, s = math.cos(self.slope), math.sin(self.slope)
        top = 0.0
        for _ in range(3 if self.slope else 1):  # tiles are upright to the slope, not to the world
            top = self.top((x + s * top) / c, y)
        return (top + x * s) / c

    def top(self, along: float, across: float) -> float:
        """Height above the plane at a point of it [m]."""
        i = math.floor((along - self.start) / self.edge)
        j = math.floor(across / self.edge + 0.5 * self.tops.shape[1])
        inside = 0 <= i < self.tops.shape[0] and 0 <= j < self.tops.shape[1]
        return float(self.tops[i, j]) if inside else 0.0

    def free(self, x: float, y: float, knee: float) -> bool:
        """Whether a foot can stand at (x, y): the ground is level around it, and not higher where its shin leans over,
        towards knee = 1 (ahead) or -1."""
        if not self.tops.size:
            return True
        along = x * math.cos(self.slope) + self.height(x, y) * math.sin(self.slope)
        top = self.top(along, y)
        around = [self.top(along + dx, y + dy) for dx in (-0.035, 0.035) for dy in (-0.035, 0.035)]
        if max(around) - top > 1e-3 or top - min(around) > 1e-3:
            return False
        shin = ((0.045, 0.0), (0.07, 0.0), (0.10, 0.04), (0.13, 0.04))  # as flat as it gets: distance, height
        return all(self.top(along + knee * dx, y) <= top + most + 1e-3 for dx, most in shin)

    def add_to(self, builder: WorldBuilder, material: Material) -> list[int]:
        """Adds plane and tiles; returns the indices of their geometries."""
        from signorini._world import Box, HalfSpace

        rotation, depth = self.rotation, 0.05
        made = [builder.add_geometry("world", HalfSpace(), orientation=rotation, material=material, name="slope")]
        for (i, j), top in np.ndenumerate(self.tops):
            if top <= 0.0:
                continue
            across = (j + 0.5 - 0.5 * self.tops.shape[1]) * self.edge
            centre = rotation @ [self.start + (i + 0.5) * self.edge, across, 0.5 * (top - depth)]
            box = Box((0.5 * self.edge, 0.5 * self.edge, 0.5 * (top + depth)))
            name = f"tile-{i}-{j}"
            made.append(
                builder.add_geometry("world", box, position=centre, orientation=rotation, material=material, name=name)
            )
        return made


def solo_world(terrain: Terrain, friction: float) -> tuple[World, Array]:
    """The robot on the terrain and q of its stand: base along the slope, feet below the shoulders and on the ground.

    Feet touch as spheres around the ankle; the meshes, wheels of that radius, never touch the ground.
    """
    from signorini._world import Material, Sphere, WorldBuilder
    from signorini.load import load, srdf
    from signorini.scenes._worlds import robots_folder

    folder = robots_folder() / "solo_description"
    builder, material = WorldBuilder(), Material(friction=friction)
    file, srdf_file = folder / "robots" / "solo12.urdf", folder / "srdf" / "solo.srdf"
    robot = load(file, builder=builder, floating_base=True, material=material, srdf=srdf_file)
    ground = terrain.add_to(builder, material)
    for leg in LEGS:
        foot = f"{leg}_FOOT"
        for index in ground:
            builder.exclude_geometries(robot.geometry_index(foot), index)
        builder.add_geometry(foot, Sphere(FOOT_RADIUS), material=material, name=f"{leg}-ball")
    world = builder.build()

    q = srdf.configuration(world, srdf.read(srdf_file).states["standing"])
    base = q[world.q_slice("root_joint")]
    base[:3] = 0.0, 0.0, terrain.height(0.0, 0.0) + HEIGHT
    base[3:] = 0.0, -math.sin(0.5 * terrain.slope), 0.0, math.cos(0.5 * terrain.slope)
    for leg in LEGS:
        joints = [world.joint(f"{leg}_{name}") for name in ("HAA", "HFE", "KFE")]
        shoulder = world.body_placement(f"{leg}_UPPER_LEG", q)[0]
        goal = foothold(terrain, shoulder[0], shoulder[1] + (STANCE if leg[1] == "L" else -STANCE))
        for _ in range(20):
            gap = goal - world.body_placement(f"{leg}_FOOT", q)[0]
            turning = world.jacobian(q, f"{leg}_FOOT")[:3, [joint.v_index for joint in joints]]
            q[[joint.q_index for joint in joints]] += np.linalg.solve(turning, gap)
    return world, q


def foothold(terrain: Terrain, x: float, y: float) -> Array:
    """Where the centre of a foot is that stands at (x, y)."""
    return np.array([x, y, terrain.height(x, y) + FOOT_RADIUS / math.cos(terrain.slope)])
