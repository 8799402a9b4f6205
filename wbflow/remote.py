"""Work folders and captures in an object store (s3://bucket/prefix, gs://..., file:///...), through fsspec.

A work folder in a store is mirrored by an ordinary local folder with the same file names.  `pull` downloads what other machines
have done; `push` uploads what was done here, during the run and at its end.  Changes are found from the store's listing: the
ETag of each file is compared with that of the last synchronization (`mirror.json`).  Files that have changed in the store since
then replace the local ones; all other differences are local changes and are uploaded.  An artifact is uploaded before its
receipt, and a run's files before its run.json, so that no file in the store refers to one that is missing.

Only one machine writes at a time: the one that `held.json` in the store names.  That object is created with a conditional put
if the store supports it, is renewed with each upload, and counts as abandoned after an hour without renewal; the next run on the
same machine takes over from a killed run at once.  The clocks of all machines must agree to within a few minutes.

Captures in a store are listed, and only those of the night are downloaded, once until their ETags change.  Credentials and
endpoints come from the store's own library (AWS_PROFILE, AWS_ENDPOINT_URL, ...); site files contain none.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from .cache.atomic import DISK_FULL_ERRORS
from .cache.checksum import Damaged, read_checksummed, write_checksummed
from .cache.layout import RunPaths, WorkFolder
from .cache.lock import Locked
from .errors import ExitCode, WbflowError
from .records.events import Event, Listener, Signal, TaskEvent
from .records.findings import Finding, finding
from .task import Task
from .words import counted, printable

LOCK_NAME = "held.json"
ABANDONED_SECONDS = 3600.0
"""A writer that has not renewed `held.json` for this many seconds counts as gone."""
UPLOAD_SECONDS = 10.0
"""Shortest time in seconds between uploads of finished results during a run."""
_WAIT_SECONDS = 5.0
_URL = re.compile(r"[a-z][a-z0-9+.-]*://")
_INSTALL = "pip install 'wbflow[cloud]'  (for gs:// also gcsfs, for abfs:// adlfs)"
_SHARES = {"smb", "cifs", "nfs", "ftp", "ftps", "sftp", "ssh", "webdav", "dav", "afp"}
"""Schemes of folders that other machines share."""
_CHECK_ACCESS = "check that it exists and can be reached, and the credentials (for S3: AWS_PROFILE, AWS_ENDPOINT_URL)"
_OPTIONS: dict[str, dict[str, Any]] = {
    "file": {"auto_mkdir": True},
    "s3": {"config_kwargs": {"retries": {"max_attempts": 1}}},  # s3fs itself already tries five times
}
_TRANSFERS = 16  # parallel transfers


class StoreError(WbflowError):
    """An operation on an object store failed; the message names the store."""


class NoSuchStore(StoreError):
    """The URL is invalid, or packages for its kind of store are missing."""

    exit_code = ExitCode.USAGE


def is_url(text: str) -> bool:
    """Return whether the text is the URL of an object store, rather than a folder."""
    return _URL.match(text) is not None


Entry = tuple[int, str]
"""Size of an object, and its mark: the ETag, or else the time of its last change.  The mark changes with the bytes."""


class ObjectStore:
    """The objects below a URL, by name.  Errors of the store's library are raised as StoreError, except for a full local disk."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")

    def listing(self) -> dict[str, Entry]:
        """Return size and mark of every object, by name."""
        system, root = self._opened
        with self._errors("listing"):
            objects = {str(path)[len(root) + 1 :]: info for path, info in system.find(root, detail=True).items()}
            return {name: _entry(info) for name, info in objects.items() if info["type"] == "file" and not name.endswith("/")}

    def read(self, name: str) -> bytes | None:
        """Return an object's bytes; None if it does not exist."""
        with self._errors(name):
            try:
                return bytes(self._opened[0].cat_file(self._path(name)))
            except FileNotFoundError:
                return None

    def write(self, name: str, data: bytes, new: bool = False) -> bool:
        """Write an object.  new: only if it does not exist; returns False if it does."""
        with self._errors(name):
            try:
                self._opened[0].pipe_file(self._path(name), data, **({"mode": "create"} if new else {}))
            except OSError as error:  # S3: PreconditionFailed, or ConditionalRequestConflict for simultaneous writes
                if new and (isinstance(error, FileExistsError) or "condition" in f"{error} {error.__cause__}".lower()):
                    return False
                raise
            return True

    def fetch(self, names: Sequence[str], root: Path) -> None:
        """Download objects to files of the same names, each by rename; objects that no longer exist are skipped."""

        def fetch_one(name: str) -> None:
            temporary = WorkFolder.unfinished(root / name)
            temporary.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):
                self._opened[0].get_file(self._path(name), str(temporary))
                temporary.replace(root / name)

        with self._errors("download"), ThreadPoolExecutor(_TRANSFERS) as threads:
            list(threads.map(fetch_one, names))

    def put(self, names: Sequence[str], root: Path) -> None:
        """Upload files to objects of the same names.  After an error, some may be uploaded and others not."""
        with self._errors("upload"):
            self._opened[0].put([str(root / name) for name in names], [self._path(name) for name in names], batch_size=_TRANSFERS)

    def remove(self, names: Iterable[str]) -> None:
        """Remove objects; those that no longer exist are ignored."""
        for name in names:
            with self._errors(name), contextlib.suppress(FileNotFoundError):
                self._opened[0].rm_file(self._path(name))

    def _path(self, name: str) -> str:
        return f"{self._opened[1]}/{name}"

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        """The fsspec file system, and the path in it."""
        try:
            from fsspec.core import url_to_fs  # optional dependency

            system, root = url_to_fs(self.url, use_listings_cache=False, **_OPTIONS.get(self.url.partition("://")[0], {}))
        except ImportError as error:
            if self.url.partition("://")[0] in _SHARES:
                what = f"{self.url}: is a folder of another machine, and no object store"
                raise NoSuchStore(what, remedy="mount it, and name the folder: captures: {root: /mnt/cameras}") from None
            raise NoSuchStore(f"{self.url}: object stores need more packages: {printable(error)}", remedy=_INSTALL) from None
        except ValueError as error:
            raise NoSuchStore(f"{self.url}: {printable(error)}", remedy="write it as s3://bucket/prefix") from None
        return system, str(root).rstrip("/")

    @contextlib.contextmanager
    def _errors(self, name: str) -> Iterator[None]:
        try:
            yield
        except StoreError:
            raise
        except Exception as error:  # each store's library has its own errors: BotoCoreError, ClientError, FSTimeoutError, ...
            if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS:
                raise
            what = f"{self.url} cannot be used ({name}): {type(error).__name__}: {printable(error)}"
            raise StoreError(what, remedy=_CHECK_ACCESS) from error


