"""When a site runs next, as far as this machine knows: from its systemd timer, and from the crontabs that may be read."""

from __future__ import annotations

import fnmatch
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from ..site.models import Site

_ANSWER_SECONDS = 5.0
"""How long to wait for cron's and systemd's programs.  Larger: `wbflow status` may hang longer on a broken machine."""
_SYSTEM_CRONTABS = ("/etc/crontab", "/etc/cron.d")
_TIME_FIELDS = 5
"""A line of a crontab begins with minute, hour, day, month and weekday, unless it begins with a word such as @daily."""


def next_run(site: Site) -> str:
    """Return when a site runs next, in words; "" if nothing on this machine is known to run it."""
    timer = f"wbflow-{site.name}.timer"  # as `wbflow init --systemd` names it
    moment = _output_of("systemctl", "show", timer, "--property=NextElapseUSecRealtime", "--value").strip()
    if moment:
        return f"{moment} ({timer})"
    for line in _crontab_lines():
        if _runs(line, site):
            words = line.split()
            times = words[:1] if line.startswith("@") else words[:_TIME_FIELDS]
            return f"{' '.join(times)} (crontab)"
    return ""


def _crontab_lines() -> Iterator[str]:
    """Yield the lines of this user's crontab and of the system's, without comments."""
    texts = [_output_of("crontab", "-l")]
    for name in _SYSTEM_CRONTABS:
        place = Path(name)
        for file in sorted(place.iterdir()) if place.is_dir() else [place]:
            try:
                texts.append(file.read_text(errors="replace"))
            except OSError:  # not there, or not for this user
                continue
    for text in texts:
        for line in text.splitlines():
            entry = line.strip()
            if entry and not entry.startswith("#"):
                yield entry


def _runs(line: str, site: Site) -> bool:
    """Does a line of a crontab run wbflow on this site: on its file, on its folder, or on a pattern that fits them?"""
    if "wbflow" not in line:
        return False
    names = {str(site.file), str(site.file.resolve()), str(site.folder), str(site.folder.resolve())}
    words = [word.strip("\"'").rstrip("/") for word in line.split()]
    return any(fnmatch.fnmatch(name, word) for name in names for word in words if "/" in word)


def _output_of(*command: str) -> str:
    """Return what a program prints; "" if it is not installed, fails, or does not answer."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_ANSWER_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""
