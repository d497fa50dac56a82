"""Where the files are that a robot file names: package://, file://, absolute and relative."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NoReturn
from urllib.parse import unquote

from signorini.load import _xml
from signorini.load._xml import Element

PathLike = str | os.PathLike[str]


class FileFinder:
    """Finds what `package://NAME/rest` and other names in one robot file stand for.

    A package is looked for, in this order, in the folders given (that hold it or are it), in ROS_PACKAGE_PATH, in the
    share folders of AMENT_PREFIX_PATH and CMAKE_PREFIX_PATH, in GZ_SIM_RESOURCE_PATH, GAZEBO_MODEL_PATH and SDF_PATH,
    and in the folders above the robot file; a folder is package NAME when it is called so, or when its package.xml says
    so. A name must not leave its package by `..`. Relative names start at the folder of the file they are in.
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
            candidates = [Path(os.path.abspath(element.file)).parent / name]
        for candidate in candidates:
            if os.path.isfile(candidate):
                return candidate
        self._missing(element, name, candidates)

    def find_model(self, element: Element, name: str) -> Path:
        """The SDF file that a URI stands for: that file, or the one that model.config in that folder names.

        Raises InvalidInputError with the places that were looked at.
        """
        if "\0" in name or len(name) > 4096:
            element.fail("uri is no name of a file")
        if name.startswith("model://"):
            inside = "/".join([*name[len("model://") :].strip("/").split("/"), "model.config"])
            folders = [path.parent for path in self._in_packages(element, name, inside)]
        elif re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", name) and not name.startswith("file://"):
            element.fail(f'uri is "{name}": only model://, file:// and plain paths are read')
        else:
            plain = unquote(name[len("file://") :]) if name.startswith("file://") else name
            folders = [Path(os.path.abspath(element.file)).parent / plain]
        for folder in folders:
            if os.path.isfile(folder):
                return folder
            if os.path.isfile(folder / "model.config"):
                return _named_by_config(element, folder / "model.config")
            if os.path.isfile(folder / "model.sdf"):
                return folder / "model.sdf"
        self._missing(element, name, folders)

    def _missing(self, element: Element, name: str, candidates: list[Path]) -> NoReturn:
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
        for variable in ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH"):
            roots += [Path(entry) for entry in _entries(variable)]
        roots += [self._folder, *self._folder.parents]
        for root in roots:
            if root.name == package or _declares(root, package):
                yield root
            if os.path.isdir(root / package):
                yield root / package


def _entries(variable: str) -> list[str]:
    return [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _named_by_config(element: Element, config: Path) -> Path:
    """Of several <sdf version="...">FILE</sdf> the newest."""
    entries = [
        (
            tuple(int(part) for part in re.findall(r"[0-9]{1,9}", entry.attributes.get("version", ""))),
            entry.text.strip(),
        )
        for entry in _xml.parse(config).all("sdf")
    ]
    if not entries:
        element.fail(f"its {config} names no <sdf> file")
    name = max(entries)[1]
    if not name or os.path.normpath(name).startswith(("..", "/")):
        element.fail(f'its {config} names "{name}", which is not in its folder')
    if not os.path.isfile(config.parent / name):
        element.fail(f'its {config} names "{name}", which is not there')
    return config.parent / name


def _declares(folder: Path, package: str) -> bool:
    manifest = folder / "package.xml"
    try:
        with manifest.open("rb") as file:
            head = file.read(65536)
    except OSError:
        return False
    found = re.search(rb"<name>\s*([^<\s]+)\s*</name>", head)
    return found is not None and found[1].decode(errors="replace") == package