def _entry(info: Mapping[str, Any]) -> Entry:
    """Return size and mark from fsspec's information on an object, whose keys differ between stores."""
    marks = (info.get(name) for name in ("ETag", "etag", "LastModified", "updated", "last_modified", "mtime", "created"))
    return int(info["size"]), str(next(filter(None, marks), ""))


Stamp = tuple[int, int]
"""Size and mtime_ns of a local file, to detect changes."""


class Mirror:
    """A local work folder and the store that it mirrors.  The caller holds the folder's lock."""

    def __init__(self, work: WorkFolder) -> None:
        self.work, self.store = work, ObjectStore(work.store)
        self._token = os.urandom(8).hex()
        """Identifies this folder in held.json."""
        self._synced: dict[str, tuple[str, Stamp]] = {}
        """By name: mark in the store ("" if not known yet) and local stamp when both sides last had the same bytes."""
        self._pending: list[tuple[Task, str]] = []
        self._fault: str | None = None
        self.holds_store = False
        self._last_upload = time.monotonic()
        with contextlib.suppress(Damaged, KeyError, TypeError, ValueError):  # without the memo, files are downloaded again
            memo = read_checksummed(work.mirror_memo, "mirror") or {}
            if memo["url"] == self.store.url:
                self._token = str(memo["token"])
                self._synced = {name: (mark, (size, mtime)) for name, (mark, size, mtime) in memo["files"].items()}

    def pull(self) -> None:
        """Download what other machines have changed since the last synchronization.  Raises StoreError, OSError."""
        remote = {name: entry for name, entry in self.store.listing().items() if self._belongs(name)}
        local = self._stamps()
        if not remote:  # a new store, or one that has lost everything: the next push uploads all local files
            self._synced = {}
        outdated = []
        for name, (size, mark) in remote.items():
            synced_mark, synced_stamp = self._synced.get(name, ("", None))
            stamp = local.get(name)
            in_cache = name.startswith(f"{self.work.cache.name}/")  # names have keys: two files of one size are taken to be equal
            if stamp and (synced_mark == mark or (not synced_mark and in_cache and stamp[0] == size)):
                self._synced[name] = mark, synced_stamp or stamp
            else:
                outdated.append(name)
        for names in self._in_order(outdated):
            self.store.fetch(names, self.work.root)
        for name, stamp in self._stamps(self.work.root / name for name in outdated).items():
            self._synced[name] = remote[name][1], stamp
        for name in self._synced.keys() - remote.keys():  # another machine has removed it
            _, synced_stamp = self._synced.pop(name)
            if synced_stamp == local.get(name):
                (self.work.root / name).unlink(missing_ok=True)
        self._save()

    def push(self, paths: Iterable[Path] | None = None) -> None:
        """Upload local changes; of these files only, if given.  Raises StoreError; the next push uploads the rest."""
        local = self._stamps(paths)
        changed = [name for name, stamp in local.items() if self._synced.get(name, ("", None))[1] != stamp]
        for names in self._in_order(changed):
            self.store.put(names, self.work.root)
            self._synced.update({name: ("", local[name]) for name in names})
        if paths is not None:
            return
        for names in reversed(list(self._in_order(self._synced.keys() - local.keys()))):
            self.store.remove(names)
            for name in names:
                del self._synced[name]
        for link in self.work.links():  # for people who browse the store: an object named like the link contains the run's id
            if run := self.work.link_target(link):
                self.store.write(f"{self.work.runs.name}/{link.name}", run.encode())
        remote = self.store.listing() if changed else {}
        self._synced.update({name: (remote[name][1], local[name]) for name in changed if name in remote})
        self._save()

    def wrap_listener(self, listen: Listener) -> Listener:
        """Return a listener that passes events on to `listen`, and uploads results as tasks finish."""

        def receive(event: Event | Signal) -> None:
            listen(event)
            if isinstance(event, TaskEvent) and event.fresh and event.key:
                self._pending.append((event.task, event.key))
                if time.monotonic() - self._last_upload > UPLOAD_SECONDS:
                    self._send(everything=False)

        return receive

    def upload_finding(self) -> Finding | None:
        """Upload finished results; return a finding if that fails."""
        self._send(everything=False)
        return finding("store-behind", reason=self._fault) if self._fault else None

    def finish(self) -> str | None:
        """Upload everything and release the store; return what went wrong, in words, or None."""
        if self.holds_store:
            self._send(everything=True)
            self.release()
        return self._fault

    def hold(self, wait: bool) -> None:
        """Become the only writer.  Raises Locked if another folder holds the store and `wait` is False; StoreError."""
        while not self.store.write(LOCK_NAME, self._claim(), new=True):
            holder = self._holder()
            if holder["token"] in {self._token, ""} or time.time() - holder["seen"] > ABANDONED_SECONDS:
                self.store.remove([LOCK_NAME])
            elif not wait:
                writer = f"process {holder['pid']} on {holder['host']}"
                hint = f"a run that was killed counts as gone after {counted(ABANDONED_SECONDS / 60, 'minute')}"
                raise Locked(f"another run holds {self.store.url}: {writer}", remedy=f"wait for it (--wait), or stop it; {hint}")
            else:
                time.sleep(_WAIT_SECONDS)
        self.holds_store = True

    def release(self) -> None:
        """Release the store.  If it does not answer, others can write after `ABANDONED_SECONDS`."""
        self.holds_store = False
        with contextlib.suppress(StoreError):
            if self._holder()["token"] == self._token:
                self.store.remove([LOCK_NAME])

    def _send(self, everything: bool) -> None:
        try:
            holder = self._holder()
            if holder["token"] not in {self._token, ""}:
                raise StoreError(f"{self.store.url} was taken over by process {holder['pid']} on {holder['host']}")
            self.store.write(LOCK_NAME, self._claim())
            self.push(None if everything else [path for task_key in self._pending for path in self.work.of_key(*task_key)])
            self._pending, self._fault = [], None
        except (StoreError, OSError) as error:
            what = error.what if isinstance(error, WbflowError) else str(error)
            self._fault = f"tonight's last results were not uploaded; only this machine has them: {what}"
        self._last_upload = time.monotonic()

    def _claim(self) -> bytes:
        return json.dumps({"token": self._token, "host": os.uname().nodename, "pid": os.getpid(), "seen": time.time()}).encode()

    def _holder(self) -> dict[str, Any]:
        """Return the holder of the store; its token is "" if there is none, or held.json is invalid."""
        try:
            return {"token": "", "host": "?", "pid": "?", "seen": 0.0, **json.loads(self.store.read(LOCK_NAME) or b"{}")}
        except (ValueError, TypeError):
            return {"token": ""}

    def _save(self) -> None:
        files = {name: [mark, *stamp] for name, (mark, stamp) in self._synced.items()}
        write_checksummed(self.work.mirror_memo, "mirror", {"url": self.store.url, "token": self._token, "files": files})

    def _belongs(self, name: str) -> bool:
        """Return whether a file belongs in the store; files of this machine alone, and those that can be rebuilt, do not."""
        work, parts = self.work, PurePosixPath(name).parts
        fewest_parts = {work.cache.name: 4, work.reference.name: 2, work.runs.name: 3}
        fewest_parts |= {path.name: 1 for path in (work.delivered_memo, work.notified, work.owner)}
        return len(parts) >= fewest_parts.get(parts[0], len(parts) + 1) and not any(part.startswith(".") for part in parts)

    def _in_order(self, names: Iterable[str]) -> Iterator[list[str]]:
        """Group names in order of upload: artifacts, then receipts and other JSON, then the records of runs and the reference."""
        last_names = {self.work.reference_record.name, RunPaths(self.work.root).record.name}

        def rank(name: str) -> int:
            return 2 if PurePosixPath(name).name in last_names else int(name.endswith(".json"))

        return (list(group) for _, group in itertools.groupby(sorted(names, key=rank), key=rank))

    def _stamps(self, paths: Iterable[Path] | None = None) -> dict[str, Stamp]:
        """Return the stamps of all local files that belong in the store, by name; of these files only, if given."""
        stamps = {}
        for path in self.work.root.rglob("*") if paths is None else paths:
            name = path.relative_to(self.work.root).as_posix()
            if self._belongs(name) and path.is_file():
                status = path.stat()
                stamps[name] = status.st_size, status.st_mtime_ns
        return stamps


