"""Versions of the libraries that stages import; they enter code fingerprints and run.json."""

from __future__ import annotations

import functools
import platform

LIBRARIES = ("cv2", "joblib", "maxflow", "networkx", "numba", "numpy", "open3d", "poselib", "pycolmap", "scipy")
"""Import names of the libraries of the stages: run.json records their versions, which all workers of a cluster must share."""

_DISTRIBUTIONS = {
    "cv2": ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
    "open3d": ("open3d-cpu", "open3d"),
    "maxflow": ("PyMaxflow",),
}
"""Import name -> distributions that may provide it; for names not listed here, the installed metadata is searched."""


def installed_versions() -> dict[str, str]:
    """Return the versions of Python and of the installed `LIBRARIES`, by name."""
    versions = {"python": platform.python_version()}
    for name in LIBRARIES:
        version = installed_version(name)
        if version != "absent":
            versions[name] = version
    return versions


@functools.cache
def installed_version(library: str) -> str:
    """Return the major.minor version of a library by its import name; "absent" if no distribution provides it."""
    from importlib import metadata  # imported here to keep `wbflow --help` fast

    for distribution in _DISTRIBUTIONS.get(library, (library,)):
        try:
            return _major_minor(metadata.version(distribution))
        except metadata.PackageNotFoundError:
            continue
    # several distributions can share an import name, such as a namespace package: all enter
    distributions = sorted(set(_provided().get(library, ())))
    versions = [f"{name} {_major_minor(metadata.version(name))}" for name in distributions]
    return " ".join(versions) or "absent"


@functools.cache
def _provided() -> dict[str, list[str]]:
    """Return distributions by import name.  It takes 0.1 CPU s, so it is called only if the distribution's name differs."""
    from importlib import metadata

    return dict(metadata.packages_distributions())


def _major_minor(version: str) -> str:
    return ".".join(version.split(".")[:2])
