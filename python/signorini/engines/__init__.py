"""Other people's simulators, each in a process and, where it is asked for, an environment of its own.

    for engine in engines.ENGINES:
        python = engines.interpreter(engine)  # None: not installed
        answer = engines.run(python, engine, setting, folder, time_step=1e-3, steps=2000)

What they run is a plain model (`_exchange`): the same bodies, masses, pairs and start for all.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from signorini.engines import _exchange

__all__ = ["ENGINES", "Engine", "cache", "install", "interpreter", "run", "run_all", "write_model"]

write_model = _exchange.write
TIMEOUT = 60.0  # [s] to load, beyond the time to step


@dataclass(frozen=True)
class Engine:
    """name: of its run_*.py too. module: that shows whether it is there. requirements: for pip, without what those ask
    for (numpy comes along). settings: what it is run as; the first is its default. licence: of the package. least: the
    oldest version that is to be measured."""

    name: str
    title: str
    module: str
    requirements: tuple[str, ...]
    licence: str
    settings: tuple[str, ...]
    least: tuple[int, ...] = ()

    def is_old(self, version: str) -> bool:
        """Whether a version is older than the least."""
        numbers = tuple(int(part) for part in version.split(".") if part.isdigit())
        return numbers < self.least


ENGINES = (
    Engine("signorini", "ours", "signorini", (), "Apache-2.0", ("default",)),
    Engine(
        "mujoco",
        "MuJoCo",
        "mujoco",
        ("mujoco-core>=4.0.1",),
        "Apache-2.0",
        ("pyramidal", "elliptic", "accurate"),
        (4, 0, 1),
    ),
    Engine(
        "drake", "Drake", "pydrake", ("drake", "pyyaml", "pydot"), "BSD-3", ("default", "near rigid", "hydroelastic")
    ),
    Engine("bullet", "Bullet", "pybullet", ("pybullet",), "zlib", ("default", "1000 iterations")),
    Engine("dart", "DART", "dartpy", ("dartpy",), "BSD-2", ("default", "exact friction")),
)


def cache() -> Path:
    """Where environments are made: SIGNORINI_ENGINES, or a folder of the user's cache."""
    named = os.environ.get("SIGNORINI_ENGINES")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "signorini" / "engines"


def _environment_python(engine: Engine) -> Path:
    return cache() / engine.name / "bin" / "python"


def interpreter(engine: Engine) -> str | None:
    """A Python that can import the engine: of its own environment, else this one; None: it is not installed."""
    own = _environment_python(engine)
    for python in (str(own) if own.exists() else None, sys.executable):
        if python is not None and _imports(python, engine.module):
            return python
    return None


def _imports(python: str, module: str) -> bool:
    look = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({module!r}) is None)"
    return subprocess.run([python, "-c", look], capture_output=True, check=False).returncode == 0


def install(engine: Engine) -> None:
    """Makes the engine's environment with the venv module and pip, from PyPI.

    Without dependencies (numpy aside): Drake's wheel asks for MOSEK, which is not free software, and runs without.
    Raises RuntimeError with pip's last line.
    """
    if not engine.requirements:
        return
    folder = cache() / engine.name
    python = str(_environment_python(engine))
    for command in (
        [sys.executable, "-m", "venv", str(folder)],
        [python, "-m", "pip", "install", "--quiet", "numpy"],
        [python, "-m", "pip", "install", "--quiet", "--no-deps", *engine.requirements],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = (done.stderr or done.stdout).strip().splitlines()
            raise RuntimeError(f"{engine.title} is not installed: {said[-1] if said else f'exit {done.returncode}'}")


def run(
    python: str, engine: Engine, setting: str, folder: Path, *, time_step: float, steps: int, limit: float = 60.0
) -> dict[str, Any]:
    """One run from the model's own start in a process of its own, one thread: what _worker says of it with the
    engine's version, or {"error": why}.

    folder: of write_model. limit: seconds of stepping after which it stops where it is.
    """
    return run_all(python, engine, setting, folder, [(None, steps)], time_step=time_step, limit=limit)[0]


def run_all(
    python: str,
    engine: Engine,
    setting: str,
    folder: Path,
    starts: Sequence[tuple[Any, int]],
    *,
    time_step: float,
    limit: float = 60.0,
) -> list[dict[str, Any]]:
    """The same for several starts, each a configuration (None: the model's own) and a number of steps, one after the
    other in one process; the engine loads the model anew for each. limit: of each. A start that
    fails is an error of its own."""
    script = Path(__file__).with_name(f"run_{engine.name}.py")
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    if python != sys.executable:
        environment.pop("PYTHONPATH", None)
        environment.pop("PYTHONHOME", None)
        environment.pop("LD_LIBRARY_PATH", None)
    with tempfile.TemporaryDirectory(prefix="signorini-engine-") as place:
        request = Path(place) / "run.json"
        many = [[None if q is None else list(map(float, q)), steps] for q, steps in starts]
        content = {"model": str(folder), "setting": setting, "time_step": time_step, "starts": many, "limit": limit}
        request.write_text(json.dumps(content))
        patience = limit * len(starts) + TIMEOUT
        try:
            done = subprocess.run(
                [python, str(script), str(request)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env=environment,
                timeout=patience,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return [{"error": f"no answer after {patience:g} s"}] * len(starts)
        answer = request.with_suffix(".answer")
        if not answer.exists():
            said = done.stderr.decode(errors="replace").strip().splitlines()
            why = f"process ended with {done.returncode}: {said[-1] if said else 'it said nothing'}"
            return [{"error": why}] * len(starts)
        result: dict[str, Any] = json.loads(answer.read_text())
        if "error" in result:
            return [result] * len(starts)
        return [{"version": result["version"], **run} for run in result["runs"]]
