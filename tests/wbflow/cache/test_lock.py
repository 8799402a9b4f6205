"""A work folder belongs to one site: another site is refused; the same one, moved, copied or renamed on disk, is not."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow.cache import owner
from wbflow.cache.layout import WorkFolder
from wbflow.cache.owner import claim
from wbflow.cli.main import main
from wbflow.errors import UsageError


@pytest.fixture
def work(tmp_path: Path) -> WorkFolder:
    return WorkFolder(tmp_path / "work")


def test_another_site_is_refused_with_exit_code_2_and_leaves_no_run(toy: ToySite) -> None:
    toy.run()
    runs = list((toy.work / "runs").iterdir())
    other = toy.folder / "other.yaml"
    other.write_text(json.dumps(json.loads(toy.file.read_text()) | {"site": "harbour", "work": str(toy.work)}))
    refused = CliRunner().invoke(main, ["run", str(other)], env=toy.env())
    assert refused.exit_code == 2
    assert "belongs to the site 'toy'" in refused.output
    assert "work: FOLDER" in refused.output
    assert list((toy.work / "runs").iterdir()) == runs
    assert toy.run()["exit_code"] == 0


def test_a_renamed_site_is_accepted_once_the_record_is_removed(work: WorkFolder, tmp_path: Path) -> None:
    claim(work, "old", tmp_path / "site.yaml")
    with pytest.raises(UsageError, match=r"remove .*site\.json"):
        claim(work, "new", tmp_path / "site.yaml")
    work.owner.unlink()
    assert claim(work, "new", tmp_path / "site.yaml") is None


def test_a_moved_work_folder_and_a_renamed_site_file_are_accepted(work: WorkFolder, tmp_path: Path) -> None:
    claim(work, "yard", tmp_path / "site.yaml")
    shutil.move(work.root, tmp_path / "elsewhere")
    assert claim(WorkFolder(tmp_path / "elsewhere"), "yard", tmp_path / "renamed.yaml") is None


def test_two_site_files_with_the_same_site_name_give_a_warning(work: WorkFolder, tmp_path: Path) -> None:
    for name in ("one.yaml", "two.yaml"):
        (tmp_path / name).touch()
    assert claim(work, "yard", tmp_path / "one.yaml") is None
    assert "one.yaml has used this work folder" in (claim(work, "yard", tmp_path / "two.yaml") or "")
    assert "two.yaml has used this work folder" in (claim(work, "yard", tmp_path / "one.yaml") or "")
    assert claim(work, "yard", tmp_path / "one.yaml") is None


def test_a_folder_written_by_a_newer_version_is_refused_with_a_remedy(
    work: WorkFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, "FORMAT", owner.FORMAT + 1)
    claim(work, "yard", tmp_path / "site.yaml")
    monkeypatch.undo()
    with pytest.raises(UsageError, match=r"was written by wbflow .*\n.*update wbflow"):
        claim(work, "yard", tmp_path / "site.yaml")


def test_a_damaged_owner_record_is_written_again(work: WorkFolder, tmp_path: Path) -> None:
    claim(work, "yard", tmp_path / "site.yaml")
    whole = work.owner.read_bytes()
    work.owner.write_bytes(whole[:-9])
    assert claim(work, "yard", tmp_path / "site.yaml") is None
    assert work.owner.read_bytes() == whole
