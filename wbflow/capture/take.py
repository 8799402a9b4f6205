"""`wbflow capture`: pictures of all cameras at once, under the names that a run looks for."""

from __future__ import annotations

import datetime
import functools
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ..cache.atomic import write_atomic
from ..cache.untrusted import MOST_TEXT_BYTES, read_outside
from ..errors import UsageError, counted, printable
from ..site.captures import answered
from ..site.models import Site
from .sources import PATIENCE, CaptureFailed, Login, Shot, shots

CREDENTIALS = "WBFLOW_CREDENTIALS"
"""Environment variable: the file of credentials, where the site file names none."""
TRIES = 3
_BETWEEN_TRIES, _LEAD = 2.0, 2.0
"""Seconds: before a camera is asked again; before the first picture, for connections to be made."""
_SECONDS_OF_AN_HOUR = 3600
_MOST_OFF = 60.0
"""Seconds by which a camera's clock may differ from this machine's and is still believed."""


@dataclass
class Taken:
    """What a camera has given."""

    camera: str
    wanted: int
    files: list[Path] = field(default_factory=list)
    fault: str = ""
    """Why some are missing."""
    own_clock: bool = True
    """Are all times the camera's own?"""
    off: float = 0.0
    """Seconds by which its clock is ahead of this machine's, where that is too much to believe it."""

    def __str__(self) -> str:
        off = datetime.timedelta(seconds=round(abs(self.off)))
        clock = f", its clock is {off} {'ahead' if self.off > 0 else 'behind'}" if self.off else ""
        times = f"; times by {'the camera' if self.own_clock else 'this machine'}{clock}" if self.files else ""
        return f"{len(self.files)} of {counted(self.wanted, 'picture')}{times}{': ' if self.fault else ''}{self.fault}"


def capture(site: Site, listen: Callable[[Taken], None] = lambda taken: None) -> list[Taken]:
    """Take pictures of every camera that has a `url`, all at the same moments.

    Parameters
    ----------
    site : Site
        Its `captures` say how many, over how long, and how files are called.
    listen : callable, optional
        Receives what a camera has given, as soon as it has ended.

    Raises
    ------
    UsageError
        No camera has a `url`; the file of credentials cannot be read; names do not tell pictures apart; captures lie in a store.
    """
    settings = site.settings.captures
    urls = {entry.id: entry.url for entry in site.settings.cameras if entry.url}
    if not urls:
        raise UsageError("no camera has a url", remedy="for example: cameras: [{id: gate, url: 'rtsp://10.0.0.5/stream'}]")
    if site.captures.store:
        raise UsageError("captures lie in an object store", remedy="capture into a folder, and copy from there")
    logins = _logins(site)
    start = time.time() + _LEAD
    moments = [start + k * settings.seconds / max(settings.frames - 1, 1) for k in range(settings.frames)]
    _check_names(site, next(iter(urls)), moments)

    def take(camera: str) -> Taken:
        taken = Taken(camera, len(moments))
        login = logins.get(camera) or logins.get("*")
        work = functools.partial(_take, site, taken, urls[camera], login, moments)
        try:
            answered(work, moments[-1] - time.time() + TRIES * (PATIENCE + _BETWEEN_TRIES))
        except TimeoutError:
            taken.fault = "does not end its answer"
        except (OSError, ValueError) as error:
            taken.fault = printable(error)
        listen(taken)
        return taken

    with ThreadPoolExecutor(len(urls)) as pool:
        return list(pool.map(take, urls))


def _take(site: Site, taken: Taken, url: str, login: Login | None, moments: list[float]) -> None:
    """Write a camera's pictures; ask again where it fails."""
    for attempt in range(TRIES):
        if attempt:
            time.sleep(_BETWEEN_TRIES)
        try:
            for shot in shots(url, login, moments[len(taken.files) :]):
                _write(site, taken, shot)
            taken.fault = ""
            return
        except CaptureFailed as error:
            taken.fault = printable(error.what)


def _write(site: Site, taken: Taken, shot: Shot) -> None:
    now = time.time()
    off = 0.0 if shot.taken is None else shot.taken - now
    believed = shot.taken is not None and abs(off) <= _MOST_OFF
    taken.own_clock = taken.own_clock and believed
    taken.off = taken.off if believed else off
    moment = shot.taken if believed and shot.taken is not None else now
    path = _free_name(site, taken.camera, site.local(moment))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, shot.data)
    os.utime(path, (moment, moment))
    taken.files.append(path)


def _free_name(site: Site, camera: str, local: datetime.datetime) -> Path:
    """The name of a capture.  In the hour that comes twice, when clocks are set back, one that the first hour has taken is not
    written over: the next second's is used."""
    path = site.captures.name(camera, local)
    for seconds in range(1, _SECONDS_OF_AN_HOUR if local.fold else 0):
        if not path.exists():
            break
        path = site.captures.name(camera, local + datetime.timedelta(seconds=seconds))
    return path


def _check_names(site: Site, camera: str, moments: list[float]) -> None:
    remedy = "captures: {pattern: '{camera}/{date}_{time}.jpg'}, or fewer frames over more seconds"
    try:
        names = {site.captures.name(camera, site.local(moment)) for moment in moments}
    except ValueError as error:
        raise UsageError(str(error), remedy=remedy) from None
    if len(names) < len(moments):
        what = f"{counted(len(moments), 'picture')} would have {counted(len(names), 'name')}: {names.pop().name}"
        raise UsageError(what, remedy=remedy)


def _logins(site: Site) -> dict[str, Login]:
    """Read user and password by camera; "*" stands for all others."""
    named = site.settings.captures.credentials or os.environ.get(CREDENTIALS)
    if not named:
        return {}
    path = site.file.parent / named
    remedy = "a line for each camera, or '*' for all:  gate: {user: viewer, password: secret}"
    try:
        data = yaml.safe_load(read_outside(path, MOST_TEXT_BYTES))
        return dict(_entries(data))
    except OSError as error:
        raise UsageError(f"the file of credentials cannot be read: {error}", where=str(path), remedy=remedy) from None
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError):  # without a word of what it holds
        raise UsageError("the file of credentials is not as it should be", where=str(path), remedy=remedy) from None


def _entries(data: Any) -> Iterator[tuple[str, Login]]:
    for camera, entry in data.items():
        yield str(camera), Login(str(entry["user"]), str(entry["password"]))
