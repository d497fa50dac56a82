"""Damaged files: the reader gives a problem or an FclibError, whatever bytes it meets. Run longer with

    python tests/fuzz/test_fclib_reader.py [seconds] [seed]

Readings happen in a process of their own, so that a crash of libhdf5, or a file that takes forever, is a finding too.
"""

import multiprocessing
import random
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import signorini
from signorini import fclib

LIMIT_BYTES = 2 << 30
LIMIT_SECONDS = 120


def seeds(folder):
    """Small valid files of each kind, as bytes."""
    rng = np.random.default_rng(0)
    j = rng.normal(size=(6, 8))
    g = np.array([1.0, 0.0, -1.0] * 2)
    path = Path(folder, "seed.hdf5")
    problem = signorini.ContactProblem.from_mass(np.eye(8), j, g, [0.5, 0.3])
    fclib.write(path, problem, signorini.solve(problem))
    yield path.read_bytes()
    with h5py.File(path, "r+") as file:  # by rows, and compressed
        w = file["fclib_local/W"]
        w["nz"][0] = -2
        x = w["x"][()]
        del w["x"]
        w.create_dataset("x", data=x, compression="gzip")
    yield path.read_bytes()
    with h5py.File(path, "w") as file:  # global, by triplets
        group = file.create_group("fclib_global")
        group["spacedim"] = np.array([3], np.int32)
        for name, a in (("M", np.eye(8)), ("H", j.T)):
            at = np.nonzero(a)
            sizes = {"m": a.shape[0], "n": a.shape[1], "nz": len(at[0]), "nzmax": len(at[0])}
            for key, value in sizes.items():
                group[f"{name}/{key}"] = np.array([value], np.int32)
            group[f"{name}/p"], group[f"{name}/i"] = at[1].astype(np.int32), at[0].astype(np.int32)
            group[f"{name}/x"] = a[at]
        group["vectors/f"], group["vectors/w"], group["vectors/mu"] = np.ones(8), g, np.array([0.5, 0.3])
    yield path.read_bytes()
    with h5py.File(path, "r+") as file:  # ... with equalities
        group = file["fclib_global"]
        for key, value in {"m": 8, "n": 1, "nz": -1, "nzmax": 1}.items():
            group[f"G/{key}"] = np.array([value], np.int32)
        group["G/p"], group["G/i"], group["G/x"] = np.array([0, 1]), np.array([7]), np.ones(1)
        group["vectors/b"] = np.zeros(1)
    yield path.read_bytes()
    constraints = [signorini.FrictionCone(0.5), signorini.FrictionCone(0.2), signorini.Equality()]
    jacobian = rng.normal(size=(7, 9))
    problem = signorini.ContactProblem(jacobian @ jacobian.T, np.append(g, 0.1), constraints=constraints)
    fclib.write(path, problem, signorini.solve(problem))
    with h5py.File(path, "r+") as file:  # local with equalities, and guesses
        for k in "12":
            file.copy("solution", f"guesses/{k}")
    yield path.read_bytes()


def odd_field(path, rng):
    """Another thing in place of one field of a valid file."""
    with h5py.File(path, "r+") as file:
        names = []
        file.visit(names.append)
        name = rng.choice(names)
        is_numbers = isinstance(file[name], h5py.Dataset) and file[name].dtype.kind in "iuf"
        value = file[name][()] if is_numbers else np.ones(3)
        del file[name]
        kind = rng.randrange(12)
        if kind == 0:
            file.create_group(name)
        elif kind == 1:
            file[name] = h5py.SoftLink(rng.choice([f"/{name}", "/nowhere", "/"]))
        elif kind == 2:
            file[name] = h5py.ExternalLink("/etc/passwd", "/x")
        elif kind == 3:
            file.create_dataset(name, shape=(2**40,), dtype=rng.choice(["f8", "i4"]), chunks=(2**20,))
        elif kind == 4:
            kinds = [
                h5py.string_dtype(),
                h5py.vlen_dtype(np.int32),
                h5py.ref_dtype,
                np.dtype([("a", "f8")]),
                "c16",
                "f2",
            ]
            file.create_dataset(name, shape=(4,), dtype=rng.choice(kinds))
        elif kind == 5:
            file.create_dataset(name, data=rng.choice([h5py.Empty("f8"), 3.0, np.zeros((2, 3)), "text", [True, False]]))
        elif kind == 6:
            file[name] = np.array([rng.choice([2**64 - 1, 2**63])], np.uint64)
        elif kind == 7:
            file[name] = np.full(np.shape(value), rng.choice([np.nan, 1e308, -1.0, -1e-300]))
        elif kind == 8:
            file[name] = np.resize(value, np.size(value) + rng.choice([-1, 1]))
        elif kind == 9:
            file[name] = np.asarray(value)[..., None]
        elif kind == 10:
            file[name] = np.asarray(value).astype(">f8")


