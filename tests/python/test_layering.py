"""The include rule of docs/architecture.md, and what goes into the source distribution."""

import re
import shutil
import subprocess
import sys
import tarfile
from functools import lru_cache
from pathlib import Path

import pytest
from conftest import REPOSITORY

INCLUDE = re.compile(r'^\s*#\s*include\s+(?:<([^>]+)>|"([^"]+)")', re.MULTILINE)
FOLDERS = "delassus problem solver model collision assembly simulation rollout bindings"
LEVELS = {folder: 2 + i for i, folder in enumerate(FOLDERS.split())}
MAY_INCLUDE = {"coal": {"collision"}}
METHODS = {
    "admm", "auto", "bisection", "convex_newton", "interior_point", "inverse", "lcp_pgs", "newton", "pgs",
}  # fmt: skip


def own_files():
    return sorted(p for folder in ("include", "src", "bindings") for p in (REPOSITORY / folder).rglob("*.[hc]pp"))


def relative(path):
    """From the repository's root, without include/signorini/ or src/: problem/residual.hpp."""
    parts = path.relative_to(REPOSITORY).parts
    skip = {"include": 2, "src": 1}.get(parts[0], 0)
    return "/".join(parts[skip:])


def level(path):
    """Place in: types, errors, require, hash, length, instruction_sets < constraint_set, de_saxce < delassus/ < the
    rest of problem/ < solver/ < model/ < collision/ < assembly/ < simulation/ < rollout/ < bindings/."""
    name = relative(path)
    if name in ("types.hpp", "errors.hpp", "require.hpp", "hash.hpp", "length.hpp", "instruction_sets.hpp"):
        return 0
    if Path(name).with_suffix("").as_posix() in ("problem/constraint_set", "problem/de_saxce"):
        return 1
    return LEVELS[name.split("/")[0]]


@lru_cache(None)
def includes(path):
    """(includes in <>, our own files that are included)."""
    angled, ours = [], []
    for outside, inside in INCLUDE.findall(path.read_text()):
        if outside:
            assert not outside.startswith("signorini/"), f"{path}: our own headers are included in quotes"
            angled.append(outside)
            continue
        candidates = [REPOSITORY / "include" / inside, path.parent / inside, REPOSITORY / "src" / inside]
        found = [c for c in candidates if c.is_file()]
        assert found, f'{path}: "{inside}" is no header of this project'
        ours.append(found[0])
    return tuple(angled), tuple(ours)


def test_there_is_something_to_check():
    names = {relative(path) for path in own_files()}
    assert {"problem/residual.hpp", "delassus/block_lu.cpp", "solver/auto.cpp", "bindings/solver.cpp"} <= names
    assert sum(len(includes(path)[1]) for path in own_files()) > 80


@pytest.mark.parametrize("path", own_files(), ids=relative)
def test_an_include_never_points_up_the_list(path):
    for other in includes(path)[1]:
        assert level(other) <= level(path), f"{relative(path)} includes {relative(other)}"


@pytest.mark.parametrize("path", [p for p in own_files() if level(p) < LEVELS["bindings"]], ids=relative)
def test_the_library_needs_eigen_and_the_standard_library_only(path):
    """... the contact library, that is; Coal is let in where MAY_INCLUDE says, in no public header."""
    for header in includes(path)[0]:
        library, folder = header.split("/")[0], relative(path).split("/")[0]
        if folder in MAY_INCLUDE.get(library, ()) and "include" not in path.parts:
            continue
        standard = re.fullmatch(r"[a-z_0-9]+", header)
        kernels = header == "immintrin.h" and path.name == "dense_kernels.cpp"
        assert standard or kernels or header.startswith("Eigen/"), f"{relative(path)} includes <{header}>"


def test_public_headers_include_public_headers():
    for path in (REPOSITORY / "include").rglob("*.hpp"):
        for other in includes(path)[1]:
            assert other.is_relative_to(REPOSITORY / "include"), f"{relative(path)} includes {relative(other)}"


def test_no_header_includes_itself_by_a_detour():
    done = set()

    def visit(path, trail):
        assert path not in trail, " -> ".join(relative(p) for p in (*trail, path))
        if path not in done:
            for other in includes(path)[1]:
                visit(other, (*trail, path))
            done.add(path)

    for path in own_files():
        visit(path, ())


def test_a_method_includes_no_other_method():
    for path in own_files():
        if level(path) == LEVELS["solver"] and path.stem in METHODS - {"auto"}:
            others = {other.stem for other in includes(path)[1]} & METHODS - {path.stem}
            assert not others, f"{relative(path)} includes {others}"


@pytest.mark.parametrize(
    ("source", "may_include"),
    [("delassus/dense_kernels.cpp", {"immintrin.h"}), ("solver/cone_kernels.cpp", set())],
)
def test_kernels_are_free_of_inline_code_of_others(source, may_include):
    # Compiled for AVX-512: an inline function of a header could be what the linker keeps for everybody.
    paths = [REPOSITORY / "src" / source]
    for path in paths:
        angled, ours = includes(path)
        assert set(angled) <= may_include
        paths += ours
    assert {relative(path).split("/")[-1] for path in paths} <= {
        "dense_kernels.cpp", "dense_kernels.hpp", "cone_kernels.cpp", "cone_kernels.hpp", "cone_block.hpp",
    }  # fmt: skip


def test_an_installed_copy_holds_the_contact_library_alone(tmp_path):
    """Headers without code to link would be a promise that the library does not keep."""
    build = REPOSITORY / "build/python"
    if not ((build / "cmake_install.cmake").is_file() and shutil.which("cmake")):
        pytest.skip("needs cmake and the build in build/python")
    command = ["cmake", "--install", build, "--prefix", tmp_path, "--component", "cpp"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    ours = {p.relative_to(REPOSITORY / "include") for p in (REPOSITORY / "include").rglob("*.hpp")}
    wanted = {p for p in ours if p.parts[1] in ("types.hpp", "errors.hpp", "problem", "delassus", "solver")}
    assert {p.relative_to(tmp_path / "include") for p in (tmp_path / "include").rglob("*.hpp")} == wanted


def test_source_distribution_holds_sources_only(tmp_path):
    pytest.importorskip("scikit_build_core")
    build = f"from scikit_build_core.build import build_sdist; build_sdist({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=REPOSITORY, check=True, capture_output=True)
    (archive,) = tmp_path.iterdir()
    with tarfile.open(archive) as held:
        names = [name.partition("/")[2] for name in held.getnames()]
    assert "bindings/module.cpp" in names
    assert not [name for name in names if name.startswith(("build/", ".venv/", "results/"))]
