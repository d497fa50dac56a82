"""Runs inside the Python that has Siconos, away from ours: it can abort, hang or print what it likes.

Reads one line a request on standard input, {"problem": npz, "answer": npz, "method", "tolerance", "max_iterations",
"storage"}, and answers each with one line of JSON on what was standard output. numpy is required, scipy optional.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import Any

sys.path.pop(0)  # this folder, whose siconos.py is not the one meant

import numpy as np
import siconos.numerics as sn

METHODS = {
    "nsgs": ("SICONOS_FRICTION_3D_NSGS", "fc3d_nsgs"),
    "nsn-ac": ("SICONOS_FRICTION_3D_NSN_AC", "fc3d_nonsmooth_Newton_AlartCurnier"),
    "nsn-fb": ("SICONOS_FRICTION_3D_NSN_FB", "fc3d_nonsmooth_Newton_FischerBurmeister"),
}


def matrix(data: Any, size: int, storage: str) -> tuple[Any, str]:
    """G + R as a dense array, a scipy CSC matrix, or Siconos' own sparse blocks (for Gauss-Seidel)."""
    try:
        import scipy.sparse as sp
    except ImportError:
        storage = "dense"
    if storage == "dense":
        dense = np.zeros((size, size))
        dense[data["indices"], np.repeat(np.arange(size), np.diff(data["indptr"]))] = data["data"]
        return dense, storage
    csc = sp.csc_matrix((data["data"], data["indices"], data["indptr"]), shape=(size, size))
    if storage == "blocks":
        blocks = sn.SBM_from_csparse(3, csc)
        return (blocks[1] if isinstance(blocks, (list, tuple)) else blocks), storage
    return csc, storage


def solve(request: dict[str, Any]) -> dict[str, Any]:
    """One solve; the time is that of the call into Siconos alone."""
    data = np.load(request["problem"])
    q, friction = data["q"], data["friction"]
    storage = request["storage"]
    operator, storage = matrix(data, len(q), storage)
    problem = sn.FrictionContactProblem(3, len(friction), operator, q, friction)
    identifier, function = METHODS[request["method"]]
    options = sn.SolverOptions(getattr(sn, identifier))
    options.dparam[sn.SICONOS_DPARAM_TOL] = request["tolerance"]
    options.iparam[sn.SICONOS_IPARAM_MAX_ITER] = request["max_iterations"]
    impulse, velocity = np.zeros(len(q)), np.zeros(len(q))
    start = time.perf_counter()
    info = getattr(sn, function)(problem, impulse, velocity, options)
    seconds = time.perf_counter() - start
    np.save(request["answer"], impulse)
    return {
        "info": 0 if info is None else int(info),
        "iterations": int(options.iparam[sn.SICONOS_IPARAM_ITER_DONE]),
        "seconds": seconds,
        "storage": storage,
    }


def version() -> str:
    """Siconos does not know its own version; Debian does."""
    command = ["dpkg-query", "-W", "-f", "${Version}", "python3-siconos"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def main() -> None:
    """Answers requests until standard input closes."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what Siconos prints must not mix with the answers
    answers.write(json.dumps({"version": version()}) + "\n")
    answers.flush()
    for line in sys.stdin:
        answers.write(json.dumps(solve(json.loads(line))) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
