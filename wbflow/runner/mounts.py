"""Paths as another machine has them: folders that workers reach under another name."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from ..errors import UsageError


@dataclass(frozen=True)
class Mount:
    """A folder here, and the name that it has there."""

    here: Path
    there: Path

    @staticmethod
    def parse(text: str) -> Mount:
        """From HERE=THERE.  Raises UsageError."""
        here, is_, there = text.partition("=")
        if not is_ or not here or not there.startswith("/"):
            what = f"--worker-root {text!r}: write HERE=THERE, a folder of this machine and what workers call it"
            raise UsageError(what, remedy="for example: --worker-root /srv=/mnt/srv")
        return Mount(Path(here).resolve(), Path(there))

    @property
    def back(self) -> Mount:
        """The way back."""
        return Mount(self.there, self.here)


T = TypeVar("T")


def moved(value: T, mounts: Sequence[Mount]) -> T:
    """The same value with all paths in it as they are called at the other end; the first mount that holds a path counts.

    Parameters
    ----------
    value : T
        Paths, or data classes, tuples, lists and dictionaries of anything.
    mounts : sequence of Mount
        Without any, the value itself.
    """
    return _moved(value, mounts) if mounts else value


def _moved(value: Any, mounts: Sequence[Mount]) -> Any:
    if isinstance(value, Path):
        found = next((mount for mount in mounts if value.is_relative_to(mount.here)), None)
        return found.there / value.relative_to(found.here) if found else value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {f.name: _moved(getattr(value, f.name), mounts) for f in dataclasses.fields(value) if f.init}
        return dataclasses.replace(value, **changed)
    if isinstance(value, dict):
        return {key: _moved(item, mounts) for key, item in value.items()}
    if type(value) in {tuple, list}:
        return type(value)(_moved(item, mounts) for item in value)
    return value
