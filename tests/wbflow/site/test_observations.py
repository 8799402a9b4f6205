"""Observations and their survey: tables as people and programs write them, and what is said of wrong rows."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wbflow.commands.check import check
from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.observation_tables import ObservationTable
from wbflow.site.observations import read_observations
from wbflow.site.yaml_document import SiteError

pytestmark = pytest.mark.filterwarnings("ignore")

CAMERAS = ("gate", "roof", "0003")
ROWS = "frame,camera,x,y\n0,gate,10,20\n1,roof,30.5,40\n"


def written(folder: Path, text: str | bytes, name: str = "seen.csv") -> Path:
    path = folder / name
    if isinstance(text, str):
        text = text.encode()
    path.write_bytes(text)
    return path


def read(folder: Path, text: str | bytes) -> ObservationTable:
    return read_observations(written(folder, text), CAMERAS)


def site(folder: Path, observations: str, survey: str | None = None, **camera: Any) -> Site:
    """A site of three cameras with these tables; camera: further keys of the first one."""
    written(folder, observations)
    lens = "intrinsics: {fx: 500, fy: 500, cx: 320, cy: 240, width: 640, height: 480}"
    more = "".join(f", {key}: {value}" for key, value in camera.items())
    lines = [
        "site: yard",
        "captures: {root: ., pattern: '{camera}.jpg'}",
        f"cameras: [{{id: gate, {lens}{more}}}, {{id: roof, {lens}}}, {{id: '0003', {lens}}}]",
        "observations: seen.csv",
    ]
    if survey is not None:
        written(folder, survey, "where.csv")
        lines.append("survey: where.csv")
    (folder / "site.yaml").write_text("\n".join(lines))
    return load_site(folder)


def problems(folder: Path, observations: str, survey: str | None = None, **camera: Any) -> str:
    with pytest.raises(SiteError) as caught:
        site(folder, observations, survey, **camera)
    return str(caught.value)


def doubts(found: Site) -> list[str]:
    """What `wbflow check` says of the tables."""
    return [fault.what for fault in check(found, None) if ".csv:" in fault.what]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    separator=st.sampled_from([",", ";", "\t"]),
    comma=st.booleans(),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    mark=st.sampled_from(["", "﻿"]),
    order=st.permutations(["frame", "camera", "id", "x", "y", "sigma"]),
    titles=st.sampled_from([str.lower, str.upper, str.title]),
    quoted=st.booleans(),
    rows=st.lists(
        st.tuples(
            st.integers(0, 9000),
            st.sampled_from(CAMERAS),
            st.sampled_from(["lamp", "7"]),
            st.floats(-1, 4000).map(lambda v: round(v, 3)),
            st.floats(-1, 4000).map(lambda v: round(v, 3)),
            st.one_of(st.none(), st.floats(0.01, 9).map(lambda v: round(v, 3))),
        ),
        min_size=1,
        max_size=8,
    ),
)
def test_a_table_means_the_same_in_every_dialect(
    tmp_path: Path, separator: str, comma: bool, newline: str, mark: str, order: list[str], titles: Any, quoted: bool, rows: Any
) -> None:
    def cell(value: object) -> str:
        text = "" if value is None else str(value)
        if comma and separator != "," and isinstance(value, float):
            text = text.replace(".", ",")
        return f'"{text}"' if quoted else text

    names = ["frame", "camera", "id", "x", "y", "sigma"]
    places = [names.index(name) for name in order]
    lines = [separator.join(cell(titles(name)) for name in order)]
    lines += [separator.join(cell(row[place]) for place in places) for row in rows]
    table = read(tmp_path, mark + newline.join(lines) + newline)
    found = table.rows

    assert found.time_unit == "frames" and list(found.time) == [row[0] for row in rows]
    assert [found.cameras[k] for k in found.camera] == [row[1] for row in rows]
    assert [found.things[k] for k in found.thing] == [row[2] for row in rows]
    assert list(found.xy) == [value for row in rows for value in row[3:5]]
    sigmas = [None if math.isnan(sigma) else sigma for sigma in found.sigma_px]
    assert sigmas == [row[5] for row in rows]
    assert list(table.line) == list(range(2, 2 + len(rows)))


@pytest.mark.parametrize(
    ("title", "first", "second", "apart"),
    [
        ("seconds", "12.5", "12.75", 0.25),
        ("Time (s)", "12.5", "12.75", 0.25),
        ("timestamp", "1763600000.0", "1763600000.25", 0.25),
        ("timestamp", "1763600000000", "1763600000250", 0.25),
        ("timestamp", "1763600000000000000", "1763600000250000000", 0.25),
        ("time", "2026-11-20T03:15:00.250Z", "2026-11-20 03:15:01.000+00:00", 0.75),
        ("time", "2026-11-20T03:15:00", "2026-11-20T04:15:01+01:00", 1.0),
    ],
)
def test_times_are_seconds_however_they_are_written(tmp_path: Path, title: str, first: str, second: str, apart: float) -> None:
    found = read(tmp_path, f"{title};camera;x;y\n{first};gate;1;2\n{second};roof;3;4\n")
    assert found.rows.time_unit == "s"
    assert found.rows.time[1] - found.rows.time[0] == pytest.approx(apart, abs=1e-5)


def test_seconds_count_more_than_frames_which_each_camera_has_of_its_own(tmp_path: Path) -> None:
    found = read(tmp_path, "frame,seconds,camera,x,y\n7,0.5,gate,1,2\n9,0.5,roof,3,4\n")
    assert found.rows.time_unit == "s" and list(found.rows.time) == [0.5, 0.5]


def test_points_without_a_time_are_told_by_their_ids(tmp_path: Path) -> None:
    found = read(tmp_path, "id,camera,x,y\nbolt,gate,1,2\nbolt,roof,3,4\nlamp post,roof,5,6\n")
    assert found.rows.things == ("bolt", "lamp post") and all(map(math.isnan, found.rows.time))


def test_comments_empty_lines_and_frames_without_the_thing_are_passed_over(tmp_path: Path) -> None:
    text = "# by hand\nsep_is_none,frame,camera,x,y\n\n0,0,gate,1,2\n,1,gate,,\n,2,gate,nan,NaN\n  \n# end\n0,3,roof,4,5\n"
    found = read(tmp_path, text)
    assert list(found.rows.time) == [0, 3] and list(found.line) == [4, 9]


def test_excel_may_name_the_separator_in_the_first_line(tmp_path: Path) -> None:
    found = read(tmp_path, "sep=;\r\nframe;camera;x;y\r\n4;gate;1,5;2\r\n")
    assert found.point(0) == (1.5, 2) and list(found.line) == [3]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "is empty"),
        ("frame,camera,x,y\n", 1, "holds no observation"),
        ("0,gate,1,2\n1,gate,3,4\n", 1, "does not name its columns"),
        ("frame,camera,x\n0,gate,1\n", 1, "has no column y"),
        ("camera,x,y\ngate,1,2\n", 1, "neither a column frame or time nor a column id"),
        ("frame,camera,x,y\n0,gate,1,2\n1,gate,3\n", 3, "has 3 values; 4 are needed"),
        ("frame,camera,x,y\n0,gate,1,2\n\n1,gate,1,2px\n", 4, "y is '2px', not a number"),
        ("frame,camera,x,y\n0,gate,1,inf\n", 2, "y is 'inf', not a number"),
        ("frame,camera,x,y\n0,gate,1,\n", 2, "has only one of x and y"),
        ("frame,camera,x,y\n0,gate,1,2\n1,rof,3,4\n2,rof,3,4\n", 3, "no camera 'rof' in the site; the same in 1 more row"),
        ("frame,camera,id,x,y\n0,gate,,1,2\n", 2, "id is empty"),
        ("frame,camera,x,y,sigma\n0,gate,1,2,0\n", 2, "sigma is 0"),
        ("time,camera,x,y\n2026-11-20T03:15:00,gate,1,2\nlater,roof,1,2\n", 3, "time is 'later', no date and time"),
        ("id,camera,x,y\nbolt,gate,1,2\nbolt,roof,1,2\nbolt,gate,5,6\n", 4, "has seen this thing in line 2 already"),
    ],
)
def test_a_wrong_row_is_named_with_its_line_and_what_is_wanted(tmp_path: Path, text: str, line: int, words: str) -> None:
    with pytest.raises(SiteError) as caught:
        read(tmp_path, text)
    assert len(caught.value.problems) == 1
    (problem,) = caught.value.problems
    assert problem.line == line and words in problem.what and problem.remedy


def test_all_kinds_of_faults_are_reported_at_once_at_the_key_of_the_site_file(tmp_path: Path) -> None:
    text = problems(tmp_path, "frame,camera,x,y\n0,gat,1,2\n1,gate,a,2\n2,roof\n")
    assert text.count("site.yaml:4:15: observations: ") == 3
    assert "seen.csv:2: there is no camera 'gat' in the site\n  did you mean 'gate'?" in text


def test_a_missing_file_is_named_with_a_similar_one(tmp_path: Path) -> None:
    site(tmp_path, ROWS)
    (tmp_path / "seen.csv").rename(tmp_path / "seen2.csv")
    with pytest.raises(SiteError, match=r"there is no such file\n  did you mean 'seen2.csv'"):
        load_site(tmp_path)


def test_a_survey_without_observations_is_no_use(tmp_path: Path) -> None:
    site(tmp_path, ROWS, "frame,x,y,z\n0,1,2,3\n")
    file = tmp_path / "site.yaml"
    file.write_text(file.read_text().replace("observations: seen.csv\n", ""))
    with pytest.raises(SiteError, match="survey: says where things were, but no observations of them are given"):
        load_site(tmp_path)


def test_a_survey_in_metres_keeps_its_coordinates(tmp_path: Path) -> None:
    found = site(tmp_path, ROWS, "Frame;Easting;Northing;Up\n0;313334,117;5154531,256;14,93\n").thing_survey
    assert found and list(found.rows.position) == [313334.117, 5154531.256, 14.93]
    assert found.rows.thing[0] == 0 and found.rows.crs == "" and math.isnan(found.rows.sigma_m[0])


def test_a_geodetic_survey_is_in_metres_of_the_frame_of_the_cameras(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    rows = "frame,latitude,longitude,height\n0,53.5001,10,21\n1,53.5,10,20\n"
    pose = "{latitude: 53.5, longitude: 10, height: 20}"
    of_cameras = site(tmp_path, ROWS, rows, pose=pose)
    assert of_cameras.thing_survey and of_cameras.thing_survey.rows.crs == of_cameras.survey.crs != ""
    assert of_cameras.thing_survey.rows.position[1] == pytest.approx(11.13, abs=0.01)  # metres north: 0.0001 degrees
    # without a geodetic camera, the first position is the origin
    alone = site(tmp_path, ROWS, rows)
    assert alone.thing_survey and alone.thing_survey.rows.position[1] == pytest.approx(0, abs=1e-6)
    assert alone.survey.crs == alone.thing_survey.rows.crs != of_cameras.survey.crs


@pytest.mark.parametrize(
    ("survey", "pose", "words"),
    [
        ("frame,latitude,longitude,height\n0,53.5,10,20\n", "{position: [0, 0, 5]}", "latitude and longitude elsewhere"),
        ("frame,x,y,z\n0,1,2,3\n", "{latitude: 53.5, longitude: 10, height: 20}", "survey: metres here, but latitude"),
    ],
)
def test_metres_and_degrees_do_not_mix(tmp_path: Path, survey: str, pose: str, words: str) -> None:
    pytest.importorskip("pyproj")
    assert words in problems(tmp_path, ROWS, survey, pose=pose)


def test_lengths_between_things_may_be_surveyed(tmp_path: Path) -> None:
    seen = "frame,camera,id,x,y\n0,gate,a,1,2\n0,gate,b,3,4\n0,roof,a,1,2\n"
    found = site(tmp_path, seen, "id,to,metres\na,b,1.5\n").thing_survey
    assert found and found.rows.lengths == ((0, 1, 1.5),) and not found.rows.thing


@pytest.mark.parametrize(
    ("survey", "line", "words"),
    [
        ("id,to,metres\na,c,1.5\n", 2, "no observation of 'c'"),
        ("id,to,metres\na,a,1.5\n", 2, "a has no length to itself"),
        ("id,to,metres\na,b,-1\n", 2, "a length of -1 metres is none"),
        ("frame,x,y,z\n0,1,2,3\n", 2, "does not say which of the 2 observed things it is about"),
        ("seconds,id,x,y,z\n0.5,a,1,2,3\n", 2, "has times in seconds, seen.csv has numbers of frames"),
        ("frame,id,x,y\n0,a,1,2\n", 1, "has no column z"),
        ("frame,id,x,y,z\n0,a,1,,3\n", 2, "lacks a coordinate"),
        ("frame,id,lat,lon,alt\n0,a,313334,5154531,14\n", 2, "latitude 313334, longitude 5.15453e+06 is no place on Earth"),
    ],
)
def test_a_wrong_row_of_a_survey_is_named(tmp_path: Path, survey: str, line: int, words: str) -> None:
    seen = "frame,camera,id,x,y\n0,gate,a,1,2\n0,gate,b,3,4\n0,roof,a,1,2\n"
    text = problems(tmp_path, seen, survey)
    assert f"survey: {tmp_path / 'where.csv'}:{line}: " in text and words in text


def test_check_doubts_observations_outside_of_the_picture(tmp_path: Path) -> None:
    found = site(tmp_path, "frame,camera,x,y\n0,gate,10,20\n0,roof,10,700\n0,0003,1,1\n")
    (doubt,) = doubts(found)
    assert ":3: 1 observation of roof outside of its picture of 640x480 pixels, the first at 10, 700" in doubt


def test_check_doubts_observations_of_one_camera(tmp_path: Path) -> None:
    (doubt,) = doubts(site(tmp_path, "frame,camera,x,y\n0,gate,10,20\n1,gate,11,20\n"))
    assert "all 2 observations are of 1 camera, gate; 2 are needed" in doubt


def test_check_doubts_cameras_whose_times_do_not_overlap(tmp_path: Path) -> None:
    text = "seconds,camera,x,y\n0,gate,1,2\n9,gate,1,2\n1,roof,1,2\n5,roof,1,2\n90.5,0003,1,2\n99,0003,1,2\n"
    (doubt,) = doubts(site(tmp_path, text))
    assert ":6: 0003 saw things from 90.500 to 99.000 s, other cameras from 0.000 to 9.000 s: at no common time" in doubt


def test_check_doubts_a_survey_of_another_time(tmp_path: Path) -> None:
    (doubt,) = doubts(site(tmp_path, f"{ROWS}1,0003,1,1\n0,roof,1,1\n", "frame,x,y,z\n700,1,2,3\n800,1,2,3\n"))
    assert "where.csv:2: gives places from frame 700 to 800, cameras saw things from frame 0 to 1" in doubt


def test_check_names_a_camera_without_pose_and_observations(tmp_path: Path) -> None:
    (doubt,) = doubts(site(tmp_path, "frame,camera,x,y\n0,gate,10,20\n0,roof,1,1\n"))
    assert "there is no observation of 0003 among 2, and its pose is not stated" in doubt


def test_thirty_thousand_rows_take_well_below_a_second(tmp_path: Path) -> None:
    rows = [f"{k},{CAMERAS[k % 3]},{k % 640}.25,{k % 480}.75" for k in range(32_000)]
    start = time.process_time()
    found = read(tmp_path, "frame,camera,x,y\n" + "\n".join(rows))
    assert len(found.line) == 32_000 and time.process_time() - start < 0.6
