"""Units that have systemd run a site every night."""

from __future__ import annotations

import getpass
import sys
from pathlib import Path

from ..cache.atomic import write_atomic
from ..site.models import Site

_SERVICE = """\
[Unit]
Description=wbflow: the night's work of {name}
Wants=network-online.target
After=network-online.target
# OnFailure=mail@%n.service     is also started after a degraded night (exit code 3); SuccessExitStatus=3 below prevents that

[Service]
Type=oneshot
User={user}
ExecStart={python} -m wbflow run {file} -q{capture} --stop-at 06:00
TimeoutStartSec=6h
# the run ends its workers itself, and keeps what is finished
KillMode=mixed
Nice=10
NoNewPrivileges=yes
PrivateTmp=yes
ProtectSystem=full
"""

_TIMER = """\
[Unit]
Description=wbflow: {name} every night

[Timer]
OnCalendar=*-*-* 03:30:00
# a machine that slept works through the night when it wakes
Persistent=true

[Install]
WantedBy=timers.target
"""


def write_units(site: Site) -> list[Path]:
    """Write a service and a timer beside the site file; returns them.  Raises OSError."""
    captures = any(entry.url for entry in site.settings.cameras)
    file = '"' + str(site.file.resolve()).replace("%", "%%").replace('"', '\\"') + '"'
    filled = {"name": site.name, "user": getpass.getuser(), "python": sys.executable, "file": file}
    units = {"service": _SERVICE.format(**filled, capture=" --capture" if captures else ""), "timer": _TIMER.format(**filled)}
    paths = [site.folder / f"wbflow-{site.name}.{kind}" for kind in units]
    for path, text in zip(paths, units.values(), strict=True):
        write_atomic(path, text.encode())
    return paths
