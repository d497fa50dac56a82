"""Many bodies at random, the same ones for the same seed: a settled heap of spheres and a hanging chain."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

import signorini
from signorini import _arrays
from signorini.scenes._bodies import (
    WORLD,
    Array,
    Bodies,
    Contacts,
    Indices,
    assemble,
    box_inertia,
    check_counts,
    check_finite,
    check_positive,
    check_range,
)

_SPREAD = (0.8, 1.2)  # radii over their mean
_MARGIN = 0.02  # a pair nearer than this many mean radii is a contact


def pile(
    num_contacts: int,
    seed: int = 0,
    *,
    layers: float | None = 4.0,
    contacts_per_sphere: float = 2.2,
    mass_ratio: float = 1.0,
    friction: float = 0.5,
    speed: float = 0.01,
    radius: float = 0.05,
    dt: float = 1e-3,
) -> signorini.ContactProblem:
    """One time step of a settled heap of spheres between four walls, with exactly num_contacts contacts.

    num_contacts: at least 1. seed: of everything random. layers: height of the heap in spheres, so that it grows in
    width (the default); None: as high as wide, a truly three-dimensional heap. contacts_per_sphere: 2 is isostatic; 2.2
    is a poured heap, 2.6 a jammed one, hyperstatic and far harder to solve. mass_ratio: masses are drawn between 1
    and mass_ratio kg, evenly on a log scale. friction: of every contact. speed: standard deviation of the spheres'
    velocities [m/s], so that some contacts slide or open. radius: mean radius [m], drawn within 20 %. dt: step [s].

    The spheres are dropped into place geometrically: overlaps are pushed apart and gravity pulls down until both
    balance. Contacts are what touches the ground or a wall, and the nearest pairs, with their gaps in the free
    velocity.

    Raises InvalidInputError naming the field for values out of range.
    """
    check_counts(1, num_contacts=num_contacts)
    _arrays.count("seed", seed, 0, bits=63)
    check_range(0.1, 100.0, contacts_per_sphere=contacts_per_sphere)
    check_positive(mass_ratio=mass_ratio, radius=radius, dt=dt)
    check_finite(speed=speed, friction=friction)
    if layers is not None:
        check_positive(layers=layers)
    random = np.random.default_rng(seed)
    num_spheres = max(1, math.ceil(num_contacts / contacts_per_sphere))
    height = max(1.0, (num_spheres ** (1.0 / 3.0)) if layers is None else min(layers, num_spheres))
    radii = random.uniform(*_SPREAD, num_spheres)
    half_width = max(math.sqrt(num_spheres / height), 1.2)
    centres = _settle(random, radii, half_width)

    contacts = _nearest_contacts(centres, radii, half_width, num_contacts, friction, radius)
    while contacts is None:  # too loose a heap: a few more spheres
        num_spheres += max(1, num_spheres // 10)
        radii = np.append(radii, random.uniform(*_SPREAD, num_spheres - len(radii)))
        centres = _settle(random, radii, half_width)
        contacts = _nearest_contacts(centres, radii, half_width, num_contacts, friction, radius)

    mass = mass_ratio ** random.uniform(0.0, 1.0, num_spheres)
    inertia = (0.4 * mass * (radius * radii) ** 2)[:, None, None] * np.eye(3)
    velocity = np.zeros((num_spheres, 6))
    velocity[:, :3] = speed * random.standard_normal((num_spheres, 3))
    velocity[:, 3:] = speed / radius * random.standard_normal((num_spheres, 3))
    bodies = Bodies(mass, inertia, radius * centres, velocity)
    shape = "heap" if layers is None else f"{layers:g}"
    return assemble(bodies, contacts, dt, f"pile-{num_contacts}-{shape}-{contacts_per_sphere:g}-{mass_ratio:g}-{seed}")


def _settle(random: np.random.Generator, radii: Array, half_width: float, sweeps: int = 600) -> Array:
    """Centres (n, 3) of spheres at rest between walls at +-half_width and above z = 0, in mean radii.

    Position-based relaxation: a step down, then every overlap is shared between its two spheres. The steps shrink to
    a hundred-thousandth of a radius, and the overlaps with them to a thousandth or so.
    """
    n = len(radii)
    columns = max(1, int(half_width))
    spot = np.arange(n)
    centres = np.stack([spot % columns, spot // columns % columns, spot // columns**2], axis=1).astype(np.float64)
    centres[:, :2] = (centres[:, :2] + 0.5) * (2.0 * half_width / columns) - half_width
    centres[:, 2] = 1.2 + 2.0 * centres[:, 2]
    centres += random.uniform(-0.4, 0.4, (n, 3))
    pairs = np.zeros((0, 2), dtype=np.int64)
    since = np.inf  # what the fastest sphere may have moved since the neighbours were found
    skin = 0.4
    for sweep in range(sweeps):
        if since > 0.5 * skin:
            pairs = cKDTree(centres).query_pairs(2.0 * _SPREAD[1] + skin, output_type="ndarray")
            pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
            since = 0.0
        before = centres.copy()
        centres[:, 2] -= 0.1 * 1e-4 ** (sweep / sweeps)
        for _ in range(2):
            a, b = pairs[:, 0], pairs[:, 1]
            offset = centres[b] - centres[a]
            distance = np.linalg.norm(offset, axis=1)
            overlap = radii[a] + radii[b] - distance
            k = overlap > 0.0
            push = (0.5 * overlap[k] / np.maximum(distance[k], 1e-12))[:, None] * offset[k]
            count = np.bincount(a[k], minlength=n) + np.bincount(b[k], minlength=n)
            move = np.empty_like(centres)
            for axis in range(3):
                move[:, axis] = np.bincount(b[k], push[:, axis], n) - np.bincount(a[k], push[:, axis], n)
            centres += move * (1.5 / np.maximum(count, 1.5))[:, None]  # averaged over the neighbours, then relaxed
            centres[:, :2] = np.clip(centres[:, :2], radii[:, None] - half_width, half_width - radii[:, None])
            centres[:, 2] = np.maximum(centres[:, 2], radii)
        since += float(np.abs(centres - before).max())
    return centres


def _nearest_contacts(
    centres: Array, radii: Array, half_width: float, num_contacts: int, friction: float, radius: float
) -> Contacts | None:
    """num_contacts: what touches a wall or the ground, then the nearest pairs; None when there are fewer."""
    pairs = cKDTree(centres).query_pairs(2.0 * _SPREAD[1] + _MARGIN, output_type="ndarray").astype(np.int64)
    offset = centres[pairs[:, 1]] - centres[pairs[:, 0]]
    distance = np.linalg.norm(offset, axis=1)
    normals = [offset / distance[:, None]]
    gaps = [distance - radii[pairs[:, 0]] - radii[pairs[:, 1]]]
    body_a: list[Indices] = [pairs[:, 0]]
    body_b: list[Indices] = [pairs[:, 1]]
    everyone = np.arange(len(radii))
    planes = [((0, 0, 1), 0.0)]
    planes += [(direction, -half_width) for direction in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))]
    for direction, level in planes:
        n = np.array(direction, dtype=np.float64)
        normals.append(np.tile(n, (len(radii), 1)))
        gaps.append(centres @ n - level - radii)
        body_a.append(np.full(len(radii), WORLD))
        body_b.append(everyone)
    normal, gap = np.concatenate(normals), np.concatenate(gaps)
    a, b = np.concatenate(body_a), np.concatenate(body_b)
    if np.count_nonzero(gap < _MARGIN) < num_contacts:
        return None
    # What stands on the ground or leans on a wall touches without overlap: before the pairs, or they would come last.
    carried = (a == WORLD) & (gap <= 1e-9)
    nearest = np.lexsort((b, a, gap, ~carried))[:num_contacts]
    chosen = nearest[np.lexsort((a[nearest], b[nearest]))]
    a, b, normal, gap = a[chosen], b[chosen], normal[chosen], gap[chosen]
    point = centres[b] - (radii[b] + 0.5 * gap)[:, None] * normal
    return Contacts(a, b, radius * point, normal, radius * gap, np.full(num_contacts, float(friction)))


def chain(
    num_links: int = 11,
    seed: int = 0,
    *,
    friction: float = 0.3,
    mass_ratio: float = 1.0,
    speed: float = 0.05,
    dt: float = 1e-3,
) -> signorini.ContactProblem:
    """One time step of a hanging chain: num_links links of wire, the first one fixed, each turned by a right angle.

    Links touch at one to three points each, near each other and along slightly different normals: small, coupled from
    end to end and hyperstatic. seed: of everything random. friction: of every contact. mass_ratio: mass of the last
    link [kg]; the first has 1 kg. speed: standard deviation of the velocities [m/s]. dt: time step [s].

    Raises InvalidInputError for less than two links, or a mass ratio or step that is not positive.
    """
    check_counts(2, num_links=num_links)
    _arrays.count("seed", seed, 0, bits=63)
    check_positive(mass_ratio=mass_ratio, dt=dt)
    check_finite(speed=speed, friction=friction)
    random = np.random.default_rng(seed)
    n = num_links - 1
    length, width, wire = 0.06, 0.04, 0.005  # outer length and width of a link, radius of its wire [m]
    pitch = length - 4.0 * wire
    mass = np.geomspace(1.0, mass_ratio, n)
    position = np.zeros((n, 3))
    position[:, 2] = -pitch * np.arange(1, n + 1)
    size = np.tile([width, 2.0 * wire, length], (n, 1))
    size[1::2] = size[1::2][:, [1, 0, 2]]
    velocity = speed * random.standard_normal((n, 6))
    velocity[:, 3:] /= width

    body_a: list[int] = []
    body_b: list[int] = []
    points, normals = [], []
    for link in range(n):
        top = position[link] + [0.0, 0.0, 0.5 * length - wire]  # its wire's centre, resting on the link above
        for _ in range(int(random.integers(1, 4))):
            tilt = random.uniform(-0.4, 0.4, 2)
            normal = np.array([tilt[0], tilt[1], 1.0])  # from the link above, A, to this one, B, which it carries
            normal /= np.linalg.norm(normal)
            body_a.append(link - 1)  # WORLD = -1 above the first
            body_b.append(link)
            normals.append(normal)
            points.append(top - wire * normal)
    contacts = Contacts(
        body_a=np.array(body_a),
        body_b=np.array(body_b),
        point=np.array(points),
        normal=np.array(normals),
        gap=np.zeros(len(points)),
        friction=np.full(len(points), float(friction)),
    )
    bodies = Bodies(mass, box_inertia(mass, size), position, velocity)
    return assemble(bodies, contacts, dt, f"chain-{num_links}-{mass_ratio:g}-{seed}")
