"""Pictures of one camera, whatever delivers them: an HTTP server, a video stream, or a folder that it writes to."""

from __future__ import annotations

import time
import urllib.parse
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..cache.untrusted import read_untrusted
from ..errors import WbflowError
from ..plugins import load
from .server import Access, Login, Shot, server_shots

_STILL_SECONDS = 0.5
"""A file that has not changed for so long is complete, seconds."""
_END_MARKERS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}
"""By the first two bytes of a file (JPEG, PNG): the bytes at the end of a complete one."""


class CaptureFailed(WbflowError):
    """A camera delivers no picture; the message contains neither user nor password."""


def shots(url: str, access: Access, moments: Sequence[float], patience: float) -> Iterator[Shot]:
    """Yield a camera's picture at each moment.  Raises CaptureFailed if the camera delivers none.

    Parameters
    ----------
    url : http://, https://, rtsp://, rtsps://, or file:// for a folder.
    access : login and certificate.
    moments : Unix times, in order.
    patience : timeout of an answer, seconds.
    """
    try:
        if url.startswith("rtsp"):
            stream_pictures = load("wbflow_stages.capture.stream:stream_pictures")
            yield from stream_pictures(_with_login(url, access.login), moments, patience)
        elif url.startswith("file:"):
            yield from _folder_shots(folder_of(url), moments, patience)
        else:
            yield from server_shots(url, access, moments, patience)
    except (OSError, ValueError) as error:
        raise CaptureFailed(str(error) or type(error).__name__) from None


def folder_of(url: str) -> Path:
    """The folder of a file:// address."""
    return Path(urllib.parse.unquote(url.partition("://")[2]))


def _folder_shots(folder: Path, moments: Sequence[float], patience: float) -> Iterator[Shot]:
    """Yield at each moment the newest file that arrives in a folder from now on; give up `patience` after the last moment."""
    start = time.time()
    used: set[Path] = set()  # each file is one picture, however often its camera is asked
    for moment in moments:
        while True:
            time.sleep(max(0.0, moment - time.time()))
            latest = _latest(folder, start, used)
            if latest is not None and time.time() - latest.stat().st_mtime > _STILL_SECONDS:
                used.add(latest)
                yield _checked(read_untrusted(latest)), latest.stat().st_mtime
                break
            if time.time() > moments[-1] + patience:
                raise OSError(f"nothing new arrives in {folder}")
            time.sleep(_STILL_SECONDS)


def _latest(folder: Path, start: float, used: set[Path]) -> Path | None:
    """The newest file that was written since `start` (a second earlier counts: some disks round) and is not yet used."""
    new: list[Path] = []
    for path in folder.iterdir():
        if path.is_file() and path not in used and path.stat().st_mtime >= start - 1:
            new.append(path)
    return max(new, key=lambda path: path.stat().st_mtime, default=None)


def _checked(data: bytes) -> bytes:
    """Return a picture's bytes unchanged.  Raises OSError if the end is missing, or if it is neither JPEG nor PNG."""
    if not data:
        raise OSError("sends an empty picture")
    end_marker = _END_MARKERS.get(data[:2])
    if end_marker is None:
        raise OSError(f"sends something else than a picture ({len(data):,} bytes)")
    if end_marker not in data[-4096:]:
        raise OSError(f"sent an incomplete picture ({len(data):,} bytes)")
    return data


def _with_login(url: str, login: Login | None) -> str:
    """An address that contains the login, as FFmpeg wants it."""
    if login is None:
        return url
    scheme, _, address = url.partition("://")
    user, password = (urllib.parse.quote(part, safe="") for part in login)
    return f"{scheme}://{user}:{password}@{address}"
