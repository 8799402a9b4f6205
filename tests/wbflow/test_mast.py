"""The whole product on a scene without measurable depth: cameras on one mast, with known lenses and unknown poses."""

from __future__ import annotations

import json
from pathlib import Path

import scenes  # noqa: F401 - registers the scene with the demo
from click.testing import CliRunner

import wbflow
from wbflow.cli.main import main
from wbflow.commands.demo import write_demo


def test_cameras_on_one_mast_make_no_cloud_for_lack_of_a_baseline(tmp_path: Path) -> None:
    folder = tmp_path / "mast"
    write_demo(folder, scene="mast", small=True, cameras=3, captures=1, seed=3)
    cameras = json.loads((folder / "cameras.json").read_text())
    lenses = {name: {key: camera[key] for key in camera if key not in "RC"} for name, camera in cameras.items()}
    (folder / "cameras.json").write_text(json.dumps(lenses))
    result = CliRunner().invoke(main, ["run", str(folder), "--jobs", "1", "--backend", "threading"])
    assert result.exit_code == 1, result.output
    record = wbflow.open_run(folder).record
    assert record.cloud is None and {pair.outcome for pair in record.pairs} == {"rejected"}
    assert record.reason is not None
    assert "no usable baseline: the rays of the matches meet at 0." in record.reason and "baselines away" in record.reason
    assert "skipped" not in record.reason
