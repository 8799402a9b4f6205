"""Are a camera's captures from tonight?  A frozen camera repeats old ones; a wrong clock gives captures of another night.

`find_stale` uses only digests, file names and the digests of earlier nights.  Evidence from the images themselves comes with the
summary of the frame task (`stale_by_image`).
"""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from wbflow_stages.contracts.camera_figures import FrameFigures, Health

from ..cache.checksum import content_digest
from ..cache.memo import Digests, EarlierCaptures
from ..cache.untrusted import read_untrusted
from ..plugins import load
from .bursts import longest_gap
from .capture_files import CaptureFile
from .captures import captures_dated
from .models import Camera, Site

FAR_OFF_HOURS = 3.0
"""A camera is stale if the time of day of its captures differs from the other cameras' by more: other light, or a wrong clock."""
APART_HOURS = 3.0
"""Captures of one night that are further apart are remarked on: light and scene have changed between them."""
NIGHT_HOURS = 36.0
"""A capture belongs to another night if it was taken further than this from noon of the night's date."""
SAME_PIXELS = 0.98
"""A camera is frozen if a larger share of its pixels is identical in all captures: noise keeps a live sensor below this."""
_EMPTY_FILE_DIGEST = content_digest(b"")
"""Digest of an empty file: repeated empty files are no evidence of a frozen image."""
_REMEDY = "restart the camera, or the job that fetches its pictures; it is used again as soon as its captures are new"
_CLOCK_REMEDY = "set the camera's clock, or check the job that fetches and names its pictures"


@dataclass
class FreshCaptures:
    """The night's captures after the search for stale ones."""

    captures: dict[str, list[CaptureFile]]
    """The captures to use, by camera."""
    stale: dict[str, Health]
    """Cameras that repeat old captures, or whose captures were taken at another time, with the finding."""
    notes: dict[str, str]
    """Remarks by camera, such as how many captures were left out."""


def find_stale(
    site: Site,
    date: datetime.date,
    captures: Mapping[str, list[CaptureFile]],
    digests: Digests,
    remembered: EarlierCaptures,
) -> FreshCaptures:
    """Leave out repeated captures, and find the cameras that are stale.

    Parameters
    ----------
    site, date : Site, date
        The site and the night.
    captures : mapping
        All files of the night, by camera.
    digests, remembered : Digests, EarlierCaptures
        Digests of files on disk; digests of earlier nights by camera, to which tonight's are added.
    """
    fresh = FreshCaptures({}, {}, {})
    repeated: dict[str, Health] = {}
    for camera in site.cameras:
        files = captures[camera.id]
        # the disk is searched for earlier nights only for a camera that has delivered something
        earlier = {}
        if any(file.digest for file in files):
            earlier = _old_nights(site, camera, date, digests, remembered)
        remembered.note(camera.id, str(date), [file.digest for file in files])
        search = _search_repeats(files, earlier)
        fresh.captures[camera.id] = search.captures
        if search.note:
            fresh.notes[camera.id] = search.note
        if search.frozen:
            repeated[camera.id] = search.frozen
    if not site.captures.dated and all(health.figures["earlier"] for health in repeated.values()):
        # names without a date: if no camera has a new capture, the same pictures are processed again on purpose
        with_files = {camera for camera, files in captures.items() if files}
        if with_files <= set(repeated):
            repeated = {}
    for name, files in fresh.captures.items():
        gap = gap_of(site, name, files)
        if gap is None:
            continue
        note = f"{gap}; they are merged all the same"
        if name in fresh.notes:
            note = f"{fresh.notes[name]}; {note}"
        fresh.notes[name] = note
    fresh.stale = {**_find_far_off(site, fresh.captures), **repeated}
    return fresh


