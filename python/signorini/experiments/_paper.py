"""The paper's figures, printed beside ours (Carpentier, Le Lidec, Montaut 2024, section V; an M1 Max).

Its problems are FCLIB's own BoxesStack, Chain and Capsules. Ours may be other problems of the same description, on
another machine: compare ratios and shapes, not the numbers.
"""

from __future__ import annotations

#: Our folder of a family -> the paper's name.
FAMILIES = {"boxes_stack": "BoxesStack", "chain": "Chain", "capsules": "Capsules"}

#: (rule, parameter) of Tables III and IV, left to right.
RULES = (
    ("linear", 2.0),
    ("linear", 4.0),
    ("linear", 8.0),
    ("linear", 16.0),
    ("spectral", 0.01),
    ("spectral", 0.05),
    ("spectral", 0.08),
)

#: Table III: mean and standard deviation of the Cholesky updates.
UPDATES = {
    "boxes_stack": ((9.20, 2.48), (6.12, 1.75), (5.85, 2.47), (6.12, 2.40), (11.26, 4.99), (5.02, 2.40), (3.97, 1.76)),
    "chain": ((5.74, 1.53), (8.76, 69.93), (33.7, 212.77), (25.48, 154.88), (7.87, 6.55), (2.76, 1.65), (3.61, 20.48)),
    "capsules": ((4.58, 1.71), (3.09, 2.01), (3.60, 2.94), (4.6, 2.06), (5.57, 4.85), (2.30, 1.50), (2.12, 1.01)),
}

#: Table IV: mean and standard deviation of the times [ms].
MILLISECONDS = {
    "boxes_stack": ((2.16, 1.80), (1.73, 1.55), (1.76, 1.80), (1.95, 1.87), (2.56, 2.03), (1.55, 1.60), (1.51, 1.76)),
    "chain": (
        (0.527, 0.417),
        (0.637, 0.373),
        (1.61, 7.84),
        (1.34, 6.82),
        (0.445, 0.53),
        (0.321, 0.304),
        (0.494, 0.301),
    ),
    "capsules": ((2.86, 1.90), (2.50, 1.92), (1.95, 1.35), (1.69, 1.20), (2.17, 1.38), (1.72, 1.09), (1.63, 1.10)),
}

#: Table II: problems, contacts, degrees of freedom, friction.
PROBLEMS = {
    "boxes_stack": (255, "0-200", "6-300", 0.7),
    "chain": (242, "8-28", "48-60", 0.3),
    "capsules": (249, "0-200", "6-300", 0.7),
}

#: What the paper shows, by experiment.
SHOWS = {
    "profiles": "Fig. 7: ADMM with the spectral rule solves most problems of BoxesStack, Capsules and Chain fastest at "
    "1e-6; PGS does not reach that within 20 000 iterations on BoxesStack and Capsules.",
    "updates": "Tables III and IV: mean and deviation of Cholesky updates and times, linear and spectral rule.",
    "convergence": "Fig. 4: on the stack of cubes and on Talos the spectral rule reaches 1e-9 in fewer iterations than "
    "the linear one, and PGS does not get there.",
    "timings": "Fig. 5: mean time to 1e-4 (absolute) or 1000 iterations of its ADMM, and of PGS and SCS on the CCP. "
    "ADMM is consistently fast; PGS falls far behind it on the hand, the humanoid and the stack of cubes. It is a "
    "plot without numbers, of problems that were not published.",
    "simulators": "Fig. 6: steps a second of UR5, Cassie and the humanoid beside MuJoCo, Drake and Bullet.",
    "inverse": "Fig. 8: torque and contact torque of a UR5 sliding on a wall, NCP and CCP; one iteration for the NCP.",
    "models": "Table I: which contact model each physics engine uses, and what it relaxes.",
}


def said(experiment: str) -> str:
    """The same as a sentence; empty where the paper has nothing of the kind."""
    return f"The paper's {SHOWS[experiment]}" if experiment in SHOWS else ""
