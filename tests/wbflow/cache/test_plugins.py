"""Functions of modules are found by their dotted names, whoever else imports these at the same time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from wbflow.cache.plugins import load


def test_threads_that_load_from_one_module_wait_until_it_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow_to_import.py").write_text("import time\n\ntime.sleep(0.2)\n\n\ndef stage():\n    return 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with ThreadPoolExecutor(4) as threads:
        assert [f() for f in threads.map(load, ["slow_to_import:stage"] * 4)] == [1] * 4
