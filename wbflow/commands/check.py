"""A site examined without running anything: what is wrong with it, with its captures, and with this machine."""

from __future__ import annotations

import dataclasses
import datetime
import difflib
import importlib
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..cache.atomic import free_bytes
from ..cache.layout import WorkFolder
from ..cache.untrusted import read_untrusted
from ..errors import ExitCode
from ..pipeline.stages import SITE_TYPES
from ..plugins import load
from ..records.findings import FINDINGS
from ..records.run_folder import NoSuchRun, RunFolder
from ..runner.disk import night_bytes
from ..runner.night import Night
from ..runner.options import Options
from ..runner.tonight import read_night
from ..site.capture_files import CaptureFile
from ..site.captures import FEW_EXAMPLES, expected, nights_near, nothing_matches
from ..site.models import Camera, Site
from ..site.observation_checks import doubts_about_observations
from ..site.plausibility import polygon_outside
from ..site.stale_cameras import gap_of
from ..site.yaml_document import Problem
from ..words import DISK_FULL_REMEDY, format_size, printable

DEBIAN_PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libgomp.so.1": "libgomp1",
}
"""Shared libraries that open3d needs and the Debian packages that hold them."""


@dataclass(frozen=True)
class Fault:
    """One problem that was found."""

    severity: Literal["error", "warning"]
    what: str
    """Where it is, and what it is."""
    remedy: str
    code: ExitCode
    """The exit code that a run would end with because of it."""


def check(site: Site, date: datetime.date | None, network: bool = True) -> list[Fault]:
    """Find everything that would spoil a run, or part of one.  network: also ask cameras with a `url` for a picture."""
    faults = [Fault("warning", _headed(doubt), doubt.remedy, ExitCode.GOOD) for doubt in site.doubts]
    for doubt in doubts_about_observations(site):
        faults.append(Fault("error", _headed(doubt), doubt.remedy, ExitCode.DEGRADED))
    machine = check_machine()
    if machine:  # without its libraries, nothing else can be examined
        return faults + machine
    night = read_night(site, Options(date))
    faults += check_captures(site, night)
    if network:
        faults += check_urls(site)
    faults += check_work(night)
    faults += check_disk(night)
    faults += check_published(site.work_folder)
    return faults


def _headed(problem: Problem) -> str:
    """A problem with its place, and without its remedy."""
    return str(dataclasses.replace(problem, remedy=""))


def exit_code(findings: Iterable[Fault]) -> ExitCode:
    """Exit code of `wbflow check`: the worst that a run would end with."""
    return min((fault.code for fault in findings if fault.severity == "error"), default=ExitCode.GOOD)


def check_captures(site: Site, night: Night) -> list[Fault]:
    """Does each camera have captures, all readable, and of the size of each other, of its intrinsics, mask and polygons?"""
    faults = []
    if len(site.cameras) < 2:
        what = f"{site.file}: {len(site.cameras)} camera: a cloud needs two or more that see the same things"
        faults.append(Fault("error", what, "list the others under cameras:", ExitCode.FAILED))
    if not any(night.files.captures.values()):
        what = f"{site.file}: no camera has a capture: {nothing_matches(site, night.date)}"
        return [*faults, Fault("error", what, _remedy_of_nothing(site, night.date), ExitCode.FAILED)]
    folder = _unreadable_folder(night)
    if folder:
        what = f"{site.file}: no camera has a capture: {folder.name} {folder.fault}"
        return [*faults, Fault("error", what, "until then, every run fails", ExitCode.FAILED)]
    faults += _faults_of_alike(site, night)
    for number, camera in enumerate(site.cameras):
        line, column = site.document.place(("cameras", number))
        where = f"{site.file}:{line}:{column}: camera {camera.id}"
        files = night.files.captures[camera.id]
        if not files:
            what = f"{where}: there is no capture {expected(site, camera, night.date)}"
            faults.append(Fault("error", what, _remedy_of_missing(site, camera), ExitCode.DEGRADED))
        sizes: dict[str, tuple[int, int]] = {}
        for file in files:
            try:
                sizes[file.name] = _size_of(file)
            except (ValueError, OSError) as error:
                faults.append(Fault("error", f"{where}: {error}", "the run continues without it", ExitCode.DEGRADED))
        faults += _faults_of_sizes(where, camera, sizes)
        stale = night.stale.get(camera.id)
        if stale and not stale.ok:
            faults.append(Fault("error", f"{where}: {stale.text}", stale.remedy, ExitCode.DEGRADED))
        gap = gap_of(site, camera.id, files)
        if gap is not None:
            remedy = "give the night's captures a pattern of their own, or a folder of their own"
            faults.append(Fault("warning", f"{where}: {gap}", remedy, ExitCode.GOOD))
    return faults


