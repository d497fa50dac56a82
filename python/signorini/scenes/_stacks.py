"""Boxes on boxes: the paper's stack of cubes and a brick wall. Hyperstatic, with mass ratios as high as one likes."""

from __future__ import annotations

import numpy as np

import signorini
from signorini.scenes._bodies import (
    WORLD,
    Bodies,
    Contacts,
    assemble,
    box_inertia,
    check_counts,
    check_finite,
    check_positive,
)


def cube_stack(
    num_cubes: int = 15,
    mass_ratio: float = 1e4,
    slip: float = 0.0,
    *,
    friction: float = 0.8,
    size: float = 0.2,
    dt: float = 1e-3,
) -> signorini.ContactProblem:
    """One time step of the paper's stack of cubes (Fig. 1): the light cube at the bottom, four contacts an interface.

    num_cubes: cubes one on the other, 4 num_cubes contacts. mass_ratio: mass of the top cube [kg]; the bottom one has
    1 kg, those between follow geometrically. slip: tangential velocity across the top interface [m/s]; it falls
    linearly to a fifth of it on the ground. friction: of every contact. size: edge [m]. dt: time step [s].

    Raises InvalidInputError for num_cubes < 1 or a value that is not positive (friction: 0 too; slip: anything finite).
    """
    check_counts(1, num_cubes=num_cubes)
    check_positive(mass_ratio=mass_ratio, size=size, dt=dt)
    check_finite(slip=slip, friction=friction)
    mass = np.geomspace(1.0, mass_ratio, num_cubes) if num_cubes > 1 else np.ones(1)
    velocity = np.zeros((num_cubes, 6))
    velocity[:, 0] = np.cumsum(np.linspace(0.2 * slip, slip, num_cubes) if num_cubes > 1 else [slip])
    position = np.zeros((num_cubes, 3))
    position[:, 2] = size * (np.arange(num_cubes) + 0.5)
    bodies = Bodies(mass, box_inertia(mass, np.full((num_cubes, 3), size)), position, velocity)

    corner = 0.5 * size * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], dtype=np.float64)
    point = np.zeros((num_cubes, 4, 3))
    point[:, :, :2] = corner
    point[:, :, 2] = size * np.arange(num_cubes)[:, None]
    above = np.repeat(np.arange(num_cubes), 4)
    nc = 4 * num_cubes
    contacts = Contacts(
        body_a=above - 1,  # the ground, WORLD = -1, below the first
        body_b=above,
        point=point.reshape(-1, 3),
        normal=np.tile([0.0, 0.0, 1.0], (nc, 1)),
        gap=np.zeros(nc),
        friction=np.full(nc, float(friction)),
    )
    return assemble(bodies, contacts, dt, f"cube-stack-{num_cubes}-{mass_ratio:g}-{slip:g}")


def wall(
    num_rows: int = 8,
    num_columns: int = 6,
    mass_ratio: float = 1e4,
    *,
    ball_mass: float = 1e3,
    ball_speed: float = 5.0,
    friction: float = 0.8,
    size: float = 0.2,
    dt: float = 1e-3,
) -> signorini.ContactProblem:
    """One time step of a brick wall as a ball hits it: half-bond courses, four contacts an overlap, the paper's wall.

    num_rows, num_columns: bricks; every other row is shifted by half a brick. mass_ratio: mass of the top row's bricks
    [kg], the bottom one's is 1 kg, geometric between. ball_mass [kg], ball_speed [m/s]: a ball that touches the middle
    of the wall's face; ball_mass = 0: no ball. size: a brick is 2 size long, size wide and high [m]. dt: time step [s].

    Raises InvalidInputError for less than one row or column, for a mass ratio, size or step that is not positive, and
    for a ball_mass or friction below 0.
    """
    check_counts(1, num_rows=num_rows, num_columns=num_columns)
    check_positive(mass_ratio=mass_ratio, size=size, dt=dt)
    check_finite(ball_speed=ball_speed, friction=friction)
    if ball_mass != 0.0:
        check_positive(ball_mass=ball_mass)
    row, column = (x.ravel() for x in np.meshgrid(np.arange(num_rows), np.arange(num_columns), indexing="ij"))
    left = 2.0 * size * column + size * (row % 2)
    edges = np.array([2.0 * size, size, size])
    position = np.stack([left + size, np.zeros(len(row)), size * (row + 0.5)], axis=1)
    mass = mass_ratio ** (row / max(num_rows - 1, 1))
    inertia = box_inertia(mass, np.tile(edges, (len(row), 1)))

    body_a: list[int] = []
    body_b: list[int] = []
    points: list[tuple[float, float, float]] = []
    for b in range(len(row)):
        below = [WORLD] if row[b] == 0 else [(row[b] - 1) * num_columns + c for c in range(num_columns)]
        for a in below:
            low = left[b] if a == WORLD else max(left[a], left[b])
            high = left[b] + 2.0 * size if a == WORLD else min(left[a], left[b]) + 2.0 * size
            if high - low < 1e-9 * size:
                continue
            for x in (low, high):
                for y in (-0.5 * size, 0.5 * size):
                    body_a.append(a)
                    body_b.append(b)
                    points.append((x, y, size * row[b]))
    normal = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    velocity = np.zeros((len(row), 6))
    if ball_mass > 0.0:
        hit = (num_rows // 2) * num_columns + num_columns // 2
        radius = 2.0 * size
        point = position[hit] + np.array([0.0, -0.5 * size, 0.0])
        body_a.append(len(row))  # the ball pushes along +y, from A to B
        body_b.append(hit)
        points.append((point[0], point[1], point[2]))
        normal = np.vstack([normal, [0.0, 1.0, 0.0]])
        position = np.vstack([position, point - [0.0, radius, 0.0]])
        mass = np.append(mass, ball_mass)
        inertia = np.concatenate([inertia, 0.4 * ball_mass * radius**2 * np.eye(3)[None]])
        velocity = np.vstack([velocity, [0.0, ball_speed, 0.0, 0.0, 0.0, 0.0]])
    contacts = Contacts(
        body_a=np.array(body_a),
        body_b=np.array(body_b),
        point=np.array(points),
        normal=normal,
        gap=np.zeros(len(points)),
        friction=np.full(len(points), float(friction)),
    )
    bodies = Bodies(mass, inertia, position, velocity)
    return assemble(bodies, contacts, dt, f"wall-{num_rows}x{num_columns}-{mass_ratio:g}")
