"""Consecutive nights of a site: the verdict on each, and where its files are found."""

from __future__ import annotations

import json
import shutil
from typing import Any

from tests.helpers.toy_site import ToySite


def kinds(record: dict[str, Any]) -> list[tuple[str, list[str]]]:
    return [(finding["kind"], finding["subject"]) for finding in record["verdict"]["findings"]]


def test_two_cameras_lost_for_a_night_degrade_only_that_night(toy: ToySite) -> None:
    first = toy.run()
    assert first["verdict"] == {"level": "good", "findings": []}
    for name in ("crane", "roof"):
        toy.capture(name).write_text("broken")
    second = toy.run(code=3)
    assert second["verdict"]["level"] == "degraded"
    assert kinds(second) == [
        ("camera-lost", ["roof"]),
        ("camera-lost", ["crane"]),
        ("fewer-points", []),
        ("fewer-pairs", []),
    ]
    assert second["verdict"]["findings"][3]["text"] == "1 pair, 17 % of the usual 6"
    for name in ("crane", "roof"):
        toy.capture(name).write_text(f"the next view from {name}")
    third = toy.run()
    assert third["verdict"] == {"level": "good", "findings": []}
    concerned = {task for task in toy.ran() if "crane" in task or "roof" in task}
    whole = {"overlap", "pairs", "poses", "fuse", *(f"depth {name}" for name in toy.cameras)}
    assert toy.ran() - concerned <= whole
    assert {"frames crane", "frames roof", "matches crane--mast-1"} & toy.ran()


def test_a_night_of_broken_captures_fails_and_reports_every_camera(toy: ToySite) -> None:
    good = toy.run()
    for name in toy.cameras:
        toy.capture(name).write_text("broken")
    result = toy.wbflow("run", "-q", "--jobs", "1")
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr.splitlines()[0].endswith(": failed")
    assert all(f"{name}: {name}.txt is not an image" in result.stderr for name in toy.cameras)
    runs = toy.work / "runs"
    record = json.loads((runs / "latest" / "run.json").read_text())
    assert record["run"] != good["run"]
    assert record["verdict"]["level"] == "failed"
    page = (runs / "latest" / "report.html").read_text()
    body = page[page.index("<body>") :]
    assert body.index("no cloud: no camera has a usable capture") < body.index("<h2>")
    assert (runs / "latest-good").resolve().name == good["run"]


def test_a_night_without_files_fails_and_names_the_folder_of_captures(toy: ToySite) -> None:
    for name in toy.cameras:
        toy.capture(name).unlink()
    toy.backend = "threading"
    record = toy.run(code=1)
    captures = str(toy.folder / "captures")
    first, *others = (finding["text"] for finding in record["verdict"]["findings"])
    wanted = f"captures.pattern wants {toy.cameras[0]}.txt, and there is no file at all in {captures}"
    assert first == f"no cloud: no camera has a usable capture of this night: {wanted}"
    assert others == [f"no capture: there is no file {name}.txt; left out tonight" for name in toy.cameras]


def test_a_date_without_captures_names_the_nights_that_have_some(toy: ToySite) -> None:
    toy = ToySite(toy.folder / "dated", ["gate", "roof", "crane"], dated=True, backend="threading")
    toy.night("2026-11-02")
    record = toy.run("--date", "2026-11-12", code=1)
    first = record["verdict"]["findings"][0]
    nearest = "there are 2 other nights with captures, the nearest 2026-11-01, 2026-11-02"
    assert first["text"] == f"no cloud: no camera has a usable capture of this night: {nearest}"
    assert first["remedy"].endswith("name another night: wbflow run SITE.yaml --date DAY")
    assert "follows" not in first


def test_quiet_prints_only_the_findings_of_a_bad_night(toy: ToySite) -> None:
    result = toy.wbflow("run", "-q", "--jobs", "1")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    toy.capture("roof").write_text("broken")
    result = toy.wbflow("run", "-q", "--jobs", "1")
    assert result.returncode == 3
    assert result.stderr.count("roof.txt is not an image") == 1
    assert "it is used again as soon as it delivers usable captures" in result.stderr


def test_expectations_in_the_site_file_are_applied_and_checked(toy: ToySite) -> None:
    toy.run()
    toy.capture("roof").write_text("broken")
    site = json.loads(toy.file.read_text())
    toy.file.write_text(json.dumps(site | {"expect": {"points": 0.3, "pairs": 3, "cameras": 0.75}}))
    assert kinds(toy.run()) == [("camera-lost", ["roof"])]
    toy.file.write_text(json.dumps(site | {"expect": {"pionts": 0.3}}))
    assert "did you mean 'points'?" in toy.wbflow("run").stderr


def test_a_work_folder_copied_without_links_can_be_used(toy: ToySite) -> None:
    """`cp -rL` turns the links `latest` and `latest-good` into folders."""
    first = toy.run()
    for name in ("latest", "latest-good"):
        link = toy.work / "runs" / name
        copy = shutil.copytree(link, toy.work / f"copy-{name}")
        link.unlink()
        copy.rename(link)
    second = toy.run()
    runs = toy.work / "runs"
    assert [(runs / name).readlink().name for name in ("latest", "latest-good")] == [second["run"]] * 2
    assert (runs / first["run"] / "run.json").is_file()
    assert {path.name for path in (toy.work / "quarantine").iterdir()} == {"latest-1", "latest-good-1"}
