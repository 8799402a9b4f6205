"""Sizes as people write them."""

from __future__ import annotations

import re

_POWERS = " KMGT"


def bytes_of(text: str) -> int:
    """A size in bytes: 4GB, 1.5G, 800 MB, 2GiB.

    Raises
    ------
    ValueError
        It is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(i?)B?\s*", text, re.IGNORECASE)
    if not found or not float(found[1]):
        raise ValueError(f"{text!r} is no size; write for example 50GB or 800MB")
    return int(float(found[1]) * (1024 if found[3] else 1000) ** _POWERS.index(found[2].upper() or " "))


def in_words(size: float) -> str:
    """A size for people: 1.2 GB, 3.4 MB, 12 kB."""
    for power, unit in ((1e9, "GB"), (1e6, "MB")):
        if size >= power:
            return f"{size / power:,.1f} {unit}"
    return f"{size / 1e3:,.0f} kB"
