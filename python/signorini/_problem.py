from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini import _arrays, _core
from signorini._core import InvalidInputError

if TYPE_CHECKING:
    import scipy.sparse as sp


@dataclass(frozen=True)
class FrictionCone:
    """A contact: three rows (T1, T2, N), impulse in {|x_T| <= friction x_N}.

    friction: coefficient mu [1], in [0, 1e6].
    """

    friction: float


@dataclass(frozen=True)
class HalfLine:
    """A joint limit: one row, impulse >= 0, velocity >= 0, one of them zero."""


@dataclass(frozen=True)
class Interval:
    """Dry friction of a joint: one row, lower <= impulse <= upper [N s]; infinite bounds are allowed."""

    lower: float
    upper: float


@dataclass(frozen=True)
class Equality:
    """One row whose velocity is zero, whatever impulse that takes."""


Constraint = FrictionCone | HalfLine | Interval | Equality

# (number of the C++ SetType, rows)
_SET_TYPES: dict[type, tuple[int, int]] = {FrictionCone: (0, 3), HalfLine: (1, 1), Interval: (2, 1), Equality: (3, 1)}


def _constraint_sets(constraints: Sequence[Constraint]) -> _core.ConstraintSets:
    types, first, second = [], [], []
    for i, constraint in enumerate(constraints):
        kind = type(constraint)
        if kind not in _SET_TYPES:
            raise InvalidInputError(
                f"constraints[{i}]: is {constraint!r}, must be a FrictionCone, HalfLine, Interval or Equality"
            )
        types.append(_SET_TYPES[kind][0])
        if isinstance(constraint, FrictionCone):
            first.append(_arrays.number(f"constraints[{i}].friction", constraint.friction))
            second.append(0.0)
        elif isinstance(constraint, Interval):
            first.append(_arrays.number(f"constraints[{i}].lower", constraint.lower))
            second.append(_arrays.number(f"constraints[{i}].upper", constraint.upper))
        else:
            first.append(0.0)
            second.append(0.0)
    return _core.ConstraintSets(types, first, second)


