"""Where a camera's pictures come from: a snapshot or Motion JPEG over HTTP, a video stream, a folder that it writes to."""

from __future__ import annotations

import email.utils
import http.client
import re
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..cache.fingerprint import load
from ..cache.untrusted import read_outside
from ..errors import WbflowError

PATIENCE = 15.0
"""Seconds that a camera may take to answer."""
LARGEST = 100_000_000
"""Bytes of one picture."""
_STREAM = "wbflow_stages.capture.stream:stream_pictures"
_LOOK_SECONDS = 0.5
_COMPLETE = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}
"""How a picture ends, by how it begins."""


class CaptureFailed(WbflowError):
    """A camera gives no picture; the message holds neither user nor password."""


@dataclass(frozen=True)
class Login:
    """Of a camera."""

    user: str
    password: str


@dataclass(frozen=True)
class Shot:
    """A picture."""

    data: bytes
    """A file's content."""
    taken: float | None
    """Unix time, by the camera's own clock; None: it does not say."""


def shots(url: str, login: Login | None, moments: Sequence[float]) -> Iterator[Shot]:
    """Yield a camera's picture at each moment (Unix times, in order).

    Raises
    ------
    CaptureFailed
        It gives none, or no more.
    """
    try:
        if url.startswith("rtsp"):
            pictures = load(_STREAM)(_with_login(url, login), moments, PATIENCE)
            yield from (Shot(data, taken) for data, taken in pictures)
        elif url.startswith("file:"):
            yield from _of_folder(Path(urllib.parse.unquote(url.partition("://")[2])), moments)
        else:
            yield from _of_server(url, login, moments)
    except urllib.error.HTTPError as error:
        why = f"{error.code} {error.reason}"
        raise CaptureFailed(f"{why}: see to its user and password" if error.code in {401, 403} else why) from None
    except TimeoutError:
        raise CaptureFailed(f"does not answer within {PATIENCE:.0f} s") from None
    except urllib.error.URLError as error:
        late = isinstance(error.reason, TimeoutError)
        raise CaptureFailed(
            f"does not answer within {PATIENCE:.0f} s" if late else f"cannot be reached: {error.reason}"
        ) from None
    except http.client.IncompleteRead as error:
        raise CaptureFailed(f"sends half a picture ({len(error.partial):,} bytes)") from None
    except (OSError, ValueError, http.client.HTTPException) as error:  # ValueError: a way of authentication that urllib lacks
        raise CaptureFailed(str(error) or type(error).__name__) from None


def _of_server(url: str, login: Login | None, moments: Sequence[float]) -> Iterator[Shot]:
    """Ask for each picture, or read them all from one answer that goes on and on."""
    opener = urllib.request.build_opener()
    if login:
        known = urllib.request.HTTPPasswordMgrWithDefaultRealm()
        known.add_password(None, url, login.user, login.password)
        opener.add_handler(urllib.request.HTTPBasicAuthHandler(known))
        opener.add_handler(urllib.request.HTTPDigestAuthHandler(known))
    for k, moment in enumerate(moments):
        _wait_until(moment)
        with opener.open(url, timeout=PATIENCE) as answer:
            if answer.headers.get_content_maintype() == "multipart":
                yield from _of_parts(answer, moments[k:])
                return
            data = answer.read(LARGEST)
            yield Shot(_whole(data), _date(answer.headers.get("Date")))


def _of_parts(answer: IO[bytes], moments: Sequence[float]) -> Iterator[Shot]:
    """Read Motion JPEG: parts with a head each, of which those at the moments count."""
    due = iter(moments)
    moment = next(due, None)
    while moment is not None:
        head = http.client.parse_headers(_SkipToHead(answer))
        length = head.get("Content-Length", "")
        data = answer.read(min(int(length), LARGEST)) if length.isdecimal() else _until_end(answer)
        if not data:
            raise OSError("the camera has ended its answer")
        if time.time() < moment:
            continue
        stamp = head.get("X-Timestamp", "")
        yield Shot(_whole(data), float(stamp) if re.fullmatch(r"\d+(\.\d+)?", stamp) else _date(head.get("Date")))
        moment = next(due, None)


class _SkipToHead:
    """The lines of a part's head, without what stands before it."""

    def __init__(self, answer: IO[bytes]) -> None:
        self._answer = answer
        self._within = False

    def readline(self, most: int = -1) -> bytes:
        line = self._answer.readline(most)
        while line and not self._within:
            self._within = line.startswith(b"--")
            line = self._answer.readline(most)
        return line


def _until_end(answer: IO[bytes]) -> bytes:
    """Read a JPEG file of unknown length."""
    data = bytearray()
    while len(data) < LARGEST and (line := answer.readline()):
        data += line
        end = data.rfind(b"\xff\xd9")
        if end >= 0 and data[end + 2 :].strip(b"\r\n") == b"":
            break
    return bytes(data)


def _of_folder(folder: Path, moments: Sequence[float]) -> Iterator[Shot]:
    """Take what a camera writes into a folder from now on, the newest at each moment; `moments` end the wait, too."""
    begun, used = time.time(), set[Path]()
    for moment in moments:
        while True:
            _wait_until(moment)
            new = [path for path in folder.iterdir() if path.is_file() and path not in used and path.stat().st_mtime >= begun - 1]
            latest = max(new, key=lambda path: path.stat().st_mtime, default=None)
            if latest and time.time() - latest.stat().st_mtime > _LOOK_SECONDS:  # it is no longer written to
                used.add(latest)
                yield Shot(_whole(read_outside(latest)), latest.stat().st_mtime)
                break
            if time.time() > moments[-1] + PATIENCE:
                raise OSError(f"nothing new arrives in {folder}")
            time.sleep(_LOOK_SECONDS)


def _whole(data: bytes) -> bytes:
    """Return a picture's bytes.  Raises OSError where their end is missing, or where they are no picture."""
    ends = _COMPLETE.get(data[:2])
    if ends is None:
        raise OSError(f"sends something else than a picture ({len(data):,} bytes)" if data else "sends an empty picture")
    if ends not in data[-4096:]:
        raise OSError(f"sends half a picture ({len(data):,} bytes)")
    return data


def _date(text: str | None) -> float | None:
    """Return the Unix time of an HTTP date."""
    try:
        return email.utils.parsedate_to_datetime(text).timestamp() if text else None
    except ValueError:
        return None


def _with_login(url: str, login: Login | None) -> str:
    if login is None:
        return url
    scheme, _, rest = url.partition("://")
    user, password = (urllib.parse.quote(word, safe="") for word in (login.user, login.password))
    return f"{scheme}://{user}:{password}@{rest}"


def _wait_until(moment: float) -> None:
    time.sleep(max(0.0, moment - time.time()))
