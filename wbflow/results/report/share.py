"""Pictures that the next report has, too, are not kept twice: the earlier report shows them by leading there."""

from __future__ import annotations

import re

from ...store.layout import WorkFolder
from ...store.run_folder import RunFolder

_PICTURE = re.compile(r'<img [^>]*?src="(data:[^"]+)"[^>]*>')


def share_pictures(work: WorkFolder, run: str) -> None:
    """Replace, in the report of the run before, each picture that the newest report holds as well by a link to that one.

    The newest report is always whole; `wbflow report SITE.yaml RUN` makes an earlier one whole again.

    Parameters
    ----------
    work : WorkFolder
        Whose runs.
    run : str
        The newest, published.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    before = [name for name in work.run_ids() if name < run][-1:]
    if not before or before[0] in {work.led_to(link) for link in work.links()}:  # the last good one stays whole
        return
    newest, earlier = work.run(run).report, work.run(before[0]).report
    try:
        here = {match.group(1) for match in _PICTURE.finditer(newest.read_text())}
        page = earlier.read_text()
    except (OSError, ValueError):  # removed, or damaged: nothing to share
        return
    link = f'<a href="../{run}/{newest.name}">the same picture as in the report of run {run}</a>'
    shared = _PICTURE.sub(lambda match: link if match.group(1) in here else match.group(), page)
    if shared != page:
        RunFolder(work.run(before[0])).write_report(shared)
