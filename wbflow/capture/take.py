"""Take pictures with all cameras at once (`wbflow capture`), or try whether each answers (`wbflow check`)."""

from __future__ import annotations

import datetime
import functools
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ..cache.atomic import write_atomic
from ..cache.untrusted import MOST_TEXT_BYTES, read_untrusted
from ..errors import UsageError
from ..site.hanging_disks import Reader
from ..site.models import CameraEntry, Site
from ..words import counted, printable
from .server import FINGERPRINT, Access, Login, Shot
from .shots import CaptureFailed, folder_of, shots

CREDENTIALS = "WBFLOW_CREDENTIALS"
"""Environment variable with the path of the credentials file, used if the site file names none."""
TRIES = 3
"""Times that a camera is asked before it counts as broken."""
_BETWEEN_TRIES = 2.0
"""Pause before a failed camera is tried again, seconds."""
_LEAD = 2.0
"""Time before the first picture, to connect, seconds."""
_MOST_CLOCK_ERROR = 60.0
"""If a camera's clock differs from this machine's by more seconds than this, its times are not used."""
TIMEOUT_SECONDS = 15.0
"""Timeout of a camera's answer, seconds."""
TRIAL_SECONDS = 8.0
"""Timeout of a camera's answer when it is only tried, seconds."""


@dataclass
class Delivery:
    """What a camera has delivered."""

    camera: str
    wanted: int
    files: list[Path] = field(default_factory=list)
    fault: str = ""
    """Why pictures are missing; "" if none are."""
    own_clock: bool = True
    """Are all times from the camera's own clock?"""
    clock_error_s: float = 0.0
    """Seconds by which its clock is ahead of this machine's, if by more than `_MOST_CLOCK_ERROR`; else 0."""

    def __str__(self) -> str:
        text = f"{len(self.files)} of {counted(self.wanted, 'picture')}"
        if self.files:
            clock = "the camera" if self.own_clock else "this machine"
            text += f"; times by {clock}"
        if self.files and self.clock_error_s:
            off = datetime.timedelta(seconds=round(abs(self.clock_error_s)))
            direction = "ahead" if self.clock_error_s > 0 else "behind"
            text += f", its clock is {off} {direction}"
        if self.fault:
            text += f": {self.fault}"
        return text


def capture(site: Site, listen: Callable[[Delivery], None] = lambda delivery: None) -> list[Delivery]:
    """Take pictures with every camera that has a `url`, all at the same moments.

    The site's `captures` set how many, over how many seconds, and the file names.  listen: called with each camera's `Delivery`.

    Raises UsageError if no camera has a `url`, the credentials file cannot be read, two pictures would get the same name, or the
    captures are in an object store.
    """
    settings = site.settings.captures
    entries = [entry for entry in site.settings.cameras if entry.url]
    if not entries:
        raise UsageError("no camera has a url", remedy="for example: cameras: [{id: gate, url: 'rtsp://10.0.0.5/stream'}]")
    if site.captures.store:
        raise UsageError("captures lie in an object store", remedy="capture into a folder, and copy from there")
    logins = _logins(site)
    site.captures.root.mkdir(parents=True, exist_ok=True)
    # the same moments for all cameras, from their first connection on: they have to show the same state of the scene
    start = time.time() + _LEAD
    moments = [start + k * settings.seconds / max(settings.frames - 1, 1) for k in range(settings.frames)]
    _check_names(site, entries[0].id, moments)

    def take(entry: CameraEntry) -> Delivery:
        delivery = Delivery(entry.id, len(moments))
        call = functools.partial(_take, site, delivery, str(entry.url), _access(site, entry, logins), moments)
        reader = Reader()  # a camera that trickles its answer for ever must not hold the others up
        try:
            reader.read(call, moments[-1] - time.time() + TRIES * (TIMEOUT_SECONDS + _BETWEEN_TRIES))
        except TimeoutError:
            delivery.fault = "did not complete its response in time"
        except (OSError, ValueError) as error:
            delivery.fault = printable(error)
        finally:
            reader.close()
        listen(delivery)
        return delivery

    with ThreadPoolExecutor(len(entries)) as pool:
        return list(pool.map(take, entries))


