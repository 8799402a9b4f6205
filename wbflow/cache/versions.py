"""Versions of the libraries that stages import: part of the code's fingerprint, and of run.json."""

from __future__ import annotations

import functools
import platform

LIBRARIES = ("cv2", "joblib", "maxflow", "networkx", "numba", "numpy", "open3d", "poselib", "pycolmap", "scipy")
"""What the stages import, by import name: run.json has their versions, and the workers of a cluster must have the same."""

_DISTRIBUTIONS = {
    "cv2": ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
    "open3d": ("open3d-cpu", "open3d"),
    "maxflow": ("PyMaxflow",),
}
"""Import name -> distributions that may provide it; of other names this is looked up."""


def installed_versions() -> dict[str, str]:
    """Return Python's version, and those of the libraries of `LIBRARIES` that are installed, by name."""
    found = {name: installed_version(name) for name in LIBRARIES}
    return {"python": platform.python_version(), **{name: version for name, version in found.items() if version != "absent"}}


@functools.cache
def installed_version(library: str) -> str:
    """Return major and minor version of a library by its import name; "absent" where no distribution provides it."""
    from importlib import metadata  # here: `wbflow --help` needs no version

    for distribution in _DISTRIBUTIONS.get(library, (library,)):
        try:
            return _minor(metadata.version(distribution))
        except metadata.PackageNotFoundError:
            continue
    found = sorted(set(_provided().get(library, ())))
    return " ".join(f"{name} {_minor(metadata.version(name))}" for name in found) or "absent"


@functools.cache
def _provided() -> dict[str, list[str]]:
    """Distributions by the import names that they provide (0.1 CPU s: only where the name does not say it)."""
    from importlib import metadata

    return dict(metadata.packages_distributions())


def _minor(version: str) -> str:
    return ".".join(version.split(".")[:2])
