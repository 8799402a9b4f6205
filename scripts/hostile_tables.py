"""Hand-written bad contents of site files, plug-ins and calibrations, and the good files that they are derived from."""

from __future__ import annotations

import json
import math
from typing import Any

SITE: dict[str, Any] = {
    "site": "hostile",
    "captures": {"root": ".", "pattern": "{camera}.jpg"},
    "cameras": [
        {
            "id": "gate",
            "intrinsics": {"fx": 500.0, "fy": 500.0, "cx": 320, "cy": 240, "width": 640, "height": 480},
            "distortion": [-0.1, 0.01, 0, 0, 0],
            "pose": {"position": [0, 0, 5], "look_at": [10, 0, 0], "position_sigma_m": 0.1, "rotation_sigma_deg": 1.0},
            "mask": "mask.png",
        },
        {"id": "roof", "intrinsics": {"hfov": 70.0}, "pose": {"position": [1, 0, 5], "yaw_pitch_roll": [0, 0, 0]}},
        {"id": "mast", "images": ["a.jpg"], "pose": {"position": [2, 0, 5], "rotation": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}},
    ],
    "distances": [["gate", "roof", 1.0]],
    "control_points": [{"id": "p", "position": [1, 2, 3], "pixels": {"gate": [1, 2], "roof": [3, 4]}}],
    "resolution": 640,
    "bounds": [[-1, -1, 0], [9, 9, 9]],
    "pairs": {"degree": 3, "min_angle": 4, "max_angle": 60, "include": [["gate", "roof"]], "exclude": []},
    "stages": {"matches": {"min_matches": 10}},
}
CALIBRATION: dict[str, Any] = {
    name: {
        "K": [[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]],
        "width": 640,
        "height": 480,
        "R": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        "C": [float(k), 0, 5],
        "distortion": [0, 0, 0, 0, 0],
        "position_sigma_m": 0.1,
        "rotation_sigma_deg": 0.2,
    }
    for k, name in enumerate(("gate", "roof", "mast"))
}
CAMERAS_TXT = "# cameras\n1 PINHOLE 640 480 500 500 320 240\n"
IMAGES_TXT = "# images\n1 1 0 0 0 0 0 0 1 gate.jpg\n\n2 1 0 0 0 1 0 0 1 roof.jpg\n\n3 1 0 0 0 2 0 0 1 mast.jpg\n\n"
OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
flags: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -1.0e-01, 1.0e-02, 0., 0., 0. ]
"""
ROS = """image_width: 640
image_height: 480
camera_name: gate
camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, 0, 0, 0]}
"""
KALIBR = """gate:
  camera_model: pinhole
  intrinsics: [500.0, 500.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0, 0]
  rostopic: /gate/image_raw
  resolution: [640, 480]
roof:
  camera_model: omni
  intrinsics: [1.2, 500.0, 500.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0, 0]
  resolution: [640, 480]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -1.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
mast:
  camera_model: ds
  intrinsics: [-0.2, 0.6, 500.0, 500.0, 320.0, 240.0]
  distortion_model: none
  resolution: [640, 480]
