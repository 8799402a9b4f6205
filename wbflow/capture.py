"""`wbflow capture`: take pictures with all cameras at once, and save them under the names that a run looks for.

A camera delivers snapshots or Motion JPEG over HTTP, a video stream, or files in a folder that it writes to.
"""

from __future__ import annotations

import datetime
import email.utils
import functools
import http.client
import os
import re
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import yaml

from .cache.atomic import write_atomic
from .cache.untrusted import MOST_TEXT_BYTES, read_untrusted
from .errors import UsageError, WbflowError
from .plugins import load
from .site.captures import Reader
from .site.models import Site
from .words import counted, printable

CREDENTIALS = "WBFLOW_CREDENTIALS"
"""Environment variable with the path of the credentials file, used if the site file names none."""
TRIES = 3
_BETWEEN_TRIES, _LEAD = 2.0, 2.0
"""Seconds of pause before a failed camera is tried again, and of lead time before the first picture, to connect."""
_MOST_CLOCK_ERROR = 60.0
"""If a camera's clock differs from this machine's by more seconds than this, its times are not used."""
TIMEOUT_SECONDS = 15.0
"""Timeout of a camera's answer, seconds."""
MOST_PICTURE_BYTES = 100_000_000
"""Largest picture that is read, bytes."""
_STILL_SECONDS = 0.5
_END_MARKERS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}
"""By the first two bytes of a file (JPEG, PNG): the bytes at the end of a complete one."""


class CaptureFailed(WbflowError):
    """A camera delivers no picture; the message contains neither user nor password."""


Login = tuple[str, str]
"""User and password of a camera."""


Shot = tuple[bytes, float | None]
"""A picture file's bytes, and the Unix time when it was taken by the camera's clock; None if the camera sends no time."""


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
        off = datetime.timedelta(seconds=round(abs(self.clock_error_s)))
        clock = f", its clock is {off} {'ahead' if self.clock_error_s > 0 else 'behind'}" if self.clock_error_s else ""
        times = f"; times by {'the camera' if self.own_clock else 'this machine'}{clock}" if self.files else ""
        return f"{len(self.files)} of {counted(self.wanted, 'picture')}{times}{': ' if self.fault else ''}{self.fault}"


def capture(site: Site, listen: Callable[[Delivery], None] = lambda delivery: None) -> list[Delivery]:
    """Take pictures with every camera that has a `url`, all at the same moments.

    The site's `captures` set how many, over how many seconds, and the file names.  listen: called with each camera's `Delivery`.

    Raises UsageError if no camera has a `url`, the credentials file cannot be read, two pictures would get the same name, or the
    captures are in an object store.
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

    def take(camera: str) -> Delivery:
        delivery = Delivery(camera, len(moments))
        login = logins.get(camera) or logins.get("*")
        call = functools.partial(_take, site, delivery, urls[camera], login, moments)
        reader = Reader()
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

    with ThreadPoolExecutor(len(urls)) as pool:
        return list(pool.map(take, urls))


def _take(site: Site, delivery: Delivery, url: str, login: Login | None, moments: list[float]) -> None:
    """Write a camera's pictures; retry if it fails."""
    for attempt in range(TRIES):
        if attempt:
            time.sleep(_BETWEEN_TRIES)
        try:
            for shot in shots(url, login, moments[len(delivery.files) :]):
                _write(site, delivery, shot)
            delivery.fault = ""
            return
        except CaptureFailed as error:
            delivery.fault = printable(error.what)


def _write(site: Site, delivery: Delivery, shot: Shot) -> None:
    data, camera_time = shot
    now = time.time()
    moment = now if camera_time is None else camera_time
    if camera_time is None or abs(camera_time - now) > _MOST_CLOCK_ERROR:
        delivery.own_clock, delivery.clock_error_s = False, moment - now
        moment = now
    path = _free_name(site, delivery.camera, site.local(moment))
    write_atomic(path, data)
    os.utime(path, (moment, moment))
    delivery.files.append(path)


def _free_name(site: Site, camera: str, local: datetime.datetime) -> Path:
    """The path of a capture.  When clocks are set back, an hour occurs twice: if a file of the first pass has the name, the name
    of the next free second is used, so that nothing is overwritten."""
    path = site.captures.name(camera, local)
    for seconds in range(1, 3600 if local.fold else 0):
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


def shots(url: str, login: Login | None, moments: Sequence[float]) -> Iterator[Shot]:
    """Yield a camera's picture at each moment (Unix times, in order).  Raises CaptureFailed if the camera delivers none."""
    try:
        if url.startswith("rtsp"):
            stream_pictures = load("wbflow_stages.capture.stream:stream_pictures")
            yield from stream_pictures(_with_login(url, login), moments, TIMEOUT_SECONDS)
        elif url.startswith("file:"):
            yield from _folder_shots(Path(urllib.parse.unquote(url.partition("://")[2])), moments)
        else:
            yield from _server_shots(url, login, moments)
    except (OSError, ValueError, http.client.HTTPException) as error:  # ValueError: urllib lacks the authentication scheme
        raise CaptureFailed(_cause(error)) from None


