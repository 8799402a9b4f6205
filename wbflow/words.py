"""How text from outside, numbers, sizes and times are written for people; and sizes read that people have written."""

from __future__ import annotations

import re
from typing import Any

LONGEST = 500
"""Characters of a reason or a name from outside that are kept."""
LONGEST_TRACE = 8000
"""Of a traceback."""
_UNFIT = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but for the end of a line and the tabulator, what turns the direction of writing, halves of characters."""


def printable(text: object, most: int = LONGEST) -> str:
    """Words from outside (a file's name, an id, what a stage raised) as they may be shown, logged and published.

    Control characters, which a terminal would obey, and bytes that are no text are written as escapes; of what is longer than
    `most` characters the middle is left out.
    """
    words = str(text)
    if len(words) > most:
        half = most // 2
        words = f"{words[:half]} ... ({len(words):,} characters) ... {words[-half:]}"
    return words if words.isprintable() else _UNFIT.sub(_escaped, words)


def counted(number: float, thing: str) -> str:
    """So many of a thing: 1 pair, 1,204 points."""
    return f"{number:,.0f} {thing}{'s' * (round(number) != 1)}"


def bytes_of(text: str) -> int:
    """A size in bytes: 4GB, 1.5G, 800 MB, 2GiB.  Raises ValueError."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(i?)B?\s*", text, re.IGNORECASE)
    if not found or not float(found[1]):
        raise ValueError(f"{text!r} is no size; write for example 50GB or 800MB")
    return int(float(found[1]) * (1024 if found[3] else 1000) ** " KMGT".index(found[2].upper() or " "))


def in_words(size: float) -> str:
    """A size for people: 1.2 GB, 3.4 MB, 12 kB."""
    for power, unit in ((1e9, "GB"), (1e6, "MB")):
        if size >= power:
            return f"{size / power:,.1f} {unit}"
    return f"{size / 1e3:,.0f} kB"


def lasting(seconds: float) -> str:
    """A length of time for people: 40 min, 3 h, 5 days; "" below a minute."""
    for unit, size, least in (("days", 86400, 48 * 3600), ("h", 3600, 3600), ("min", 60, 60)):
        if seconds >= least:
            return f"{seconds / size:.0f} {unit}"
    return ""


def spoken(value: Any) -> str:
    """A number, yes or no, or a word, as people read it."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else f"{value:,}"


def number(value: float) -> str:
    """As people read it: three digits that count, thousands apart."""
    if value == 0 or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def _escaped(found: re.Match[str]) -> str:
    code = ord(found.group())
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name that is no text (PEP 383)
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
