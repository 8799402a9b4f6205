"""The captures of a night: which files belong to it, whether they are completely written, and their digests."""

from __future__ import annotations

import datetime
import functools
import glob
import re
import time
from collections.abc import Mapping
from pathlib import Path

from ..cache.memo import Digests
from ..cache.untrusted import Unreadable, find_untrusted, is_file
from ..errors import UsageError, WbflowError
from ..words import printable
from .bursts import BurstEnds, burst_ends, neighbours, night_of
from .capture_files import CaptureFile, with_current_digest
from .hanging_disks import fault_of_folder, results_by_camera
from .models import Camera, Site

QUIET_SECONDS = 0.5
"""A capture is complete when it has not changed for so long.  Longer delays every run; shorter reads captures half written."""
MOST_WAIT_SECONDS = 10.0
"""How long captures that are still being written are waited for, all together."""
FAT_STEP_NS = 2_000_000_000
"""Step of the time stamps of FAT file systems, nanoseconds."""
_POLL_SECONDS = 0.05
"""How often it is looked at whether they have grown."""


def nights_with_captures(site: Site) -> set[datetime.date]:
    """The nights, from the file names, for which any camera has a capture."""
    # what the site file lists by name belongs to no night
    ids = [camera.id for camera in site.cameras if camera.images is None]
    reads = ((name, functools.partial(_moments, site, name)) for name in ids)
    moments: set[datetime.datetime] = set()
    for _, answer in results_by_camera(reads):
        # `find_captures` reports the cameras whose disks hang or fail
        if not isinstance(answer, OSError):
            moments |= answer
    if not site.captures.timed:
        return {moment.date() for moment in moments}
    ends = burst_ends(moments, site.zone)
    return {night_of(moment, ends) for moment in moments}


def _moments(site: Site, camera: str) -> set[datetime.datetime]:
    return set(site.captures.moments(camera))


def list_store(site: Site) -> None:
    """Update the list of captures in the object store, if the site has one.  Raises StoreError, OSError."""
    if site.captures.store:
        from ..remote import list_captures  # here: only sites with an object store need it

        list_captures(site.captures.root, site.captures.store)


def night(site: Site, date: datetime.date | None) -> datetime.date:
    """The night to work on: `date`, else the newest one for which any camera has a capture, else today.

    Nights later than tomorrow (from a camera with a wrong clock) are ignored unless there are no others.  If file names contain
    no date, the days on which the files were written are used: last year's photographs belong to a night of last year.
    """
    today = site.today()
    if date is not None:
        return date
    if site.captures.dated:
        candidates = nights_with_captures(site)
    else:
        candidates = _days_written(site, today)
    if not candidates:
        return today
    # tomorrow: a camera's clock may be in a time zone further east
    tomorrow = today + datetime.timedelta(days=1)
    believable = [candidate for candidate in candidates if candidate <= tomorrow]
    return max(believable or candidates)


def _days_written(site: Site, today: datetime.date) -> set[datetime.date]:
    """The days on which the newest capture of each camera was written."""

    if site.captures.store:  # these files have the times of their download
        return set()
    days: set[datetime.date] = set()
    reads = ((camera.id, functools.partial(_day_written, site, camera, today)) for camera in site.cameras)
    for _, answer in results_by_camera(reads):
        if not isinstance(answer, OSError):
            days |= answer
    return days


def _day_written(site: Site, camera: Camera, today: datetime.date) -> set[datetime.date]:
    """The day on which the newest capture of one camera was written; empty if it has none."""
    times = [path.stat().st_mtime for path in _paths(site, camera, today) if is_file(path)]
    if not times:
        return set()
    return {site.local(max(times)).date()}


def _paths(site: Site, camera: Camera, date: datetime.date) -> list[Path]:
    """The files of a camera: those that the site file lists, else those that match the pattern."""
    if camera.images is not None:
        return [site.captures.root / name for name in camera.images]
    return site.captures.files(camera.id, date)


def backlog(site: Site, since: datetime.date) -> list[datetime.date]:
    """The nights with captures from a day on, in order.

    Raises UsageError if the names of captures contain no date, or if there are no such nights.
    """
    if not site.captures.dated:
        what = "--since needs {date} in captures.pattern: the names of captures don't say which night they are of"
        raise UsageError(what, remedy="for example: pattern: '{camera}/{date:%Y-%m-%d}.jpg'; or run without --since")
    list_store(site)
    dates = sorted(date for date in nights_with_captures(site) if date >= since)
    if not dates:
        raise UsageError(f"there are no captures since {since}", remedy="check captures.root and pattern, or the cameras")
    return dates


