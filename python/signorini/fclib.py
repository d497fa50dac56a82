"""Contact problems in the HDF5 layout of FCLIB (Acary, Bremond, Koziara, Perignon 2014, INRIA RT-0444).

Local files hold W, q, mu: W is the Delassus operator G, q the free velocity. Global files hold M, H, f, w, mu:
G = H^T M^-1 H, g = H^T M^-1 f + w. Either may hold equality rows (V, R, s and G, b). FCLIB orders each contact
(N, T1, T2), everything else here (T1, T2, N): the permutation lives in this file and nowhere else.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
import numpy.typing as npt

from signorini import _arrays, _core, _files
from signorini._core import InvalidInputError, __version__
from signorini._problem import Constraint, ContactProblem, Equality, FrictionCone, check_problem
from signorini._solution import Solution

if TYPE_CHECKING:
    import scipy.sparse as sp

    Array = npt.NDArray[np.float64]

__all__ = ["FclibError", "StoredSolution", "read", "read_guesses", "read_solution", "write"]

_LFS_POINTER = b"version https://git-lfs"
_LARGEST_COMPRESSION = 1032  # deflate cannot do better, so a file that claims more is damaged


class FclibError(InvalidInputError):
    """A file that cannot be read: the message names the file, the field and what is wrong with it."""


@dataclass(frozen=True, eq=False)
class StoredSolution:
    """An answer or a guess kept in a file.

    impulse: [N s], (n,)
    velocity: s = G impulse + g [m/s], (n,); None when the file has none
    """

    impulse: Array
    velocity: Array | None


def read(
    path: str | os.PathLike[str], operator: Literal["delassus", "mass"] | None = None, *, check: bool = True
) -> ContactProblem:
    """Reads a contact problem, local or global, stored by columns, rows or triplets.

    operator: "delassus" for an explicit G, "mass" for J and M (from a global file, or from a local one that also holds
        /signorini_dynamics); None for what the file is made of.
    check: refuse an indefinite matrix, as ContactProblem does.

    Raises FclibError when the file is damaged, a git-lfs pointer or not supported; OSError when it cannot be opened.
    """
    if operator not in (None, "delassus", "mass"):
        raise InvalidInputError(f"operator: is {operator!r}, must be 'delassus', 'mass' or None")
    with _File(path) as file:
        try:
            if "fclib_local" in file.root:
                return _read_local(file, operator, check)
            if "fclib_global" in file.root:
                return _read_global(file, operator, check)
        except FclibError:
            raise
        except InvalidInputError as error:
            raise FclibError(f"{file.path}: {error}") from None
        file.fail("", "has neither the group fclib_local nor fclib_global")


def read_solution(path: str | os.PathLike[str]) -> StoredSolution | None:
    """The solution stored with a problem, or None. Raises as read does."""
    with _File(path) as file:
        return _read_stored(file, "solution") if "solution" in file.root else None


def read_guesses(path: str | os.PathLike[str]) -> list[StoredSolution]:
    """The initial guesses stored with a problem, possibly none. Raises as read does."""
    with _File(path) as file:
        guesses: list[StoredSolution] = []
        while f"guesses/{len(guesses) + 1}" in file.root:
            guesses.append(_read_stored(file, f"guesses/{len(guesses) + 1}"))
        return guesses


def write(
    path: str | os.PathLike[str],
    problem: ContactProblem,
    solution: Solution | None = None,
    title: str = "",
    description: str = "",
) -> None:
    """Writes a local FCLIB file, and J and M as /signorini_dynamics when the problem was made from them.

    Compliance is added to W, since the layout has no place of its own for it. Raises InvalidInputError when the problem
    holds other constraints than friction cones followed by equalities, the solution is of another size, or a text is
    none. A file that is there is replaced at the end, or stays as it is.
    """
    import h5py
    import scipy.sparse as sp

    check_problem(problem)
    if solution is not None and not isinstance(solution, Solution):
        raise InvalidInputError(f"solution: is a {type(solution).__name__}, must be a signorini.Solution or None")
    n, contact_rows = problem.size, 3 * problem.num_contacts
    kinds = [type(c) for c in problem.constraints]
    if kinds != [FrictionCone] * problem.num_contacts + [Equality] * (n - contact_rows):
        raise InvalidInputError("problem: has other constraints than friction cones and then equalities; FCLIB has not")
    if solution is not None and solution.impulse.shape != (n,):
        raise InvalidInputError(f"solution: has {solution.impulse.size} entries, must have {n}")
    texts = {"title": _files.text("title", title) or _files.text("problem.name", problem.name)}
    texts["description"] = _files.text("description", description)

    order = _from_ours(n, contact_rows)
    w = sp.csc_array(problem.delassus + sp.diags_array(problem.compliance))[order][:, order]
    with _files.replacing(path) as target, h5py.File(target, "w") as file:
        local = file.create_group("fclib_local")
        local["spacedim"] = np.array([3], np.int32)
        local["vectors/q"] = problem.free_velocity[order][:contact_rows]
        local["vectors/mu"] = problem.friction
        _write_matrix(local, "W", w[:contact_rows, :contact_rows])
        if n > contact_rows:
            _write_matrix(local, "V", w[:contact_rows, contact_rows:])
            _write_matrix(local, "R", w[contact_rows:, contact_rows:])
            local["vectors/s"] = problem.free_velocity[order][contact_rows:]
        info = local.create_group("info")
        for key, text in texts.items():
            info[key] = np.bytes_(text or b" ")
        info["math_info"] = np.bytes_(f"written by signorini {__version__}")
        if problem.mass is not None and problem.jacobian is not None and not problem.compliance.any():
            _write_matrix(file, "signorini_dynamics/M", problem.mass)
            _write_matrix(file, "signorini_dynamics/H", problem.jacobian[order])
        if solution is not None:
            file["solution/r"] = solution.impulse[order][:contact_rows]
            file["solution/u"] = solution.velocity[order][:contact_rows]
            if n > contact_rows:
                file["solution/l"] = solution.impulse[order][contact_rows:]


# ---- the permutation ------------------------------------------------------------------------------------------------


def _to_ours(n: int, contact_rows: int) -> npt.NDArray[np.intp]:
    """x_ours = x_file[order]: (T1, T2, N) from (N, T1, T2) per contact; equality rows stay."""
    order = np.arange(n)
    order[:contact_rows] = order[:contact_rows].reshape(-1, 3)[:, [1, 2, 0]].ravel()
    return order


def _from_ours(n: int, contact_rows: int) -> npt.NDArray[np.intp]:
    """x_file = x_ours[order]."""
    order = np.arange(n)
    order[:contact_rows] = order[:contact_rows].reshape(-1, 3)[:, [2, 0, 1]].ravel()
    return order


# ---- reading --------------------------------------------------------------------------------------------------------


class _File:
    """An open file whose every claim is checked before memory is spent on it."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        import h5py

        self.path = _files.checked(path)
        special = _files.special(self.path)
        if special is not None:
            self.fail("", f"is {special}, must be a regular file: HDF5 goes back and forth in it")
        with open(self.path, "rb") as raw:  # a missing file or a folder raises here, clearly
            start = raw.read(len(_LFS_POINTER))
        if start == _LFS_POINTER:
            self.fail("", "is a git-lfs pointer, not the problem itself: fetch it with `git lfs pull`")
        self.size = self.path.stat().st_size
        try:
            self.root: Any = h5py.File(self.path, "r")
        except OSError as error:
            self.fail("", f"is not a readable HDF5 file ({error})")

    def __enter__(self) -> _File:
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        self.root.close()
        # What libhdf5 finds damaged surfaces as one of these, wherever it was met.
        found = isinstance(error, (OSError, RuntimeError, ValueError, LookupError, TypeError, OverflowError))
        if found and not isinstance(error, InvalidInputError):
            self.fail("", f"is damaged ({error})")

    def fail(self, field: str, message: str) -> NoReturn:
        raise FclibError(f"{self.path}: {field}: {message}" if field else f"{self.path}: {message}")

    def array(self, field: str, kinds: str) -> Any:
        """A one-dimensional dataset of numbers whose numpy kind is among `kinds`, with its size checked first."""
        import h5py

        data = self.root.get(field)
        if data is None:
            self.fail(field, "is missing")
        if not isinstance(data, h5py.Dataset):
            self.fail(field, "is not a dataset")
        if data.dtype.kind not in kinds or data.dtype.itemsize > 8:
            self.fail(field, f"has entries of type {data.dtype}, must be {'integers' if kinds == 'iu' else 'numbers'}")
        if data.shape is None or len(data.shape) > 1:
            self.fail(field, f"has shape {data.shape}, must have 1 dimension")
        if data.is_virtual or data.external:
            self.fail(field, "keeps its data in another file, which is not supported")
        stored, claimed = data.id.get_storage_size(), data.size * data.dtype.itemsize
        if claimed > _LARGEST_COMPRESSION * stored or stored > self.size:
            self.fail(field, f"claims {data.size} entries, more than the file of {self.size} bytes holds")
        return np.atleast_1d(data[()])

    def vector(self, field: str, size: int | None = None) -> Array:
        values: Array = self.array(field, "iuf").astype(np.float64)
        if size is not None and values.size != size:
            self.fail(field, f"has {values.size} entries, must have {size}")
        self.check_finite(field, values)
        return values

    def integer(self, field: str, lowest: int) -> int:
        values = self.array(field, "iu")
        if values.size != 1:
            self.fail(field, f"has {values.size} entries, must have 1")
        value = int(values[0])
        if not lowest <= value < 2**31:
            self.fail(field, f"is {value}, must be in [{lowest}, 2^31)")
        return value

    def check_finite(self, field: str, values: Array) -> None:
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            self.fail(f"{field}[{bad[0]}]", f"is {values[bad[0]]}, must be finite")

    def matrix(self, field: str, rows: int | None, cols: int | None) -> sp.csc_array:
        """A matrix whose size the vectors of the file vouch for. rows = cols = None: a square one of full rank."""
        import scipy.sparse as sp

        m, n, nz = self.integer(f"{field}/m", 0), self.integer(f"{field}/n", 0), self.integer(f"{field}/nz", -2)
        self.integer(f"{field}/nzmax", 0)
        p, i = self.array(f"{field}/p", "iu"), self.array(f"{field}/i", "iu")
        x = self.array(f"{field}/x", "iuf").astype(np.float64)
        if rows is None and cols is None:
            if m != n or m > x.size:
                self.fail(field, f"is {m} x {n} with {x.size} entries, must be square with an entry in each row")
        elif (m, n) != (rows, cols):
            self.fail(field, f"is {m} x {n}, must be {rows} x {cols} to fit the vectors")

        def indices(name: str, values: Any, bound: int) -> Any:
            bad = np.flatnonzero((values < 0) | (values >= bound))
            if bad.size:
                self.fail(f"{field}/{name}[{bad[0]}]", f"is {values[bad[0]]}, must be in [0, {bound})")
            return values.astype(np.int32)

        def entries(name: str, values: Any, count: int) -> Any:
            if values.size < count:
                self.fail(f"{field}/{name}", f"has {values.size} entries, must have {count}")
            return values[:count]

        if nz >= 0:  # triplets: p holds columns, i rows
            x = entries("x", x, nz)
            at = (indices("i", entries("i", i, nz), m), indices("p", entries("p", p, nz), n))
            self.check_finite(f"{field}/x", x)
            return sp.csc_array(sp.coo_array((x, at), shape=(m, n)))
        lines, bound = (n, m) if nz == -1 else (m, n)
        if p.size != lines + 1:
            self.fail(f"{field}/p", f"has {p.size} entries, must have {lines + 1}")
        p = p.astype(np.int64)
        if p[0] != 0 or (np.diff(p) < 0).any():
            self.fail(f"{field}/p", "must start at 0 and never decrease")
        count = int(p[-1])
        x, i = entries("x", x, count), indices("i", entries("i", i, count), bound)
        self.check_finite(f"{field}/x", x)
        kind = sp.csc_array if nz == -1 else sp.csr_array
        result = sp.csc_array(kind((x, i, p.astype(np.int32)), shape=(m, n)))
        result.sum_duplicates()
        return result


