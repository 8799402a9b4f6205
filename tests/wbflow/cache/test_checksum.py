"""Remembered content is used only if it is unchanged and belongs to the expected subject."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wbflow.cache.checksum import Damaged, NoChecksum, dump_with_checksum, parse_checksummed, read_checksummed, write_checksummed

CONTENT = {"points": 12, "names": ["gate", "roof"]}


def test_checksummed_content_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_checksummed(tmp_path / "memo.json", "memo", CONTENT)
    assert read_checksummed(tmp_path / "memo.json", "memo") == CONTENT
    assert json.loads((tmp_path / "memo.json").read_bytes())["points"] == 12
    assert parse_checksummed(dump_with_checksum("memo", CONTENT, in_lines=True), "memo") == CONTENT
    assert dump_with_checksum("memo", CONTENT) == dump_with_checksum("memo", CONTENT)


def test_any_single_changed_byte_is_found() -> None:
    data = dump_with_checksum("memo", CONTENT)
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1
        with pytest.raises(Damaged):
            parse_checksummed(bytes(changed), "memo")


@pytest.mark.parametrize("length", [0, 1, 30, 60])
def test_a_truncated_file_is_refused(length: int) -> None:
    with pytest.raises(Damaged):
        parse_checksummed(dump_with_checksum("memo", CONTENT)[:length], "memo")


def test_content_of_another_subject_is_refused() -> None:
    with pytest.raises(Damaged, match="belongs to frames/gate"):
        parse_checksummed(dump_with_checksum("frames/gate", CONTENT), "frames/roof")


def test_missing_files_and_files_of_earlier_versions_are_not_damaged(tmp_path: Path) -> None:
    assert read_checksummed(tmp_path / "none.json", "memo") is None
    (tmp_path / "old.json").write_text(json.dumps(CONTENT))
    assert read_checksummed(tmp_path / "old.json", "memo") is None
    with pytest.raises(NoChecksum):
        parse_checksummed(b"{}", "memo")
