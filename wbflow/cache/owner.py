"""The site that a work folder belongs to: if two sites shared a folder, each would be compared with the other's nights."""

from __future__ import annotations

from pathlib import Path

from .. import __version__
from ..errors import UsageError
from .checksum import Damaged, read_checksummed, write_checksummed
from .layout import WorkFolder

FORMAT = 1
"""Format version of the work folder; it is increased when wbflow starts to write what older versions cannot use."""
_IDENTITY = "work folder"


def claim(work: WorkFolder, site: str, file: Path) -> str | None:
    """Record which site a work folder belongs to; return a warning if another existing file of this site was the last to use it.

    The caller holds the lock.  An unclaimed folder goes to the first site that claims it.  Sites are identified by name: a site
    file may be moved or renamed.  Raises UsageError if the folder belongs to another site or was written by a newer version of
    wbflow; OSError.
    """
    claimed = {"site": site, "file": str(file.resolve()), "format": FORMAT, "version": __version__}
    try:
        owner = read_checksummed(work.owner, _IDENTITY) or {}
    except Damaged:
        owner = {}
    if owner.get("format", FORMAT) > FORMAT:
        what = f"{work.root} was written by wbflow {owner.get('version')}, and this is wbflow {claimed['version']}"
        raise UsageError(what, remedy="update wbflow, or name another work folder in the site file (work: FOLDER)")
    if owner.get("site", site) != site:
        what = f"{work.root} belongs to the site {owner['site']!r} of {owner.get('file')}, not to {site!r}"
        remedy = f"name another work folder in the site file (work: FOLDER); after renaming a site, remove {work.owner}"
        raise UsageError(what, where=str(file), remedy=remedy)
    if owner != claimed:
        write_checksummed(work.owner, _IDENTITY, claimed)
    previous_file = owner.get("file", claimed["file"])
    if previous_file == claimed["file"] or not Path(previous_file).is_file():
        return None
    return f"{previous_file} has used this work folder, too: tonight is compared with its nights as well"