def trial(site: Site) -> dict[str, str]:
    """Ask each camera that has a `url` for one picture, all at once: why it delivers none, by camera id; "" if it does.

    A folder that a camera writes to only has to be there.  Raises UsageError if the credentials file cannot be read.
    """
    entries = [entry for entry in site.settings.cameras if entry.url]
    logins = _logins(site)

    def fault_of(entry: CameraEntry) -> str:
        url = str(entry.url)
        if url.startswith("file:"):
            folder = folder_of(url)
            if folder.is_dir():
                return ""
            return f"there is no folder {printable(folder)}"
        reader = Reader()
        call = functools.partial(next, shots(url, _access(site, entry, logins), [time.time()], TRIAL_SECONDS))
        try:
            reader.read(call, 2 * TRIAL_SECONDS)
        except CaptureFailed as error:
            return printable(error.what)
        except TimeoutError:
            return "did not complete its response in time"
        finally:
            reader.close()
        return ""

    with ThreadPoolExecutor(max(len(entries), 1)) as pool:
        faults = pool.map(fault_of, entries)
        return {entry.id: fault for entry, fault in zip(entries, faults, strict=True)}


def _access(site: Site, entry: CameraEntry, logins: dict[str, Login]) -> Access:
    """How a camera is reached: its login, or that of all cameras, and what its certificate is verified with."""
    tls = entry.tls
    if isinstance(tls, str) and not FINGERPRINT.fullmatch(tls):
        tls = str(site.file.parent / tls)
    return Access(logins.get(entry.id) or logins.get("*"), tls)


def _take(site: Site, delivery: Delivery, url: str, access: Access, moments: list[float]) -> None:
    """Write a camera's pictures; retry if it fails.

    Parameters
    ----------
    site, delivery : Site, Delivery
        Where the pictures are saved, and what is reported of them.
    url, access : str, Access
        The camera's address, and how it is reached.
    moments : list of float
        Unix times.
    """
    for attempt in range(TRIES):
        if attempt:
            time.sleep(_BETWEEN_TRIES)
        try:
            # a further try is for the moments whose pictures are missing
            for shot in shots(url, access, moments[len(delivery.files) :], TIMEOUT_SECONDS):
                _write(site, delivery, shot)
            delivery.fault = ""
            return
        except CaptureFailed as error:
            delivery.fault = printable(error.what)


def _write(site: Site, delivery: Delivery, shot: Shot) -> None:
    """Write a picture under the time at which it was taken: by the camera's clock, unless that is wrong or unknown."""
    data, camera_time = shot
    now = time.time()
    moment = now if camera_time is None else camera_time
    if camera_time is None or abs(camera_time - now) > _MOST_CLOCK_ERROR:
        delivery.own_clock = False
        delivery.clock_error_s = moment - now
        moment = now
    path = _free_name(site, delivery, site.local(moment))
    write_atomic(path, data)
    os.utime(path, (moment, moment))
    delivery.files.append(path)


def _free_name(site: Site, delivery: Delivery, local: datetime.datetime) -> Path:
    """The path of a capture, which overwrites none that it must not: if that has the name, the name of the next free second.

    A name has the resolution of a second, and two pictures may come within one: a late one, or one of a clock that stutters.
    When clocks are set back, an hour occurs twice.
    """
    path = site.captures.name(delivery.camera, local)
    if not local.fold and path not in delivery.files:
        return path
    for seconds in range(1, 3600):
        if not path.exists():
            break
        path = site.captures.name(delivery.camera, local + datetime.timedelta(seconds=seconds))
    return path


def _check_names(site: Site, camera: str, moments: list[float]) -> None:
    """Raise UsageError if the pattern gives no names for new captures, or two moments the same one."""
    remedy = "captures: {pattern: '{camera}/{date}_{time}.jpg'}, or fewer frames over more seconds"
    try:
        names = {site.captures.name(camera, site.local(moment)) for moment in moments}
    except ValueError as error:
        raise UsageError(str(error), remedy=remedy) from None
    if len(names) < len(moments):
        what = f"{counted(len(moments), 'picture')} would have {counted(len(names), 'name')}: {names.pop().name}"
        raise UsageError(what, remedy=remedy)


def _logins(site: Site) -> dict[str, Login]:
    """Read user and password by camera; "*" is for all others."""
    file_name = site.settings.captures.credentials or os.environ.get(CREDENTIALS)
    if not file_name:
        return {}
    path = site.file.parent / file_name
    remedy = "a line for each camera, or '*' for all:  gate: {user: viewer, password: secret}"
    try:
        data = yaml.safe_load(read_untrusted(path, MOST_TEXT_BYTES))
        return {str(camera): (str(entry["user"]), str(entry["password"])) for camera, entry in data.items()}
    except OSError as error:
        raise UsageError(f"the file of credentials cannot be read: {error}", where=str(path), remedy=remedy) from None
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError):  # the message must not show the contents
        raise UsageError("the file of credentials is not valid", where=str(path), remedy=remedy) from None
