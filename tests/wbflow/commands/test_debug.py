"""`wbflow debug`: the inputs of one task as files, and a script that runs it alone."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow.cli.main import main


def debug(toy: ToySite, *words: str, code: int = 0) -> str:
    result = CliRunner().invoke(main, ["debug", str(toy.file), *words, "--out", str(toy.folder / "look")], env=toy.env())
    assert result.exit_code == code, result.output
    return result.output


def script_output(toy: ToySite) -> str:
    script = toy.folder / "look" / "run.py"
    assert len(script.read_text().splitlines()) <= 12
    done = subprocess.run([sys.executable, str(script)], env=toy.env(), capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def test_the_script_reproduces_the_bytes_in_the_cache(toy: ToySite) -> None:
    toy.run()
    printed = debug(toy, "fuse")
    assert f"now try  python {toy.folder / 'look' / 'run.py'}" in printed
    assert "the same bytes as the cache has" in script_output(toy)
    (cached,) = (toy.work / "cache" / "fuse").glob("*/*.ply")
    assert (toy.folder / "look" / "result.ply").read_bytes() == cached.read_bytes()


def test_the_script_gives_other_bytes_for_a_changed_parameter(toy: ToySite) -> None:
    toy.run()
    debug(toy, "disparity", "gate--roof")
    file = toy.folder / "look" / "task.json"
    file.write_text(file.read_text().replace('"tolerance": 1.0', '"tolerance": 2.0'))
    assert "other bytes than the cache has" in script_output(toy)


def test_the_script_of_a_failed_task_raises_the_same_error(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.run(code=3)
    debug(toy, "frames roof")
    assert (toy.folder / "look" / "inputs" / "captures.0.roof.txt").read_text() == "broken"
    assert "ValueError: roof.txt is not an image" in script_output(toy)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("frames", "rof"), "did you mean 'frames roof'?"),
        (("coffee",), "there is no stage 'coffee'"),
        (("matches gate--roof",), "'matches gate--roof' waits for 'pairs', which has not been made yet"),
        (("poses",), "--until pairs"),
        ((), "name a task"),
    ],
)
def test_tasks_that_cannot_be_debugged_are_refused_with_a_remedy(toy: ToySite, words: tuple[str, ...], message: str) -> None:
    toy.run("--until", "frames")
    assert message in debug(toy, *words, code=2)


def test_the_runs_command_lists_paths_of_cloud_and_report(toy: ToySite) -> None:
    record = toy.run()
    result = CliRunner().invoke(main, ["runs", str(toy.file), "--json"])
    (listed,) = json.loads(result.stdout)
    assert (listed["site"], listed["run"], listed["level"]) == ("toy", record["run"], "good")
    assert Path(listed["cloud"]).read_bytes() == toy.cloud
    assert Path(listed["report"]).is_file()


def test_the_site_report_lists_all_sites_of_a_folder_the_worst_first(toy: ToySite) -> None:
    toy.run()
    (toy.folder.parent / "other").mkdir()
    (toy.folder.parent / "other" / "site.yaml").write_text(
        "site: other\ncaptures: {pattern: x}\ncameras: [a, b]\n'<script>': 1\n"
    )
    (toy.folder.parent / "notes.yaml").write_text("nothing: of ours\n")
    out = toy.folder.parent / "www" / "sites.html"
    result = CliRunner().invoke(main, ["site-report", str(toy.folder.parent), "--out", str(out)])
    assert result.exit_code == 0, result.output
    page = out.read_text()
    assert page.index('id="other"') < page.index('id="toy"')
    assert "notes.yaml" not in page
    assert "<script>" not in page
    assert 'class="badge good"' in page
    link = page.split('<a href="')[1].split('"')[0]
    assert (out.parent / link).resolve() == (toy.work / "runs" / "latest" / "report.html").resolve()
