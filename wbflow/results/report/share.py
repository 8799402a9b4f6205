"""Points, and pictures of pairs, that the next report has, too, are not kept twice: the earlier report leads to that one.

What a page shows unasked (findings, cameras, maps) stays in it.
"""

from __future__ import annotations

import re

from ...store.layout import WorkFolder
from ...store.outside import read_outside
from ...store.run_folder import RunFolder

_PICTURE = re.compile(r'<img data-folded id="([^"]*)" src="(data:[^"]+)"[^>]*>')
_STREAM = re.compile(r'<script type="[^"]+" class="(points|seen)" data-of="(\w+)"[^>]*>([^<]+)</script>')
_VIEWER = re.compile(r'<script class="viewer">.*?</script>\n', re.DOTALL)
"""What shows points: of no use where they are elsewhere."""


def share_pictures(work: WorkFolder, run: str) -> None:
    """Replace, in the report of the run before, each folded picture that the newest report holds as well by a link to that one.

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
        text = read_outside(newest).decode()
        here = {match.group(match.lastindex or 0) for kind in (_PICTURE, _STREAM) for match in kind.finditer(text)}
        page = read_outside(earlier).decode()
    except (OSError, ValueError):  # removed, or damaged: nothing to share
        return
    alike = _alike(work, before[0])
    target = f"../{run}/{newest.name}"

    def picture(match: re.Match[str]) -> str:
        link = f'<a class="elsewhere" id="{match.group(1)}" href="{target}">the same picture as in the report of run {run}</a>'
        return link if match.group(2) in here else match.group()

    own = any(match.group(1) == "points" and match.group(3) not in here for match in _STREAM.finditer(page))

    def stream(match: re.Match[str]) -> str:
        if match.group(3) not in here or (own and match.group(1) == "points"):  # the view is there with all its points, or not
            return match.group()
        return f'<script type="application/json" class="{match.group(1)}-elsewhere">"{target}"</script>'

    shared = _STREAM.sub(stream, _PICTURE.sub(picture, page))
    if shared != page and all(match.group(1) != "points" for match in _STREAM.finditer(shared)):
        shared = _VIEWER.sub("", shared, count=1)
    for name in alike if shared != page else ():
        RunFolder(work.run(name)).write_report(shared)


def _alike(work: WorkFolder, run: str) -> list[str]:
    """A run, and those before it that show the same page under another name, since nothing had changed; not what links show."""
    shown, found = {work.led_to(link) for link in work.links()}, [run]
    for name in reversed([name for name in work.run_ids() if name < run]):
        if not (work.run(name).report.exists() and work.run(name).report.samefile(work.run(run).report)):
            break
        found.append(name)
    return [name for name in found if name not in shown]
