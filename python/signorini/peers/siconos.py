"""Siconos' solvers (Acary et al.): nonsmooth Gauss-Seidel and nonsmooth Newton, in a process of their own.

Siconos is not on PyPI; Debian and Ubuntu have it as python3-siconos, for their own interpreter. That one is
/usr/bin/python3, or what the environment variable SIGNORINI_SICONOS_PYTHON names.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import selectors
import shutil
import subprocess
import tempfile
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import signorini
from signorini._solve import LawName
from signorini.peers._common import PeerSolution, PeerUnavailableError, check_input, judged, system_matrix

NAME = "siconos"
METHODS = ("nsgs", "nsn-ac", "nsn-fb")
TIMEOUT = 60.0  # seconds a solve may take
_DENSE_ROWS = 120  # below, dense Newton is faster than sparse by a factor of five to ten


class _DiedError(Exception):
    """The process ended or was killed; the message says why."""


class _Worker:
    """A process that answers one request at a time, started again after each death."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="signorini-siconos-")
        self.version = ""

    @property
    def folder(self) -> Path:
        return Path(self._folder.name)

    def start(self) -> None:
        if self._process is not None and self._process.poll() is None:
            return
        script = Path(__file__).with_name("_siconos_worker.py")
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment.pop("PYTHONPATH", None)
        environment.pop("PYTHONHOME", None)
        self._process = subprocess.Popen(
            [_interpreter(), str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        self.version = str(self._line(20.0)["version"])

    def ask(self, request: dict[str, Any], timeout: float) -> dict[str, Any]:
        self.start()
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write((json.dumps(request) + "\n").encode())
            self._process.stdin.flush()
        except BrokenPipeError:
            raise _DiedError(f"exit status {self._process.wait()}") from None
        return self._line(timeout)

    def _line(self, timeout: float) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            ready = selector.select(timeout)
        if not ready:
            self.stop()
            raise _DiedError(f"timeout after {timeout:g} s")
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            self.stop()
            raise _DiedError(f"exit status {code}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    with contextlib.suppress(BrokenPipeError):
                        pipe.close()
            self._process = None


def _interpreter() -> str:
    return os.environ.get("SIGNORINI_SICONOS_PYTHON", "/usr/bin/python3")


@lru_cache(maxsize=1)
def _worker() -> _Worker:
    interpreter = _interpreter()
    if shutil.which(interpreter) is None:
        raise PeerUnavailableError(f"{interpreter} does not exist: Siconos has no Python to run in")
    worker = _Worker()
    try:
        worker.start()
    except (_DiedError, OSError) as error:
        raise PeerUnavailableError(
            f"{interpreter} cannot import siconos ({error}): on Debian, apt install python3-siconos python3-scipy"
        ) from error
    atexit.register(worker.stop)
    return worker


def version() -> str:
    """The version installed. Raises PeerUnavailableError when Siconos cannot be started."""
    return _worker().version


def solve(
    problem: signorini.ContactProblem,
    law: LawName = "ncp",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    *,
    method: str = "nsn-fb",
    timeout: float = TIMEOUT,
) -> PeerSolution:
    """One of "nsgs", "nsn-ac" and "nsn-fb" on the NCP; Siconos has no CCP for these.

    Settings: Siconos' own tolerance at the one asked for, at most max_iterations (None: 20 000 sweeps of NSGS, 300
    iterations of Newton; more gain nothing), all else at its defaults. Storage as suits each: sparse blocks for NSGS,
    dense matrices for Newton up to 40 contacts, sparse above (dense again where sparse aborts). When Siconos says it is
    done and our certificate does not hold (its error is relative to |q|), it is asked again at a tenth and a hundredth,
    and the time is that of the last attempt alone. One thread; killed after timeout seconds.
    """
    if max_iterations is None:
        max_iterations = 20000 if method == "nsgs" else 300
    check_input(problem, law, tolerance, max_iterations)
    if law != "ncp":
        raise signorini.InvalidInputError('law: Siconos solves the "ncp" only')
    if method not in METHODS:
        raise signorini.InvalidInputError(f'method: is "{method}", must be one of {", ".join(METHODS)}')
    worker = _worker()
    peer = f"siconos-{method}"
    order = np.arange(problem.size).reshape(-1, 3)[:, [2, 0, 1]].ravel()  # Siconos has the normal first
    matrix = system_matrix(problem)[order][:, order].tocsc()
    matrix.sort_indices()
    problem_file, answer_file = worker.folder / "problem.npz", worker.folder / "answer.npy"
    np.savez(
        problem_file,
        data=matrix.data,
        indices=matrix.indices,
        indptr=matrix.indptr,
        q=np.asarray(problem.free_velocity)[order],
        friction=np.asarray(problem.friction),
    )
    storage = "blocks" if method == "nsgs" else "dense" if problem.size <= _DENSE_ROWS else "sparse"
    request = {
        "problem": str(problem_file),
        "answer": str(answer_file),
        "method": method,
        "max_iterations": max_iterations,
        "storage": storage,
    }
    answer: PeerSolution | None = None
    for factor in (1.0, 0.1, 0.01):
        start = time.perf_counter()
        try:
            try:
                reply = worker.ask({**request, "tolerance": tolerance * factor}, timeout)
            except _DiedError as death:
                if "timeout" in str(death) or request["storage"] != "sparse":
                    raise
                request["storage"] = "dense"  # its sparse LU aborts now and then
                reply = worker.ask({**request, "tolerance": tolerance * factor}, timeout)
        except _DiedError as death:
            if answer is not None:
                return answer  # the looser attempt stands
            zero = np.zeros(problem.size)
            status = "timeout" if "timeout" in str(death) else "crashed"
            residual = signorini.residual(problem, zero, law)
            seconds = time.perf_counter() - start
            return PeerSolution(peer, status, False, zero, residual, 0, seconds, note=str(death))
        impulse = np.zeros(problem.size)
        impulse[order] = np.load(answer_file)
        answer = judged(
            peer,
            problem,
            impulse,
            law,
            tolerance,
            claimed=reply["info"] == 0,
            iterations=reply["iterations"],
            seconds=reply["seconds"],
            limited=reply["iterations"] >= max_iterations,
            note=f"{reply['storage']} storage, own tolerance {tolerance * factor:.0e}",
        )
        if answer.solved or not answer.claimed:
            break
    assert answer is not None
    return answer
