"""Notifications: sent when a site's state changes, or as set reminders and heartbeats; a failing command harms no night."""

from __future__ import annotations

import datetime
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from tests.wbflow.verdict.test_rules import NAMES, PAIRS, camera, lost, night, pair, without
from wbflow.cache.checksum import read_checksummed, write_checksummed
from wbflow.cache.layout import WorkFolder
from wbflow.cache.store import Cache
from wbflow.records.finished_run import Run
from wbflow.records.metrics import metrics
from wbflow.records.record import RunRecord, moment, stamp
from wbflow.records.run_folder import RunFolder
from wbflow.runner.notify import MOST_WORDS, NotifyFailed, notify, summary
from wbflow.site.load import load_site
from wbflow.site.models import Notify
from wbflow.site.yaml_document import SiteError
from wbflow_stages.contracts.camera_figures import Health

LISTENER = """\
import json, os, sys
told = {"stdin": json.load(sys.stdin), "env": {n: v for n, v in os.environ.items() if n.startswith("WBFLOW_")}}
with open("told.jsonl", "a") as file:
    file.write(json.dumps(told) + "\\n")
"""


class Site:
    """A work folder whose notifications go to a program that writes down what it receives."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        self.work = WorkFolder(folder / "work")
        self.file = folder / "told.jsonl"
        (folder / "listen.py").write_text(LISTENER)
        self.how = Notify(command=[sys.executable, "listen.py"], **settings)
        self.folder = folder

    def send(self, record: RunRecord) -> str | None:
        return notify(self.how, self.folder, Run(RunFolder(self.work.run(record.run)), record, {}, Cache(self.work)))

    @property
    def received(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.file.read_text().splitlines()] if self.file.exists() else []


def down(*names: str, date: str = "2026-11-20") -> RunRecord:
    """A night on which these cameras are lost."""
    pairs = [pair for pair in without(names[0]) if not {pair.left, pair.right} & set(names)]
    return night(date, [lost(name) if name in names else camera(name) for name in NAMES], pairs)


def all_down(date: str = "2026-11-20") -> RunRecord:
    return night(date, [lost(name) for name in NAMES], [], points=0)


def test_each_state_is_reported_once_and_so_is_recovery(tmp_path: Path) -> None:
    site = Site(tmp_path)
    nights = [night(), down("roof"), down("roof"), down("roof", "mast"), all_down(), all_down(), night(), night()]
    occasions = [site.send(record) for record in nights]
    assert occasions == [None, "degraded", None, "degraded", "failed", None, "recovered", None]
    assert [entry["stdin"]["event"] for entry in site.received] == ["degraded", "degraded", "failed", "recovered"]


def test_the_summary_names_the_first_finding_of_each_sort_of_bad_night(tmp_path: Path) -> None:
    site = Site(tmp_path)
    knocked = replace(camera("crane"), health=Health("moved", "turned by 1.9 degrees", remedy="look at its mount"))
    foreign = replace(camera("mast"), health=Health("wrong-scene", "it shows another place", remedy="look at its picture"))
    poor = [pair(*names, *(("ok",) if k == 0 else ("rejected", False))) for k, names in enumerate(PAIRS)]
    nights = [
        down("roof"),
        night(cameras=[knocked, foreign, camera("gate"), camera("roof")]),
        all_down(),
        night(pairs=poor),
        night(),
    ]
    for record in [*nights[:2], *nights[1:]]:  # the second one twice
        site.send(record)
    assert [entry["env"]["WBFLOW_SUMMARY"] for entry in site.received] == [
        "yard 2026-11-20: degraded: roof: roof.jpg is empty (0 bytes); left out tonight",
        "yard 2026-11-20: degraded: crane: turned by 1.9 degrees (and 1 more)",
        "yard 2026-11-20: failed: no cloud: only camera gate has a usable capture (and 4 more)",
        "yard 2026-11-20: degraded: mast: none of its 3 pairs could be used: 23 inliers, 30 needed (and 2 more)",
        "yard 2026-11-20: good; no more camera-no-usable-pair mast, camera-no-usable-pair roof, fewer-pairs",
    ]


def test_a_notification_contains_findings_report_summary_and_event(tmp_path: Path) -> None:
    site = Site(tmp_path)
    record = down("roof")
    site.send(record)
    (entry,) = site.received
    assert record.verdict
    assert entry["stdin"]["findings"] == record.verdict.to_json()["findings"]
    assert entry["stdin"]["report"] == entry["env"]["WBFLOW_REPORT"] == str(site.work.run(record.run).report)
    words = "yard 2026-11-20: degraded: roof: roof.jpg is empty (0 bytes); left out tonight"
    assert entry["env"]["WBFLOW_SUMMARY"] == words
    assert (entry["env"]["WBFLOW_EVENT"], entry["env"]["WBFLOW_EXIT_CODE"]) == ("degraded", "3")


def test_a_heartbeat_is_sent_on_every_night_without_another_event(tmp_path: Path) -> None:
    site = Site(tmp_path, heartbeat=True)
    nights = [night(), night(), down("roof"), down("roof"), night()]
    assert [site.send(record) for record in nights] == ["heartbeat", "heartbeat", "degraded", "heartbeat", "recovered"]


def later(record: RunRecord, hours: float) -> RunRecord:
    """The same record from a run that ended `hours` after that of the 20th (03:16 UTC)."""
    ended = moment("2026-11-20T03:16:00Z") + datetime.timedelta(hours=hours)
    return replace(record, finished=stamp(ended))


def test_reminders_and_recovery_state_how_long_a_bad_state_has_lasted(tmp_path: Path) -> None:
    site = Site(tmp_path, remind=["1h", "1d"])
    after = {
        0: down("roof"),
        0.5: down("roof"),
        1: down("roof"),
        2: down("roof"),
        25: down("roof"),
        48: down("roof"),
        51: night(),
    }
    occasions = [site.send(later(record, hours)) for hours, record in after.items()]
    assert occasions == ["degraded", None, "reminder", None, "reminder", None, "recovered"]
    summaries = [entry["env"]["WBFLOW_SUMMARY"] for entry in site.received]
    assert summaries[1].startswith("yard 2026-11-20: degraded, for 1 h: roof: ")
    assert summaries[2].startswith("yard 2026-11-20: degraded, for 25 h: roof: ")
    assert summaries[3] == "yard 2026-11-20: good, back after 2 days; no more camera-lost roof"
    assert [entry["stdin"]["lasted"] for entry in site.received] == ["", "1 h", "25 h", "2 days"]


def test_reminders_count_from_the_present_state_and_recovery_from_the_first(tmp_path: Path) -> None:
    site = Site(tmp_path, remind=["1h"])
    after = {
        0: down("roof"),
        1.5: down("roof", "mast"),
        2: down("roof", "mast"),
        2.5: down("roof", "mast"),
        3: night(),
        9: night(),
    }
    occasions = [site.send(later(record, hours)) for hours, record in after.items()]
    assert occasions == ["degraded", "degraded", None, "reminder", "recovered", None]
    words = "yard 2026-11-20: good, back after 3 h; no more camera-lost mast, camera-lost roof"
    assert site.received[-1]["env"]["WBFLOW_SUMMARY"] == words
    assert site.received[-1]["stdin"]["recovered"] == ["camera-lost mast", "camera-lost roof"]


def test_a_state_recorded_by_an_older_version_counts_from_now_on(tmp_path: Path) -> None:
    site = Site(tmp_path, remind=["1h"])
    site.send(down("roof"))
    known = read_checksummed(site.work.notified, "notified") or {}
    write_checksummed(site.work.notified, "notified", {"state": known["state"]})
    assert [site.send(later(down("roof"), hours)) for hours in (30, 30.5, 31)] == [None, None, "reminder"]


@pytest.mark.parametrize("length", ["1 hour", "0h", "60", "-1d"])
def test_an_invalid_reminder_interval_is_refused_with_its_place(tmp_path: Path, length: str) -> None:
    (tmp_path / "site.yaml").write_text(
        f"site: s\ncaptures: {{pattern: '{{camera}}'}}\ncameras: [a]\nnotify: {{command: x, remind: [{length}]}}\n"
    )
    with pytest.raises(SiteError, match=r"site.yaml:4:31: notify.remind\[0\]: .* write for example 30min"):
        load_site(tmp_path)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("echo no route to host >&2; exit 7", "ended with 7: no route to host"),
        ("sleep 60", "had not ended after 0.2 s, and was killed"),
        (["no-such-program"], "could not be started"),
    ],
)
def test_a_failed_notification_is_sent_again_the_next_night(tmp_path: Path, command: str | list[str], message: str) -> None:
    site = Site(tmp_path)
    how, site.how = site.how, Notify(command=command, seconds=0.2 if message.startswith("had") else 30)
    with pytest.raises(NotifyFailed, match=message):
        site.send(down("roof"))
    site.how = how
    assert site.send(down("roof")) == "degraded"


def test_a_state_is_reported_again_if_the_memo_is_damaged(tmp_path: Path) -> None:
    site = Site(tmp_path)
    site.send(down("roof"))
    memo = site.work.notified
    memo.write_text(memo.read_text().replace("camera-lost", "camera-last"))
    assert [site.send(record) for record in (down("roof"), down("roof"), night())] == ["degraded", None, "recovered"]
    memo.write_text("{")
    assert site.send(night()) is None


def test_a_summary_is_one_line_of_bounded_length() -> None:
    words = summary(night(cameras=[lost("x\n\x1b[31m" + "y" * 999), *map(camera, NAMES[1:])]))
    assert len(words) == MOST_WORDS
    assert words.isprintable()


def test_a_failing_notify_command_is_logged_and_does_not_harm_the_run(toy: ToySite) -> None:
    site = json.loads(toy.file.read_text())
    toy.file.write_text(json.dumps(site | {"notify": {"command": "cat > told.json; exit 1", "seconds": 20}}))
    toy.run()
    assert not (toy.folder / "told.json").exists()
    toy.capture("roof").write_text("broken")
    record = toy.run(code=3)
    received = json.loads((toy.folder / "told.json").read_text())
    assert received["findings"] == record["verdict"]["findings"]
    assert Path(received["cloud"]).is_file()
    last = json.loads((toy.work / "runs" / "latest" / "log.jsonl").read_text().splitlines()[-1])
    assert "ended with 1: no output" in last["what"]


@pytest.mark.parametrize("command", ["5", "[]", "[a, 5]", "''"])
def test_an_invalid_command_is_refused_with_its_place(tmp_path: Path, command: str) -> None:
    (tmp_path / "site.yaml").write_text(
        f"site: s\ncaptures: {{pattern: '{{camera}}'}}\ncameras: [a]\nnotify: {{command: {command}}}\n"
    )
    with pytest.raises(SiteError, match=r"site.yaml:4:19: notify.command: a command is a text for the shell"):
        load_site(tmp_path)


def test_metrics_describe_a_run_in_the_format_of_prometheus() -> None:
    lines = metrics(down("roof")).splitlines()
    assert 'wbflow_verdict{site="yard",level="degraded"} 1' in lines
    assert 'wbflow_verdict{site="yard",level="good"} 0' in lines
    assert 'wbflow_findings{site="yard",kind="camera-lost"} 1' in lines
    assert 'wbflow_camera_ok{site="yard",camera="roof"} 0' in lines
    assert 'wbflow_points{site="yard"} 100000' in lines
    assert 'wbflow_finished_timestamp_seconds{site="yard"} 1795144560' in lines
    names = [line.split()[2] for line in lines if line.startswith("# TYPE")]
    assert len(names) == len(set(names))
    assert all(line.startswith("#") or line.split("{")[0] in names for line in lines)


def test_labels_are_quoted_for_prometheus() -> None:
    record = night(cameras=[camera('a"b\\c\nd'), *map(camera, NAMES[1:])])
    assert 'camera="a\\"b\\\\c\\nd"' in metrics(record)
