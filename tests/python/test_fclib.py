import os
import pickle
import socket
import tracemalloc

import h5py
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from reference import planted_problem

import signorini
from signorini import ContactProblem, Equality, FrictionCone, HalfLine, fclib

# FCLIB orders each contact (N, T1, T2): file[k] = ours[ORDER[k]].
ORDER = np.array([2, 0, 1])


def file_order(num_contacts, extra=0):
    contacts = (3 * np.arange(num_contacts)[:, None] + ORDER).ravel()
    return np.append(contacts, 3 * num_contacts + np.arange(extra)).astype(int)


def write_matrix(group, name, matrix, form):
    matrix = sp.coo_array(matrix)
    target = group.create_group(name)
    if form == "triplet":
        p, i, x, nz = matrix.col, matrix.row, matrix.data, matrix.nnz
    else:
        compressed = matrix.tocsc() if form == "csc" else matrix.tocsr()
        p, i, x, nz = compressed.indptr, compressed.indices, compressed.data, -1 if form == "csc" else -2
    for key, value in {"m": matrix.shape[0], "n": matrix.shape[1], "nz": nz, "nzmax": matrix.nnz}.items():
        target[key] = np.array([value], np.int32)
    target["p"], target["i"], target["x"] = p.astype(np.int32), i.astype(np.int32), x


def local_file(path, form="csc", change=None, extra=None):
    """The planted problem as a local file, written here and not by the package; returns (delassus, g, mu, impulse)."""
    mass, j, g, mu, impulse = planted_problem(0)
    delassus = j @ np.linalg.solve(mass, j.T)
    order = file_order(5)
    with h5py.File(path, "w") as file:
        local = file.create_group("fclib_local")
        local["spacedim"] = np.array([3], np.int32)
        write_matrix(local, "W", delassus[order][:, order], form)
        local["vectors/q"], local["vectors/mu"] = g[order], mu
        file["solution/r"], file["solution/u"] = impulse[order], (delassus @ impulse + g)[order]
        file["guesses/number_of_guesses"] = np.array([1], np.int32)
        file["guesses/1/r"] = 2 * impulse[order]
        if extra:
            extra(file)
        for field, value in (change or {}).items():
            if field in file:
                del file[field]
            if value is not None:
                file[field] = value
    return delassus, g, mu, impulse


@pytest.fixture
def path(tmp_path):
    return tmp_path / "problem.hdf5"


@pytest.mark.parametrize("form", ["csc", "csr", "triplet"])
def test_local_file(path, form):
    delassus, g, mu, impulse = local_file(path, form)
    problem = fclib.read(path)
    np.testing.assert_allclose(problem.delassus.toarray(), delassus, atol=1e-14)
    np.testing.assert_array_equal(problem.free_velocity, g)
    np.testing.assert_array_equal(problem.friction, mu)
    assert problem.name == "problem"
    assert signorini.residual(problem, impulse).relative < 1e-12
    assert fclib.read(str(path)).size == 15


def test_stored_solution_and_guesses(path):
    delassus, g, _, impulse = local_file(path)
    stored = fclib.read_solution(path)
    np.testing.assert_array_equal(stored.impulse, impulse)
    np.testing.assert_allclose(stored.velocity, delassus @ impulse + g, atol=1e-14)
    (guess,) = fclib.read_guesses(path)
    np.testing.assert_array_equal(guess.impulse, 2 * impulse)
    assert guess.velocity is None
    local_file(path, change={"solution": None, "guesses": None})
    assert fclib.read_solution(path) is None
    assert fclib.read_guesses(path) == []


@pytest.mark.parametrize("form", ["csc", "csr", "triplet"])
@pytest.mark.parametrize("equalities", [0, 2])
def test_global_file(path, form, equalities):
    rng = np.random.default_rng(1)
    mass, j, _, mu, _ = planted_problem(1)
    f, w = rng.normal(size=24), rng.normal(size=15)
    g_matrix, b = rng.normal(size=(24, equalities)), rng.normal(size=equalities)
    order = file_order(5)
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_global")
        group["spacedim"] = np.array([3], np.int32)
        write_matrix(group, "M", mass, form)
        write_matrix(group, "H", j[order].T, form)
        group["vectors/f"], group["vectors/w"], group["vectors/mu"] = f, w[order], mu
        if equalities:
            write_matrix(group, "G", g_matrix, form)
            group["vectors/b"] = b
    jacobian = np.vstack([j, g_matrix.T])
    for operator in (None, "mass", "delassus"):
        problem = fclib.read(path, operator)
        assert (problem.mass is None) == (operator == "delassus")
        expected = jacobian @ np.linalg.solve(mass, jacobian.T)
        np.testing.assert_allclose(problem.delassus.toarray(), expected, atol=1e-9)
        np.testing.assert_allclose(
            problem.free_velocity, jacobian @ np.linalg.solve(mass, f) + np.append(w, b), atol=1e-12
        )
        assert problem.constraints == tuple(FrictionCone(m) for m in mu) + (Equality(),) * equalities


