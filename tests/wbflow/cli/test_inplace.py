"""What somebody sees who looks while lines are drawn over those before."""

from __future__ import annotations

import re

import pytest

from wbflow.cli.inplace import InPlace

_STEP = re.compile(r"\x1b\[(\??\d*)([A-Za-z])|([\r\n])|([^\x1b\r\n]+)")


class Terminal:
    """As much of a terminal as lines that are drawn in place need."""

    def __init__(self) -> None:
        self.rows, self.row, self.column = [""], 0, 0

    def write(self, text: str) -> list[list[str]]:
        """Obey; returns what stands there after each step."""
        return [self._step(*found.groups()) for found in _STEP.finditer(text)]

    def _step(self, count: str, order: str, turn: str, words: str) -> list[str]:
        here = self.rows[self.row]
        if words:
            self.rows[self.row] = here[: self.column].ljust(self.column) + words + here[self.column + len(words) :]
            self.column += len(words)
        elif turn == "\r":
            self.column = 0
        elif turn == "\n":
            self.row, self.column = self.row + 1, 0
            self.rows += [""] * (self.row == len(self.rows))
        elif order == "A":
            self.row -= int(count)
        elif order == "K":
            self.rows[self.row] = here[: self.column]
        elif order == "J":
            self.rows[self.row :] = [here[: self.column]]
        return list(self.rows)


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """All that is written."""
    pieces: list[str] = []
    monkeypatch.setattr("wbflow.cli.inplace.echo", lambda text, nl, err: pieces.append(text))
    return pieces


def test_whoever_looks_in_between_sees_whole_lines_and_no_gap(written: list[str]) -> None:
    place, terminal = InPlace(), Terminal()
    place.draw(["frames 1/4", "depth 0/4", "1 of 8 tasks; about 40 s left"])
    terminal.write(written.pop())
    place.draw(["frames 2/4", "depth 0/4", "2 of 8 tasks; about 9 s left"])
    for seen in terminal.write(written.pop()):
        assert [row.split()[0] for row in seen[:2]] == ["frames", "depth"]
        assert re.match(r"[12] of 8 tasks; about \d+ s left", seen[2])
    assert terminal.rows == ["frames 2/4", "depth 0/4", "2 of 8 tasks; about 9 s left"]


def test_what_is_said_stays_above_and_what_was_drawn_goes(written: list[str]) -> None:
    place, terminal = InPlace(), Terminal()
    place.draw(["frames 1/4", "depth 0/4", "1 of 8 tasks"])
    place.draw(["frames 2/4", "2 of 8 tasks"], above="roof  frames  failed")
    terminal.write("".join(written))
    assert terminal.rows == ["roof  frames  failed", "frames 2/4", "2 of 8 tasks"]
    written.clear()
    place.end()
    place.end()
    terminal.write("".join(written))
    assert terminal.rows == ["roof  frames  failed", ""]
    assert "".join(written).count("\x1b[?25h") == 1


def test_one_line_has_no_more_than_there_is_room_for(written: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    terminal = Terminal()
    InPlace().say("harbour: captures of 3/12 cameras\x1b[2J")
    terminal.write(written.pop())
    assert terminal.rows == ["harbour: captures o"]
