"""A site examined without running anything: what is wrong with it, with its captures, and with this machine."""

from __future__ import annotations

import datetime
import difflib
import importlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from ..cache.atomic import free_bytes
from ..cache.layout import WorkFolder
from ..cache.untrusted import read_untrusted
from ..errors import ExitCode
from ..pipeline.stages import SITE_TYPES
from ..plugins import load
from ..records.run_folder import NoSuchRun, RunFolder
from ..run.night import Night
from ..run.options import Options
from ..run.tonight import read_night
from ..site.captures import CaptureFile, expected
from ..site.models import Camera, Site
from ..words import printable

DEBIAN_PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libgomp.so.1": "libgomp1",
}
"""Shared libraries that open3d needs and the Debian packages that hold them."""

BYTES_PER_PIXEL = 40
"""Disk space that a night takes in the cache, for each pixel of each camera at working resolution (measured, generous)."""


@dataclass(frozen=True)
class Fault:
    """One problem that was found."""

    severity: Literal["error", "warning"]
    what: str
    """Where it is, and what it is."""
    remedy: str
    code: ExitCode
    """The exit code that a run would end with because of it."""


def check(site: Site, date: datetime.date | None) -> list[Fault]:
    """Find everything that would spoil a run, or part of one."""
    machine = check_machine()
    if machine:
        return machine + _disk(site)
    return [*check_captures(site, read_night(site, Options(date))), *_disk(site), *check_published(site.work_folder)]


def exit_code(findings: Iterable[Fault]) -> ExitCode:
    """Exit code of `wbflow check`: the worst that a run would end with."""
    return min((fault.code for fault in findings if fault.severity == "error"), default=ExitCode.GOOD)


def check_captures(site: Site, night: Night) -> list[Fault]:
    """Does each camera have captures, all readable and of the size that its intrinsics are for?"""
    faults = []
    if len(site.cameras) < 2:
        what = f"{site.file}: {len(site.cameras)} camera: a cloud needs two or more that see the same things"
        faults.append(Fault("error", what, "list the others under cameras:", ExitCode.FAILED))
    for number, camera in enumerate(site.cameras):
        line, column = site.document.place(("cameras", number))
        where = f"{site.file}:{line}:{column}: camera {camera.id}"
        files = night.files.captures[camera.id]
        if not files:
            what = f"{where}: there is no capture {expected(site, camera, night.date)}"
            faults.append(Fault("error", what, _remedy_of_missing(site, camera), ExitCode.DEGRADED))
        for file in files:
            try:
                width, height = _size_of(file)
            except (ValueError, OSError) as error:
                faults.append(Fault("error", f"{where}: {error}", "the run continues without it", ExitCode.DEGRADED))
                continue
            lens = camera.lens
            if lens.width and (width, height) != (lens.width, lens.height):
                what = f"{where}: {file.name} is {width}x{height}, its intrinsics are for {lens.width}x{lens.height}"
                faults.append(Fault("error", what, "calibrate for this size, or correct width and height", ExitCode.DEGRADED))
    return faults


def _remedy_of_missing(site: Site, camera: Camera) -> str:
    """What to do about a camera without captures; the file names may spell its id differently."""
    capture_names = site.captures.cameras() - {other.id for other in site.cameras} if camera.images is None else set()
    similar = difflib.get_close_matches(camera.id, capture_names, 1)
    if similar:
        return f"did you mean {printable(similar[0])!r}? There are captures of it"
    return "check captures.root and pattern, or the camera itself"


def _size_of(file: CaptureFile) -> tuple[int, int]:
    """(width, height) of a capture as it would be used.  Raises ValueError, OSError if it cannot be."""
    import numpy as np

    if not file.digest:
        raise ValueError(f"{file.name} {file.fault}")
    capture = load(SITE_TYPES["captures"])(file.name, np.frombuffer(read_untrusted(file.path), dtype=np.uint8))
    image = load("wbflow_stages.capture.video:one_picture")(capture)
    return image.shape[1], image.shape[0]


def check_machine() -> list[Fault]:
    """Can every library be imported?"""
    faults = []
    for name in ("numpy", "cv2", "scipy", "numba", "networkx", "poselib", "open3d"):
        try:
            importlib.import_module(name)
        except (ImportError, OSError) as error:
            faults.append(Fault("error", f"{name} cannot be imported: {error}", _import_remedy(str(error)), ExitCode.FAILED))
    return faults


def _import_remedy(message: str) -> str:
    library = re.search(r"lib[\w.+-]+\.so[.\d]*", message)
    package = DEBIAN_PACKAGES.get(library.group(0)) if library else None
    if package:
        return f"as root: apt-get install {package}"
    return "reinstall wbflow: python -m pip install --force-reinstall wbflow"


def check_published(work: WorkFolder) -> list[Fault]:
    """Are the published files of every run unchanged?  Those of runs to which links such as `latest` point must also exist."""
    linked = {work.link_target(link) for link in work.links()}
    faults = []
    for name in work.run_ids():
        remedy = f"the next  wbflow run  publishes intact ones; do not use the results of {name}"
        try:
            for path in RunFolder.of(work, name).damaged(missing=name in linked):
                what = "is damaged" if path.exists() else "is gone"
                faults.append(Fault("error", f"{path} {what}", remedy, ExitCode.DEGRADED))
        except NoSuchRun as error:
            faults.append(Fault("error", error.what, remedy, ExitCode.DEGRADED))
    return faults


def _disk(site: Site) -> list[Fault]:
    free = free_bytes(site.work_folder.root)
    width = site.settings.resolution or 4000
    needed = len(site.cameras) * width * width * 2 // 3 * BYTES_PER_PIXEL
    if free > needed:
        return []
    what = f"{site.work_folder.root} has {free / 1e9:.1f} GB free; a night of this site takes about {needed / 1e9:.1f} GB"
    return [Fault("warning", what, "free some space: wbflow clean SITE.yaml --keep 3", ExitCode.FAILED)]
