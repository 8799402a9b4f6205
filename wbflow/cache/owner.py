"""Which site a work folder belongs to: two sites that shared one would be compared with each other's nights."""

from __future__ import annotations

from pathlib import Path

from .. import __version__
from ..errors import UsageError
from .layout import WorkFolder
from .signed import Damaged, read_signed, write_signed

FORMAT = 1
"""Of the work folder; raised when a version of wbflow writes what older ones cannot work with."""
_OF = "work folder"


def claim(work: WorkFolder, site: str, file: Path) -> str | None:
    """Record which site a work folder belongs to; returns a warning where another file of this site has used it before.

    The caller holds the lock.

    Parameters
    ----------
    work : WorkFolder
        The folder.  One that nobody has claimed belongs to the first site that does.
    site, file : str, Path
        Name of the site, which decides, and its file, which may be moved or renamed.

    Raises
    ------
    UsageError
        The folder belongs to another site, or a newer version of wbflow has written it.
    OSError
        The disk is full, or there is no right to write.
    """
    mine = {"site": site, "file": str(file.resolve()), "format": FORMAT, "version": __version__}
    try:
        owner = read_signed(work.owner, _OF) or {}
    except Damaged:
        owner = {}
    if owner.get("format", FORMAT) > FORMAT:
        what = f"{work.root} was written by wbflow {owner.get('version')}, and this is wbflow {mine['version']}"
        raise UsageError(what, remedy="update wbflow, or name another work folder in the site file (work: FOLDER)")
    if owner.get("site", site) != site:
        what = f"{work.root} belongs to the site {owner['site']!r} of {owner.get('file')}, not to {site!r}"
        remedy = f"name another work folder in the site file (work: FOLDER); after renaming a site, remove {work.owner}"
        raise UsageError(what, where=str(file), remedy=remedy)
    if owner != mine:
        write_signed(work.owner, _OF, mine)
    other = owner.get("file", mine["file"])
    if other == mine["file"] or not Path(other).is_file():
        return None
    return f"{other} has used this work folder, too: its nights are among those that tonight is compared with"