def _friction(file: _File, group: str, rows: int) -> Array:
    dimension = file.integer(f"{group}/spacedim", 0)
    if dimension != 3:
        file.fail(f"{group}/spacedim", f"is {dimension}; only problems in 3 dimensions are supported")
    if rows % 3:
        file.fail(group, f"has {rows} contact rows, must have 3 for each contact")
    mu = file.vector(f"{group}/vectors/mu", rows // 3)
    bad = np.flatnonzero(mu < 0)
    if bad.size:
        file.fail(f"{group}/vectors/mu[{bad[0]}]", f"is {mu[bad[0]]}, must be >= 0")
    return mu


def _laws(friction: Array, num_equalities: int) -> dict[str, Any]:
    """friction= or constraints=, for ContactProblem."""
    if num_equalities == 0:
        return {"friction": friction}
    cones: list[Constraint] = [FrictionCone(float(mu)) for mu in friction]
    return {"constraints": cones + [Equality()] * num_equalities}


def _read_local(file: _File, operator: str | None, check: bool) -> ContactProblem:
    import scipy.sparse as sp

    q = file.vector("fclib_local/vectors/q")
    rows = q.size
    mu = _friction(file, "fclib_local", rows)
    with_equalities = any(f"fclib_local/{field}" in file.root for field in ("V", "R", "vectors/s"))
    s = file.vector("fclib_local/vectors/s") if with_equalities else np.zeros(0)
    order = _to_ours(rows + s.size, rows)
    g = np.concatenate([q, s])[order]
    arguments = _laws(mu, s.size) | {"name": file.path.stem, "check": check}
    if operator == "mass":
        if "signorini_dynamics" not in file.root:
            file.fail("signorini_dynamics", "is missing: this local file holds no mass matrix")
        mass = file.matrix("signorini_dynamics/M", None, None)
        jacobian = file.matrix("signorini_dynamics/H", g.size, mass.shape[0])
        return ContactProblem.from_mass(mass, jacobian[order], g, **arguments)
    w = file.matrix("fclib_local/W", rows, rows)
    if with_equalities:  # u = W r + V l + q, 0 = V^T r + R l + s
        v = file.matrix("fclib_local/V", rows, s.size)
        r = file.matrix("fclib_local/R", s.size, s.size)
        w = sp.csc_array(sp.vstack([sp.hstack([w, v]), sp.hstack([v.T, r])]))
    return ContactProblem(w[order][:, order], g, **arguments)


def _read_global(file: _File, operator: str | None, check: bool) -> ContactProblem:
    import scipy.sparse as sp

    f, w = file.vector("fclib_global/vectors/f"), file.vector("fclib_global/vectors/w")
    rows = w.size
    mu = _friction(file, "fclib_global", rows)
    mass = file.matrix("fclib_global/M", f.size, f.size)
    jacobian = sp.csc_array(file.matrix("fclib_global/H", f.size, rows).T)
    if "fclib_global/G" in file.root or "fclib_global/vectors/b" in file.root:  # G^T v + b = 0
        b = file.vector("fclib_global/vectors/b")
        equalities = file.matrix("fclib_global/G", f.size, b.size)
        jacobian, w = sp.csc_array(sp.vstack([jacobian, equalities.T])), np.concatenate([w, b])
    order = _to_ours(w.size, rows)
    jacobian = sp.csc_array(jacobian[order])
    # J M^-1 f is a column of the operator of J and f: as exact as that, also where M is ill-conditioned.
    with_force = sp.csc_array(sp.vstack([jacobian, f[np.newaxis]]))
    try:
        operator_with_force = _core.mass_space_delassus(_arrays.csc_arrays(mass), _arrays.csc_arrays(with_force))
    except InvalidInputError as error:
        field, _, words = str(error).partition(": ")
        file.fail("fclib_global/M" if field == "mass" else "fclib_global/H or vectors/f", words)
    g = w[order] + operator_with_force.column(w.size)[:-1]
    arguments = _laws(mu, w.size - rows) | {"name": file.path.stem, "check": check}
    problem = ContactProblem.from_mass(mass, jacobian, g, **arguments)
    return ContactProblem(problem.delassus, g, **arguments) if operator == "delassus" else problem


def _read_stored(file: _File, group: str) -> StoredSolution:
    impulse = file.vector(f"{group}/r")
    rows = impulse.size
    if rows % 3:
        file.fail(f"{group}/r", f"has {rows} entries, must have 3 for each contact")
    velocity = file.vector(f"{group}/u", rows) if f"{group}/u" in file.root else None
    if f"{group}/l" in file.root:
        multipliers = file.vector(f"{group}/l")
        impulse = np.concatenate([impulse, multipliers])
        # An equality's velocity is zero by definition.
        velocity = None if velocity is None else np.concatenate([velocity, np.zeros(multipliers.size)])
    order = _to_ours(impulse.size, rows)
    return StoredSolution(impulse[order], None if velocity is None else velocity[order])


def _write_matrix(group: Any, name: str, matrix: Any) -> None:
    import scipy.sparse as sp

    csc = sp.csc_array(matrix)
    csc.sum_duplicates()
    target = group.create_group(name)
    sizes = {"m": csc.shape[0], "n": csc.shape[1], "nzmax": csc.nnz, "nz": -1}
    for key, value in sizes.items():
        target[key] = np.array([value], np.int32)
    target["p"] = csc.indptr.astype(np.int32)
    target["i"] = csc.indices.astype(np.int32)
    target["x"] = csc.data
