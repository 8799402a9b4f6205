"""Ids of cameras and sites: made of the names that people give, in whatever script."""

from __future__ import annotations

import re
from collections.abc import Iterable

_LONGEST = 90
"""Characters of an id that is made of a name; some are left for a number."""


def as_id(name: str) -> str:
    """A name as an id that still resembles it: Tor süd becomes Tor-sud, Ещё Eshche, and what is no letter or digit `-`.

    A name of nothing but signs is written as their code points (`!!` as u21-u21), so that it is never lost.
    """
    from anyascii import anyascii  # here: only new sites and mistakes need its tables

    written = _joined(anyascii(name))
    return written or _joined("-".join(f"u{ord(letter):x}" for letter in name))


def _joined(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text)[:_LONGEST].strip("-.")


def unique_ids(names: Iterable[str]) -> list[str]:
    """An id for each name; names that become the same id get numbers: gate, gate-2."""
    ids: list[str] = []
    for name in names:
        base = as_id(name) or "unnamed"
        identity = base
        number = 1
        while identity in ids:
            number += 1
            identity = f"{base}-{number}"
        ids.append(identity)
    return ids
