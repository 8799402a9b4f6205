"""What a night has to say about changes: on the terminal, in cron's mail, in the history, and in messages."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cli.main import main

NIGHTS = {
    "2026-11-15": "",
    "2026-11-16": "stack -3",
    "2026-11-17": "stack -3, van 5, box 9",
    "2026-11-18": "van 5, box 12",
}
LISTENER = """\
import json, os, sys
with open("told.jsonl", "a") as file:
    file.write(json.dumps({**json.load(sys.stdin), "env": dict(os.environ)}) + "\\n")
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A dated site with captures of four nights; the first one becomes the reference."""
    monkeypatch.syspath_prepend(str(HELPERS))
    toy = ToySite(tmp_path / "site", ["gate", "roof"], dated=True, compares=True, watched=True, backend="threading")
    (toy.folder / "listen.py").write_text(LISTENER)
    toy.keys = {"notify": {"command": [sys.executable, "listen.py"]}}
    toy.write()
    for date, things in NIGHTS.items():
        toy.things(date, things)
    return toy


def wbflow(site: ToySite, command: str, *words: str) -> Result:
    return CliRunner().invoke(main, [command, str(site.file), *words], env=site.env())


def run(site: ToySite, date: str, *words: str) -> Result:
    return wbflow(site, "run", "--date", date, "--backend", "threading", "--jobs", "1", *words)


def told(site: ToySite) -> list[dict[str, Any]]:
    """The messages since the last call."""
    file = site.folder / "told.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    file.unlink(missing_ok=True)
    return [json.loads(line) for line in lines]


def test_the_first_line_of_a_night_says_what_has_changed(site: ToySite) -> None:
    lines = []
    size = "2.0 x 1.4 x 2.6 m at"
    for date in NIGHTS:
        done = run(site, date)
        assert done.exit_code == 0, done.output
        lines.append(next(line for line in done.output.splitlines() if line.startswith("toy, night of")))
    assert lines == [
        "toy, night of 2026-11-15: good: nothing to look at",
        f"toy, night of 2026-11-16: good, 1 change: C1 vanished {size} 5.0, 15.3",
        f"toy, night of 2026-11-17: good, 3 changes: C2 new {size} 3.0, 15.3; C3 new {size} 3.0, 15.3; "
        f"C1 vanished since 2026-11-16, {size} 5.0, 15.3",
        f"toy, night of 2026-11-18: good, 2 changes: C3 new since 2026-11-17, grown to {size} 3.0, 15.3; "
        f"C2 new since 2026-11-17, {size} 3.0, 15.3; C1 gone",
    ]
    history = wbflow(site, "history").output
    assert "good, 3 changes" in history
    assert "C2 new 2.0 x 1.4 x 2.6 m at 3.0, 15.3" in history


def test_a_quiet_run_is_silent_once_every_change_is_acknowledged(site: ToySite) -> None:
    run(site, "2026-11-15")
    for expected in ("good, 1 change: C1 vanished", ""):
        done = run(site, "2026-11-16", "-q")
        assert (done.exit_code, done.stdout) == (0, "")
        assert expected in done.stderr
        assert bool(expected) == bool(done.stderr)
        wbflow(site, "acknowledge", "C1", "--note", "it was sold")
    assert "good: nothing to look at; 1 change acknowledged" in run(site, "2026-11-16").output


def test_each_change_is_told_once_when_it_is_new_and_when_it_has_grown(site: ToySite) -> None:
    messages = []
    for date in NIGHTS:
        run(site, date)
        run(site, date)
        messages.append([(message["event"], [change["id"] for change in message["changes"]]) for message in told(site)])
    assert messages == [[], [("changed", ["C1"])], [("changed", ["C2", "C3"])], [("changed", ["C3"])]]


def test_a_message_has_size_place_volume_and_picture_of_each_change(site: ToySite) -> None:
    for date in ("2026-11-15", "2026-11-16", "2026-11-17"):
        run(site, date)
    message = told(site)[-1]
    assert message["summary"] == (
        "toy 2026-11-17: good; 2 changes: C2 new 2.0 x 1.4 x 2.6 m at 3.0, 15.3, 4.0 to 6.0 m³; "
        "C3 new 2.0 x 1.4 x 2.6 m at 3.0, 15.3, 8.0 to 10.0 m³"
    )
    assert (message["level"], message["exit_code"], message["open"]) == ("good", 0, 3)
    van = message["changes"][0]
    assert (van["volume_least"], van["volume_most"], van["zone"], van["first"]) == (4.0, 6.0, "van", "2026-11-17")
    for role, name in {"before": "change-C2-before.jpg", "after": "change-C2-after.jpg", "picture": "change-C2.jpg"}.items():
        assert Path(van[role]).name == name
        assert Path(van[role]).is_file()
        assert message["env"][f"WBFLOW_{role.upper()}"] == message[role] == van[role], "those of the first change"


@pytest.mark.parametrize(
    ("wanted", "ids"),
    [
        ({"min_volume": 7}, [["C3"]]),
        ({"zones": ["van"]}, [["C2"]]),
        (False, []),
        ({"min_volume": 3.5, "zones": ["stack"]}, [["C1"]]),
    ],
)
def test_the_site_file_says_which_changes_are_told(site: ToySite, wanted: Any, ids: list[list[str]]) -> None:
    corners = [[0, 0], [1, 0], [0, 1]]
    site.keys = {
        "notify": {"command": [sys.executable, "listen.py"], "changes": wanted},
        "zones": [{"name": name, "polygon": corners} for name in ("van", "stack")],
    }
    site.write()
    for date in ("2026-11-15", "2026-11-16", "2026-11-17"):
        run(site, date)
    assert [[change["id"] for change in message["changes"]] for message in told(site)] == ids


def test_a_message_that_failed_is_sent_after_the_next_run(site: ToySite) -> None:
    site.keys["notify"] = {"command": "exit 1"}
    site.write()
    for date in ("2026-11-15", "2026-11-16"):
        assert run(site, date).exit_code == 0
    site.keys["notify"] = {"command": [sys.executable, "listen.py"]}
    site.write()
    run(site, "2026-11-17")
    assert [change["id"] for message in told(site) for change in message["changes"]] == ["C2", "C3", "C1"]


def test_the_rerun_of_an_old_night_is_no_news(site: ToySite) -> None:
    for date in ("2026-11-15", "2026-11-16", "2026-11-17"):
        run(site, date)
    told(site)
    site.things("2026-11-16", "stack -3, shed 40")
    assert "C4" not in run(site, "2026-11-16").output
    assert told(site) == []


def test_a_change_where_none_is_expected_degrades_the_night_until_it_is_acknowledged(site: ToySite) -> None:
    site.keys["expect"] = {"changes": "none"}
    site.write()
    run(site, "2026-11-15")
    done = run(site, "2026-11-16")
    assert done.exit_code == 3
    assert "degraded, 1 change: C1 vanished" in done.output
    assert "look at its pictures in the report; if it may stay: wbflow acknowledge" in done.output
    wbflow(site, "acknowledge", "C1")
    assert run(site, "2026-11-16").exit_code == 0


def test_an_unexpected_change_sends_one_message(site: ToySite) -> None:
    site.keys["expect"] = {"changes": "none"}
    site.write()
    for date in ("2026-11-15", "2026-11-16", "2026-11-16", "2026-11-17", "2026-11-18"):
        run(site, date)
    messages = told(site)
    news = [(message["event"], [change["id"] for change in message["changes"]]) for message in messages]
    assert news == [("degraded", ["C1"]), ("degraded", ["C2", "C3"]), ("degraded", ["C3"])]
    assert messages[0]["summary"] == (
        "toy 2026-11-16: degraded; 1 change: C1 vanished 2.0 x 1.4 x 2.6 m at 5.0, 15.3, 2.0 to 4.0 m³"
    )
    assert [finding["kind"] for finding in messages[0]["findings"]] == ["unexpected-change"]


def test_a_recovered_night_tells_its_changes_in_the_same_message(site: ToySite) -> None:
    run(site, "2026-11-15")
    site.capture("roof", "2026-11-16").write_text("obscured: roof")
    run(site, "2026-11-16")
    told(site)
    run(site, "2026-11-17")
    (message,) = told(site)
    assert message["event"] == "recovered"
    assert {"C2", "C3"} <= {change["id"] for change in message["changes"]}
    assert "camera-obscured roof" in message["recovered"]
    assert message["summary"].startswith("toy 2026-11-17: good; no more camera-obscured roof, no-cloud; 3 changes: C1 vanished ")


def test_a_message_without_changes_has_no_pictures(site: ToySite) -> None:
    site.keys["notify"] = {"command": [sys.executable, "listen.py"], "heartbeat": True}
    site.write()
    for date in ("2026-11-15", "2026-11-16"):
        run(site, date)
    heartbeat, changed = told(site)
    assert (heartbeat["event"], heartbeat["changes"], heartbeat["before"], heartbeat["env"]["WBFLOW_AFTER"]) == (
        "heartbeat", [], "", ""
    )  # fmt: skip
    assert changed["event"] == "changed", "a change is told instead of a heartbeat"


def test_a_night_after_a_bad_one_says_what_is_no_more(site: ToySite) -> None:
    run(site, "2026-11-15")
    site.capture("roof", "2026-11-16").write_text("obscured: roof")
    done = run(site, "2026-11-16")
    assert done.exit_code != 0
    done = run(site, "2026-11-17")
    assert done.exit_code == 0
    line = next(line for line in done.output.splitlines() if line.startswith("toy, night of"))
    assert "; no more " in line
    assert "camera-obscured roof" in line


def test_a_zone_to_notify_of_must_exist(site: ToySite) -> None:
    site.keys = {
        "notify": {"command": "true", "changes": {"zones": ["quai"]}},
        "zones": [{"name": "quay", "polygon": [[0, 0], [1, 0], [0, 1]]}],
    }
    site.write()
    done = run(site, "2026-11-15")
    assert done.exit_code == 2
    assert "notify.changes.zones[0]: there is no zone 'quai'" in done.output
    assert "did you mean 'quay'?" in done.output
