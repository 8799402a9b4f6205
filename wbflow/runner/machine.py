"""What this machine lets a run have, and what its processes hold; where the system does not say (no /proc), nothing is known."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

SHARE = 0.8
"""Of the memory of this machine, or of the control group that the run is in, that its workers may hold together."""
_KERNEL = Path("/proc")
_GROUPS = Path("/sys/fs/cgroup")
_CLEAR, _STATUS = f"{_KERNEL}/self/clear_refs", f"{_KERNEL}/self/status"  # text: looked at for each task
_STATUS_BYTES = 1 << 16
_HELD = (b"VmHWM:", b"RssFile:", b"RssShmem:")


def memory() -> int:
    """Bytes that workers may hold together, if nobody says otherwise; 0 where it is not known."""
    known = [*_group_limits()]
    with suppress(ValueError, OSError):
        known.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return int(SHARE * min(known, default=0))


def held_by(process: int) -> int:
    """Bytes that a process holds for itself (what it shares with others, such as libraries, does not count); 0: not known."""
    try:
        _, resident, shared, *_ = (_KERNEL / str(process) / "statm").read_text().split()
    except (OSError, ValueError):
        return 0
    return (int(resident) - int(shared)) * os.sysconf("SC_PAGE_SIZE")


def count_from_here() -> None:
    """Forget what this process held at most so far."""
    with suppress(OSError):
        descriptor = os.open(_CLEAR, os.O_WRONLY)
        try:
            os.write(descriptor, b"5")
        finally:
            os.close(descriptor)


def most_held() -> int:
    """Bytes that this process held for itself at most since it was last asked to forget; where that is not told, with what it
    shares and since its start."""
    with suppress(OSError, ValueError):
        descriptor = os.open(_STATUS, os.O_RDONLY)
        try:
            told = os.read(descriptor, _STATUS_BYTES)
        finally:
            os.close(descriptor)
        peak, files, shared = (int(told[told.index(name) + len(name) :].split(None, 1)[0]) for name in _HELD)
        return (peak - files - shared) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def kills_for_memory() -> int:
    """How often the kernel has killed a process because memory ran out, so far."""
    counted = 0
    for file in [_KERNEL / "vmstat", *(folder / "memory.events" for folder in _groups())]:
        try:
            rows = dict(line.split()[:2] for line in file.read_text().splitlines())
            counted += int(rows.get("oom_kill", 0))
        except (OSError, ValueError):
            continue
    return counted


def offer_first() -> None:
    """Let the kernel, where it has to kill something, take this process before the others of its owner."""
    with suppress(OSError):
        (_KERNEL / "self" / "oom_score_adj").write_text("500")


def _groups() -> Iterator[Path]:
    """The control group that this process is in, and those around it."""
    try:
        lines = (_KERNEL / "self" / "cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        number, _, rest = line.partition(":")
        if number == "0":
            group = _GROUPS / rest.partition(":")[2].lstrip("/")
            yield from (folder for folder in (group, *group.parents) if folder.is_relative_to(_GROUPS))


def _group_limits() -> Iterator[int]:
    for file in [*(folder / "memory.max" for folder in _groups()), _GROUPS / "memory" / "memory.limit_in_bytes"]:
        try:
            yield int(file.read_text())
        except (OSError, ValueError):  # "max": there is no limit
            continue
