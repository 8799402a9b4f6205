"""Lines at the foot of a terminal that are drawn again and again in their place, each over what it was before.

Nothing is wiped before it is drawn anew: whoever looks in between (a slow line, tmux) sees whole lines, and none flickers.
"""

from __future__ import annotations

import shutil

from ..errors import printable
from .words import echo

_WIPE_REST, _WIPE_BELOW = "\x1b[K", "\x1b[J"
_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"


class InPlace:
    """The lines, on stderr; the cursor rests at the end of the last, and is hidden."""

    def __init__(self) -> None:
        self._height = 0

    def draw(self, lines: list[str], above: str | None = None) -> None:
        """Draw them; none may be wider than the terminal.  above: said for good, above them."""
        hide = _HIDE_CURSOR if self._height == 0 else ""
        said = [] if above is None else [line + _WIPE_REST for line in above.split("\n")]
        drawn = [line + _WIPE_REST for line in lines]
        echo(hide + self._top() + "\n".join([*said, *drawn]) + _WIPE_BELOW, nl=False, err=True)
        self._height = len(lines)

    def say(self, words: str) -> None:
        """Draw one line, as much of it as there is room for."""
        self.draw([printable(words)[: shutil.get_terminal_size().columns - 1]])

    def end(self) -> None:
        """Take them away, if there are any."""
        if not self._height:
            return
        echo(self._top() + _WIPE_BELOW + _SHOW_CURSOR, nl=False, err=True)
        self._height = 0

    def _top(self) -> str:
        return "\r" + (f"\x1b[{self._height - 1}A" if self._height > 1 else "")
