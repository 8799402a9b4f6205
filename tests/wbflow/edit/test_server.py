"""`wbflow edit` over HTTP: which requests are answered, and what is written to the site file."""

from __future__ import annotations

import difflib
import http.client
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers import edit_site
from tests.wbflow.verdict.test_rules import night
from wbflow.api import load_site
from wbflow.cache.ply import ply_bytes
from wbflow.edit.server import EditServer
from wbflow.records.run_folder import UnfinishedRun
from wbflow.site.calibration.calibrated import look_at


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return edit_site.write(tmp_path / "harbour")


@pytest.fixture
def server(file: Path) -> Iterator[EditServer]:
    with edit_site.served(file) as server:
        yield server


def ask(
    server: EditServer, path: str, body: Any = None, host: str = "", token: str | None = None, kind: str = "application/json"
) -> tuple[int, bytes, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    headers = {"Host": host or f"127.0.0.1:{server.server_port}"} | ({"Content-Type": kind} if body is not None else {})
    content = None if body is None else json.dumps(body)
    connection.request("GET" if body is None else "POST", f"/{server.token if token is None else token}/{path}", content, headers)
    with connection.getresponse() as reply:
        return reply.status, reply.read(), reply.headers


def state(server: EditServer) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(ask(server, "state")[1])
    return found


def marks(state: dict[str, Any]) -> dict[str, Any]:
    """What the page sends if nothing was drawn."""
    cameras = {c["id"]: {"privacy": [{"was": k, "corners": p} for k, p in enumerate(c["privacy"])]} for c in state["cameras"]}
    return {"cameras": cameras, "zones": state["zones"], "points": state["points"]}


def save(server: EditServer, drawn: dict[str, Any], version: str) -> tuple[int, str]:
    status, body, _ = ask(server, "save", {"marks": drawn, "version": version})
    return status, body.decode()


def changed(file: Path) -> list[str]:
    """Lines removed from and added to the site file, marked with - and +."""
    return [line for line in difflib.ndiff(edit_site.SITE.splitlines(), file.read_text().splitlines()) if line[0] in "-+"]


@pytest.mark.parametrize("path", ["", "edit.js", "state", "picture/gate", "shade/gate"])
def test_requests_are_answered_only_with_the_token_and_a_local_host_name(server: EditServer, path: str) -> None:
    assert ask(server, path)[0] == 200
    assert ask(server, path, host=f"localhost:{server.server_port}")[0] == 200
    for token in ("", "wrong", server.token[:-1], server.token + "x", "%00", "%C3%BC"):
        status, body, _ = ask(server, path, token=token)
        assert (status, body) == (403, b"forbidden\n")
    for host in ("evil.example", f"evil.example:{server.server_port}", "127.0.0.1", f"127.0.0.1:{server.server_port + 1}"):
        assert ask(server, path, host=host)[0] == 403


def test_saving_needs_the_token_a_local_host_name_and_json(server: EditServer, file: Path) -> None:
    there = state(server)
    body = {"marks": {"cameras": {}, "zones": [], "points": []}, "version": there["version"]}
    assert ask(server, "save", body, token="wrong")[0] == 403
    assert ask(server, "done", {}, token="wrong")[0] == 403
    assert ask(server, "save", body, host="evil.example")[0] == 403
    assert ask(server, "save", body, kind="text/plain")[0] == 409, "what a form of another page could send"
    assert changed(file) == []


@pytest.mark.parametrize("method", ["HEAD", "OPTIONS", "PUT", "DELETE", "CONNECT", "TRACE", "PATCH"])
def test_other_http_methods_are_refused_without_the_token(server: EditServer, method: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    connection.request(method, "/wrong/state")
    with connection.getresponse() as reply:
        assert reply.status == 403


def test_the_server_is_local_and_its_page_loads_nothing_from_elsewhere(server: EditServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    assert len(server.token) >= 32
    _, page, headers = ask(server, "")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
    assets = b"".join(ask(server, name)[1] for name in ("", "edit.js", "edit.css"))
    assert not re.search(rb"https?://|//[a-z]+\.", assets)
    assert b"harbour" not in page


@pytest.mark.parametrize("path", ["../../etc/passwd", "picture/../site.yaml", "state/x", "save", "edit.html", "picture/none"])
def test_unknown_paths_are_refused(server: EditServer, path: str) -> None:
    assert ask(server, path)[0] in {404, 409}


def test_saving_without_drawing_leaves_the_site_file_unchanged(server: EditServer, file: Path) -> None:
    there = state(server)
    assert save(server, marks(there), there["version"])[0] == 200
    assert file.read_text() == edit_site.SITE


def test_saving_changes_only_the_lines_of_what_was_drawn(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["cameras"]["gate"]["privacy"].append({"was": None, "corners": [[10, 20], [60, 20], [60, 50.5]]})
    drawn["cameras"]["shed"]["privacy"].append({"was": None, "corners": [[1, 2], [30, 2], [30, 40]]})
    drawn["cameras"]["roof"]["privacy"].append({"was": None, "corners": [[1, 2], [30, 2], [30, 40]]})
    drawn["zones"][0]["corners"][2] = [4.25, 3]
    drawn["zones"].append({"was": None, "name": "yes", "corners": [[0, 0], [5, 0], [5, 5]], "least_m": 0})
    drawn["points"][0]["pixels"]["mast"] = [150.2, 80]
    drawn["points"].append({"was": None, "id": "door", "position": [1, 2, 0.5], "pixels": {"gate": [5, 6], "mast": [7, 8.5]}})
    status, body = save(server, drawn, there["version"])
    assert status == 200, body
    garden = "[[0.0, 0.7], [0.3, 0.65], [0.3, 1.0], [0.0, 1.0]]"
    roof = "id: roof, intrinsics: *lens, pose: {position: [0, -14, 7], look_at: [0, 0, 0]}"
    assert changed(file) == [
        f"-     privacy: [{garden}]   # the neighbour's garden",
        f"+     privacy: [{garden}, [[10, 20], [60, 20], [60, 50.5]]]   # the neighbour's garden",
        f"-   - {{{roof}}}",
        f"+   - {{{roof}, privacy: [[[1, 2], [30, 2], [30, 40]]]}}",
        "-   - shed          # nobody knows where it is",
        "+   - {id: shed, privacy: [[[1, 2], [30, 2], [30, 40]]]}          # nobody knows where it is",
        "-   - {name: quay,   polygon: [[-3, -3], [3, -3], [3, 3], [-3, 3]], least_m: 0.5}   # where ships moor",
        "+   - {name: quay,   polygon: [[-3, -3], [3, -3], [4.25, 3], [-3, 3]], least_m: 0.5}   # where ships moor",
        "+   - {name: 'yes', polygon: [[0, 0], [5, 0], [5, 5]]}",
        "-     pixels: {gate: [176.4, 78.4], roof: [159.9, 88.9]}",
        "+     pixels: {gate: [176.4, 78.4], roof: [159.9, 88.9], mast: [150.2, 80]}",
        "+   - {id: door, position: [1, 2, 0.5], pixels: {gate: [5, 6], mast: [7, 8.5]}}",
    ]
    site = load_site(file)
    assert [len(camera.privacy) for camera in site.cameras] == [2, 1, 0, 1]
    again = json.loads(body)
    assert save(server, marks(again), again["version"])[0] == 200
    assert len(changed(file)) == 12


def test_deleted_marks_are_removed_from_the_site_file(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["cameras"]["gate"]["privacy"] = []
    drawn["zones"], drawn["points"] = [], []
    assert save(server, drawn, there["version"])[0] == 200
    text = file.read_text()
    assert "privacy: []   # the neighbour's garden" in text
    assert "zones: []" in text
    assert "# What Ben measured in May:\ncontrol_points: []" in text
    assert "# Long side that stages work at." in text


def test_masks_are_painted_into_files_that_the_site_file_names(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    square = [[100, 100], [139, 100], [139, 139], [100, 139]]
    drawn["cameras"]["gate"]["mask"] = [
        {"use": False, "corners": square},
        {"use": True, "corners": [[0, 0], [9, 0], [9, 9], [0, 9]]},
    ]
    drawn["cameras"]["shed"]["mask"] = [{"use": False, "corners": square}]
    assert save(server, drawn, there["version"])[0] == 200
    assert [line for line in changed(file) if line[0] == "+"] == [
        "+   - {id: shed, mask: masks/shed.png}          # nobody knows where it is"
    ]
    gate, shed = (cv2.imread(str(file.parent / "masks" / f"{name}.png"), cv2.IMREAD_GRAYSCALE) for name in ("gate", "shed"))
    assert np.count_nonzero(shed == 0) == 40 * 40
    assert np.count_nonzero(gate == 0) == 40 * 40 + 20 * 60 - 10 * 10, "the mask that was there, and both areas"
    again = state(server)
    drawn["cameras"]["gate"]["mask"] = []
    assert save(server, drawn, again["version"])[0] == 200
    gate = cv2.imread(str(file.parent / "masks" / "gate.png"), cv2.IMREAD_GRAYSCALE)
    assert np.count_nonzero(gate == 0) == 20 * 60, "areas that were taken back are gone"


def test_marks_that_the_site_file_refuses_are_left_out_and_named(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["points"][0]["position"] = None
    drawn["points"].append({"was": None, "id": "door", "position": None, "pixels": {"gate": [5, 6], "mast": [7, 8]}})
    drawn["points"].append({"was": None, "id": "hook", "position": [1, 2, 3], "pixels": {"gate": [5, 6], "mast": [7, 8]}})
    drawn["zones"].append({"was": None, "name": "line", "corners": [[0, 0], [1, 1]], "least_m": 0})
    drawn["cameras"]["shed"]["mask"] = [{"use": False, "corners": [[0, 0], [9, 0], [9, 9]]}]
    status, body = save(server, drawn, there["version"])
    assert status == 200, body
    assert [line for line in changed(file) if line[0] == "+"] == [
        "+   - {id: shed, mask: masks/shed.png}          # nobody knows where it is",
        "+   - {id: hook, position: [1, 2, 3], pixels: {gate: [5, 6], mast: [7, 8]}}",
    ]
    unsaved = json.loads(body)["unsaved"]
    assert [(mark["kind"], mark["drawn"], mark["was"]) for mark in unsaved] == [
        ("zone", 1, None),
        ("point", 0, 0),
        ("point", 1, None),
    ]
    assert [mark["why"] for mark in unsaved][1:] == ["its coordinates are missing"] * 2


def test_what_shares_its_text_by_an_alias_is_named_and_the_rest_is_saved(tmp_path: Path) -> None:
    garden = "[[[0.0, 0.7], [0.3, 0.65], [0.3, 1.0], [0.0, 1.0]]]"
    text = edit_site.SITE.replace(f"privacy: {garden}", f"privacy: &garden {garden}")
    text = text.replace("{id: roof, ", "{id: roof, privacy: *garden, ")
    text = text.replace("position: [0.5, 1.0, 0.0]", "position: &bolt [0.5, 1.0, 0.0]")
    text += "  - {id: bolt 2, position: *bolt, pixels: {gate: [170, 70], roof: [150, 80]}}\n"
    text = text.replace("\n# Long side that stages work at.\nresolution: 1600\n", "")
    file = edit_site.write(tmp_path / "harbour", text)
    with edit_site.served(file) as server:
        there = state(server)
        drawn = marks(there)
        drawn["cameras"]["roof"]["privacy"].append({"was": None, "corners": [[1, 1], [9, 1], [9, 9]]})
        drawn["cameras"]["gate"]["privacy"] = []
        drawn["points"][1]["position"] = [0.5, 1.0, 0.25]
        drawn["points"][1]["pixels"]["gate"] = [171, 71]
        drawn["points"].append({"was": None, "id": "hook", "position": [1, 2, 3], "pixels": {"gate": [5, 6], "mast": [7, 8]}})
        drawn["zones"][0]["name"] = "pier"
        status, body = save(server, drawn, there["version"])
    assert status == 200, body
    lines = [line for line in difflib.ndiff(text.splitlines(), file.read_text().splitlines()) if line[0] in "-+"]
    assert [line[2:] for line in lines if line[0] == "+"] == [
        "  - {name: pier,   polygon: [[-3, -3], [3, -3], [3, 3], [-3, 3]], least_m: 0.5}   # where ships moor",
        "  - {id: hook, position: [1, 2, 3], pixels: {gate: [5, 6], mast: [7, 8]}}",
    ]
    unsaved = [(mark["kind"], mark["camera"], mark["drawn"], mark["was"]) for mark in json.loads(body)["unsaved"]]
    assert unsaved == [("privacy", "gate", None, 0), ("privacy", "roof", 1, None), ("point", "", 1, 1)]
    for mark in json.loads(body)["unsaved"]:
        assert "it shares its text with others (an alias)" in mark["why"] and "change this by hand" in mark["why"]


def test_a_mask_that_cannot_be_named_in_the_file_is_not_written(tmp_path: Path) -> None:
    text = edit_site.SITE.replace("mask: masks/gate.png", "mask: &all masks/gate.png")
    text = text.replace("{id: roof, ", "{id: roof, mask: *all, ")
    file = edit_site.write(tmp_path / "harbour", text)
    with edit_site.served(file) as server:
        there = state(server)
        drawn = marks(there)
        drawn["cameras"]["roof"]["mask"] = [{"use": False, "corners": [[0, 0], [9, 0], [9, 9]]}]
        drawn["zones"][0]["name"] = "pier"
        status, body = save(server, drawn, there["version"])
    assert status == 200, body
    assert [(mark["kind"], mark["camera"]) for mark in json.loads(body)["unsaved"]] == [("mask", "roof")]
    assert "name: pier" in file.read_text() and "roof.png" not in file.read_text()
    assert not (file.parent / "masks" / "roof.png").exists()


def test_nothing_is_written_if_the_site_file_cannot_be_loaded(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["cameras"]["shed"]["mask"] = [{"use": False, "corners": [[0, 0], [9, 0], [9, 9]]}]
    broken = edit_site.SITE.replace("resolution: 1600", "resolution: many")
    file.write_text(broken)
    status, body = save(server, drawn, there["version"])
    assert status == 409
    assert re.search(r"site\.yaml:27:13: resolution: .*mend it", body, re.DOTALL)
    assert file.read_text() == broken
    assert not (file.parent / "masks" / "shed.png").exists()


def test_what_was_changed_in_the_file_meanwhile_is_kept(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["points"][0]["pixels"]["mast"] = [150.5, 80]
    drawn["cameras"]["gate"]["privacy"].append({"was": None, "corners": [[10, 20], [60, 20], [60, 50]]})
    new_zone = "  - {name: gatehouse, polygon: [[0, 0], [1, 0], [1, 1]]}\n"
    text = edit_site.SITE.replace("zones:\n", f"zones:\n{new_zone}").replace("  - shed  ", "  - {id: shed, intrinsics: *lens}  ")
    file.write_text(text)
    status, body = save(server, drawn, there["version"])
    assert status == 200, body
    answer = json.loads(body)
    assert (answer["merged"], answer["unsaved"]) == (True, [])
    assert [zone["name"] for zone in answer["zones"]] == ["gatehouse", "quay"]
    expected = text.replace("roof: [159.9, 88.9]}", "roof: [159.9, 88.9], mast: [150.5, 80]}")
    assert file.read_text() == expected.replace("[0.0, 1.0]]]", "[0.0, 1.0]], [[10, 20], [60, 20], [60, 50]]]")


def test_a_mark_that_was_changed_in_both_places_stays_as_in_the_file_and_is_named(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["points"][0]["position"] = [9, 9, 9]
    drawn["zones"] = []
    text = edit_site.SITE.replace("[0.5, 1.0, 0.0]", "[0.5, 1.0, 0.25]").replace("least_m: 0.5", "least_m: 0.75")
    file.write_text(text)
    answer = json.loads(save(server, drawn, there["version"])[1])
    assert file.read_text() == text
    point, zone = sorted(answer["unsaved"], key=lambda mark: str(mark["kind"]))
    assert (point["drawn"], point["was"]) == (0, 0) and "saving again replaces that" in point["why"]
    assert (zone["drawn"], zone["was"]) == (None, 0) and "is not removed" in zone["why"]
    again = marks(answer)
    again["points"][0]["position"] = [9, 9, 9]
    assert save(server, again, answer["version"])[0] == 200
    assert "position: [9, 9, 9]" in file.read_text()


def test_two_pages_of_one_file_do_not_undo_each_other(server: EditServer, file: Path) -> None:
    there = state(server)
    one, other = marks(there), json.loads(json.dumps(marks(there)))
    one["zones"].append({"was": None, "name": "north", "corners": [[0, 0], [5, 0], [5, 5]], "least_m": 0})
    other["zones"].append({"was": None, "name": "south", "corners": [[0, 0], [5, 0], [5, -5]], "least_m": 0})
    assert save(server, one, there["version"])[0] == 200
    assert save(server, other, there["version"])[0] == 200
    assert [zone.name for zone in load_site(file).settings.zones or ()] == ["quay", "north", "south"]


def test_a_mask_that_was_changed_meanwhile_is_painted_over(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    mask_file = file.parent / "masks" / "gate.png"
    changed_mask = np.full((edit_site.HEIGHT, edit_site.WIDTH), 255, np.uint8)
    changed_mask[-10:] = 0
    cv2.imwrite(str(mask_file), changed_mask)
    drawn["cameras"]["gate"]["mask"] = [{"use": False, "corners": [[100, 100], [139, 100], [139, 139], [100, 139]]}]
    status, body = save(server, drawn, there["version"])
    assert status == 200, body
    mask = cv2.imread(str(mask_file), cv2.IMREAD_GRAYSCALE)
    assert np.count_nonzero(mask == 0) == 40 * 40 + 10 * edit_site.WIDTH


def test_a_camera_that_somebody_drew_on_and_that_is_gone_is_said(server: EditServer, file: Path) -> None:
    there = state(server)
    drawn = marks(there)
    drawn["cameras"]["shed"]["privacy"].append({"was": None, "corners": [[10, 20], [60, 20], [60, 50]]})
    text = edit_site.SITE.replace("  - shed          # nobody knows where it is\n", "")
    file.write_text(text)
    status, body = save(server, drawn, there["version"])
    assert (status, "camera 'shed', on which you drew, is no longer in the file" in body) == (409, True)
    assert file.read_text() == text


@pytest.mark.parametrize("body", [{}, {"marks": {"zones": 3}, "version": "x"}, {"marks": {}, "version": "x", "path": "/etc"}])
def test_malformed_requests_are_refused(server: EditServer, body: dict[str, Any]) -> None:
    assert ask(server, "save", body)[0] == 400


def test_windows_line_ends_and_the_byte_order_mark_are_kept(tmp_path: Path) -> None:
    file = edit_site.write(tmp_path / "harbour")
    file.write_bytes(b"\xef\xbb\xbf" + edit_site.SITE.replace("\n", "\r\n").encode())
    with edit_site.served(file) as server:
        there = state(server)
        drawn = marks(there)
        drawn["zones"][0]["name"] = "pier"
        assert save(server, drawn, there["version"])[0] == 200
    wanted = edit_site.SITE.replace("name: quay", "name: pier").replace("\n", "\r\n")
    assert file.read_bytes() == b"\xef\xbb\xbf" + wanted.encode()


def test_guides_are_lines_from_one_click_and_places_from_two_with_residuals(server: EditServer) -> None:
    X = [0.5, 1.0, 0.0]
    exact = {camera: edit_site.seen(camera, X) for camera in edit_site.PLACES}

    def look(camera: str, pixels: dict[str, list[float]], position: list[float] | None) -> dict[str, Any]:
        points = [{"was": None, "id": "bolt", "position": position, "pixels": pixels}]
        body = {"camera": camera, "marks": {"points": points}, "chosen": 0, "ground": 0.0}
        found: dict[str, Any] = json.loads(ask(server, "look", body)[1])
        return found

    one = look("mast", {"gate": exact["gate"]}, None)["guide"]
    line = np.array(one["lines"][0])
    assert np.linalg.norm(line - exact["mast"], axis=1).min() < 5
    along, there = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0]), np.array(exact["mast"]) - line[0]
    assert abs(along[0] * there[1] - along[1] * there[0]) < 0.02, "the place lies on the line"
    two = look("mast", {name: exact[name] for name in ("gate", "roof")}, [0.5, 1.0, 0.1])
    assert two["guide"]["at"] == pytest.approx(exact["mast"], abs=0.02)
    assert two["guide"]["stated"] == pytest.approx(edit_site.seen("mast", [0.5, 1.0, 0.1]), abs=0.02)
    assert two["residuals"][0]["metres"] == pytest.approx(0.1, abs=1e-4)
    missed = {**exact, "mast": [exact["mast"][0], exact["mast"][1] + 6]}
    off_px = look("shed", missed, None)["residuals"][0]["pixels"]
    assert max(off_px, key=lambda name: float(off_px[name])) == "mast"
    assert 2 < off_px["mast"] < 6


def test_zones_are_placed_where_the_rays_of_pixels_meet_the_ground(server: EditServer) -> None:
    corner = [3.0, -3.0]
    pixel = edit_site.seen("roof", [*corner, 0.0])
    found = json.loads(ask(server, "ground", {"camera": "roof", "pixel": pixel, "ground": 0.0})[1])
    assert found == pytest.approx(corner, abs=1e-3)
    assert json.loads(ask(server, "ground", {"camera": "roof", "pixel": [160, -400], "ground": 0.0})[1]) is None
    assert json.loads(ask(server, "ground", {"camera": "shed", "pixel": [160, 90], "ground": 0.0})[1]) is None
    body = {"camera": "roof", "marks": {"zones": state(server)["zones"]}, "ground": 0.0}
    zone = json.loads(ask(server, "look", body)[1])["zones"][0]
    assert zone["corners"][1] == pytest.approx(pixel, abs=0.02)
    assert len(zone["lines"]) == 4


@pytest.mark.parametrize("ends", ["done", "interrupt"])
def test_the_command_prints_its_address_and_ends_on_done_or_interrupt(file: Path, ends: str) -> None:
    command = [sys.executable, "-m", "wbflow", "edit", str(file)]
    # tests started in the background of a shell ignore SIGINT, and their child processes would inherit this
    heeds = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, preexec_fn=heeds) as process:
        try:
            assert process.stdout
            found = re.match(r"http://127\.0\.0\.1:(\d+)/([\w-]{32,})/$", process.stdout.readline().strip())
            assert found
            if ends == "interrupt":
                process.stdout.readline()
                process.send_signal(signal.SIGINT)
            else:
                connection = http.client.HTTPConnection("127.0.0.1", int(found[1]), timeout=30)
                connection.request("POST", f"/{found[2]}/done", "{}", {"Content-Type": "application/json"})
                with connection.getresponse() as reply:
                    assert reply.status == 200
            assert process.wait(30) == 0
        finally:
            process.kill()


def test_poses_and_ground_of_the_last_run_are_used_if_none_are_stated(tmp_path: Path) -> None:
    plain = "site: harbour\ncaptures: {root: captures, pattern: '{camera}.png'}\ncameras: [gate, roof, mast, shed]\n"
    file = edit_site.write(tmp_path / "harbour", plain)
    with edit_site.served(file) as server:
        assert not any(camera["posed"] for camera in state(server)["cameras"])
    K = [[edit_site.FOCAL, 0, 159.5], [0, edit_site.FOCAL, 89.5], [0, 0, 1]]
    solved = {
        name: {"K": K, "R": look_at(C, [0, 0, 0]), "C": C, "width": 320, "height": 180} for name, C in edit_site.PLACES.items()
    }
    heights = np.concatenate([np.full(3000, 0.4, np.float32), np.linspace(0.5, 9, 3000, dtype=np.float32)])
    record = night()
    run = UnfinishedRun(load_site(file).work_folder, record.run)
    run.write_cameras(solved)
    run.write("cloud.ply", bytes(ply_bytes({"x": heights, "y": heights, "z": heights})))
    run.publish(record, [], "")
    with edit_site.served(file) as server:
        there = state(server)
        assert [camera["posed"] for camera in there["cameras"]] == [True, True, True, False]
        assert there["ground"] == pytest.approx(0.4, abs=0.01)
        points = [{"was": None, "id": "bolt", "position": [0, 0, 0], "pixels": {"gate": edit_site.seen("gate", [0, 0, 0])}}]
        found = json.loads(ask(server, "look", {"camera": "roof", "marks": {"points": points}, "chosen": 0})[1])
        assert found["guide"]["lines"]
        assert "stated" not in found["guide"], "nothing ties the solved world to coordinates that are stated"
