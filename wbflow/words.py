"""Formats untrusted text, numbers, sizes and times for people, and parses sizes that people write."""

from __future__ import annotations

import re
from typing import Any

LONGEST = 500
"""Longest reason or name from outside, in characters."""
LONGEST_TRACE = 8000
"""Longest traceback, in characters."""
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters to escape: controls other than newline and tab, line separators and bidirectional marks, and lone surrogates."""

DISK_FULL_REMEDY = "free some space (wbflow clean SITE.yaml --keep 3), or limit what is kept (`keep:` in the site file)"


def printable(text: object, most: int = LONGEST) -> str:
    """Return text from outside (a file name, an id, a stage's exception) in a form that is safe to show, log and publish.

    Control characters, which a terminal would obey, and undecodable bytes are written as escapes.  The middle of a text longer
    than `most` characters is left out.
    """
    words = str(text)
    if len(words) > most:
        half = most // 2
        words = f"{words[:half]} ... ({len(words):,} characters) ... {words[-half:]}"
    return words if words.isprintable() else _UNPRINTABLE.sub(_escape, words)


def counted(number: float, thing: str) -> str:
    """A count with its noun: 1 pair, 1,204 points."""
    return f"{number:,.0f} {thing}{'s' * (round(number) != 1)}"


def bytes_of(text: str) -> int:
    """Parse a size such as 4GB, 1.5G, 800 MB or 2GiB into bytes.  Raises ValueError."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(i?)B?\s*", text, re.IGNORECASE)
    if not match or not float(match[1]):
        raise ValueError(f"{text!r} is not a size; write for example 50GB or 800MB")
    return int(float(match[1]) * (1024 if match[3] else 1000) ** " KMGT".index(match[2].upper() or " "))


def format_size(size: float) -> str:
    """A size for people: 1.2 GB, 3.4 MB, 12 kB."""
    for power, unit in ((1e9, "GB"), (1e6, "MB")):
        if size >= power:
            return f"{size / power:,.1f} {unit}"
    return f"{size / 1e3:,.0f} kB"


def format_duration(seconds: float) -> str:
    """A duration for people: 40 min, 3 h, 5 days; "" below a minute."""
    for unit, size, least in (("days", 86400, 48 * 3600), ("h", 3600, 3600), ("min", 60, 60)):
        if seconds >= least:
            return f"{seconds / size:.0f} {unit}"
    return ""


def format_value(value: Any) -> str:
    """A value for people: yes or no for a bool, a formatted number, or the string itself."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else f"{value:,}"


def number(value: float) -> str:
    """A number for people: three significant digits; from 100 on, whole with thousands separators."""
    if value == 0 or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def _escape(match: re.Match[str]) -> str:
    code = ord(match.group())
    if 0xDC80 <= code <= 0xDCFF:  # an undecodable byte of a file name (PEP 383)
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