@contextlib.contextmanager
def writing(work: WorkFolder, wait: bool) -> Iterator[Mirror]:
    """Hold the store of a work folder while the block runs: download other machines' changes first, and upload all local ones at
    the end.  The caller holds the folder's lock.  Raises Locked, StoreError."""
    mirror = Mirror(work)
    mirror.hold(wait)
    try:
        mirror.pull()
        yield mirror
        if mirror.holds_store and (fault := mirror.finish()):
            raise StoreError(fault)
    finally:
        mirror.release()


def list_captures(root: Path, url: str) -> None:
    """Mirror the names of all captures in a store in a folder.  A new or changed capture is an empty file until `fetch_captures`
    downloads its bytes.  Raises StoreError, OSError."""
    memo = WorkFolder(root).mirror_memo
    known: dict[str, list[Any]] = {}
    with contextlib.suppress(Damaged):
        known = (read_checksummed(memo, "captures") or {}).get("files", {})
    files = {
        name: [*entry] for name, entry in ObjectStore(url).listing().items() if not {"..", "/"} & {*PurePosixPath(name).parts}
    }
    files.pop(memo.name, None)
    for name, entry in files.items():
        path = root / name
        try:
            if known.get(name) != entry or not path.is_file():
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                path.touch()
        except OSError as error:
            if error.errno in DISK_FULL_ERRORS:
                raise  # any other error: no local file can have this name, at least not together with the others
    for name in known.keys() - files.keys():
        (root / name).unlink(missing_ok=True)
    if files != known:
        write_checksummed(memo, "captures", {"files": files})


def fetch_captures(root: Path, url: str, paths: Iterable[Path]) -> None:
    """Download the captures that are still empty files.  Raises StoreError, OSError."""
    empty = [path for path in paths if path.is_file() and not path.stat().st_size]
    ObjectStore(url).fetch([str(path.relative_to(root)) for path in empty], root)
