"""What users pass, checked and converted to what the core takes."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from signorini._core import CscArrays, InvalidInputError

if TYPE_CHECKING:
    import scipy.sparse as sp

Array = npt.NDArray[np.float64]


def is_sparse(value: Any) -> bool:
    """Whether value is a scipy.sparse matrix; answered without importing scipy, which takes longer than a solve."""
    sparse = sys.modules.get("scipy.sparse")
    return sparse is not None and bool(sparse.issparse(value))


def numbers(field: str, value: Any, ndim: int | None = None) -> Array:
    """value as a float64 array of ndim dimensions; None: of any."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise InvalidInputError(f"{field}: is not a rectangular array of numbers ({error})") from None
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise InvalidInputError(f"{field}: has masked entries, must have none")
    # An empty list has no type of its own; numpy calls it float64.
    if array.dtype.kind not in "iuf":
        what = f"is {value!r}" if array.ndim == 0 else f"has entries of type {array.dtype}"
        raise InvalidInputError(f"{field}: {what}, must be real numbers")
    if ndim is not None and array.ndim != ndim:
        raise InvalidInputError(f"{field}: has shape {array.shape}, must have {ndim} dimension{'s' * (ndim > 1)}")
    # Of no dimension it would get one.
    return np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)


def vector(field: str, value: Any, size: int | None = None) -> Array:
    array = numbers(field, value, 1)
    if size is not None and array.size != size:
        raise InvalidInputError(f"{field}: has {array.size} entries, must have {size}")
    return array


def matrix(field: str, value: Any) -> Array:
    """value as a column-major float64 matrix."""
    return np.asfortranarray(numbers(field, value, 2))


def csc(field: str, value: Any) -> sp.csc_array:
    """value, dense or sparse, as a float64 CSC matrix with sorted indices and without duplicates."""
    import scipy.sparse as sp

    if not sp.issparse(value):
        return sp.csc_array(matrix(field, value))
    if value.ndim != 2:
        raise InvalidInputError(f"{field}: has shape {value.shape}, must have 2 dimensions")
    if value.dtype.kind not in "iuf":
        raise InvalidInputError(f"{field}: has entries of type {value.dtype}, must be real numbers")
    try:
        # Before any conversion: converting a damaged matrix reads or writes out of bounds.
        if hasattr(value, "check_format"):
            value.check_format(full_check=True)
        elif value.format == "coo":
            _check_indices("row", value.row, value.shape[0])
            _check_indices("column", value.col, value.shape[1])
        elif value.format == "lil":
            if [len(row) for row in value.rows] != [len(row) for row in value.data]:
                raise ValueError("rows and data must have the same lengths")
            _check_indices("column", np.array([c for row in value.rows for c in row], dtype=np.int64), value.shape[1])
        result = sp.csc_array(value, dtype=np.float64)
    except (ValueError, IndexError) as error:
        raise InvalidInputError(f"{field}: is a damaged sparse matrix ({error})") from None
    if not result.has_canonical_format:
        result = result.copy() if result is value or np.shares_memory(result.data, value.data) else result
        result.sum_duplicates()
    if result.nnz > np.iinfo(np.int32).max:
        raise InvalidInputError(f"{field}: has {result.nnz} entries, must have less than 2^31")
    return result


def _check_indices(name: str, indices: npt.NDArray[Any], bound: int) -> None:
    if indices.size and not (indices.min() >= 0 and indices.max() < bound):
        raise ValueError(f"{name} indices must be in [0, {bound})")


def csc_arrays(value: sp.csc_array) -> CscArrays:
    rows, cols = value.shape
    return CscArrays(
        rows,
        cols,
        np.ascontiguousarray(value.data),
        np.ascontiguousarray(value.indices, dtype=np.int32),
        np.ascontiguousarray(value.indptr, dtype=np.int32),
    )


def number(field: str, value: Any) -> float:
    """value as a float. bool is refused: it is never meant."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InvalidInputError(f"{field}: is {value!r}, must be a number")
    try:
        return float(value)
    except OverflowError:
        raise InvalidInputError(f"{field}: is {value!r}, must be a finite number") from None


def finite(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    """value as a float64 array of this shape, or as a number for all of its entries; none larger than a step takes."""
    array = numbers(field, value)
    if array.shape not in (shape, ()):
        raise InvalidInputError(f"{field}: has shape {array.shape}, must be {shape}")
    if array.size and not np.abs(array).max() <= 1e100:
        small = np.abs(array) <= 1e100
        at = np.unravel_index(int(np.argmin(small)), array.shape)
        place = f"[{', '.join(map(str, at))}]" if at else ""
        raise InvalidInputError(f"{field}{place}: is {array[at]}, must be within +-1e100")
    return array


def flag(field: str, value: Any) -> bool:
    """value as a bool; nothing else is one, as "no" would be true."""
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidInputError(f"{field}: is {value!r}, must be True or False")
    return bool(value)


def text(field: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InvalidInputError(f"{field}: is {value!r}, must be a string")
    return value


def count(field: str, value: Any, lowest: int = -(2**31), bits: int = 31) -> int:
    """value as an int in [lowest, 2^bits); without these, of 32 bits, and the core knows the range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise InvalidInputError(f"{field}: is {value!r}, must be an integer")
    if not lowest <= value < 2**bits:
        raise InvalidInputError(f"{field}: is {value}, must be in [{lowest}, 2^{bits})")
    return int(value)