def _old_nights(site: Site, camera: Camera, date: datetime.date, digests: Digests, remembered: EarlierCaptures) -> dict[str, str]:
    """The night of each digest of a camera's earlier captures: remembered ones, and those of the last earlier night on disk."""
    if camera.images is not None:  # the site file lists them, so repeating them is intended
        return {}
    # 1. what earlier runs have read
    night_of = remembered.last_delivered(camera.id, str(date))
    # 2. the files themselves, if their names say of which night they are
    pattern = site.captures
    if pattern.dated:
        days = {moment.date() for moment in pattern.moments(camera.id)}
        previous = max((day for day in days if day < date), default=None)
        if previous is not None and str(previous) not in night_of.values():
            # that night was not run here, so its captures are known from the disk alone
            for file in captures_dated(site, camera, previous, digests):
                if file.digest:
                    night_of[file.digest] = str(previous)
    return night_of


@dataclass(frozen=True)
class _Search:
    """The result of the search for repeats among a camera's captures."""

    captures: list[CaptureFile]
    """The captures to use."""
    frozen: Health | None = None
    note: str = ""


def _search_repeats(files: list[CaptureFile], earlier: Mapping[str, str]) -> _Search:
    """Leave out a camera's repeated captures, or find that it is frozen.  earlier: night by digest."""
    counts = Counter(file.digest for file in files)
    readable: list[CaptureFile] = []
    for file in files:
        if file.digest in {"", _EMPTY_FILE_DIGEST}:
            continue
        is_repeat = file.digest in earlier or counts[file.digest] > 1
        if is_repeat and _is_truncated(file.path):
            continue
        readable.append(file)
    if not readable:
        return _Search(files)
    first_of: dict[str, CaptureFile] = {}  # the first file of each content
    for file in readable:
        first_of.setdefault(file.digest, file)
    distinct = list(first_of.values())
    new = [file for file in distinct if file.digest not in earlier]
    figures = {"captures": len(readable), "different": len(distinct), "earlier": len(distinct) - len(new)}
    if not new:
        last_night = max(earlier[digest] for digest in first_of)
        text = f"its captures are the same as those of {last_night}: the picture is frozen"
        return _Search(distinct, Health("stale", text, figures, {"earlier": 0}, _REMEDY))
    # unreadable files stay: the frame task names them
    usable = [file for file in files if file not in readable or file in new]
    if len(distinct) == 1 and len(readable) > 1:
        text = f"all {len(readable)} captures of the night are the same picture: it is frozen"
        return _Search(usable, Health("stale", text, figures, {"different": len(readable)}, _REMEDY))
    if len(new) == len(readable):
        return _Search(usable)
    left_out = len(readable) - len(new)
    return _Search(usable, note=f"{left_out} of {len(readable)} captures come again, or are of an earlier night; left out")


def _is_truncated(path: Path) -> bool:
    """Is an image file cut off?  Files that are cut within their headers are equal, whatever their pictures show."""
    try:
        return bool(load("wbflow_stages.io.image_headers:is_truncated")(read_untrusted(path)))
    except OSError:
        return False


def gap_of(site: Site, camera: str, files: Iterable[CaptureFile]) -> str | None:
    """The gap, in words, between captures of a night that are hours apart by their names; None if there is none."""
    moments = _moments(site, camera, files)
    gap = longest_gap(moments)
    if gap is None or _in_hours(gap[1] - gap[0]) <= APART_HOURS:
        return None
    before, after = gap
    hours = _in_hours(after - before)
    return f"its captures of the night are {hours:.0f} h apart, at {before:%H:%M} and {after:%H:%M} ({len(moments)} in all)"


