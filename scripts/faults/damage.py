"""Damaged files: every kind of file in the work folder is corrupted, truncated, removed or swapped with another one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from tests.helpers.toy_site import ToySite

from .bench import Bench, Row, set_parameters

OTHER = {"disparity": {"tolerance": 2.0}}
"""With these parameters, the tasks that read most artifacts run again."""

SORTS = {
    "receipt": "cache/*/*/*.json",
    "artifact": "cache/*/*/*.wbf",
    "cloud in the cache": "cache/*/*/*.ply",
    "picture": "cache/*/*/*.jpg",
    "keypoints of a picture": "cache/*/*/*.marks",
    "captures memo": "cache/captures.json",
    "functions memo": "cache/functions.json",
    "intact memo": "cache/intact.json",
    "memo of the last whole night": "cache/unchanged.*",
    "points of the view": "cache/*/*/*.view",
    "delivered": "delivered.json",
    "ledger": "ledger.sqlite*",
    "lock": "lock",
    "run.json": "runs/*/run.json",
    "log": "runs/*/log.jsonl",
    "cameras": "runs/*/cameras.json",
    "report": "runs/*/report.html",
    "published cloud": "runs/*/*.ply",
    "reference": "reference/**/*.*",
}
"""Every kind of file, with its glob pattern in the work folder."""


def damage(bench: Bench, reduced: bool) -> Row:
    """One file is damaged in one way; then the same night runs again, and runs whose tasks read the existing artifacts."""
    row = Row("damaged file")
    sites = _three_nights(bench, pin="none"), _three_nights(bench)
    tries = 1 if reduced else 16
    for k in range(tries):
        made = sites[(k + 1) % 2]
        for sort, pattern in SORTS.items():
            files = sorted(path for path in made.work.glob(pattern) if path.is_file() and "latest" not in str(path))
            if not files:
                continue
            ways = list(WAYS) if sort != "lock" else ["garbage", "emptied", "removed", "a folder", "a pipe"]
            way = ways[(k + len(sort)) % len(ways)]
            file = bench.random.choice(files)
            what = f"{sort} {way}: {file.relative_to(made.work)}"
            twin = bench.copy(made)
            if k % 4 > 1:  # this run verifies the copied files; later runs verify them again only if they were changed
                bench.run(twin)
                what += ", found intact before"
            victim = twin.work / file.relative_to(made.work)
            victim.chmod(0o644)
            WAYS[way](bench, victim)
            _still_right(bench, row, twin, what)
    return row


def exchanges(bench: Bench, reduced: bool) -> Row:
    """Two files of one kind are swapped, each intact and with a valid checksum."""
    row = Row("files exchanged")
    made = _three_nights(bench)
    sorts = ("receipt", "artifact", "picture", "run.json")
    for _ in range(1 if reduced else 15):
        for sort in sorts:
            files = [path for path in made.work.glob(SORTS[sort]) if "latest" not in str(path)]
            stages = {path.parts[-3] for path in files if len([f for f in files if f.parts[-3] == path.parts[-3]]) > 1}
            stage = bench.random.choice(sorted(stages))
            one, other = bench.random.sample(sorted(path for path in files if path.parts[-3] == stage), 2)
            twin = bench.copy(made)
            a, b = (twin.work / path.relative_to(made.work) for path in (one, other))
            if sort == "artifact" and bench.random.random() < 0.5:  # together with their receipts
                _exchange(a.with_suffix(".json"), b.with_suffix(".json"))
            _exchange(a, b)
            _still_right(bench, row, twin, f"{sort}: {one.relative_to(made.work)} and {other.relative_to(made.work)}")
    for name in ("captures.json", "functions.json"):  # memos of another site
        twin, old = bench.copy(made), bench.site(2)
        bench.night(old, "another")
        bench.run(old)
        shutil.copyfile(old.work / "cache" / name, twin.work / "cache" / name)
        _still_right(bench, row, twin, f"{name} of another work folder")
        bench.discard(old)
    return row


def references(bench: Bench, reduced: bool) -> Row:
    """One file of the reference is damaged, in its folder or in the cache; the clouds of later nights must not change."""
    row = Row("reference damaged")
    made = bench.site(3, watched=True)
    bench.run(made, "--date", "2026-11-01")
    expected = {}
    whole = bench.copy(made)
    for date in (later := ("2026-11-02", "2026-11-03")):
        whole.night(date)
        bench.run(whole, "--date", date)
        expected[date] = whole.cloud
    for k in range(2 if reduced else 60):
        files = sorted(path for path in (made.work / "reference").rglob("*") if path.is_file())
        records = [made.work / "reference" / f"reference{end}.json" for end in ("", "-twin")]
        file = records[k // 2 % 2] if k % 2 == 0 else bench.random.choice(files)
        of_cache = made.work / "cache" / file.relative_to(made.work / "reference")
        file = of_cache if k % 4 == 3 and of_cache.exists() else file
        way = list(WAYS)[k % len(WAYS)]
        twin = bench.copy(made)
        WAYS[way](bench, twin.work / file.relative_to(made.work))
        row.tries += 1
        for date in later:
            twin.night(date)
            bench.check_recovery(row, twin, expected[date], f"{way}: {file.relative_to(made.work)}, night of {date}")
        bench.discard(twin)
    return row


def _three_nights(bench: Bench, pin: str = "auto") -> ToySite:
    toy = bench.site(2, pin=pin)
    for view in ("two", "three", "one"):
        bench.night(toy, view)
        bench.run(toy)
    if pin != "none":
        bench.run(toy, command="pin")
    return toy


def _still_right(bench: Bench, row: Row, toy: ToySite, what: str) -> None:
    row.tries += 1
    bench.check_recovery(row, toy, bench.cloud(2, "one"), what)
    set_parameters(toy, **OTHER)
    bench.check_recovery(row, toy, bench.cloud(2, "one", **OTHER), f"{what}, and other parameters")
    bench.night(toy, "three")
    bench.check_recovery(row, toy, bench.cloud(2, "three", **OTHER), f"{what}, and an earlier night's captures")
    for command in ("history", "status") if row.tries % 5 == 0 else ():
        bench.check_exit(row, bench.run(toy, command=command), f"{what}: {command}", {0})
    bench.discard(toy)


def _flip(bench: Bench, path: Path) -> None:
    data = bytearray(path.read_bytes())
    if data:
        data[bench.random.randrange(len(data))] ^= 1 << bench.random.randrange(8)
    path.write_bytes(data)


def _digit(bench: Bench, path: Path) -> None:
    """A digit becomes another one, so JSON stays valid."""
    data = bytearray(path.read_bytes())
    digits = [i for i, byte in enumerate(data) if 48 <= byte < 58]
    if not digits:
        return _flip(bench, path)
    place = bench.random.choice(digits)
    data[place] = 48 + (data[place] - 48 + 1 + bench.random.randrange(9)) % 10
    path.write_bytes(data)
    return None


def _cut(bench: Bench, path: Path) -> None:
    path.write_bytes(path.read_bytes()[: bench.random.randrange(max(path.stat().st_size, 1))])


def _zeros(bench: Bench, path: Path) -> None:
    """A block of zeros, as after a power cut on some file systems."""
    data = bytearray(path.read_bytes())
    start = bench.random.randrange(max(len(data), 1))
    data[start : start + 512] = bytes(len(data[start : start + 512]))
    path.write_bytes(data)


def _longer(bench: Bench, path: Path) -> None:
    path.write_bytes(path.read_bytes() + bench.random.randbytes(100))


WAYS: dict[str, Callable[[Bench, Path], None]] = {
    "bit flipped": _flip,
    "digit changed": _digit,
    "cut short": _cut,
    "zeros in it": _zeros,
    "longer": _longer,
    "garbage": lambda bench, path: _put(path, bench.random.randbytes(300)),
    "emptied": lambda bench, path: _put(path, b""),
    "removed": lambda bench, path: path.unlink(),
    "a folder": lambda bench, path: _instead(path, lambda: path.joinpath("something").mkdir(parents=True)),
    "a pipe": lambda bench, path: _instead(path, lambda: os.mkfifo(path)),
    "a link to nothing": lambda bench, path: _instead(path, lambda: path.symlink_to("nothing")),
}


def _instead(path: Path, make: Callable[[], None]) -> None:
    """Replace a file with something else that `make` creates."""
    path.unlink()
    make()


def _put(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _exchange(one: Path, other: Path) -> None:
    a, b = one.read_bytes(), other.read_bytes()
    for path, data in ((one, b), (other, a)):
        path.chmod(0o644)
        path.write_bytes(data)