def _faults_of_alike(site: Site, night: Night) -> list[Fault]:
    """Cameras that deliver the same files: a job that copies them has mixed them up."""
    deliveries: dict[str, list[tuple[str, str]]] = {}
    for camera, files in night.files.captures.items():
        for digest, name in {file.digest: file.name for file in files if file.digest}.items():
            deliveries.setdefault(digest, []).append((camera, name))
    said: set[tuple[str, ...]] = set()
    faults = []
    for delivered in deliveries.values():
        cameras = tuple(camera for camera, _ in delivered)
        if len(cameras) > 1 and cameras not in said:
            said.add(cameras)
            names = " and ".join(name for _, name in delivered)
            what = f"{site.file}: {', '.join(cameras)} deliver the same picture: {names} are equal"
            faults.append(Fault("error", what, FINDINGS["cameras-alike"].remedy, ExitCode.DEGRADED))
    return faults


def _unreadable_folder(night: Night) -> CaptureFile | None:
    """The folder that holds the captures of all cameras, if it cannot be read: said once, not once for each camera."""
    first = next(iter(night.files.captures.values()))
    same = all(files == first for files in night.files.captures.values())
    return first[0] if same and first and not first[0].digest else None


def _faults_of_sizes(where: str, camera: Camera, sizes: dict[str, tuple[int, int]]) -> list[Fault]:
    """Captures, mask and privacy polygons that do not go together.  sizes: width and height by capture."""
    if not sizes:
        return []
    faults = []
    ordered = list(sizes.values())
    # the most common size; of equally common ones the latest, as the stage frames takes it
    width, height = max(reversed(ordered), key=ordered.count)
    for name, size in sizes.items():
        if size != (width, height):
            what = f"{where}: {name} is {size[0]}x{size[1]}, its other captures are {width}x{height}: it is left out"
            remedy = (
                "thumbnails and pictures of other sizes belong elsewhere; or change captures.pattern so that it leaves them out"
            )
            faults.append(Fault("warning", what, remedy, ExitCode.GOOD))
    lens = camera.lens
    if lens.width and (width, height) != (lens.width, lens.height):
        name = next(name for name, size in sizes.items() if size == (width, height))
        what = f"{where}: {name} is {width}x{height}, its intrinsics are for {lens.width}x{lens.height}"
        faults.append(Fault("error", what, "calibrate for this size, or correct width and height", ExitCode.DEGRADED))
    if not lens.width:  # with a size of the picture, loading the site has checked the polygons
        for polygon in camera.privacy:
            outside = polygon_outside(polygon, (width, height))
            if outside:
                remedy = "corners are pixels of a capture, x before y, or shares of its width and height"
                faults.append(Fault("error", f"{where}: privacy: {outside}", remedy, ExitCode.DEGRADED))
    if camera.mask is not None:
        faults += _faults_of_mask(where, camera.mask, width, height)
    return faults


def _faults_of_mask(where: str, mask: Path, width: int, height: int) -> list[Fault]:
    try:
        data = _bytes_of(mask)
        decoded = load("wbflow_stages.capture.files:decoded_mask")(f"mask {mask.name}", data)
    except (ValueError, OSError) as error:
        return [Fault("error", f"{where}: {error}", "make it anew, e.g. with wbflow edit", ExitCode.DEGRADED)]
    if decoded.shape == (height, width):
        return []
    what = f"{where}: mask {mask.name} is {decoded.shape[1]}x{decoded.shape[0]}, its captures are {width}x{height}"
    return [Fault("error", what, "make a mask of the captures' size, e.g. with wbflow edit", ExitCode.DEGRADED)]