def _find_far_off(site: Site, captures: Mapping[str, list[CaptureFile]]) -> dict[str, Health]:
    """Cameras whose captures, by the times in their names, were taken at another time of day than the other cameras'."""
    hours: dict[str, float] = {}
    for camera, files in captures.items():
        moments = _moments(site, camera, files)
        if moments:
            hours[camera] = _median_hour([_hour_of(moment) for moment in moments])
    # of two cameras that differ, either may be wrong
    if len(hours) < 3:
        return {}
    healths = {}
    typical_hour = _median_hour(list(hours.values()))
    for camera, camera_hour in hours.items():
        lag = _hour_difference(camera_hour, typical_hour)
        if abs(lag) > FAR_OFF_HOURS:
            direction = "after" if lag > 0 else "before"
            text = f"its captures were taken {abs(lag):.1f} hours {direction} those of the other cameras"
            healths[camera] = Health("stale", text, {"hours_off": lag}, {"hours_off": FAR_OFF_HOURS}, _CLOCK_REMEDY)
    return healths


def _moments(site: Site, camera: str, files: Iterable[CaptureFile]) -> list[datetime.datetime]:
    """When captures were taken, by the times in their names; those without a time are left out."""
    moments: list[datetime.datetime] = []
    for file in files:
        moment = site.captures.moment(camera, file.path)
        if moment is not None:
            moments.append(moment)
    return moments


def _hour_of(moment: datetime.datetime) -> float:
    return moment.hour + moment.minute / 60 + moment.second / 3600


def _hour_difference(hour: float, other: float) -> float:
    """Signed hours from `other` to `hour`, the shorter way across midnight."""
    return (hour - other + 12) % 24 - 12


def _median_hour(hours: list[float]) -> float:
    """The median time of day: the one with the smallest sum of distances to all others, as hours have no first and last."""

    def distances(hour: float) -> float:
        return sum(abs(_hour_difference(hour, other)) for other in hours)

    return min(hours, key=distances)


def night_by_pictures(frames: Iterable[FrameFigures]) -> str:
    """The night (ISO 8601) of most cameras by the capture times in their files; "" without such times or a majority.

    Used if names contain no date: then old photographs are not stale, only those that differ from the majority.
    """
    last_times = []
    for frame in frames:
        times = _capture_times(frame)
        if times:
            last_times.append(times[-1])
    if not last_times:
        return ""
    last_times.sort()
    median = last_times[len(last_times) // 2]
    of_that_night = [moment for moment in last_times if abs(_in_hours(moment - median)) <= NIGHT_HOURS]
    if 2 * len(of_that_night) <= len(last_times):
        return ""
    return str(median.date())


def stale_by_image(frame: FrameFigures, night: str, in_order: bool) -> Health | None:
    """The finding for a camera whose images are frozen, or whose capture times are of another night or out of order.

    night: ISO 8601, "" if unknown.  in_order: do file names give the order in which captures were taken?
    """
    unchanged = frame.unchanged
    if unchanged is not None and unchanged > SAME_PIXELS:
        text = f"{100 * unchanged:.1f} % of the pixels are the same in all captures of the night: the picture is frozen"
        return Health("stale", text, {"unchanged": unchanged}, {"unchanged": SAME_PIXELS}, _REMEDY)
    times = _capture_times(frame)
    if not times or not night:
        return None
    noon = datetime.datetime.combine(datetime.date.fromisoformat(night), datetime.time(12))
    lag = max((_in_hours(moment - noon) for moment in times), key=abs)
    if abs(lag) > NIGHT_HOURS:
        text = f"its captures say that they were taken on {times[0]:%Y-%m-%d %H:%M}; the night is that of {night}"
        return Health("stale", text, {"hours_off": lag}, {"hours_off": NIGHT_HOURS}, _CLOCK_REMEDY)
    if in_order and frame.taken_in_order is False:
        text = "its captures say that they were taken in another order than their names"
        return Health("stale", text, {}, {}, _CLOCK_REMEDY)
    return None


def _capture_times(frame: FrameFigures) -> list[datetime.datetime]:
    """When the first and the last capture of a camera were taken; [] if unknown."""
    try:
        return [datetime.datetime.fromisoformat(text or "") for text in (frame.taken_first, frame.taken_last)]
    except ValueError:
        return []


def _in_hours(difference: datetime.timedelta) -> float:
    return difference.total_seconds() / 3600
