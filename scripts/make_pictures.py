"""Photographs the first look of a run's report in Chromium, headless, as the README shows it.

    wbflow demo nights --nights 7 --frames 3 && wbflow run nights --since 2026-11-10
    scripts/make_pictures.py nights sites/report.jpg

Needs Debian's `chromium`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2

import wbflow
from wbflow.config.load import load_site

WIDTH, HEIGHT = 1280, 810
WAIT_MS = 15_000
"""Of the page's own time, until its points are unpacked and drawn."""


def photograph(page: Path, picture: Path) -> None:
    """Write the first screen of a page as PNG.  Raises subprocess.CalledProcessError, FileNotFoundError."""
    look = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--window-size={WIDTH},{HEIGHT}"]
    command = ["chromium", *look, f"--virtual-time-budget={WAIT_MS}", f"--screenshot={picture}", page.resolve().as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("site", type=Path)
    parser.add_argument("out", type=Path, help="a JPEG file")
    parser.add_argument("--run", default="latest", help="id of the run (default: %(default)s)")
    parser.add_argument("--work", type=Path, help="its work folder")
    arguments = parser.parse_args()
    run = wbflow.open_run(load_site(arguments.site, arguments.work), arguments.run)
    with tempfile.TemporaryDirectory() as folder:
        seen = Path(folder) / "page.png"
        photograph(run.finished.folder.paths.report, seen)
        pixels = cv2.imread(str(seen))
    if pixels is None:
        print("chromium left no picture", file=sys.stderr)
        return 1
    cv2.imwrite(str(arguments.out), pixels, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return 0


if __name__ == "__main__":
    sys.exit(main())
