"""An object store by its URL (s3://bucket/prefix, gs://..., file:///...), through fsspec: whole objects by name, nothing else.

Credentials and endpoints are those of the store's own library (AWS_PROFILE, AWS_ENDPOINT_URL, ...): no site file holds any.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import ExitCode, WbflowError, printable

_URL = re.compile(r"[a-z][a-z0-9+.-]*://")
_INSTALL = "pip install 'wbflow[cloud]'  (for gs:// also gcsfs, for abfs:// adlfs)"
_REACH = "is it there, does this machine reach it, and do its credentials hold (for S3: AWS_PROFILE, AWS_ENDPOINT_URL)?"
_ON_DISK: dict[str, dict[str, Any]] = {"file": {"auto_mkdir": True}, "local": {"auto_mkdir": True}}
"""What file systems need that have folders."""
_S3: dict[str, Any] = {"config_kwargs": {"retries": {"max_attempts": 1}}}
"""s3fs tries five times itself: where nothing answers, somebody waits half a minute, and not three."""
_OPTIONS = {**_ON_DISK, "s3": _S3, "s3a": _S3}
_TOGETHER = 500
"""So many objects are put there in one go; after a failure nobody knows which of them are there."""
_AT_ONCE = 16


class StoreError(WbflowError):
    """An object store does not do what is asked; the message names it."""


class NoSuchStore(StoreError):
    """The URL is of no store that can be used here."""

    exit_code = ExitCode.USAGE


def is_url(text: str) -> bool:
    """Is an object store named, and no folder?"""
    return _URL.match(text) is not None


class Found(NamedTuple):
    """An object as a listing tells of it."""

    size: int
    mark: str
    """Another one for other bytes: its ETag; where there is none, when it was written."""
    seconds: float
    """When it was written, seconds since 1970; 0 where nobody says."""

    @staticmethod
    def of(entry: Mapping[str, Any]) -> Found:
        """From what fsspec tells."""
        moment = next(
            (entry[name] for name in ("LastModified", "mtime", "updated", "last_modified", "created") if entry.get(name)), 0
        )
        seconds = moment.timestamp() if hasattr(moment, "timestamp") else moment if isinstance(moment, int | float) else 0.0
        return Found(int(entry["size"]), str(entry.get("ETag") or entry.get("etag") or moment), float(seconds))


class Objects:
    """The objects below a URL.  Whatever a store's library raises comes as StoreError."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")

    def names(self, below: str) -> list[str]:
        """Names of all objects below one, by name: one request for each thousand of them."""
        with self._told(below):
            top = self._path(f"{below}/")
            try:
                found = self._system.find(top.rstrip("/"))
            except FileNotFoundError:
                if self._folders:
                    return []
                raise
            return sorted(f"{below}/{str(path).rpartition(f'/{below}/')[2]}" for path in found)

    def found(self) -> dict[str, Found]:
        """Every object by name, with what tells that it is another one than before."""
        with self._told("a listing"):
            try:
                listed = self._system.find(self._top, detail=True)
            except FileNotFoundError:
                if self._folders:
                    return {}
                raise
            files = {path: entry for path, entry in listed.items() if entry.get("type") != "directory" and not path.endswith("/")}
            return {str(path)[len(self._top) + 1 :]: Found.of(entry) for path, entry in files.items()}

    def read(self, name: str) -> bytes | None:
        """An object's bytes; None where there is none."""
        return self.read_all([name])[0]

    def read_all(self, names: Sequence[str]) -> list[bytes | None]:
        """The same of many, at the same time where all of them are there."""
        import tempfile  # here: it takes a while, and few work folders are mirrors

        with tempfile.TemporaryDirectory() as folder:
            places = [Path(folder) / str(k) for k in range(len(names))]
            try:
                self._fetch(names, places)
            except FileNotFoundError:  # of one; where there are others, each is asked for by itself
                if len(names) > 1:
                    return [self.read(name) for name in names]
            return [place.read_bytes() if place.is_file() else None for place in places]

    def fetch(self, name: str, to: Path) -> bool:
        """Copy an object to a file; False where there is none."""
        try:
            self._fetch([name], [to])
        except FileNotFoundError:
            return False
        return True

    def put(self, files: Sequence[tuple[Path, str]]) -> None:
        """Copy files to objects, several at the same time.  After an error some are there, and others are not."""
        for start in range(0, len(files), _TOGETHER):
            some = files[start : start + _TOGETHER]
            with self._told(some[0][1]):
                self._system.put([str(path) for path, _ in some], [self._path(name) for _, name in some], **self._at_once)

    def write(self, name: str, data: bytes) -> None:
        """Put an object into the place of whatever bears its name."""
        with self._told(name):
            self._system.pipe_file(self._path(name), data)

    def create(self, name: str, data: bytes) -> bool:
        """Make an object that must not be there yet; False where there is one.  (A store that knows no such condition puts it
        there all the same.)"""
        with self._told(name):
            try:
                self._system.pipe_file(self._path(name), data, mode="create")
            except FileExistsError:
                return False
            except OSError as error:  # as S3 says it: PreconditionFailed, or, where two come at once, ConditionalRequestConflict
                if "condition" in f"{error} {error.__cause__}".lower():
                    return False
                raise
            return True

    def remove(self, names: Iterable[str]) -> None:
        """Remove objects; one that is gone already is none the worse."""
        paths = [self._path(name) for name in names]
        with self._told("objects that are not needed any more"):
            if self._folders:
                for path in paths:
                    with contextlib.suppress(FileNotFoundError):
                        self._system.rm_file(path)
            elif paths:
                self._system.rm(paths)

    def _fetch(self, names: Sequence[str], places: Sequence[Path]) -> None:
        with self._told(names[0], missing_too=True):
            self._system.get([self._path(name) for name in names], [str(place) for place in places])

    def _path(self, name: str) -> str:
        return f"{self._top}/{name}"

    @property
    def _at_once(self) -> dict[str, int]:
        """So many files are in memory at the same time."""
        return {"batch_size": _AT_ONCE} if getattr(self._system, "async_impl", False) else {}

    @property
    def _folders(self) -> bool:
        """Is it none of the stores that have no folders?"""
        return self.url.partition("://")[0] in {*_ON_DISK, "memory"}

    @cached_property
    def _system(self) -> Any:
        return self._opened[0]

    @cached_property
    def _top(self) -> str:
        return str(self._opened[1]).rstrip("/")

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        try:
            from fsspec.core import url_to_fs  # an extra
        except ImportError:
            raise NoSuchStore(f"{self.url}: an object store needs fsspec, which is not installed", remedy=_INSTALL) from None
        scheme = self.url.partition("://")[0]
        try:
            system, top = url_to_fs(self.url, use_listings_cache=False, **_OPTIONS.get(scheme, {}))
        except ImportError as error:
            raise NoSuchStore(f"{self.url}: {printable(error)}", remedy=_INSTALL) from None
        except ValueError as error:
            raise NoSuchStore(f"{self.url}: {printable(error)}", remedy="write it as s3://bucket/prefix") from None
        return system, top

    @contextlib.contextmanager
    def _told(self, name: str, missing_too: bool = False) -> Iterator[None]:
        """Faults in words that name the store.  missing_too: that something is not there is for the caller."""
        try:
            yield
        except StoreError:
            raise
        except FileNotFoundError as error:
            if missing_too:
                raise
            raise StoreError(f"{self.url} is not there: {printable(error)}", remedy=_REACH) from error
        except Exception as error:  # each store's library has errors of its own: BotoCoreError, ClientError, FSTimeoutError, ...
            what = f"{self.url} cannot be used ({name}): {type(error).__name__}: {printable(error)}"
            raise StoreError(what, remedy=_REACH) from error