def mutated(data, rng, folder):
    if rng.randrange(4) == 0:
        path = Path(folder, "odd.hdf5")
        path.write_bytes(data)
        odd_field(path, rng)
        return path.read_bytes()
    data = bytearray(data)
    kind = rng.randrange(6)
    if kind == 0:  # cut off
        del data[rng.randrange(len(data)) :]
    elif kind == 1:  # a hole
        start = rng.randrange(len(data))
        data[start : start + rng.randrange(1, 64)] = bytes(rng.randrange(64))
    else:
        for _ in range(rng.choice([1, 1, 2, 4, 16])):
            at = rng.randrange(len(data))
            if kind == 2:
                data[at] ^= 1 << rng.randrange(8)
            elif kind == 3:
                data[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)])
            elif kind == 4:  # an integer at its limits
                data[at : at + 4] = rng.choice([0, 2**31 - 1, 2**32 - 1, 1, 2**24]).to_bytes(4, "little")
            else:  # a double that is none
                data[at : at + 8] = np.array(rng.choice([np.nan, np.inf, -1e300, 1e-320])).tobytes()
    return bytes(data)


def read_all(path):
    """What every damaged file is put through. Raises on what the reader must not do."""
    for read in (fclib.read, lambda p: fclib.read(p, "mass"), fclib.read_solution, fclib.read_guesses):
        try:
            result = read(path)
        except fclib.FclibError as error:
            assert str(path) in str(error)
        else:
            if isinstance(result, signorini.ContactProblem):
                assert np.isfinite(result.free_velocity).all()
                assert np.isfinite(result.delassus.data).all()


def _worker(connection):
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    while (path := connection.recv()) is not None:
        try:
            read_all(path)
            connection.send("")
        except BaseException as error:
            connection.send(f"{type(error).__name__}: {error}")


class Reader:
    """A process that reads files; replaced when one kills it."""

    def __init__(self):
        self.context = multiprocessing.get_context("spawn")
        self.process = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None

    def __call__(self, path):
        """What went wrong with this file, or nothing."""
        if self.process is None:
            self.connection, other = self.context.Pipe()
            self.process = self.context.Process(target=_worker, args=(other,), daemon=True)
            self.process.start()
            other.close()
        self.connection.send(str(path))
        try:
            if self.connection.poll(LIMIT_SECONDS):
                return self.connection.recv()
            problem = f"no answer in {LIMIT_SECONDS} s"
        except (EOFError, ConnectionResetError):
            self.process.join()
            problem = f"the process died with exit code {self.process.exitcode}"
        self.stop()
        return problem


def fuzz(folder, count, seed, seconds=float("inf")):
    rng = random.Random(seed)
    originals = list(seeds(folder))
    end, findings, done = time.monotonic() + seconds, [], 0
    with Reader() as reader:
        while done < count and time.monotonic() < end:
            data = mutated(rng.choice(originals), rng, folder)
            path = Path(folder, "damaged.hdf5")
            path.write_bytes(data)
            if problem := reader(path):
                kept = Path(folder, f"finding-{seed}-{done}.hdf5")
                kept.write_bytes(data)
                findings.append(f"{kept}: {problem}")
            done += 1
    return findings, done


def test_the_seeds_are_read(tmp_path):
    for i, data in enumerate(seeds(tmp_path)):
        path = tmp_path / f"{i}.hdf5"
        path.write_bytes(data)
        assert fclib.read(path).num_contacts == 2


@pytest.mark.parametrize("seed", range(2))
def test_damaged_bytes(tmp_path, seed):
    findings, done = fuzz(tmp_path, 400, seed)
    assert done == 400
    assert not findings, "\n".join(findings)


if __name__ == "__main__":
    folder = tempfile.mkdtemp(prefix="fclib-fuzz-")
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    findings, done = fuzz(folder, 10**9, int(sys.argv[2]) if len(sys.argv) > 2 else time.time_ns(), seconds)
    print(f"{done} files, {len(findings)} findings in {folder}", *findings, sep="\n")
    sys.exit(bool(findings))