def find_captures(site: Site, date: datetime.date, digests: Digests) -> dict[str, list[CaptureFile]]:
    """Return each camera's files of a night, ordered by time or name; an empty list if a camera has none.

    digests: remembers the digests of files.
    """
    # 1. Names alone, of all cameras: a burst across midnight is recognised by all of them together.
    paths, faults = _paths_of_night(site, date)
    # 2. The content of the files of this night.
    captures: dict[str, list[CaptureFile]] = {}
    reads = ((name, functools.partial(_with_digests, site, paths[name], digests)) for name in paths)
    for name, files in results_by_camera(reads):
        if isinstance(files, OSError):
            faults[name] = files
        else:
            captures[name] = files
    for camera in site.cameras:
        if camera.id in faults:
            captures[camera.id] = [_unreadable(site, camera, date, faults[camera.id])]
    return {camera.id: captures[camera.id] for camera in site.cameras}


def _unreadable(site: Site, camera: Camera, date: datetime.date, error: OSError) -> CaptureFile:
    """What stands for the captures of a camera whose folder cannot be read: this folder, or the expected names, and why."""
    if error.filename is not None:
        folder = Path(error.filename)
        return CaptureFile(f"folder {printable(folder)}", folder, "", fault_of_folder(error))
    name = expected(site, camera, date)
    return CaptureFile(printable(name), Path(name), "", fault_of_folder(error))


def captures_of(site: Site, camera: Camera, date: datetime.date, digests: Digests) -> list[CaptureFile]:
    """The files of one camera in a night, as `find_captures` returns them.

    Parameters
    ----------
    site, camera, date : Site, Camera, date
        The site, its camera, and the night.
    digests : Digests
        Remembers the digests of files.
    """
    paths, faults = _paths_of_night(site, date)
    if camera.id in faults:
        return [_unreadable(site, camera, date, faults[camera.id])]
    return _with_digests(site, paths[camera.id], digests)


def captures_dated(site: Site, camera: Camera, date: datetime.date, digests: Digests) -> list[CaptureFile]:
    """The files of one camera with this date in their names, whichever night a burst around midnight belongs to.

    There are none where their folder cannot be read.

    Parameters
    ----------
    site, camera, date : Site, Camera, date
        The site, its camera, and the date.
    digests : Digests
        Remembers the digests of files.
    """
    try:
        return _with_digests(site, _paths(site, camera, date), digests)
    except Unreadable:
        raise
    except OSError:
        return []


_Listing = dict[Path, datetime.datetime]
"""The files of a camera that may belong to a night, in their order, with the times in their names."""


def _paths_of_night(site: Site, date: datetime.date) -> tuple[dict[str, list[Path]], dict[str, OSError]]:
    """Each camera's files of a night; and why they could not be listed, by camera, where a disk hangs or fails."""
    listings: dict[str, _Listing] = {}
    faults: dict[str, OSError] = {}
    reads = ((camera.id, functools.partial(_listing, site, camera, date)) for camera in site.cameras)
    for name, answer in results_by_camera(reads):
        if isinstance(answer, OSError):
            faults[name] = answer
        else:
            listings[name] = answer
    ends: BurstEnds = {}
    if site.captures.timed:
        moments: set[datetime.datetime] = set()
        for listing in listings.values():
            moments |= set(listing.values())
        ends = burst_ends(moments, site.zone)
    paths: dict[str, list[Path]] = {}
    for camera, listing in listings.items():
        paths[camera] = [path for path, moment in listing.items() if night_of(moment, ends) == date]
    return paths, faults


def _listing(site: Site, camera: Camera, date: datetime.date) -> _Listing:
    """The files of a camera with the dates around a night, as only the time in a name says which night it belongs to."""
    noon = datetime.time(12)  # of files without a valid time: they belong to their date
    if camera.images is not None or not site.captures.timed:
        return dict.fromkeys(_paths(site, camera, date), datetime.datetime.combine(date, noon))
    listing: _Listing = {}
    for day in neighbours(date):
        try:
            paths = site.captures.files(camera.id, day)
        except Unreadable:
            raise
        except OSError:
            if day == date:
                raise
            continue  # a folder of another day
        for path in paths:
            listing[path] = site.captures.moment(camera.id, path) or datetime.datetime.combine(day, noon)
    return listing


def _with_digests(site: Site, paths: list[Path], digests: Digests) -> list[CaptureFile]:
    if site.captures.store:
        from ..remote import fetch_captures

        fetch_captures(site.captures.root, site.captures.store, paths)
    return [_with_digest(str(path).removeprefix(f"{site.captures.root}/"), path, digests) for path in paths]


FEW_EXAMPLES = 3
"""How many names of files a message shows."""