def _remedy_of_nothing(site: Site, date: datetime.date) -> str:
    """What to do if there is no capture at all."""
    others = nights_near(site, date)
    if others:
        return f"check that the cameras deliver, or name another night: wbflow check {site.file} --date {others[0]}"
    return "check captures.root and pattern: {camera} stands for the id, {date:%Y-%m-%d} for the night"


def check_urls(site: Site) -> list[Fault]:
    """Does each camera that has a `url` deliver a picture?"""
    if not any(entry.url for entry in site.settings.cameras):
        return []
    from ..capture.take import trial  # here: only such sites need the network

    faults: list[Fault] = []
    found = trial(site)
    for number, entry in enumerate(site.settings.cameras):
        fault = found.get(entry.id)
        if fault:
            line, column = site.document.place(("cameras", number, "url"))
            what = f"{site.file}:{line}:{column}: camera {entry.id}: {fault}"
            remedy = "open its url in a browser on this machine, or pass the network by: --no-network"
            faults.append(Fault("error", what, remedy, ExitCode.DEGRADED))
    return faults


def _remedy_of_missing(site: Site, camera: Camera) -> str:
    """What to do about a camera without captures; the file names may spell its id differently."""
    capture_names: set[str] = set()  # what the pattern finds that is no camera of the site
    if camera.images is None:
        capture_names = site.captures.cameras() - {other.id for other in site.cameras}
    similar = difflib.get_close_matches(camera.id, capture_names, 1)
    if similar:
        return f"did you mean {printable(similar[0])!r}? There are captures of it"
    if any(entry.id == camera.id and entry.url for entry in site.settings.cameras):
        return f"take some: wbflow capture {site.file}, or wbflow run {site.file} --capture"
    if camera.images is None and capture_names:
        return f"there are captures of {', '.join(sorted(map(printable, capture_names))[:FEW_EXAMPLES])}"
    return "check captures.root and pattern, or the camera itself"


def _size_of(file: CaptureFile) -> tuple[int, int]:
    """(width, height) of a capture as it would be used.  Raises ValueError, OSError if it cannot be."""
    if not file.digest:
        raise ValueError(f"{file.name} {file.fault}")
    capture = load(SITE_TYPES["captures"])(file.name, _bytes_of(file.path))
    image = load("wbflow_stages.capture.video:one_picture")(capture)
    return image.shape[1], image.shape[0]


def _bytes_of(path: Path) -> Any:
    """The bytes of a file as an array (n,) uint8.  Raises Unreadable."""
    import numpy as np

    return np.frombuffer(read_untrusted(path), dtype=np.uint8)


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
    if library and library.group(0) in DEBIAN_PACKAGES:
        return f"as root: apt-get install {DEBIAN_PACKAGES[library.group(0)]}"
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


def check_work(night: Night) -> list[Fault]:
    """Can the work folder be written, or made where it is not there yet?"""
    root = night.cache.work.root
    # the first of these that is there, even if it is a link that leads nowhere
    place = next(path for path in (root, *root.parents) if os.path.lexists(path))
    if not place.is_dir():
        what = f"work: {printable(place)} is no folder"
        return [Fault("error", what, "name a folder as `work`; it is made if it is not there", ExitCode.FAILED)]
    if not os.access(place, os.W_OK | os.X_OK):
        what = f"work: {printable(place)} cannot be written"
        return [Fault("error", what, "check the rights on it and its file system, or name another folder", ExitCode.FAILED)]
    return []


def check_disk(night: Night) -> list[Fault]:
    """Is there space for one more night?"""
    root = night.cache.work.root
    free = free_bytes(root)
    needed = night_bytes(night)
    if free > needed:
        return []
    what = f"{root} has {format_size(free)} free; a night of this site takes about {format_size(needed)}"
    return [Fault("warning", what, DISK_FULL_REMEDY, ExitCode.FAILED)]