def test_forces_on_an_ill_conditioned_mass_matrix(path):
    exact = scipy.linalg.invhilbert(9, exact=True)  # condition 5e11; times `scale`, the entries of the matrix are whole
    scale = 12252240  # lowest common multiple of 1 to 17
    f = np.arange(1, 10)
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_global")
        group["spacedim"] = np.array([3], np.int32)
        write_matrix(group, "M", np.round(scale * scipy.linalg.hilbert(9)), "csc")
        write_matrix(group, "H", np.eye(9), "csc")
        group["vectors/f"], group["vectors/w"], group["vectors/mu"] = f.astype(float), np.zeros(9), np.ones(3)
    expected = np.array([int(x) for x in exact @ f.astype(object)], dtype=float) / scale
    np.testing.assert_allclose(fclib.read(path).free_velocity[file_order(3)], expected, rtol=1e-14)


def test_the_matrix_of_a_large_global_file_is_never_dense(path):
    n = 3000  # free points on the floor; n x n numbers are 72 MB
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_global")
        group["spacedim"] = np.array([3], np.int32)
        for name in ("M", "H"):
            write_matrix(group, name, sp.eye_array(n), "csc")
        group["vectors/f"], group["vectors/w"], group["vectors/mu"] = np.zeros(n), np.ones(n), np.ones(n // 3)
    fclib.read(path)  # scipy's modules are loaded now
    tracemalloc.start()
    problem = fclib.read(path, "delassus")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert problem.delassus.nnz == n
    assert peak < 1e7


def test_equality_rows_of_a_local_file(path):
    rng = np.random.default_rng(2)
    a = rng.normal(size=(17, 30))
    block, g = a @ a.T, rng.normal(size=17)
    order = file_order(5, 2)
    stored = block[order][:, order]

    def rewrite(file):
        local = file["fclib_local"]
        del local["W"], local["vectors/q"]
        write_matrix(local, "W", stored[:15, :15], "csc")
        write_matrix(local, "V", stored[:15, 15:], "csr")
        write_matrix(local, "R", stored[15:, 15:], "triplet")
        local["vectors/q"], local["vectors/s"] = g[order][:15], g[15:]

    local_file(path, extra=rewrite)
    problem = fclib.read(path)
    np.testing.assert_allclose(problem.delassus.toarray(), block, atol=1e-13)
    np.testing.assert_array_equal(problem.free_velocity, g)
    assert problem.constraints[-2:] == (Equality(), Equality())
    s = signorini.solve(problem, tolerance=1e-9)
    assert s.solved
    np.testing.assert_allclose((block @ s.impulse + g)[15:], 0.0, atol=1e-7)  # V^T r + R l + s = 0


@pytest.mark.parametrize("kind", ["delassus", "mass", "equalities", "empty"])
def test_what_is_written_is_read_back(path, kind):
    mass, j, g, mu, _ = planted_problem(3)
    delassus = j @ np.linalg.solve(mass, j.T)
    if kind == "delassus":
        problem = ContactProblem(delassus, g, mu, np.linspace(0, 0.1, 15), name="block")
    elif kind == "mass":
        problem = ContactProblem.from_mass(mass, j, g, mu)
    elif kind == "equalities":
        problem = ContactProblem(delassus, g, constraints=[FrictionCone(m) for m in mu[:4]] + [Equality()] * 3)
    else:
        problem = ContactProblem(np.zeros((0, 0)), [], [])
    solution = signorini.solve(problem, tolerance=1e-9)
    fclib.write(path, problem, solution, title="a title", description="of a block")
    again = fclib.read(path)
    system = problem.delassus.toarray() + np.diag(problem.compliance)
    np.testing.assert_allclose(again.delassus.toarray(), system, rtol=1e-15)
    np.testing.assert_array_equal(again.free_velocity, problem.free_velocity)
    assert again.constraints == problem.constraints
    stored = fclib.read_solution(path)
    np.testing.assert_array_equal(stored.impulse, solution.impulse)
    assert signorini.residual(again, stored.impulse).relative < 1e-8
    if kind == "mass":
        tree = fclib.read(path, "mass")
        np.testing.assert_array_equal(tree.mass.toarray(), mass)
        np.testing.assert_array_equal(tree.jacobian.toarray(), j)
    with h5py.File(path) as file:
        assert file["fclib_local/info/title"][()] == b"a title"
        assert file["fclib_local/W/nz"][0] == -1


def test_write_refuses_what_the_layout_cannot_hold(path):
    problem = ContactProblem(np.eye(4), np.zeros(4), constraints=[HalfLine(), FrictionCone(0.1)])
    with pytest.raises(signorini.InvalidInputError, match="problem"):
        fclib.write(path, problem)
    small = ContactProblem(np.eye(3), np.zeros(3), [0.1])
    with pytest.raises(signorini.InvalidInputError, match="solution"):
        fclib.write(path, small, signorini.solve(ContactProblem(np.eye(6), np.zeros(6), [0.1, 0.1])))
    with pytest.raises(signorini.InvalidInputError, match="solution: is a ndarray"):
        fclib.write(path, small, np.zeros(3))
    with pytest.raises(signorini.InvalidInputError, match="problem: is a ndarray"):
        fclib.write(path, np.eye(3))
    assert not path.exists()


def test_git_lfs_pointer_is_named_as_one(path):
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    with pytest.raises(fclib.FclibError, match=r"problem\.hdf5.*git-lfs.*git lfs pull"):
        fclib.read(path)


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", b"not hdf5 at all", bytes(4096)])
def test_what_is_not_hdf5_is_refused(path, content):
    path.write_bytes(content)
    with pytest.raises(fclib.FclibError, match=r"problem\.hdf5.*HDF5"):
        fclib.read(path)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        fclib.read(tmp_path / "none.hdf5")
    with pytest.raises(IsADirectoryError):
        fclib.read(tmp_path)


def one(value):
    return np.array([value], np.int32)


NNZ, N = 225, 15
DAMAGED = {
    "no group": ({"fclib_local": None}, "fclib_local"),
    "no matrix": ({"fclib_local/W": None}, "W/m.*missing"),
    "no q": ({"fclib_local/vectors/q": None}, "vectors/q.*missing"),
    "no mu": ({"fclib_local/vectors/mu": None}, "vectors/mu.*missing"),
    "no dimension": ({"fclib_local/spacedim": None}, "spacedim.*missing"),
    "plane problem": ({"fclib_local/spacedim": one(2)}, "spacedim.*is 2.*3 dimensions"),
    "rows claimed": ({"fclib_local/W/m": one(2**31 - 1)}, "W.*2147483647 x 15"),
    "columns claimed": ({"fclib_local/W/n": one(12)}, "W.*15 x 12"),
    "negative rows": ({"fclib_local/W/m": one(-3)}, "W/m.*-3"),
    "unknown storage": ({"fclib_local/W/nz": one(-3)}, "W/nz.*-3"),
    "two sizes": ({"fclib_local/W/m": np.array([15, 15], np.int32)}, "W/m.*2 entries"),
    "size not an integer": ({"fclib_local/W/m": np.array([15.0])}, "W/m.*integers"),
    "a group for a dataset": ({"fclib_local/W/x": None, "fclib_local/W/x/y": one(1)}, "W/x.*not a dataset"),
    "short p": ({"fclib_local/W/p": np.zeros(3, np.int32)}, "W/p.*3 entries.*16"),
    "p not from 0": ({"fclib_local/W/p": np.arange(1, 17, dtype=np.int32)}, "W/p.*start at 0"),
    "p decreases": ({"fclib_local/W/p": np.array([0, 9, 3] + [NNZ] * 13, np.int32)}, "W/p.*never decrease"),
    "p beyond x": ({"fclib_local/W/p": np.array([0] * 15 + [NNZ + 1], np.int32)}, "W/[xi].*225 entries.*226"),
    "p huge": ({"fclib_local/W/p": np.array([0] * 15 + [2**62], np.int64)}, "W/[xi].*225 entries"),
    "p negative": ({"fclib_local/W/p": np.array([0, -1] + [NNZ] * 14, np.int32)}, "W/p"),
    "short i": ({"fclib_local/W/i": np.zeros(10, np.int32)}, "W/i.*10 entries"),
    "i out of range": ({"fclib_local/W/i": np.full(NNZ, N, np.int32)}, r"W/i\[0\].*15.*\[0, 15\)"),
    "i negative": ({"fclib_local/W/i": np.full(NNZ, -1, np.int32)}, r"W/i\[0\].*-1"),
    "i not integers": ({"fclib_local/W/i": np.zeros(NNZ)}, "W/i.*integers"),
    "x of text": ({"fclib_local/W/x": np.array([b"a"] * NNZ)}, "W/x.*numbers"),
    "x nan": ({"fclib_local/W/x": np.full(NNZ, np.nan)}, r"W/x\[0\].*nan"),
    "x inf": ({"fclib_local/W/x": np.append(np.ones(NNZ - 1), np.inf)}, r"W/x\[224\].*inf"),
    "x of two dimensions": ({"fclib_local/W/x": np.zeros((15, 15))}, "W/x.*dimension"),
    "indefinite": ({"fclib_local/W/x": np.arange(NNZ) - 100.0}, "delassus"),
    "q nan": ({"fclib_local/vectors/q": np.full(N, np.nan)}, r"vectors/q\[0\].*nan"),
    "q 1e300": ({"fclib_local/vectors/q": np.full(N, 1e300)}, "1e.300"),
    "q short": ({"fclib_local/vectors/q": np.zeros(12)}, "vectors/mu|W"),
    "q not three a contact": ({"fclib_local/vectors/q": np.zeros(14)}, "14 contact rows"),
    "mu short": ({"fclib_local/vectors/mu": np.zeros(4)}, "vectors/mu.*4 entries.*5"),
    "mu negative": ({"fclib_local/vectors/mu": np.array([0.1, 0.1, -0.5, 0.1, 0.1])}, r"mu\[2\].*-0\.5"),
    "mu complex": ({"fclib_local/vectors/mu": np.ones(5, complex)}, "vectors/mu.*numbers"),
    "half of the equality rows": ({"fclib_local/vectors/s": np.zeros(2)}, "V/m.*missing"),
}


@pytest.mark.parametrize(("change", "message"), DAMAGED.values(), ids=DAMAGED.keys())
def test_damaged_file_is_refused_with_file_and_field(path, change, message):
    local_file(path, change=change)
    with pytest.raises(fclib.FclibError, match=rf"problem\.hdf5: .*{message}") as caught:
        fclib.read(path)
    assert isinstance(caught.value, ValueError)
    assert type(pickle.loads(pickle.dumps(caught.value))) is fclib.FclibError


def test_claims_of_size_cost_no_memory(path):
    def claim(file):
        del file["fclib_local/vectors/q"]
        # A few bytes on disk, a terabyte once read: HDF5 makes up entries that were never written.
        file["fclib_local/vectors"].create_dataset("q", shape=(2**37,), dtype=np.float64, chunks=(2**20,))

    local_file(path, extra=claim)
    assert path.stat().st_size < 1e5
    with pytest.raises(fclib.FclibError, match=r"vectors/q.*claims 137438953472 entries"):
        fclib.read(path)


def test_data_kept_in_another_file_is_refused(path, tmp_path):
    (tmp_path / "other.bin").write_bytes(bytes(8 * N))

    def external(file):
        del file["fclib_local/vectors/q"]
        place = [(str(tmp_path / "other.bin"), 0, 8 * N)]
        file["fclib_local/vectors"].create_dataset("q", shape=(N,), dtype=np.float64, external=place)

    local_file(path, extra=external)
    with pytest.raises(fclib.FclibError, match=r"vectors/q.*another file"):
        fclib.read(path)


def test_a_number_format_that_numpy_lacks_is_refused(path):
    def strange(file):
        del file["fclib_local/vectors/q"]
        kind = h5py.h5t.IEEE_F64LE.copy()
        kind.set_ebias(33023)
        h5py.h5d.create(file["fclib_local/vectors"].id, b"q", kind, h5py.h5s.create_simple((N,)))

    local_file(path, extra=strange)
    with pytest.raises(fclib.FclibError, match=r"problem\.hdf5: is damaged"):
        fclib.read(path)


def test_compressed_files_are_read(path):
    def compress(file):
        x = file["fclib_local/W/x"][()]
        del file["fclib_local/W/x"]
        file["fclib_local/W"].create_dataset("x", data=x, compression="gzip", shuffle=True)

    delassus, *_ = local_file(path, extra=compress)
    np.testing.assert_allclose(fclib.read(path).delassus.toarray(), delassus, atol=1e-14)


def test_operator_argument(path):
    local_file(path)
    with pytest.raises(fclib.FclibError, match="signorini_dynamics.*missing"):
        fclib.read(path, "mass")
    with pytest.raises(signorini.InvalidInputError, match="operator.*sparse"):
        fclib.read(path, "sparse")


@pytest.mark.parametrize("family", ["boxes_stack", "capsules", "chain", "cube_stack", "real"])
def test_the_data(data, family):
    """Every stored solution is one, and the mass form is the same problem."""
    files = sorted((data / family).glob("*.hdf5"))
    assert files
    for file in files[:: max(1, len(files) // 30)]:
        problem, stored = fclib.read(file), fclib.read_solution(file)
        if stored is not None:
            # Real matrices are unsymmetric, and their solutions are those of the matrix as it stands.
            allowed = max(1e-7, 2.0 * problem.asymmetry)
            assert signorini.residual(problem, stored.impulse).relative < allowed, file.stem
        with h5py.File(file) as raw:
            has_dynamics = "signorini_dynamics" in raw
        if has_dynamics:
            other = fclib.read(file, "mass")
            difference = abs(other.delassus - problem.delassus).max() / abs(problem.delassus).max()
            assert difference < 1e-6 + problem.asymmetry, file.stem


SMALL = ContactProblem(np.eye(3), np.zeros(3), [0.1], name="small")


@pytest.mark.parametrize(
    ("name", "texts", "message"),
    [
        ("small", {"title": 5}, "title: is 5, must be a str"),
        ("small", {"title": None}, "title: is None"),
        ("small", {"title": "\udcff"}, "title: is .*UTF-8"),
        ("small", {"description": None}, "description: is None"),
        ("small", {"description": "\udcff"}, "description: is .*UTF-8"),
        ("raw-\udcff", {}, r"problem\.name: is .*UTF-8"),
    ],
)
def test_what_was_there_stays_when_a_text_is_bad(path, name, texts, message):
    path.write_bytes(b"precious")
    with pytest.raises(signorini.InvalidInputError, match=message):
        fclib.write(path, ContactProblem(np.eye(3), np.zeros(3), [0.1], name=name), **texts)
    assert path.read_bytes() == b"precious"
    assert list(path.parent.iterdir()) == [path]


def test_what_was_there_stays_when_writing_fails(path, monkeypatch):
    path.write_bytes(b"precious")
    path.chmod(0o640)

    def full(*_):
        raise OSError("no space left")

    with monkeypatch.context() as broken:
        broken.setattr(fclib, "_write_matrix", full)
        with pytest.raises(OSError, match="no space left"):
            fclib.write(path, SMALL)
    assert path.read_bytes() == b"precious"
    assert list(path.parent.iterdir()) == [path]
    link = path.with_name("link.hdf5")
    link.symlink_to(path.name)
    fclib.write(link, SMALL)
    assert link.is_symlink()
    assert fclib.read(path).size == 3
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_file_goes_where_there_is_a_folder_and_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.a\.hdf5"):
        fclib.write(tmp_path / "nowhere" / "a.hdf5", SMALL)
    with pytest.raises(IsADirectoryError, match=tmp_path.name):
        fclib.write(tmp_path, SMALL)


def test_what_is_no_name_of_a_file(tmp_path):
    refused = ("x\0y", r"path: is 'x\\x00y', must be without null"), (5, "path: is 5"), (b"x", "path: is b'x'")
    for use in (fclib.read, fclib.read_solution, fclib.read_guesses, lambda path: fclib.write(path, SMALL)):
        for path, message in refused:
            with pytest.raises(signorini.InvalidInputError, match=message):
                use(path)


def test_pipes_and_devices_are_no_problem_files(path):
    os.mkfifo(path)  # to open it would wait for a writer
    with pytest.raises(fclib.FclibError, match=r"problem\.hdf5: is a pipe, must be a regular file"):
        fclib.read(path)
    with pytest.raises(fclib.FclibError, match=r"null: is a device, must be a regular file"):
        fclib.read("/dev/null")
    path.unlink()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        with pytest.raises(fclib.FclibError, match=r"problem\.hdf5: is a socket, must be a regular file"):
            fclib.read(path)