def _what_is_there(site: Site) -> str:
    """The names, below the captures' root, of a few files that are there, for a message that none of them is a capture."""
    root = str(site.captures.root)
    names: list[str] = []
    unreadable: list[OSError] = []
    # lazily: the folder may hold a million files
    for name in find_untrusted(str(Path(glob.escape(root)) / "**"), unreadable.append):
        if is_file(Path(name)):
            names.append(printable(name.removeprefix(f"{root}/"), 120))
        if len(names) == FEW_EXAMPLES:
            break
    if names:
        return f"there are {', '.join(names)} in {printable(root)}"
    if unreadable:
        return f"folder {printable(unreadable[0].filename)} {fault_of_folder(unreadable[0])}"
    return f"there is no file at all in {printable(root)}"


def nothing_matches(site: Site, date: datetime.date) -> str:
    """Why no camera has a capture of a night: only other nights have some, or none fits the pattern."""
    others = nights_near(site, date)
    if len(others) == 1:
        return f"only the night of {others[0]} has captures"
    if others:
        newest = max(others)
        nearest = sorted(others[:FEW_EXAMPLES])
        words = f"there are {len(others)} other nights with captures, the nearest {', '.join(map(str, nearest))}"
        return words if newest in nearest else f"{words}, the newest {newest}"
    for camera in site.cameras:
        undated = next(site.captures.undated(camera.id), None)
        if undated is not None:
            pattern = printable(site.captures.text)
            what = f"{printable(undated)} has no valid date or time where captures.pattern ({pattern}) wants them"
            if re.search("%[aAbBp]", site.captures.text):
                what += "; names of months and days are English there (November, Nov)"
            return what
    wanted = printable(expected(site, site.cameras[0], date).removeprefix(f"{site.captures.root}/"))
    return f"captures.pattern wants {wanted}, and {_what_is_there(site)}"


def nights_near(site: Site, date: datetime.date) -> list[datetime.date]:
    """The nights with captures, the nearest to a date first; none if the names of captures contain no date."""
    nights = sorted(nights_with_captures(site)) if site.captures.dated else []
    return sorted(nights, key=lambda night: abs(night - date))


def expected(site: Site, camera: Camera, date: datetime.date) -> str:
    """The expected names of a camera's captures of a night, for messages."""
    if camera.images:
        return ", ".join(camera.images)
    return site.captures.expected(camera.id, date)


def find_named(site: Site, digests: Digests) -> dict[str, CaptureFile]:
    """The files that the site file names: masks by camera id, and files of stages by `file_of_stage`."""
    paths: dict[str, Path] = {}
    for camera in site.cameras:
        if camera.mask:
            paths[camera.id] = camera.mask
    for stage, settings in site.stages.items():
        for name, path in settings.files.items():
            paths[file_of_stage(stage, name)] = path
    return {key: _with_digest(path.name, path, digests) for key, path in paths.items()}


def file_of_stage(stage: str, name: str) -> str:
    """The key of a file that a stage's section names; it contains a space, which no camera id does."""
    return f"{stage} {name}"


def _with_digest(name: str, path: Path, digests: Digests) -> CaptureFile:
    """A file with its digest, or with the fault that kept it from being read.  name: untrusted, so made printable here."""
    try:
        return CaptureFile(printable(name), path, digests.of(path))
    except (OSError, ValueError) as error:
        if isinstance(error, WbflowError):
            reason = error.what
        else:
            reason = getattr(error, "strerror", None) or str(error)
        return CaptureFile(printable(name), path, "", printable(reason))


def when_complete(
    captures: Mapping[str, list[CaptureFile]], digests: Digests
) -> tuple[dict[str, list[CaptureFile]], frozenset[Path]]:
    """Return captures once they are completely written, and the paths of those still being written after `MOST_WAIT_SECONDS`.

    A capture counts as complete when nothing was written to it for `QUIET_SECONDS`.
    """
    end = time.monotonic() + MOST_WAIT_SECONDS
    growing: set[Path] = set()
    for files in captures.values():
        growing |= {file.path for file in files if file.digest and _is_written(file.path)}
    waited_for = set(growing)
    # a file that was quiet once is complete: only those that were still growing are looked at again
    while growing and time.monotonic() < end:
        time.sleep(_POLL_SECONDS)
        growing = {path for path in growing if _is_written(path)}
    complete: dict[str, list[CaptureFile]] = {}
    for name, files in captures.items():
        complete[name] = []
        for file in files:
            if file.path in waited_for:
                file = with_current_digest(file, digests)
            complete[name].append(file)
    return complete, frozenset(growing)


def _is_written(path: Path) -> bool:
    """Was a file changed within `QUIET_SECONDS`?  A time in the future does not count: it is of a disk with another clock."""
    try:
        stamp_ns = path.stat().st_mtime_ns
    except OSError:
        return False
    quiet = QUIET_SECONDS
    if QUIET_SECONDS and stamp_ns % FAT_STEP_NS == 0:
        # FAT counts in steps of two seconds, so a file that is being written may seem that much older
        quiet += FAT_STEP_NS / 1e9
    return 0 <= time.time() - stamp_ns / 1e9 < quiet
