"""Where the files are that a robot file names: package://, file://, absolute and relative."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote

from signorini.load._xml import Element

PathLike = str | os.PathLike[str]


class FileFinder:
    """Finds what `package://NAME/rest` and other names in one robot file stand for.

    A package is looked for, in this order, in the folders given (that hold it or are it), in ROS_PACKAGE_PATH, in the
    share folders of AMENT_PREFIX_PATH and CMAKE_PREFIX_PATH, and in the folders above the robot file; a folder is
    package NAME when it is called so, or when its package.xml says so. A name must not leave its package by `..`.
    Relative names start at the robot file's folder.
    """

    def __init__(self, file: Path, package_dirs: Iterable[PathLike] = ()) -> None:
        self._folder = Path(os.path.abspath(file)).parent
        self._given = [Path(os.path.abspath(folder)) for folder in package_dirs]
        self._packages: dict[str, list[Path]] = {}

    def find(self, element: Element, name: str) -> Path:
        """The file that `name`, in an attribute of `element`, stands for.

        Raises InvalidInputError with the places that were looked at.
        """
        if "\0" in name or len(name) > 4096:
            element.fail("filename is no name of a file")
        for scheme in ("package://", "model://"):
            if name.startswith(scheme):
                candidates = self._in_packages(element, name, name[len(scheme) :].lstrip("/"))
                break
        else:
            if name.startswith("file://"):
                name = unquote(name[len("file://") :])
            elif re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", name):
                element.fail(f'filename is "{name}": only package://, model://, file:// and plain paths are read')
            candidates = [self._folder / name]
        for candidate in candidates:
            with suppress(OSError):  # a name that is too long
                if candidate.is_file():
                    return candidate
        places = "".join(f"\n    {place}" for place in candidates) or "\n    (no folder of this package was found)"
        given = "" if self._given else "; package_dirs=[...] adds folders"
        element.fail(f'filename is "{name}", which is not there. Looked for at{given}:{places}')

    def _in_packages(self, element: Element, name: str, rest: str) -> list[Path]:
        package, _, inside = rest.partition("/")
        if not package or not inside or package in (".", ".."):
            element.fail(f'filename is "{name}", must be package://NAME/PATH')
        if os.path.normpath(inside).startswith(("..", "/")):
            element.fail(f'filename is "{name}", which leads out of its package')
        if package not in self._packages:
            self._packages[package] = list(dict.fromkeys(self._folders(package)))
        return [folder / inside for folder in self._packages[package]]

    def _folders(self, package: str) -> Iterator[Path]:
        roots = [*self._given]
        roots += [Path(entry) for entry in _entries("ROS_PACKAGE_PATH")]
        roots += [
            Path(entry) / "share"
            for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH")
            for entry in _entries(variable)
        ]
        roots += [self._folder, *self._folder.parents]
        for root in roots:
            if root.name == package or _declares(root, package):
                yield root
            if (root / package).is_dir():
                yield root / package


def _entries(variable: str) -> list[str]:
    return [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _declares(folder: Path, package: str) -> bool:
    manifest = folder / "package.xml"
    try:
        with manifest.open("rb") as file:
            head = file.read(65536)
    except OSError:
        return False
    found = re.search(rb"<name>\s*([^<\s]+)\s*</name>", head)
    return found is not None and found[1].decode(errors="replace") == package
