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
            fields = 1 if line.startswith("@") else _TIME_FIELDS
            times = " ".join(line.split()[:fields])
            return f"{times} (crontab)"
    return ""


def _crontab_lines() -> Iterator[str]:
    """Yield the lines of this user's crontab and of the system's, without comments."""
    texts = [_output_of("crontab", "-l")]
    for name in _SYSTEM_CRONTABS:
        place = Path(name)
        files = [place]
        if place.is_dir():
            files = sorted(place.iterdir())
        for file in files:
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
    for word in line.split():
        path = word.strip("\"'").rstrip("/")
        # a cron job has no folder of its own, so that a path without one says nothing
        if "/" in path and any(fnmatch.fnmatch(name, path) for name in names):
            return True
    return False


def _output_of(*command: str) -> str:
    """Return what a program prints; "" if it is not installed, fails, or does not answer."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_ANSWER_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    if done.returncode != 0:
        return ""
    return done.stdout
