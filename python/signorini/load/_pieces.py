"""Concave meshes -> convex pieces, by CoACD, in a process of its own: it may abort or hang on meshes of strangers.

Wei, Liu, Ling, Su: Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity and Tree Search,
SIGGRAPH 2022. Pieces take seconds, so they are kept in the user's cache folder.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import zipfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from signorini._core import InvalidInputError

Array = npt.NDArray[np.float64]

#: CoACD's concavity, as a share of the mesh's size, up to which a piece is left as it is; most pieces; seed.
THRESHOLD, PIECES, SEED = 0.05, 32, 0
TIMEOUT = 600.0  # [s]
MAX_TRIANGLES = 500_000

_WORKER = """
import sys
import numpy as np, coacd
given = np.load(sys.argv[1])
coacd.set_log_level("error")
mesh = coacd.Mesh(given["points"], given["triangles"])
pieces = coacd.run_coacd(mesh, threshold=float(sys.argv[3]), max_convex_hull=int(sys.argv[4]), seed=int(sys.argv[5]))
np.savez(sys.argv[2], sizes=[len(p[0]) for p in pieces], points=np.concatenate([p[0] for p in pieces]))
"""


def pieces(points: Array, triangles: npt.NDArray[np.int64]) -> list[Array]:
    """Vertices, (n, 3), of each convex piece of a mesh; the same ones for the same mesh.

    Raises ImportError when coacd is missing, InvalidInputError when it fails.
    """
    if importlib.util.find_spec("coacd") is None:
        raise ImportError("decompose: meshes are decomposed by CoACD: pip install 'signorini[meshes]'")
    if len(triangles) > MAX_TRIANGLES:
        raise InvalidInputError(f"has {len(triangles)} triangles, at most {MAX_TRIANGLES} are decomposed")
    points, corners = _merged(points, triangles)
    kept = _cache(points, corners)
    found = _load(kept)
    if found is None:
        found = _decomposed(points, corners)
        _keep(kept, found)
    return found


def _merged(points: Array, triangles: npt.NDArray[np.int64]) -> tuple[Array, npt.NDArray[np.int32]]:
    """Points at one place as one, and no triangle that is an edge or a point."""
    unique, number = np.unique(points + 0.0, axis=0, return_inverse=True)
    corners = number.reshape(-1)[triangles]
    a, b, c = corners.T
    return unique, np.ascontiguousarray(corners[(a != b) & (b != c) & (c != a)], dtype=np.int32)


def _decomposed(points: Array, triangles: npt.NDArray[np.int32]) -> list[Array]:
    with tempfile.TemporaryDirectory() as folder:
        given, answer = os.path.join(folder, "mesh.npz"), os.path.join(folder, "pieces.npz")
        np.savez(given, points=points, triangles=triangles)
        command = [sys.executable, "-c", _WORKER, given, answer, str(THRESHOLD), str(PIECES), str(SEED)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        try:
            done = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT, check=False
            )
        except subprocess.TimeoutExpired:
            raise InvalidInputError(f"CoACD did not decompose it within {TIMEOUT:g} s") from None
        found = _load(Path(answer))
    if found is None:
        words = done.stderr.decode(errors="replace").split("\n")
        reason = next((line.strip() for line in reversed(words) if line.strip()), "no pieces")
        raise InvalidInputError(f"CoACD cannot decompose it (exit status {done.returncode}: {reason[:200]})")
    return found


def _cache(points: Array, triangles: npt.NDArray[np.int32]) -> Path:
    """The file that holds the pieces of this mesh, if anything does."""
    folder = os.environ.get("XDG_CACHE_HOME", "")
    root = Path(folder) if os.path.isabs(folder) else Path("~/.cache").expanduser()
    key = hashlib.sha256(f"{version('coacd')} {THRESHOLD} {PIECES} {SEED} {points.shape}".encode())
    key.update(np.ascontiguousarray(points).tobytes())
    key.update(triangles.tobytes())
    return root / "signorini" / "pieces" / f"{key.hexdigest()[:32]}.npz"


def _load(path: Path) -> list[Array] | None:
    try:
        with np.load(path, allow_pickle=False) as data:
            sizes, points = data["sizes"], data["points"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = sizes.ndim == 1 and sizes.dtype.kind == "i" and len(sizes) and (sizes > 0).all()
    if not whole or points.shape != (sizes.sum(), 3) or points.dtype != np.float64 or not np.isfinite(points).all():
        return None
    return np.split(points, np.cumsum(sizes)[:-1])


def _keep(path: Path, found: list[Array]) -> None:
    """A folder that cannot be written to is no reason to fail; a reader never sees half a file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            np.savez(file, sizes=[len(piece) for piece in found], points=np.concatenate(found))
        os.replace(file.name, path)
    except OSError:
        return
