"""A work folder whose truth lies in an object store: what others have done comes down, what was done here goes up.

The folder on this machine is complete in names, sizes and times: large files are stand-ins until somebody reads them (see
`remote.standin`).  So all else works on it as on any other work folder, and what differs from what was agreed with the store at
the beginning is what was done since: new files go up, and what was removed is dropped there, too.  What was removed by hand
between two runs comes back: it is a mirror.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..cache.artifact import digest
from ..cache.atomic import write_atomic
from ..cache.layout import WorkFolder
from ..cache.signed import Damaged, read_signed, write_signed
from .objects import Objects
from .segments import FOLDER, Entry, Segment, many, next_name, outdated, whole_name
from .standin import StandIn, mirrored_url, stand_in, write_stand_in

SMALL = 32_768
"""Bytes of a file that a segment holds itself."""
_SMALL_RECEIPT = 1_000_000
"""The same of receipts, which every plan reads."""
_OF = "what was agreed with an object store"


class _Stamp(NamedTuple):
    """What tells that a file is another one than was agreed."""

    size: int
    mtime_ns: int


class _Agreed(NamedTuple):
    """A file that is the same here and in the store."""

    entry: Entry
    stamp: _Stamp


@dataclass(frozen=True)
class _Fresh:
    """A file that the store does not have, or not as it is."""

    place: str
    path: Path
    stamp: _Stamp
    entry: Entry
    data: bytes | None = None
    """Of a small one."""
    uploads: bool = True
    """Does an object have to be made for it?"""


class Mirror:
    """A work folder and its store.  The caller holds the lock of the folder, and, to write there, the store's."""

    def __init__(self, work: WorkFolder, objects: Objects) -> None:
        self.work = work
        self.objects = objects
        self.damages: list[str] = []
        """What the store could not be believed, in words."""
        self._agreed: dict[str, _Agreed] = {}
        self._segments: list[str] = []
        self._shown: dict[str, str] = {}
        self._changed = False

    def pull(self) -> bool:
        """Bring what others have done since; is there anything?

        Raises
        ------
        StoreError
            The store does not answer.
        OSError
            The disk is full, or there is no right to write.
        """
        told = self._recall()
        self._segments = self.objects.names(FOLDER)
        if told and not self._segments:
            self.damages.append(f"{self.objects.url} has lost all that it knew: what is here goes up again")
            told, self._agreed = [], {}
        here = dict(self._here())
        lacking = any(
            place not in here and not agreed.entry.at for place, agreed in self._agreed.items()
        )  # only segments hold it
        new = [name for name in self._segments if lacking or name not in told]
        entries = {} if lacking else {place: agreed.entry for place, agreed in self._agreed.items()}
        small: dict[str, bytes] = {}
        for name, data in zip(new, self.objects.read_all(new) if new else (), strict=True):
            self._fold(name, data, entries, small)
        if mirrored_url(self.work) != self.objects.url:
            write_atomic(self.work.mirror_memo, json.dumps({"url": self.objects.url}).encode())
        self._lay_out(entries, small, here)
        self._changed |= bool(new) or told != self._segments
        return bool(new)

    def push(self, some: Iterable[Path] | None = None) -> int:
        """Send what was done here: its bytes first, then that it is there.  Returns how many files went.

        Parameters
        ----------
        some : iterable of Path, optional
            Only these; all that there is, and what was removed, if not given.

        Raises
        ------
        StoreError
            The store does not answer: what has not gone goes with the next push.
        """
        here = dict(self._stamps(some) if some is not None else self._here())
        fresh = list(self._fresh(here))
        gone = tuple(place for place in self._agreed if place not in here) if some is None else ()
        if not fresh and not gone:
            return 0
        self.objects.put([(one.path, one.entry.at) for one in fresh if one.uploads])
        files = {one.place: one.entry for one in fresh}
        small = {one.place: one.data for one in fresh if one.data is not None}
        self._tell(Segment(files, small, gone), next_name(self._segments))
        before = {agreed.entry.at for place in (*gone, *files) if (agreed := self._agreed.get(place))}
        self._agreed |= {one.place: _Agreed(one.entry, one.stamp) for one in fresh}
        for place in gone:
            del self._agreed[place]
        if unused := before - {agreed.entry.at for agreed in self._agreed.values()} - {""}:
            self.objects.remove(sorted(unused))
        if some is None:
            self._show()
        return len(fresh)

    def _show(self) -> None:
        """Say in the store, too, where the links lead, for who looks there: an object of a link's name holds the id of a run."""
        for link in self.work.links():
            name, run = f"{self._published}{link.name}", self.work.led_to(link)
            if run and self._shown.get(name) != run:
                self.objects.write(name, run.encode())
                self._shown[name] = run

    def unsent(self) -> tuple[int, int]:
        """How many files the store does not have, and their bytes."""
        sizes = [s.size for place, s in self._here() if not (a := self._agreed.get(place)) or a.stamp != s]
        return len(sizes), sum(sizes)

    def settle(self) -> None:
        """Bring segments together where there are many.  Raises StoreError."""
        if not many(self._segments):
            return
        small: dict[str, bytes] = {}
        for place, agreed in self._agreed.items():
            if not agreed.entry.at or agreed.entry.size <= SMALL:
                small[place] = (self.work.root / place).read_bytes()
                if digest(small[place]) != agreed.entry.digest:
                    return  # it has been touched just now: another time
        everything = Segment({place: agreed.entry for place, agreed in self._agreed.items()}, small, whole=True)
        self._tell(everything, whole_name(next_name(self._segments)))
        old = outdated(self._segments)
        self.objects.remove(old)
        self._segments = [name for name in self._segments if name not in old]

    def save(self) -> None:
        """Remember what was agreed.  Raises OSError."""
        if self._changed:
            files = {place: [*vars(agreed.entry).values(), agreed.stamp.mtime_ns] for place, agreed in self._agreed.items()}
            told = {"url": self.objects.url, "segments": self._segments, "files": files, "shown": self._shown}
            write_signed(self.work.agreed_memo, _OF, told, lasts=False)
            self._changed = False

    def _recall(self) -> list[str]:
        """Take up what was agreed; returns the segments that were known then."""
        try:
            told = read_signed(self.work.agreed_memo, _OF)
            if told is None or told["url"] != self.objects.url:
                return []
            self._agreed = {
                place: _Agreed(Entry(size, found, at), _Stamp(size, mtime))
                for place, (size, found, at, mtime) in told["files"].items()
            }
            self._shown = dict(told["shown"])
            return list(told["segments"])
        except (Damaged, KeyError, TypeError, ValueError):  # it costs reading the segments again
            self._agreed = {}
            return []

    def _fold(self, name: str, data: bytes | None, entries: dict[str, Entry], small: dict[str, bytes]) -> None:
        """Add what a segment tells."""
        try:
            segment = Segment.decoded(name, data or b"")
        except Damaged:
            what = "is damaged" if data is not None else "is gone"
            self.damages.append(f"{self.objects.url}/{name} {what}: what it told of is made again")
            return
        if segment.whole:
            entries.clear()
        entries.update(segment.files)
        small.update(segment.small)
        for place in segment.gone:
            entries.pop(place, None)

    def _lay_out(self, entries: Mapping[str, Entry], small: Mapping[str, bytes], here: Mapping[str, _Stamp]) -> None:
        """Make the folder as the store has it, but for what was done here and has not gone up."""
        before, self._agreed = self._agreed, {}
        for place, entry in entries.items():
            known, stamp = before.get(place), here.get(place)
            if stamp and known and stamp == known.stamp and known.entry == entry:
                self._agreed[place] = known
                continue
            path = self.work.root / place
            if stamp and known and stamp == known.stamp:
                if known.entry.digest != entry.digest or stand_in(path):
                    stamp = self._put(path, entry, small.get(place))
            elif stamp is None or not (_digest(path) == entry.digest or place.startswith(self._own)):
                stamp = self._put(path, entry, small.get(place))
            elif _digest(path) != entry.digest:  # it goes up
                continue
            if stamp:
                self._agreed[place] = _Agreed(entry, stamp)
        for place in before.keys() - entries.keys():
            if here.get(place) == before[place].stamp:  # somebody else has removed it
                (self.work.root / place).unlink(missing_ok=True)

    @property
    def _own(self) -> tuple[str, ...]:
        """Where what was done here counts, though the store has something else: nobody else has the same keys, or runs."""
        return tuple(f"{folder.name}/" for folder in (self.work.cache, self.work.runs))

    def _put(self, path: Path, entry: Entry, data: bytes | None) -> _Stamp | None:
        """Lay a file as the store has it; None for one of which nobody has the bytes."""
        if data is not None and digest(data) == entry.digest:
            write_atomic(path, data, lasts=False, ours=True)
        elif entry.at:
            write_stand_in(path, StandIn(entry.size, entry.digest, entry.at))
        else:
            return None
        self._changed = True
        return _stamp(path)

    def _here(self) -> Iterator[tuple[str, _Stamp]]:
        """Every file that belongs into the store; not what is of this machine alone, or can be made again from the rest."""
        work = self.work
        yield from self._stamps([work.seen_memo, work.notified])
        for top, least in ((work.cache, 2), (work.reference, 0), (work.runs, 1)):
            depth = str(top).count("/") + least
            for folder, folders, names in os.walk(top):
                folders[:] = [name for name in folders if not name.startswith(".")]
                if folder.count("/") >= depth:
                    yield from self._stamps([f"{folder}/{name}" for name in names if not name.startswith(".")])

    def _stamps(self, paths: Iterable[Path | str]) -> Iterator[tuple[str, _Stamp]]:
        start = len(f"{self.work.root}/")
        for path in paths:
            if stamp := _stamp(path):
                yield str(path)[start:], stamp

    def _fresh(self, here: Mapping[str, _Stamp]) -> Iterator[_Fresh]:
        """What is not as it was agreed, with the object that it goes to, or that has its bytes already."""
        objects = {agreed.entry.at: agreed.entry.digest for agreed in self._agreed.values()}
        holders = {
            (place.startswith(self._published), a.entry.digest): a.entry.at for place, a in self._agreed.items() if a.entry.at
        }
        for place in sorted(here):
            agreed, stamp = self._agreed.get(place), here[place]
            if agreed and agreed.stamp == stamp:
                continue
            path = self.work.root / place
            if known := stand_in(path):
                yield _Fresh(place, path, stamp, Entry(known.size, known.digest, known.at), uploads=False)
                continue
            try:
                data = path.read_bytes() if stamp.size <= self._small(path) else None
                found = digest(data) if data is not None else _digest(path)
            except OSError:  # gone since
                continue
            published = place.startswith(self._published)
            if data is not None and not published:
                yield _Fresh(place, path, stamp, Entry(len(data), found), data, uploads=False)
                continue
            again = agreed is not None and agreed.entry.digest == found  # made again, perhaps since the store's was damaged
            at = agreed.entry.at if agreed and again else holders.get((published, found), "")
            uploads = again or not at
            if not at:
                at = place if objects.get(place, found) == found else _beside(place, found)
                objects[at], holders[published, found] = found, at
            yield _Fresh(place, path, stamp, Entry(stamp.size, found, at), data, uploads)

    def _small(self, path: Path) -> int:
        """So large may a file be that a segment holds."""
        return _SMALL_RECEIPT if self.work.receipt_beside(path) == path and path.is_relative_to(self.work.cache) else SMALL

    @property
    def _published(self) -> str:
        """People look for what lies there: it has objects of its own names."""
        return f"{self.work.runs.name}/"

    def _tell(self, segment: Segment, name: str) -> None:
        self.objects.write(name, segment.encoded(name))
        self._segments.append(name)
        self._changed = True


def _stamp(path: Path | str) -> _Stamp | None:
    try:
        status = os.stat(path)  # noqa: PTH116 (many)
    except OSError:
        return None
    return _Stamp(status.st_size, status.st_mtime_ns)


def _digest(path: Path) -> str:
    """Of a file's bytes, or of those that it stands for."""
    if known := stand_in(path):
        return known.digest
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


def _beside(place: str, found: str) -> str:
    """Another name for an object, where its own is in use."""
    path = Path(place)
    return str(path.with_name(f"{path.stem}~{found[:8]}{path.suffix}"))