def _cause(error: Exception) -> str:
    if isinstance(error, TimeoutError) or (isinstance(error, urllib.error.URLError) and isinstance(error.reason, TimeoutError)):
        return f"does not answer within {TIMEOUT_SECONDS:.0f} s"
    if isinstance(error, urllib.error.HTTPError):
        login = ": check its user and password in the file of credentials" if error.code in {401, 403} else ""
        return f"{error.code} {error.reason}{login}"
    if isinstance(error, urllib.error.URLError):
        return f"cannot be reached: {error.reason}"
    if isinstance(error, http.client.IncompleteRead):
        return f"sent an incomplete picture ({len(error.partial):,} bytes)"
    return str(error) or type(error).__name__


def _server_shots(url: str, login: Login | None, moments: Sequence[float]) -> Iterator[Shot]:
    """Request each picture, or read all of them from one endless response (Motion JPEG)."""
    opener = urllib.request.build_opener()
    if login:
        passwords = urllib.request.HTTPPasswordMgrWithDefaultRealm()
        passwords.add_password(None, url, *login)
        opener.add_handler(urllib.request.HTTPBasicAuthHandler(passwords))
        opener.add_handler(urllib.request.HTTPDigestAuthHandler(passwords))
    for k, moment in enumerate(moments):
        _wait_until(moment)
        with opener.open(url, timeout=TIMEOUT_SECONDS) as response:
            if response.headers.get_content_maintype() == "multipart":
                yield from _mjpeg_shots(response, moments[k:])
                return
            data = response.read(MOST_PICTURE_BYTES)
            yield _checked(data), _parse_date(response.headers.get("Date"))


def _mjpeg_shots(response: IO[bytes], moments: Sequence[float]) -> Iterator[Shot]:
    """Read Motion JPEG: parts with a header each; yield the first part at or after each moment."""
    remaining = iter(moments)
    moment = next(remaining, None)
    while moment is not None:
        while (line := response.readline()) and not line.startswith(b"--"):
            pass  # what precedes a part's header
        headers = http.client.parse_headers(response)
        length = headers.get("Content-Length", "")
        data = response.read(min(int(length), MOST_PICTURE_BYTES)) if length.isdecimal() else _read_until_end(response)
        if not data:
            raise OSError("the camera closed the connection")
        if time.time() < moment:
            continue
        stamp = headers.get("X-Timestamp", "")
        yield _checked(data), float(stamp) if re.fullmatch(r"\d+(\.\d+)?", stamp) else _parse_date(headers.get("Date"))
        moment = next(remaining, None)


def _read_until_end(response: IO[bytes]) -> bytes:
    """Read a JPEG file of unknown length."""
    data = bytearray()
    while len(data) < MOST_PICTURE_BYTES and (line := response.readline()):
        data += line
        end = data.rfind(b"\xff\xd9")
        if end >= 0 and data[end + 2 :].strip(b"\r\n") == b"":
            break
    return bytes(data)


def _folder_shots(folder: Path, moments: Sequence[float]) -> Iterator[Shot]:
    """Yield at each moment the newest file that arrives in a folder from now on; give up `TIMEOUT_SECONDS` after the last one."""
    start, used = time.time(), set[Path]()
    for moment in moments:
        while True:
            _wait_until(moment)
            new = [path for path in folder.iterdir() if path.is_file() and path not in used and path.stat().st_mtime >= start - 1]
            latest = max(new, key=lambda path: path.stat().st_mtime, default=None)
            if latest and time.time() - latest.stat().st_mtime > _STILL_SECONDS:  # the camera has finished writing it
                used.add(latest)
                yield _checked(read_untrusted(latest)), latest.stat().st_mtime
                break
            if time.time() > moments[-1] + TIMEOUT_SECONDS:
                raise OSError(f"nothing new arrives in {folder}")
            time.sleep(_STILL_SECONDS)


def _checked(data: bytes) -> bytes:
    """Return a picture's bytes unchanged.  Raises OSError if the end is missing, or if it is neither JPEG nor PNG."""
    end_marker = _END_MARKERS.get(data[:2])
    if end_marker is None:
        raise OSError(f"sends something else than a picture ({len(data):,} bytes)" if data else "sends an empty picture")
    if end_marker not in data[-4096:]:
        raise OSError(f"sent an incomplete picture ({len(data):,} bytes)")
    return data


def _parse_date(text: str | None) -> float | None:
    try:
        return email.utils.parsedate_to_datetime(text).timestamp() if text else None
    except ValueError:
        return None


def _with_login(url: str, login: Login | None) -> str:
    if login is None:
        return url
    scheme, _, address = url.partition("://")
    user, password = (urllib.parse.quote(part, safe="") for part in login)
    return f"{scheme}://{user}:{password}@{address}"


def _wait_until(moment: float) -> None:
    time.sleep(max(0.0, moment - time.time()))