"""
CAMERA_FILES = {"lenses/gate.yaml": OPENCV, "lenses/roof.yaml": ROS, "lenses/mast.yaml": ROS, "chain.yaml": KALIBR}
"""Camera files by name: a folder with one file per camera, and one file of all cameras."""


_TIMES = {
    "Unix seconds": "{camera}/{date:%s}.jpg",
    "weeks": "{camera}/{date:%G-W%V-%u}.jpg",
    "an offset from UTC": "{camera}/{date}T{time:%H%M%S%z}.jpg",
    "the hour of 12 without its half of the day": "{camera}/{date}_{time:%I%M%S}.jpg",
    "a month and no year": "{camera}/{date:%m-%d}.jpg",
}
"""Dates and times of file names that say too little, or in a way that is not read."""


def texts() -> dict[str, str | bytes]:
    """Whole site files."""
    head = "site: x\ncaptures: {root: ., pattern: '{camera}.jpg'}\n"
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
    )
    return {
        "an empty file": "",
        "only a comment": "# nothing\n",
        "a list": "- a\n",
        "a word": "harbour",
        "a number": "5",
        "two documents": f"{head}cameras: [a]\n---\nsite: y\n",
        "no YAML": "site: [unclosed",
        "a tabulator": "site:\n\tx: y\n",
        "a key twice": f"{head}cameras: [a]\ncameras: [b]\n",
        "bytes that are no text": b"site: \xff\xfe\n",
        "UTF-16": "site: x\n".encode("utf-16"),
        "zero bytes": b"site: \0\0\0\n",
        "a binary file": bytes(range(256)) * 20,
        "an alias bomb": bomb + head + "cameras: *a11\n",
        "an alias bomb of mappings": "x0: &x0 {a: 1, b: 1}\n"
        + "".join(f"x{k}: &x{k} {{a: *x{k - 1}, b: *x{k - 1}}}\n" for k in range(1, 40)),
        "merge keys without end": "a: &a {<<: *a}\n",
        "an alias of itself": f"{head}cameras: &c [*c]\n",
        "an alias of nobody": f"{head}cameras: *nobody\n",
        "a complex key": "? [a, b]\n: c\n",
        "a mapping as key": "{a: b}: c\n",
        "a null key": f"{head}cameras: [a]\n~: 5\n",
        "a number as key": f"{head}cameras: [a]\n5: 5\n",
        **{
            f"a pattern with {what}": f"site: x\ncaptures: {{root: ., pattern: '{text}'}}\ncameras: [a]\n"
            for what, text in _TIMES.items()
        },
        "100,000 brackets": head + "cameras: " + "[" * 100_000,
        "100,000 braces": head + "cameras: " + "{a: " * 100_000,
        "brackets that are closed": head + "cameras: " + "[" * 5000 + "]" * 5000,
        "a nesting of 500": head + "cameras:\n" + "".join(f"{' ' * k}a:\n" for k in range(1, 500)),
        "sequences in sequences": head + "cameras:\n  " + "- " * 3000 + "a\n",
        "question marks": "? " * 3000 + "a\n",
        "an integer that is none": f"{head}cameras: [a]\nresolution: !!int x\n",
        "a float that is none": f"{head}cameras: [a]\nresolution: !!float x\n",
        "a boolean that is none": f"{head}cameras: [a]\nresolution: !!bool x\n",
        "binary that is none": f"{head}cameras: [a]\nwork: !!binary =\n",
        "a date that is none": f"{head}cameras: [a]\nresolution: 2026-99-99\n",
        "a time that is none": f"{head}cameras: [a]\nresolution: 2026-01-01 99:99:99\n",
        "a date": f"{head}cameras: [a]\nresolution: 2026-01-01\n",
        "sixty-based digits": f"{head}cameras: [a]\nresolution: {'1:' * 5000}1\n",
        "5,000 digits": f"{head}cameras: [a]\nresolution: {'9' * 5000}\n",
        "400 digits": f"{head}cameras: [a]\nresolution: {'9' * 400}\n",
        "a set": f"{head}cameras: !!set {{a, b}}\n",
        "an ordered mapping": f"{head}cameras: !!omap [a: b]\n",
        "an ordered mapping that is none": f"{head}cameras: !!omap [a]\n",
        "pairs that are none": f"{head}cameras: !!pairs 5\n",
        "Python": f"{head}cameras: !!python/object/apply:os.system [true]\n",
        "an unknown tag": f"{head}cameras: !camera {{id: a}}\n",
        "a word for a mapping": f"{head}cameras: !!map x\n",
        "a directive of YAML 9": f"%YAML 9.9\n---\n{head}cameras: [a]\n",
        "an unknown directive": "%x\n",
        "an anchor of 100,000 letters": f"&{'a' * 100_000} b",
        "a megabyte of text": "x" * 1_000_000,
        "a variable that is not set": f"{head}cameras: [a]\nwork: ${{HOSTILE_NOBODY}}\n",
        "escape codes for a key": f'{head}cameras: [a]\n"\\e[2J\\e]0;x\\a": 5\n',
    }


def plug_ins() -> dict[str, bytes]:
    return {
        "a syntax error": b"def match(:\n",
        "a zero byte": b"def match(left, right): pass\0\n",
        "another encoding": b"# -*- coding: nobody -*-\ndef match(left, right): pass\n",
        "bytes that are no text": b"x = '\xff\xfe'\ndef match(left, right): pass\n",
        "100,000 brackets": b"x = " + b"(" * 100_000,
        "a tower of signs": b"x = " + b"-" * 200_000 + b"1\n",
        "no such function": b"def other(left, right): pass\n",
        "an unknown input": b"def match(front): pass\n",
        "inputs by position": b"def match(left, right, /): pass\n",
        "a broken import in it": b"from broken import x\ndef match(front, *, x: x = x): pass\n",
    }


def changed() -> dict[str, dict[str, Any]]:
    """Sections that replace those of the good site file."""

    def named(*ids: str) -> dict[str, Any]:
        return {"cameras": list(ids), "distances": [], "control_points": [], "pairs": {}}

    def gate(**more: Any) -> dict[str, Any]:
        return {"cameras": [{**SITE["cameras"][0], **more}, *SITE["cameras"][1:]]}

    position = SITE["cameras"][0]["pose"]["position"]
    return {
        "cameras: 5": {"cameras": 5},
        "cameras: a word": {"cameras": "gate"},
        "cameras: a mapping": {"cameras": {"gate": 1}},
        "cameras: lists": {"cameras": [["gate"]]},
        "site: ..": {"site": ".."},
        "site: a path": {"site": "a/b"},
        "site: too long": {"site": "x" * 101},
        "a camera called ..": named("..", "b"),
        "a camera called a/b": named("a/b", "b"),
        "pairs of one name": named("a", "b--c", "a--b", "c"),
        "a camera with escape codes": named("\x1b[2J", "b"),
        "work in nobody's home": {"work": "~nosuchuser/work"},
        "captures in nobody's home": {"captures": {"root": "~nosuchuser", "pattern": "{camera}"}},
        "captures nowhere": {"captures": {"root": "nowhere", "pattern": "{camera}"}},
        "calibration in nobody's home": {"calibration": "~nosuchuser/cameras.json"},
        "calibration nowhere": {"calibration": "nowhere.json"},
        "a pattern of nothing known": {"captures": {"root": ".", "pattern": "{night}"}},
        "use: os:system": {"stages": {"matches": {"use": "os:system"}}},
        "use: 5": {"stages": {"matches": {"use": 5}}},
        "use: a list": {"stages": {"matches": {"use": ["os:system"]}}},
        "use: nobody": {"stages": {"matches": {"use": "nobody:nothing"}}},
        "use: no function": {"stages": {"matches": {"use": "os"}}},
        "use: dots": {"stages": {"matches": {"use": "..:x"}}},
        "use: a builtin module": {"stages": {"matches": {"use": "sys:exit"}}},
        "use: an extension module": {"stages": {"matches": {"use": "numpy.random.mtrand:rand"}}},
        "a method of nobody": {"stages": {"matches": {"matcher": "nobody:x"}}},
        "a method that is a number": {"stages": {"matches": {"matcher": 5}}},
        "a method that is a list": {"stages": {"matches": {"matcher": ["structural"]}}},
        "an unknown stage": {"stages": {"nothing": {}}},
        "stages: a list": {"stages": ["matches"]},
        "a stage that is a number": {"stages": {"matches": 5}},
        "a parameter that is no number": {"stages": {"matches": {"min_matches": math.nan}}},
        "a parameter of the wrong kind": {"stages": {"matches": {"min_matches": "many"}}},
        "a lens that is no number": gate(intrinsics={"hfov": math.nan}),
        "a lens without end": gate(intrinsics={**SITE["cameras"][0]["intrinsics"], "fx": math.inf}),
        "a lens of 400 digits": gate(intrinsics={**SITE["cameras"][0]["intrinsics"], "fx": 10**400}),
        "a pose that is no number": gate(pose={"position": [math.nan, 0, 0]}),
        "a pose without end": gate(pose={"position": [math.inf, 0, 0], "look_at": [0, 0, 0]}),
        "a rotation of nothing": gate(pose={"position": position, "rotation": [[0, 0, 0]] * 3}),
        "a rotation that is no number": gate(pose={"position": position, "rotation": [[math.nan] * 3] * 3}),
        "a mirror for a rotation": gate(pose={"position": position, "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}),
        "a look at itself": gate(pose={"position": position, "look_at": position}),
        "a look straight up": gate(pose={"position": [0, 0, 0], "look_at": [0, 0, 9]}),
        "a heading without end": gate(pose={"position": position, "yaw_pitch_roll": [math.inf, 0, 0]}),
        "a latitude that is no number": gate(pose={"latitude": math.nan, "longitude": 0, "height": 0}),
        "distortion that is no number": gate(distortion=[math.nan]),
        "a mask that is a folder": gate(mask="."),
        "a mask of nobody": gate(mask="~nosuchuser/mask.png"),
        "a distance that is no number": {"distances": [["gate", "roof", math.nan]]},
        "a distance without end": {"distances": [["gate", "roof", math.inf]]},
        "a distance of lists": {"distances": [[["gate"], {"a": 1}, 3]]},
        "a point that is no number": {"control_points": [{"position": [math.nan] * 3, "pixels": {"gate": [1, 2]}}]},
        "bounds that are no numbers": {"bounds": [[math.nan] * 3, [1, 1, 1]]},
        "a pair of lists": {"pairs": {"include": [[["gate"], "roof"]]}},
        "a degree that is no number": {"pairs": {"degree": math.nan}},
    }


_LENS = {key: CALIBRATION["gate"][key] for key in ("K", "width", "height")}
_POSES: dict[str, dict[str, Any]] = {
    "millimetres": {"R": CALIBRATION["gate"]["R"], "t": [1200, 0, 0], "unit": "mm"},
    "millimetres in the key": {"rvec": [0, 0, 0], "tvec_mm": [1200, 0, 0]},
    "degrees": {"rvec": [0, 0, 90], "tvec": [0, 0, 0]},
    "two rotations": {"R": CALIBRATION["gate"]["R"], "rvec": [0, 0, 0.5], "t": [0, 0, 0]},
    "a quaternion of either order": {"quaternion": [0.9, 0.1, 0.3, 0.3], "t": [0, 0, 0]},
    "roll, pitch and yaw": {"roll": 0, "pitch": 10, "yaw": 90, "C": [0, 0, 1]},
}
_STEREO_PARAMS = {
    **{f"CameraParameters{k}": {"IntrinsicMatrix": _LENS["K"], "ImageSize": [480, 640]} for k in (1, 2)},
    "RotationOfCamera2": CALIBRATION["gate"]["R"],
    "TranslationOfCamera2": [-100, 0, 0],
}


def jsons() -> dict[str, str | bytes]:
    good = json.dumps(CALIBRATION)
    return {
        "an empty file": "",
        "a list": "[]",
        "a number": "5",
        "nobody in it": "{}",
        "cut short": good[:200],
        "no text": b"\xff\xfe{}",
        "zero bytes": b"\0" * 100,
        "100,000 brackets": "[" * 100_000,
        "100,000 brackets within a camera": '{"gate": ' + "[" * 100_000 + "]" * 100_000 + "}",
        "5,000 digits": good.replace("640", "9" * 5000, 1),
        "400 digits": good.replace("640", "9" * 400, 1),
        "1e999": good.replace("500.0", "1e999", 1),
        "NaN": good.replace("500.0", "NaN", 1),
        "a camera that is a list": '{"gate": []}',
        "a camera that is nothing": '{"gate": null}',
        "a mirror": good.replace("[0, 1, 0]", "[0, -1, 0]", 1),
        "a size of nothing": good.replace('"width": 640', '"width": 0', 1),
        "a size that is true": good.replace('"width": 640', '"width": true', 1),
        "a size of a quintillion": good.replace('"width": 640', f'"width": {10**18}', 1),
        "UTF-16": good.encode("utf-16"),
        "a NumPy archive": b"PK\3\4" + b"\0\xff" * 100,
        "a MATLAB file": b"MATLAB 5.0 MAT-file" + b"\0\xff" * 100,
        "numbers as text": good.replace("640", '"640"'),
        "comments": f"// my rig\n{good}",
        "MATLAB's stereoParams": json.dumps(_STEREO_PARAMS),
        "cameras of OpenSfM": json.dumps({"a": {"projection_type": "perspective", "width": 640, "height": 480, "focal": 0.85}}),
        "sfm_data of OpenMVG": json.dumps({"sfm_data_version": "0.3", "views": [], "intrinsics": [], "extrinsics": []}),
        **{f"a pose of {name}": json.dumps({"gate": _LENS | pose}) for name, pose in _POSES.items()},
        "no principal point": good.replace("320", "null", 1),
    }


def colmap() -> dict[str, tuple[str, bytes]]:
    cameras, images = CAMERAS_TXT.encode(), IMAGES_TXT.encode()
    return {
        "a zero quaternion": ("images.txt", images.replace(b"1 1 0 0 0", b"1 0 0 0 0", 1)),
        "a quaternion that is no number": ("images.txt", images.replace(b"1 1 0 0 0", b"1 nan 0 0 0", 1)),
        "a translation without end": ("images.txt", images.replace(b"0 0 0 1 gate", b"inf 0 0 1 gate", 1)),
        "a tiny quaternion": ("images.txt", images.replace(b"1 1 0 0 0", b"1 1e-200 0 0 0", 1)),
        "a huge quaternion": ("images.txt", images.replace(b"1 1 0 0 0", b"1 1e200 0 0 0", 1)),
        "a word": ("images.txt", images.replace(b"1 1 0 0 0", b"1 x 0 0 0", 1)),
        "a camera of nobody": ("images.txt", images.replace(b"0 1 gate", b"0 7 gate", 1)),
        "an image without a name": ("images.txt", images.replace(b" gate.jpg", b"", 1)),
        "images that are no text": ("images.txt", b"\xff\xfe" + images),
        "cameras that are no text": ("cameras.txt", b"\xff\xfe" + cameras),
        "an unknown model": ("cameras.txt", cameras.replace(b"PINHOLE", b"PINBALL")),
        "too few parameters": ("cameras.txt", cameras.replace(b" 320 240", b"")),
        "a size of 400 digits": ("cameras.txt", cameras.replace(b"640", b"9" * 400)),
        "a size of nothing": ("cameras.txt", cameras.replace(b"640", b"0")),
        "a lens that is no number": ("cameras.txt", cameras.replace(b"500 500", b"nan 500")),
        "a lens of nothing": ("cameras.txt", cameras.replace(b"500 500", b"0 500")),
        "a lens of 400 digits": ("cameras.txt", cameras.replace(b"500 500", b"9" * 400 + b" 500")),
    }
