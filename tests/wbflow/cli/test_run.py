"""What is printed about a night when it has ended."""

from __future__ import annotations

import pytest

from tests.helpers import made_up_run
from wbflow.cli.run import print_findings
from wbflow.records.findings import Finding, Verdict


def test_findings_common_to_many_cameras_are_printed_in_a_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    ids = made_up_run.names(60)
    lost = [Finding("camera-lost", (name,), "there is no capture", remedy="see that it delivers") for name in ids]
    alone = Finding("fewer-points", (), "900 points, 50 % of the usual 1,800", remedy="compare")
    print_findings(made_up_run.record(ids, verdict=Verdict("degraded", (*lost, alone))))
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:4] == [f"  {name}: there is no capture" for name in ids[:3]]
    assert lines[4] == f"  and 57 more like these: {', '.join(ids[3:])}"
    assert lines[5:] == ["    see that it delivers", "  900 points, 50 % of the usual 1,800", "    compare"]
