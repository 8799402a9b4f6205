"""Hostile site files and calibrations: hand-written ones, and fuzzed good ones."""

from __future__ import annotations

import copy
import json
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hostile_tables import CALIBRATION, CAMERA_FILES, CAMERAS_TXT, IMAGES_TXT, SITE, changed, colmap, jsons, plug_ins, texts

ROOT = Path(__file__).resolve().parent.parent

WRONG: dict[str, Any] = {
    "a number": 5,
    "minus one": -1,
    "a word": "x",
    "nothing": None,
    "an empty list": [],
    "an empty mapping": {},
    "no number": math.nan,
    "endless": math.inf,
    "400 digits": 10**400,
    "true": True,
    "somebody's home": "~nosuchuser/x",
    "two dots": "..",
    "a zero byte": "a\0b",
    "escape codes": "\x1b[2J\x1b]0;x\x07",
    "a long word": "x" * 100_000,
    "a list of lists": [[[[1]]]],
}


@dataclass(frozen=True)
class Case:
    """Files, by name, that replace those of the good site."""

    name: str
    files: dict[str, bytes]
    refused: bool = True
    """Whether the site must be refused; if not, it may be refused or used."""


def write_base(folder: Path) -> None:
    """Write the good files into a folder, and remove those that only cases add."""
    for name, data in base().items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    for extra in ("plugin.py", "cameras.json"):
        if extra not in base():
            (folder / extra).unlink(missing_ok=True)


def base() -> dict[str, bytes]:
    """A good site file and the files that it refers to, by name."""
    return {
        "site.yaml": _dumped(SITE),
        "mask.png": b"",
        "model/cameras.txt": CAMERAS_TXT.encode(),
        "model/images.txt": IMAGES_TXT.encode(),
        **{file: text.encode() for file, text in CAMERA_FILES.items()},
    }


def site_cases() -> Iterator[Case]:
    """Site files: hand-written bad ones, and a good one with each of its values replaced by several or all of `WRONG`."""
    for name, text in texts().items():
        yield Case(name, {"site.yaml": text if isinstance(text, bytes) else text.encode()})
    for name, code in plug_ins().items():
        used = {**SITE, "stages": {"matches": {"use": "plugin:match"}}}
        yield Case(f"a plug-in with {name}", {"site.yaml": _dumped(used), "plugin.py": code})
    for name, changes in changed().items():
        yield Case(name, {"site.yaml": _dumped({**SITE, **changes})})
    for place in _places(SITE):
        for name, value in WRONG.items():
            if name in _TRIED_EVERYWHERE or place[0] in {"site", "captures", "calibration"} or len(place) == 1:
                yield Case(
                    f"{'.'.join(map(str, place))} is {name}", {"site.yaml": _dumped(_with(SITE, place, value))}, refused=False
                )


_TRIED_EVERYWHERE = {"a word", "no number", "400 digits", "an empty mapping"}


def calibration_cases() -> Iterator[Case]:
    """Bad calibrations: JSON files, the camera files of other tools, and COLMAP's text model."""
    site = _dumped({key: value for key, value in SITE.items() if key != "calibration"} | {"calibration": "cameras.json"})
    for name, data in jsons().items():
        yield Case(f"JSON: {name}", {"site.yaml": site, "cameras.json": data if isinstance(data, bytes) else data.encode()})
    for place in _places(CALIBRATION["gate"]):
        for name in _TRIED_IN_CALIBRATIONS:
            changed = {**CALIBRATION, "gate": _with(CALIBRATION["gate"], place, WRONG[name])}
            text = json.dumps(changed).encode()
            yield Case(f"JSON: {'.'.join(map(str, place))} is {name}", {"site.yaml": site, "cameras.json": text}, refused=False)
    yield from _camera_files()
    model = _dumped(SITE | {"calibration": "model"})
    for name, (file, text) in colmap().items():
        yield Case(f"COLMAP: {name}", {"site.yaml": model, f"model/{file}": text})


def _camera_files() -> Iterator[Case]:
    """Camera files as OpenCV, ROS and Kalibr write them: unchanged, and with each value replaced by bad ones."""
    import yaml

    for file, text in CAMERA_FILES.items():
        site = _calibrated_by(file)
        yield Case(f"{file} as it is", {"site.yaml": site}, refused=False)
        data = yaml.safe_load(text.replace("%YAML:1.0\n", "").replace("!!opencv-matrix", ""))
        for place in _places(data):
            for name in _TRIED_IN_CALIBRATIONS:
                said = f"{file}: {'.'.join(map(str, place))} is {name}"
                yield Case(said, {"site.yaml": site, file: _dumped(_with(data, place, WRONG[name]))}, refused=False)


def _calibrated_by(file: str) -> bytes:
    """A site file whose lenses come from a camera file, or from the folder of camera files."""
    cameras = [{key: value for key, value in camera.items() if key not in _LENS} for camera in SITE["cameras"]]
    return _dumped(SITE | {"cameras": cameras, "calibration": file.partition("/")[0]})


