"""The mathematics once more, in plain NumPy: what the package's own certificate is checked against."""

import numpy as np


def project_cone(mu, x):
    """Projection of (nc, 3) points (T1, T2, N) on |x_T| <= mu x_N, by the nearest of its three candidates."""
    out = np.empty_like(x)
    for i, (m, p) in enumerate(zip(mu, x, strict=True)):
        t = np.hypot(p[0], p[1])
        axis = p[:2] / t if t > 0 else np.array([1.0, 0.0])
        edge = np.append(m * axis, 1.0) / np.hypot(m, 1.0)
        candidates = [np.zeros(3), max(p @ edge, 0.0) * edge]
        if p[2] >= 0.0 and t <= m * p[2]:
            candidates.append(p)
        out[i] = min(candidates, key=lambda c: np.linalg.norm(p - c))
    return out


def relative_residual(delassus, free_velocity, mu, impulse, compliance=None, law="ncp"):
    """max |l - P_K(l - t)| / max(|l|, |g| / sqrt(d)), l = sqrt(d) impulse, t = (sigma + Gamma(sigma)) / sqrt(d)."""
    a = 0.5 * (delassus + delassus.T) + np.diag(np.zeros(len(free_velocity)) if compliance is None else compliance)
    g = free_velocity.reshape(-1, 3)
    sigma = (a @ impulse).reshape(-1, 3) + g
    if law == "ncp":
        sigma[:, 2] += mu * np.linalg.norm(sigma[:, :2], axis=1)
    root = np.sqrt(np.diag(a).reshape(-1, 3).mean(axis=1))[:, None]
    x = root * impulse.reshape(-1, 3)
    error = np.linalg.norm(x - project_cone(mu, x - sigma / root), axis=1).max()
    scale = max(np.linalg.norm(x, axis=1).max(), np.linalg.norm(g / root, axis=1).max())
    return error / scale


def planted_problem(seed, num_contacts=5, num_velocities=24):
    """(M, J, g, mu, impulse): contacts that stick, slide and open by turns, g chosen so that impulse solves."""
    rng = np.random.default_rng(seed)
    j = rng.normal(size=(3 * num_contacts, num_velocities))
    mass = np.diag(10.0 ** rng.uniform(-1, 1, num_velocities))
    mu = rng.uniform(0.1, 0.9, num_contacts)
    impulse, sigma = np.zeros((num_contacts, 3)), np.zeros((num_contacts, 3))
    for i in range(num_contacts):
        angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 2.0)
        direction = np.array([np.cos(angle), np.sin(angle)])
        if i % 3 == 0:  # sticks
            impulse[i] = size * np.append(rng.uniform(0, 0.9) * mu[i] * direction, 1.0)
        elif i % 3 == 1:  # slides, friction against the motion
            impulse[i] = size * np.append(-mu[i] * direction, 1.0)
            sigma[i, :2] = rng.uniform(0.1, 1.0) * direction
        else:  # opens
            sigma[i] = np.append(rng.normal(size=2), rng.uniform(0.1, 1.0))
    delassus = j @ np.linalg.solve(mass, j.T)
    return mass, j, sigma.ravel() - delassus @ impulse.ravel(), mu, impulse.ravel()