def _sets_of(
    field: str, n: int, friction: Any, constraints: Any
) -> tuple[_core.ConstraintSets, _arrays.Array, tuple[Constraint, ...] | None]:
    """Core sets of the n rows of `field`, friction of the contacts, and the constraints where those were given."""
    if (friction is None) == (constraints is None):
        given = "neither" if friction is None else "both"
        raise InvalidInputError(f"friction: {given} of friction and constraints given, must be exactly one")
    if constraints is None:
        if n % 3 != 0:
            raise InvalidInputError(f"{field}: has {n} rows, must have 3 for each contact")
        if isinstance(friction, (int, float)) or getattr(friction, "shape", None) == ():
            friction = np.full(n // 3, _arrays.number("friction", np.asarray(friction).item()))
        mu = _arrays.vector("friction", friction, n // 3)
        return _core.ConstraintSets.friction_cones(mu), mu, None
    if isinstance(constraints, (str, bytes)) or not isinstance(constraints, Iterable):
        raise InvalidInputError(f"constraints: is {constraints!r}, must be a sequence of constraints")
    listed = tuple(constraints)
    sets = _constraint_sets(listed)
    if sets.size != n:
        raise InvalidInputError(f"constraints: have {sets.size} rows, must have {n}")
    return sets, np.array([c.friction for c in listed if isinstance(c, FrictionCone)], dtype=np.float64), listed


class ContactProblem:
    """Find the impulse x with x in K and -(s + Gamma(s)) in the normal cone of K at x, s = (G + R) x + g.

    K is a product of constraint sets, Gamma the De Saxce correction: Signorini's condition, Coulomb's law and maximum
    dissipation in one. Constant once built; may be solved from several threads. (Carpentier et al. 2024, eq. 27.)

    delassus: G = J M^-1 J^T [1/kg], (n, n), symmetric positive semidefinite; an array or any scipy.sparse matrix. Of an
        unsymmetric matrix the symmetric part is used, and `asymmetry` says how far it was.
    free_velocity: g [m/s], (n,); per contact (T1, T2, N), normal last, positive when separating.
    friction: coefficients [1] in [0, 1e6], (nc,) with n = 3 nc, for a problem of contacts only. One number serves all.
    compliance: diagonal of R [1/kg] >= 0, (n,); None for rigid contact.
    constraints: instead of friction, a sequence of FrictionCone, HalfLine, Interval, Equality in row order.
    name: shown in tables.
    check: also factor G + R once and refuse it when it is not positive semidefinite: by more than 1e-5 of its diagonal,
        for rounding, and more where it is unsymmetric.

    Raises InvalidInputError, a ValueError, naming the field, its value and what is allowed.
    """

    def __init__(
        self,
        delassus: npt.ArrayLike | sp.spmatrix | sp.sparray,
        free_velocity: npt.ArrayLike,
        friction: npt.ArrayLike | None = None,
        compliance: npt.ArrayLike | None = None,
        *,
        constraints: Iterable[Constraint] | None = None,
        name: str = "",
        check: bool = True,
    ) -> None:
        self._dense = not _arrays.is_sparse(delassus)
        if not self._dense:
            given = _arrays.csc("delassus", delassus)
            _square("delassus", given.shape)
            operator = _core.sparse_delassus(_arrays.csc_arrays(given))
        else:
            dense = _arrays.matrix("delassus", delassus)
            _square("delassus", dense.shape)
            operator = _core.dense_delassus(dense)
        self._mass: sp.csc_array | None = None
        self._jacobian: sp.csc_array | None = None
        self._build(operator, free_velocity, friction, compliance, constraints, name, check)

    @classmethod
    def from_mass(
        cls,
        mass: npt.ArrayLike | sp.spmatrix | sp.sparray,
        jacobian: npt.ArrayLike | sp.spmatrix | sp.sparray,
        free_velocity: npt.ArrayLike,
        friction: npt.ArrayLike | None = None,
        compliance: npt.ArrayLike | None = None,
        *,
        constraints: Iterable[Constraint] | None = None,
        name: str = "",
        check: bool = True,
    ) -> ContactProblem:
        """The problem with G = J M^-1 J^T, which is never formed: cheaper when contacts outnumber degrees of freedom.

        mass: M [kg, kg m, kg m^2], (nv, nv), symmetric (to 1e-6) positive definite, both triangles, condition number at
            most 1e15 (rows scaled to diagonal 1); array or scipy.sparse.
        jacobian: J, (n, nv); array or scipy.sparse.
        The other arguments and errors are those of ContactProblem.
        """
        m, j = _arrays.csc("mass", mass), _arrays.csc("jacobian", jacobian)
        _square("mass", m.shape)
        if j.shape[1] != m.shape[0]:
            raise InvalidInputError(f"jacobian: has {j.shape[1]} columns, must have the {m.shape[0]} of mass")
        operator = _core.mass_space_delassus(_arrays.csc_arrays(m), _arrays.csc_arrays(j))
        self = cls.__new__(cls)
        self._dense = False
        self._mass, self._jacobian = _kept(m, mass), _kept(j, jacobian)
        self._build(operator, free_velocity, friction, compliance, constraints, name, check)
        return self

    def _build(
        self,
        operator: _core.Delassus,
        free_velocity: Any,
        friction: Any,
        compliance: Any,
        constraints: Iterable[Constraint] | None,
        name: str,
        check: bool,
    ) -> None:
        n = operator.size
        g = _arrays.vector("free_velocity", free_velocity, n)
        sets, mu, self._constraints = _sets_of("delassus", n, friction, constraints)
        r = np.zeros(n) if compliance is None else _arrays.vector("compliance", compliance, n)
        self._core = _core.ContactProblem(operator, g, sets, r)
        if check:
            self._core.check_definite()
        self._asymmetry = operator.asymmetry
        self._sets = sets
        self._name = str(name)
        self._free_velocity = _read_only(g, free_velocity)
        self._friction = _read_only(mu, friction)
        self._compliance = _read_only(r, compliance)

    @property
    def name(self) -> str:
        """Shown in tables."""
        return self._name

    @property
    def size(self) -> int:
        """n, the rows of all constraints."""
        return self._core.size

    @property
    def num_contacts(self) -> int:
        """Friction cones among the constraints."""
        return self._core.num_contacts

    @property
    def num_constraints(self) -> int:
        """Constraint sets of all kinds."""
        return self.num_contacts if self._constraints is None else len(self._constraints)

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraint sets, in row order."""
        if self._constraints is None:
            self._constraints = tuple(FrictionCone(float(mu)) for mu in self._friction)
        return self._constraints

    @property
    def free_velocity(self) -> _arrays.Array:
        """g [m/s], (n,), read-only."""
        return self._free_velocity

    @property
    def friction(self) -> _arrays.Array:
        """Friction coefficients [1] of the friction cones, (nc,), read-only."""
        return self._friction

    @property
    def compliance(self) -> _arrays.Array:
        """Diagonal of R [1/kg], (n,), read-only."""
        return self._compliance

    @property
    def asymmetry(self) -> float:
        """max |G - G^T| / max |G| of the matrix that was given."""
        return self._asymmetry

    @cached_property
    def scale(self) -> _arrays.Array:
        """d [1/kg], (n,): mean diagonal of G + R in each constraint's rows; the certificate's units. Read-only."""
        return _read_only(self._core.scale, None)

    @property
    def delassus(self) -> sp.csc_array:
        """G [1/kg], (n, n), its symmetric part, without R. A new matrix at each call."""
        import scipy.sparse as sp

        return sp.csc_array(self._core.delassus.csc(), shape=(self.size, self.size))

    @property
    def mass(self) -> sp.csc_array | None:
        """M, (nv, nv), read-only, when the problem was made from_mass."""
        return self._mass

    @property
    def jacobian(self) -> sp.csc_array | None:
        """J, (n, nv), read-only, when the problem was made from_mass."""
        return self._jacobian

    def velocity(self, impulse: npt.ArrayLike) -> _arrays.Array:
        """s = (G + R) impulse + g [m/s], (n,), for an impulse [N s], (n,)."""
        return self._core.velocity(_arrays.vector("impulse", impulse, self.size))

    def project(self, impulse: npt.ArrayLike) -> _arrays.Array:
        """The point of K next to impulse [N s], (n,)."""
        return self._sets.project(_arrays.vector("impulse", impulse, self.size))

    def __repr__(self) -> str:
        label = f"{self.name!r}, " if self.name else ""
        others = self.num_constraints - self.num_contacts
        more = f", {others} other constraints" if others else ""
        return f"ContactProblem({label}{self.num_contacts} contacts{more})"

    def __reduce__(self) -> tuple[Any, ...]:
        pure = self._constraints is None
        arguments: tuple[Any, ...]
        if self._mass is not None:
            arguments = (self._mass, self._jacobian)
        else:  # the same operator again, which rounds alike
            arguments = (self.delassus.toarray() if self._dense else self.delassus,)
        return _rebuild, (
            arguments,
            self._free_velocity,
            self._friction if pure else None,
            self._compliance,
            None if pure else self._constraints,
            self._name,
            self._asymmetry,
        )


def check_problem(problem: Any) -> ContactProblem:
    if not isinstance(problem, ContactProblem):
        raise InvalidInputError(f"problem: is a {type(problem).__name__}, must be a signorini.ContactProblem")
    return problem


def _rebuild(
    matrices: tuple[Any, ...],
    free_velocity: Any,
    friction: Any,
    compliance: Any,
    constraints: Any,
    name: str,
    asymmetry: float,
) -> ContactProblem:
    vectors = free_velocity, friction, compliance
    arguments: dict[str, Any] = {"constraints": constraints, "name": name, "check": False}
    if len(matrices) == 2:
        problem = ContactProblem.from_mass(matrices[0], matrices[1], *vectors, **arguments)
    else:
        problem = ContactProblem(matrices[0], *vectors, **arguments)
    problem._asymmetry = asymmetry
    return problem


def _square(field: str, shape: tuple[int, ...]) -> None:
    if shape[0] != shape[1]:
        raise InvalidInputError(f"{field}: has shape {shape}, must be square")


def _kept(matrix: sp.csc_array, given: Any) -> sp.csc_array:
    # A copy when the values may be the caller's own, as in _read_only.
    matrix = matrix.copy() if getattr(given, "format", "") == "csc" else matrix
    matrix.data.flags.writeable = False
    return matrix


def _read_only(array: _arrays.Array, given: Any) -> _arrays.Array:
    # A copy when what the caller gave came through unchanged: later writes to it must not show here.
    if given is not None and np.shares_memory(array, np.asarray(given)):
        array = array.copy()
    array.flags.writeable = False
    return array