_LENS = {"intrinsics", "distortion"}
_TRIED_IN_CALIBRATIONS = ("a word", "nothing", "no number", "endless", "400 digits", "minus one", "an empty list", "true")


def fuzzed(count: int, seed: int) -> Iterator[Case]:
    """Good files with a few bytes, lines or words changed; a seed always gives the same cases."""
    chance = random.Random(seed)
    calibrated = _dumped(SITE | {"calibration": "cameras.json"})
    model = _dumped(SITE | {"calibration": "model"})
    sites = [_dumped(SITE), _as_yaml(SITE), *(_at_home(file.read_text()) for file in sorted((ROOT / "sites").glob("*.yaml")))]
    for k in range(count):
        kind = chance.random()
        if kind < 0.7:
            files = {"site.yaml": _mutated(chance.choice(sites), chance)}
        elif kind < 0.83:
            files = {"site.yaml": calibrated, "cameras.json": _mutated(json.dumps(CALIBRATION, indent=1).encode(), chance)}
        elif kind < 0.92:
            file = chance.choice([*CAMERA_FILES])
            files = {"site.yaml": _calibrated_by(file), file: _mutated(CAMERA_FILES[file].encode(), chance)}
        elif kind < 0.96:
            files = {"site.yaml": model, "model/images.txt": _mutated(IMAGES_TXT.encode(), chance)}
        else:
            files = {"site.yaml": model, "model/cameras.txt": _mutated(CAMERAS_TXT.encode(), chance)}
        yield Case(f"seed {seed}, number {k}", files, refused=False)


_WORDS = [
    *(b".nan", b"-.inf", b"1e999", b"9" * 400, b"-1", b"0", b"~", b"null", b"[]", b"{}", b"!!int x", b"!!binary x", b"!!set {a}"),
    *(b"!!python/object/apply:os.system [x]", b"2026-99-99", b"&a [*a]", b"*nobody", b"~nosuchuser", b"..", b"${NOBODY}", b"${"),
    *(
        b"\xff\xfe",
        b"\0",
        b"\x1b[2J",
        b"[" * 60,
        b"{" * 60,
        b"- " * 60,
        b"? ",
        b"<<: *a",
        b"'",
        b'"',
        b"%YAML 9.9",
        b"---",
        b"\t",
    ),
    *(
        b"use: os:system",
        b"use: 5",
        b"{camera",
        b"{date:%}",
        b"a--b",
        b"0000",
        b"yes",
        b"12:30:45",
        b"0x_",
        b"!!float x",
        b"!!timestamp x",
    ),
]


def _mutated(data: bytes, chance: random.Random) -> bytes:
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at, end = sorted(chance.randrange(len(data) + 1) for _ in range(2))
        short = min(end, at + chance.randrange(1, 20))
        lines = data.split(b"\n")
        how = chance.randrange(8)
        if how == 0:
            data = data[:at] + bytes([chance.randrange(256)]) + data[at + 1 :]
        elif how == 1:
            data = data[:at] + data[short:]
        elif how == 2:
            data = data[:at] + chance.choice(_WORDS) + data[at:]
        elif how == 3:
            data = data[:at] + chance.choice(_WORDS) + data[short:]
        elif how == 4:
            del lines[chance.randrange(len(lines))]
            data = b"\n".join(lines)
        elif how == 5:
            lines.insert(chance.randrange(len(lines)), chance.choice(lines))
            data = b"\n".join(lines)
        elif how == 6:
            line = chance.randrange(len(lines))
            key, colon, _ = lines[line].partition(b":")
            lines[line] = key + colon + b" " + chance.choice(_WORDS)
            data = b"\n".join(lines)
        else:
            data = data[:at]
        data = data or b"\n"
    return data


def _places(data: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The place (keys and indices from the root) of every value."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*above, key)
        yield from _places(value, (*above, key))


def _with(data: Any, place: tuple[Any, ...], value: Any) -> Any:
    changed = copy.deepcopy(data)
    inner = changed
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    return changed


def _dumped(data: Any) -> bytes:
    """JSON, which is also YAML if nan and infinity are spelled as YAML spells them."""
    return json.dumps(data, indent=1).replace("NaN", ".nan").replace("-Infinity", "-.inf").replace("Infinity", ".inf").encode()


def _as_yaml(data: Any) -> bytes:
    import yaml

    return yaml.safe_dump(data, sort_keys=False).encode()


def _at_home(text: str) -> bytes:
    """A site file of the repository, changed so that its captures are in its own folder and it has no calibration."""
    import re

    text = re.sub(r"root: \S+", "root: .", text)
    return re.sub(r"(?m)^calibration: .*$", "", text).replace("masks/roof.png", "mask.png").encode()
