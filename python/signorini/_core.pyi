# The compiled module, as the package uses it.
import enum
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__version__: str
_Vector = npt.NDArray[np.float64]

class InvalidInputError(ValueError): ...

class CscArrays:
    def __init__(
        self,
        rows: int,
        cols: int,
        data: _Vector,
        indices: npt.NDArray[np.int32],
        indptr: npt.NDArray[np.int32],
    ) -> None: ...

class ConstraintSets:
    def __init__(self, types: Sequence[int], first: Sequence[float], second: Sequence[float]) -> None: ...
    @staticmethod
    def friction_cones(friction: _Vector) -> ConstraintSets: ...
    def project(self, x: _Vector) -> _Vector: ...
    @property
    def size(self) -> int: ...

class Delassus:
    @property
    def size(self) -> int: ...
    @property
    def asymmetry(self) -> float: ...
    def csc(self) -> tuple[_Vector, npt.NDArray[np.int32], npt.NDArray[np.int32]]: ...
    def column(self, column: int) -> _Vector: ...

def dense_delassus(matrix: npt.NDArray[np.float64]) -> Delassus: ...
def sparse_delassus(matrix: CscArrays) -> Delassus: ...
def mass_space_delassus(mass: CscArrays, jacobian: CscArrays) -> Delassus: ...

class ContactProblem:
    def __init__(
        self, delassus: Delassus, free_velocity: _Vector, sets: ConstraintSets, compliance: _Vector
    ) -> None: ...
    @property
    def delassus(self) -> Delassus: ...
    @property
    def size(self) -> int: ...
    @property
    def num_contacts(self) -> int: ...
    @property
    def scale(self) -> _Vector: ...
    @property
    def compliance(self) -> _Vector: ...
    def velocity(self, impulse: _Vector) -> _Vector: ...
    def check_definite(self) -> None: ...

class InverseSettings:
    law: Any
    proximal_weight: float
    tolerance: float
    max_iterations: int
    def validate(self) -> None: ...

class InverseSolution:
    status: Any
    impulse: _Vector
    velocity: _Vector
    residual: float
    relative: float
    worst: int
    iterations: int

def solve_inverse(
    velocity: _Vector,
    compliance: _Vector,
    sets: ConstraintSets,
    settings: InverseSettings,
    guess: _Vector,
    speed: float,
) -> InverseSolution: ...
def inverse_residual(
    velocity: _Vector, compliance: _Vector, sets: ConstraintSets, law: Any, impulse: _Vector
) -> float: ...

class Residual:
    @property
    def primal(self) -> float: ...
    @property
    def dual(self) -> float: ...
    @property
    def complementarity(self) -> float: ...
    @property
    def relative(self) -> float: ...
    @property
    def against_free_velocity(self) -> float: ...
    @property
    def signorini(self) -> float: ...
    @property
    def dissipation(self) -> float: ...
    def solves(self, tolerance: float) -> bool: ...
    @staticmethod
    def largest_share(tolerance: float) -> float: ...

class Law(enum.Enum):
    ncp = 0
    ccp = 1

def residual(problem: ContactProblem, impulse: _Vector, law: Law) -> Residual: ...

# Their names are words as users write them ("max iterations"), so they are not spelt out.
SolverType: Any
PenaltyRule: Any
Status: Any

class AdmmSettings:
    penalty_rule: Any
    penalty: float
    proximal_weight: float
    spectral_exponent: float
    spectral_increment: float
    linear_factor: float
    ratio: float
    scaling: bool
    anderson_memory: int
    paper_tolerance: float

class PgsSettings:
    over_relaxation: float

class PyramidSettings:
    facets: int

class ConvexSettings:
    impedance: float

class BisectionSettings:
    least_relaxation: float
    relaxation_decay: float

class Settings:
    solver: Any
    law: Law
    tolerance: float
    aim: float
    max_iterations: int
    record_history: bool
    admm: AdmmSettings
    pgs: PgsSettings
    pyramid: PyramidSettings
    convex: ConvexSettings
    bisection: BisectionSettings
    def __init__(self) -> None: ...
    def validate(self) -> None: ...

class Workspace:
    """Memory of the solvers, reused by solves of the same pattern. Two threads that share one take turns."""

    def __init__(self) -> None: ...

class Guess:
    def __init__(self, impulse: _Vector, penalty: float) -> None: ...

class Solution:
    @property
    def status(self) -> Any: ...
    @property
    def solver(self) -> Any: ...
    @property
    def impulse(self) -> _Vector: ...
    @property
    def velocity(self) -> _Vector: ...
    @property
    def residual(self) -> Residual: ...
    @property
    def model_residual(self) -> float: ...
    @property
    def iterations(self) -> int: ...
    @property
    def factorizations(self) -> int: ...
    @property
    def seconds(self) -> float: ...
    @property
    def penalty(self) -> float: ...
    @property
    def history(self) -> npt.NDArray[np.float64]: ...

def solve(
    problem: ContactProblem, settings: Settings, workspace: Workspace | None, guess: Guess | None
) -> Solution: ...
