"""The verdict on a night: it names everything that a person has to look at, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from wbflow.errors import ExitCode
from wbflow.pipeline.summaries import CameraFigures, CoverageSummary, PairFigures, PosesSummary
from wbflow.records.findings import FINDINGS, Finding, Verdict
from wbflow.records.record import CameraRecord, CloudRecord, PairRecord, RunRecord, Seconds, TaskCounts
from wbflow.runner.state import Cause, State
from wbflow.site.load import load_site
from wbflow.site.models import Expected
from wbflow.task import Task
from wbflow.verdict.baseline import appearance_of, baseline_before, baseline_of
from wbflow.verdict.facts import Facts
from wbflow.verdict.rules import judge, uses_sift_alone
from wbflow_stages.contracts.camera_figures import Health
from wbflow_stages.contracts.pose_figures import CalibrationCheck, PoseIssue

NAMES = ("crane", "gate", "mast", "roof")
PAIRS = [(a, b) for i, a in enumerate(NAMES) for b in NAMES[i + 1 :]]
DEFAULTS, NOTHING_FAILED = Expected(), Facts()
LOOKS = {"brightness": 110.0, "sharpness": 0.27}


def camera(name: str, **figures: float | str) -> CameraRecord:
    return CameraRecord(name, "ok", figures=CameraFigures.from_json(LOOKS | figures))


def pair(left: str, right: str, outcome: str = "ok", matched: bool = True) -> PairRecord:
    reason = None if outcome == "ok" else "23 inliers, 30 needed"
    return PairRecord(left, right, outcome, reason, matched=matched)


EVERY_PAIR = tuple(pair(*names) for names in PAIRS)


def night(
    date: str = "2026-11-20",
    cameras: Sequence[CameraRecord] = tuple(map(camera, NAMES)),
    pairs: Sequence[PairRecord] = EVERY_PAIR,
    points: int = 100_000,
    past: Sequence[RunRecord] = (),
    expected: Expected = DEFAULTS,
    facts: Facts = NOTHING_FAILED,
    settings: str = "as ever",
) -> RunRecord:
    """A judged night; `past`: the nights before it, newest first."""
    box = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    run = date.replace("-", "") + "T031500Z"
    times = f"{date}T03:15:00Z", f"{date}T03:16:00Z"
    record = RunRecord(
        run,
        "yard",
        "0.1.0",
        date,
        *times,
        exit_code=0,
        tasks=TaskCounts(),
        seconds=Seconds(1.0, 1.0),
        peak_rss_mb=1,
        cameras=tuple(cameras),
        pairs=tuple(pairs),
        cloud=CloudRecord(points, box, path="cloud.ply") if points else None,
        reason=None if points else "only camera gate has a usable capture",
        settings=settings,
    )
    usual = baseline_before(past, settings, expected.since)
    return judge(replace(record, usual=usual), replace(facts, earlier=tuple(past), expected=expected))


def verdict_of(record: RunRecord) -> Verdict:
    assert record.verdict
    return record.verdict


def only(record: RunRecord) -> Finding:
    (finding,) = verdict_of(record).findings
    return finding


def lost(name: str, code: str = "bad-input") -> CameraRecord:
    return CameraRecord(name, "failed", f"{name}.jpg is empty (0 bytes)", code)


def without(name: str) -> list[PairRecord]:
    return [pair(*names) for names in PAIRS if name not in names]


def test_a_night_without_findings_is_good() -> None:
    first = night()
    assert (verdict_of(first), first.exit_code) == (Verdict("good"), ExitCode.GOOD)
    assert verdict_of(night("2026-11-21", points=90_000, past=[first])) == Verdict("good")


def test_a_single_rejected_pair_does_not_degrade_a_night() -> None:
    pairs = [pair("crane", "gate", "rejected", matched=False), *(pair(*names) for names in PAIRS[1:])]
    assert night(pairs=pairs).exit_code == ExitCode.GOOD


def test_nights_of_a_lost_camera_are_counted_until_it_is_back() -> None:
    cameras = [*map(camera, NAMES[:3]), lost("roof")]
    nights: list[RunRecord] = [night("2026-11-16")]
    for date in ("2026-11-17", "2026-11-18", "2026-11-19"):
        nights.insert(0, night(date, cameras, without("roof"), past=nights))
    assert nights[0].exit_code == ExitCode.DEGRADED
    finding = verdict_of(nights[0]).findings[0]
    assert (finding.kind, finding.subject) == ("camera-lost", ("roof",))
    assert finding.text == "roof.jpg is empty (0 bytes); left out tonight; down since 2026-11-17, 3 nights"
    assert finding.figures == {"since": "2026-11-17", "nights": 3}
    again = night("2026-11-19", cameras, without("roof"), past=nights)
    assert verdict_of(again).findings[0].figures["nights"] == 3, "a second run of the same night"
    back = night("2026-11-20", past=nights)
    assert back.exit_code == ExitCode.GOOD
    assert back.cameras[3].notes == ("back after 3 nights: it was down since 2026-11-17",)
    assert back.cameras[3].down is None


def test_bad_nights_do_not_change_what_is_usual() -> None:
    nights = [night("2026-11-01")]
    for day in range(2, 25):
        nights = [night(f"2026-11-{day:02}", points=50_000, past=nights), *nights][:14]
    finding = only(nights[0])
    assert finding.kind == "fewer-points"
    assert finding.text == "50,000 points, 50 % of the usual 100,000"
    assert (finding.figures, finding.expected) == ({"points": 50_000}, {"points": 100_000})


def test_fewer_pairs_than_usual_are_a_finding() -> None:
    good = [night("2026-11-19")]
    record = night(cameras=[*map(camera, NAMES[:3]), lost("roof")], pairs=without("roof"), past=good)
    assert [str(finding) for finding in verdict_of(record).findings] == [
        "roof: roof.jpg is empty (0 bytes); left out tonight",
        "3 pairs, 50 % of the usual 6",
    ]


def test_without_an_earlier_night_pairs_are_compared_with_the_planned_ones() -> None:
    pairs = [pair(*names, *(("ok",) if i in {0, 5} else ("rejected", False))) for i, names in enumerate(PAIRS)]
    assert only(night(pairs=pairs)).text == "only 2 of 6 pairs could be used; most of the others: 23 inliers, 30 needed"


@pytest.mark.parametrize("before", [0, 1, 7])
def test_a_night_with_few_pairs_is_degraded_though_every_camera_is_paired(before: int) -> None:
    """21 pairs are rejected, yet every camera is in a pair, and there is a cloud."""
    names = [f"camera-{k}" for k in range(10)]
    kept = [*zip(names[::2], names[1::2], strict=True), ("camera-1", "camera-2")]
    others = [(a, b) for k, a in enumerate(names) for b in names[k + 1 : k + 5] if (a, b) not in kept][:21]
    planned = [*kept, *others]
    poor = [*(pair(*n) for n in kept), *(pair(*n, "rejected", matched=False) for n in others)]
    assert len(others) == 21
    cameras = [CameraRecord(name, "ok") for name in names]
    past = [night(f"2026-11-{19 - k}", cameras, [pair(*n) for n in planned]) for k in range(before)]
    record = night(cameras=cameras, pairs=poor, past=past)
    assert record.exit_code == ExitCode.DEGRADED
    assert "fewer-pairs" in {finding.kind for finding in verdict_of(record).findings}


def test_nights_with_other_settings_do_not_count_as_usual() -> None:
    past = [night("2026-11-19", settings="at full resolution")]
    assert night(points=40_000, past=past).exit_code == ExitCode.GOOD


@pytest.mark.parametrize(
    ("expected", "points", "kinds"),
    [
        (Expected(points=0.4), 50_000, []),
        (Expected(points=0.9), 85_000, ["fewer-points"]),
        (Expected(points=90_000), 85_000, ["fewer-points"]),
        (Expected(cameras=5), 100_000, ["fewer-cameras"]),
        (Expected(since="2026-11-20"), 50_000, []),
    ],
)
def test_expectations_of_the_site_file_decide_about_findings(expected: Expected, points: int, kinds: list[str]) -> None:
    record = night(points=points, past=[night("2026-11-19")], expected=expected)
    assert [finding.kind for finding in verdict_of(record).findings] == kinds


def test_a_lost_camera_that_the_site_may_lack_is_named_on_a_good_night() -> None:
    record = night(cameras=[*map(camera, NAMES[:3]), lost("roof")], pairs=without("roof"), expected=Expected(cameras=0.75))
    assert record.exit_code == ExitCode.GOOD
    assert only(record).subject == ("roof",)


def test_a_camera_far_darker_than_usual_is_obscured() -> None:
    cameras = [camera("crane", brightness=9.9), *map(camera, NAMES[1:])]
    record = night(cameras=cameras, past=[night("2026-11-19")])
    finding = only(record)
    assert (finding.kind, finding.subject) == ("camera-obscured", ("crane",))
    assert finding.text == "its picture has 9 % of its usual brightness"
    assert (finding.figures["brightness"], finding.expected["brightness"]) == (9.9, 110.0)
    assert night(cameras=cameras).exit_code == ExitCode.GOOD, "nobody knows how bright it should be"


def test_a_night_on_which_all_cameras_are_dark_is_good() -> None:
    cameras = [camera(name, brightness=12.0) for name in NAMES]
    assert night(cameras=cameras, past=[night("2026-11-19")]).exit_code == ExitCode.GOOD


def test_a_camera_less_sharp_than_usual_is_a_finding() -> None:
    cameras = [camera("crane", sharpness=0.07), *map(camera, NAMES[1:])]
    assert only(night(cameras=cameras, past=[night("2026-11-19")])).text == "its picture has 26 % of its usual sharpness"


def test_a_camera_whose_pairs_find_no_common_points_shows_a_wrong_scene() -> None:
    pairs = [pair(*names, matched="crane" not in names) for names in PAIRS]
    record = night(pairs=pairs, past=[night("2026-11-19")])
    finding = only(record)
    assert (finding.kind, finding.subject) == ("camera-wrong-scene", ("crane",))
    assert finding.text.startswith("0 % of its pairs find common points, usually 100 % do")


def test_the_matched_share_of_a_camera_ignores_its_lost_partners() -> None:
    pairs = [pair(*names, matched="crane" not in names) for names in PAIRS]
    cameras = [camera("crane"), *(lost(name) for name in NAMES if name != "crane")]
    assert "matched_share" not in appearance_of(night(cameras=cameras, pairs=pairs))["crane"]
    others = [camera("crane"), lost("roof"), *(camera(name) for name in NAMES if name not in {"crane", "roof"})]
    assert appearance_of(night(cameras=others, pairs=pairs))["crane"]["matched_share"] == 0


def test_the_health_of_a_camera_becomes_a_finding() -> None:
    health = Health("stale", "its picture is yesterday's", {"age_h": 26.0}, {"age_h": 2.0}, "look at its recorder")
    record = night(cameras=[replace(camera("crane"), health=health), *map(camera, NAMES[1:])])
    assert only(record).kind == "camera-stale"
    assert only(record).remedy == "look at its recorder"


def test_a_camera_left_out_for_its_health_is_reported_with_that_state() -> None:
    blind = replace(lost("roof"), outcome="skipped", health=Health("obscured", "98 % of the picture show nothing"))
    finding = verdict_of(night(cameras=[*map(camera, NAMES[:3]), blind], pairs=without("roof"))).findings[0]
    assert (finding.kind, finding.text) == ("camera-obscured", "98 % of the picture show nothing; left out tonight")


def test_a_long_reason_is_shortened_in_the_finding() -> None:
    reason = "; ".join(f"roof_{number}.jpg is empty (0 bytes)" for number in range(99))
    cameras = [*map(camera, NAMES[:3]), replace(lost("roof"), reason=reason)]
    record = night(cameras=cameras, pairs=without("roof"))
    assert verdict_of(record).findings[0].text.endswith("...; left out tonight")
    assert len(verdict_of(record).findings[0].text) < 250
    assert record.cameras[3].reason == reason


def test_a_camera_whose_stated_pose_is_contradicted_is_reported_as_moved() -> None:
    world = PosesSummary(issues=(PoseIssue("moved", "mast", text="seems to be turned by 3.1 degrees. Has it been moved?"),))
    record = judge(replace(night(), poses=world), Facts())
    assert (only(record).kind, only(record).subject) == ("camera-moved", ("mast",))


def test_a_camera_common_to_all_contradictions_is_reported_as_unverified() -> None:
    world = PosesSummary(
        issues=(PoseIssue("unverified", "mast", text="2 of its 2 pairs contradict its known pose by up to 33.8 px"),)
    )
    record = judge(replace(night(), poses=world), Facts())
    assert (only(record).kind, only(record).subject) == ("camera-unverified", ("mast",))


@pytest.mark.parametrize(
    ("dense", "rows_px", "probability", "triplets", "kinds"),
    [
        (2, 0.4, 0.9, False, []),
        (2, 1.6, 0.9, False, ["camera-unverified"]),
        (2, 0.4, 0.9, True, ["camera-unverified"]),
        (1, 0.4, 0.9, False, ["camera-unverified"]),
        (1, 0.4, 0.7, False, []),
    ],
    ids=["two rows are right", "the rows are off, too", "three cameras contradict it, too", "one is right", "unlikely pairs"],
)
def test_surfaces_found_on_the_rows_outweigh_matches_against_a_pose(
    dense: int, rows_px: float, probability: float, triplets: bool, kinds: list[str]
) -> None:
    far = {"poses_px": 19.4, "probability": probability}
    rows = PairFigures.from_json(far | {"verified": "dense", "row_error_px": rows_px})
    of_mast = [rows] * dense + [PairFigures.from_json(far)] * (3 - dense)
    figures = dict(zip([names for names in PAIRS if "mast" in names], of_mast, strict=True))
    pairs = [replace(pair(*names), figures=figures.get(names, PairFigures())) for names in PAIRS]
    issue = PoseIssue("unverified", "mast", "3 of its 3 pairs contradict its known pose by up to 19.4 px", triplets)
    stated = [camera(name, pose_from="stated") for name in NAMES]
    record = judge(replace(night(cameras=stated, pairs=pairs), poses=PosesSummary(issues=(issue,))), Facts())
    assert [found.kind for found in verdict_of(record).findings] == kinds


@pytest.mark.parametrize(
    ("solved", "rejected", "probability", "kinds"),
    [
        ("roof", ("crane--gate", "crane--mast"), 0.5, ["camera-unverified"]),
        ("roof", ("crane--gate", "crane--mast"), 0.9, []),
        ("roof", ("crane--gate",), 0.5, []),
        ("", ("crane--gate", "crane--mast"), 0.5, []),
    ],
    ids=["only a solved camera agrees", "other pairs determine it", "a stated camera agrees", "all are stated"],
)
def test_a_stated_pose_needs_a_usable_pair_with_another_stated_pose(
    solved: str, rejected: Sequence[str], probability: float, kinds: list[str]
) -> None:
    cameras = [camera(name, pose_from="solved" if name == solved else "stated") for name in NAMES]
    pairs = [pair(*names, "rejected" if "--".join(names) in rejected else "ok") for names in PAIRS]
    pairs = [replace(found, figures=PairFigures(probability=probability)) for found in pairs]
    assert [found.kind for found in verdict_of(night(cameras=cameras, pairs=pairs)).findings] == kinds


def test_uncertain_poses_of_several_cameras_are_one_finding() -> None:
    world = PosesSummary(
        issues=(
            PoseIssue("uncertain", "mast", row_px=4.07),
            PoseIssue("uncertain", "gate", row_px=2.9),
        )
    )
    record = judge(replace(night(), poses=world), Facts())
    assert (only(record).kind, only(record).subject, record.exit_code) == ("poses-uncertain", ("mast", "gate"), ExitCode.DEGRADED)
    assert "up to 4.1 px off the row" in only(record).text


def test_undetermined_lenses_are_one_finding_with_a_remedy() -> None:
    world = PosesSummary(
        issues=tuple(PoseIssue("lens-undetermined", name, focal=0.031, border_px=2.24) for name in ("mast", "gate"))
    )
    record = judge(replace(night(), poses=world), Facts())
    found = only(record)
    assert (found.kind, found.subject, record.exit_code) == ("lens-undetermined", ("mast", "gate"), ExitCode.DEGRADED)
    assert "uncertain by 3.1 %" in found.text and "2.2 px at the border" in found.text
    assert found.remedy is not None and "wbflow calibrate" in found.remedy


def test_inconsistent_solved_poses_are_a_finding() -> None:
    world = PosesSummary(
        issues=(
            PoseIssue("inconsistent", "gate", strain=21.7),
            PoseIssue("inconsistent", "mast", strain=21.7),
        )
    )
    record = judge(replace(night(), poses=world), Facts())
    found = only(record)
    assert (found.kind, found.subject, record.exit_code) == ("poses-inconsistent", ("gate", "mast"), ExitCode.DEGRADED)
    assert "22 times better" in found.text and found.figures == {"strain": 21.7}
    world = PosesSummary(issues=(PoseIssue("inconsistent", "gate", excess_px=0.55),))
    alone = only(judge(replace(night(), poses=world), Facts()))
    assert (alone.subject, alone.figures) == (("gate",), {"excess_px": 0.55})
    many = replace(found, subject=("gate", "mast", "quay"))
    assert str(found).startswith("matches of gate, mast contradict each other: ") and str(many).startswith("3 cameras: ")


@pytest.mark.parametrize("known", ["stated", "solved"])
def test_the_remedy_for_a_camera_without_a_pair_doubts_only_a_stated_pose(known: str) -> None:
    tried = [replace(p, outcome="rejected", figures=PairFigures(known=known)) if "roof" in p.cameras else p for p in EVERY_PAIR]
    finding = next(f for f in verdict_of(night(pairs=tried)).findings if f.kind == "camera-no-usable-pair")
    assert finding.subject == ("roof",)
    assert ("its pose is not the one in the site file" in finding.remedy) is (known == "stated")


@pytest.mark.parametrize(("angle", "is_wide"), [(20.0, False), (48.0, True), (None, False)])
def test_a_camera_whose_views_are_all_far_apart_says_so(angle: float | None, is_wide: bool) -> None:
    figures = PairFigures(angle_deg=angle)
    tried = [replace(p, outcome="rejected", figures=figures) if "roof" in p.cameras else p for p in EVERY_PAIR]
    finding = next(f for f in verdict_of(night(pairs=tried)).findings if f.kind == "camera-no-usable-pair")
    assert ("(views 48 to 48 degrees apart)" in finding.text) is is_wide
    assert ("add a camera in between" in finding.remedy) is is_wide


@pytest.mark.parametrize(
    ("code", "sift_alone", "is_proposed"),
    [("too-few-inliers", True, True), ("too-few-inliers", False, False), ("pure-rotation", True, False)],
)
def test_learned_keypoints_are_proposed_to_a_site_without_them_where_too_few_matches_leave_a_camera_without_a_pair(
    code: str, sift_alone: bool, is_proposed: bool
) -> None:
    tried = [replace(p, outcome="rejected", code=code, matched=False) if "roof" in p.cameras else p for p in EVERY_PAIR]
    facts = Facts(sift_alone=sift_alone)
    found = [only(night(pairs=tried, facts=facts))]
    unsolved = [*map(camera, NAMES[:3]), replace(camera("roof"), outcome="unsolved", code=Cause.UNSOLVED)]
    found.append(only(night(cameras=unsolved, pairs=tried, facts=facts)))
    assert [finding.kind for finding in found] == ["camera-no-usable-pair", "camera-unsolved"]
    for finding in found:
        assert ("wbflow models get aliked-n32" in finding.remedy) is is_proposed
        assert ("detector: sift+onnx, model: aliked-n32" in finding.remedy) is is_proposed


@pytest.mark.parametrize(
    ("stages", "is_so"),
    [
        ("", True),
        ("features: {detector: sift}, matches: {matcher: mutual}", True),
        ("features: {detector: sift+onnx, model: mine.onnx}", False),
        ("matches: {matcher: onnx, model: mine.onnx}", False),
        ("features: {detector: 'mine:detect'}", False),
        ("features: {use: 'mine:detect'}", False),
    ],
)
def test_a_site_uses_sift_alone_unless_it_has_a_model_or_keypoints_of_its_own(tmp_path: Path, stages: str, is_so: bool) -> None:
    (tmp_path / "mine.onnx").write_bytes(b"weights")
    (tmp_path / "mine.py").write_text("def detect(frame):\n    return None\n")
    file = tmp_path / "site.yaml"
    file.write_text(
        f"site: yard\ncaptures: {{root: ., pattern: '{{camera}}.jpg'}}\ncameras: [gate, roof]\nstages: {{{stages}}}\n"
    )
    assert uses_sift_alone(load_site(file)) is is_so


@pytest.mark.parametrize(("pose_from", "is_proposed"), [("matches", True), ("stated", False)])
def test_learned_keypoints_are_proposed_for_a_camera_in_no_pair_unless_poses_chose_the_pairs(
    pose_from: str, is_proposed: bool
) -> None:
    cameras = [*map(camera, NAMES[:3]), camera("roof", pose_from=pose_from)]
    finding = only(night(cameras=cameras, pairs=without("roof"), facts=Facts(sift_alone=True)))
    assert finding.kind == "camera-unpaired"
    assert ("learned keypoints" in finding.remedy) is is_proposed


def rejected_pair(left: str, right: str, given: float, beside: float) -> PairRecord:
    """A pair with stated poses, rejected by dense matching; given, beside: shares that match on the stated rows and eight off."""
    figures = PairFigures(known="stated", row_share=given, row_chance=beside)
    return PairRecord(left, right, "rejected", "dense matching does not confirm the cameras", matched=True, figures=figures)


def test_only_the_camera_that_explains_the_rejected_pairs_is_named() -> None:
    wide = rejected_pair("crane", "roof", 0.026, 0.024)  # no evidence: about as much matches eight rows off
    tried = [pair("crane", "gate"), rejected_pair("crane", "mast", 0.03, 0.1), rejected_pair("gate", "mast", 0.01, 0.012), wide]
    (fruitless,) = (
        f
        for f in verdict_of(night(pairs=[*tried, rejected_pair("mast", "roof", 0.1, 0.16)])).findings
        if f.kind == "camera-no-usable-pair"
    )
    assert fruitless.subject == ("mast",)
    assert "roof has no conclusive pair" in fruitless.text and "measure it again" in fruitless.remedy


def test_two_cameras_with_equally_many_rejected_pairs_are_both_named() -> None:
    tried = [
        pair("crane", "gate"),
        rejected_pair("crane", "mast", 0.03, 0.1),
        rejected_pair("gate", "roof", 0.03, 0.1),
        rejected_pair("mast", "roof", 0.1, 0.16),
    ]
    found = verdict_of(night(pairs=tried)).findings
    assert [f.subject for f in found if f.kind == "camera-no-usable-pair"] == [("mast",), ("roof",)]


def test_a_camera_all_of_whose_pairs_failed_is_not_at_fault() -> None:
    """The function of a stage is: the finding about its tasks says so."""
    tried = [pair("crane", "gate"), pair("crane", "roof", "failed"), pair("gate", "roof", "failed")]
    assert "camera-no-usable-pair" not in [finding.kind for finding in verdict_of(night(pairs=tried)).findings]


def test_a_camera_in_no_pair_is_a_finding() -> None:
    assert only(night(pairs=without("roof"))).kind == "camera-unpaired"


def test_failed_tasks_of_one_cause_are_one_finding() -> None:
    state = State("failed", "lost its worker process, twice", Cause.WORKER_LOST)
    failed = tuple((Task("matches", names), state) for names in PAIRS[:3])
    finding = only(night(facts=Facts(failed)))
    assert finding.text == "matches crane--gate failed: lost its worker process, twice (and 2 more tasks with the same cause)"


def test_no_cloud_is_a_failure_unless_none_was_asked_for() -> None:
    record = night(cameras=[camera("crane"), *map(lost, NAMES[1:])], pairs=[], points=0)
    assert (verdict_of(record).level, record.exit_code) == ("failed", ExitCode.FAILED)
    assert verdict_of(record).findings[0].text == "no cloud: only camera gate has a usable capture"
    assert night(points=0, facts=Facts(product=False)).exit_code == ExitCode.GOOD


def test_a_missing_requested_result_other_than_a_cloud_is_a_failure() -> None:
    record = night(points=0, facts=Facts(product=False, missing=("poses", "of 11 pairs none is more likely right than wrong")))
    assert (only(record).kind, verdict_of(record).level, record.exit_code) == ("no-result", "failed", ExitCode.FAILED)


def test_an_interrupted_night_is_reported_and_never_counts_as_usual() -> None:
    record = night(points=0, facts=Facts(interrupted=True))
    assert (only(record).kind, record.exit_code) == ("interrupted", ExitCode.INTERRUPTED)
    assert baseline_before([record], "as ever") is None


def test_less_ground_seen_than_usual_is_a_finding() -> None:
    seen = [
        replace(night(date), poses=PosesSummary(), results={"coverage": CoverageSummary(area_m2=400.0, seen_by_two=share)})
        for date, share in (("2026-11-19", 0.8), ("2026-11-20", 0.3))
    ]
    record = judge(replace(seen[1], usual=baseline_before([seen[0]], "as ever")), Facts())
    assert only(record).text == "120 m² seen by two cameras, 38 % of the usual 320"


def test_usual_figures_are_medians() -> None:
    usual = baseline_of([night(points=points) for points in (90_000, 100_000, 250_000)])
    assert (usual.nights, usual.figures) == (3, {"points": 100_000, "pairs": 6})
    assert usual.cameras["gate"] == {**LOOKS, "matched_share": 1.0}


def test_captures_that_change_during_the_run_are_named() -> None:
    moving = replace(camera("gate"), captures_in_motion=("gate.jpg",))
    record = night(cameras=[moving, *map(camera, ("crane", "mast", "roof"))])
    finding = only(record)
    assert (finding.kind, finding.subject, record.exit_code) == ("captures-in-motion", ("gate",), ExitCode.DEGRADED)
    assert "gate.jpg" in finding.text


def test_cameras_that_deliver_the_same_picture_are_named_unless_it_is_blank() -> None:
    def showing(name: str, contrast: float) -> CameraRecord:
        return CameraRecord(name, "ok", figures=CameraFigures(picture_digest="a" if name != "roof" else "b", contrast=contrast))

    finding = only(night(cameras=[showing(name, 40.0) for name in NAMES]))
    assert (finding.kind, finding.subject) == ("cameras-alike", ("crane", "gate", "mast"))
    nothing = verdict_of(night(cameras=[showing(name, 0.5) for name in NAMES])).findings
    assert [finding.kind for finding in nothing] == ["pictures-soft"]


@pytest.mark.parametrize(
    ("detail_px", "misfit", "soft"),
    [(1.0, 0.9, False), (3.0, 0.9, False), (1.0, 2.0, False), (2.2, 1.6, True), (3.6, 1.2, True)],
)
def test_pictures_that_lack_detail_are_soft_if_their_points_fit_badly(detail_px: float, misfit: float, soft: bool) -> None:
    figures = CameraFigures(detail_px=detail_px, misfit=misfit)
    found = verdict_of(night(cameras=[CameraRecord(name, "ok", figures=figures) for name in NAMES])).findings
    assert [finding.kind for finding in found] == (["pictures-soft"] if soft else [])


@pytest.mark.parametrize(
    ("coarseness", "misfit", "soft"),
    [(1.4, 0.9, False), (1.4, 1.5, False), (1.0, 1.8, False), (1.45, 1.8, True), (1.0, 2.1, True)],
)
def test_badly_fitting_pictures_are_soft_sooner_if_coarsely_coded(coarseness: float, misfit: float, soft: bool) -> None:
    figures = CameraFigures(coarseness=coarseness, misfit=misfit)
    found = verdict_of(night(cameras=[CameraRecord(name, "ok", figures=figures) for name in NAMES])).findings
    assert [finding.kind for finding in found] == (["pictures-soft"] if soft else [])


@pytest.mark.parametrize(
    ("epipolar_px", "misfit", "soft"), [(0.4, 1.8, False), (0.9, 0.9, False), (0.6, 1.7, True), (0.8, 1.8, True)]
)
def test_pictures_distorted_by_hot_air_are_soft(epipolar_px: float, misfit: float, soft: bool) -> None:
    cameras = [replace(camera(name), figures=CameraFigures(misfit=misfit)) for name in NAMES]
    figures = PairFigures(epipolar_px=epipolar_px, probability=0.9)
    pairs = [replace(pair(*names), figures=figures) for names in PAIRS]
    found = verdict_of(night(cameras=cameras, pairs=pairs)).findings
    assert [finding.kind for finding in found] == (["pictures-soft"] if soft else [])
    assert all(f"matches {epipolar_px:.1f} px from their epipolar lines" in finding.text for finding in found)


@pytest.mark.parametrize(("misfit", "cameras", "degraded"), [(0.7, 4, False), (0.9, 4, False), (1.5, 1, False), (1.5, 4, True)])
def test_points_that_fit_much_worse_than_on_usual_nights_degrade_the_night(misfit: float, cameras: int, degraded: bool) -> None:
    before = night("2026-11-19", [replace(camera(name), figures=CameraFigures(misfit=0.7)) for name in NAMES])
    tonight = [
        replace(camera(name), figures=CameraFigures(misfit=misfit if k < cameras else 0.7)) for k, name in enumerate(NAMES)
    ]
    found = verdict_of(night(cameras=tonight, past=[before])).findings
    assert [finding.kind for finding in found] == (["pictures-soft"] if degraded else [])
    assert all("points 1.5 times as far off as expected (usually 0.7)" in finding.text for finding in found)
    assert verdict_of(night(cameras=tonight)).good, "a first night"
    blurred = only(night(cameras=[camera(name, blur_px=4.0) for name in NAMES], past=[before]))
    assert "usually" not in blurred.text, "points of tonight are unknown"


@pytest.mark.parametrize(("saturated", "blinded", "degraded"), [(0.45, 4, False), (0.6, 1, False), (0.6, 4, True)])
def test_mostly_white_pictures_of_several_cameras_degrade_the_night(saturated: float, blinded: int, degraded: bool) -> None:
    cameras = [camera(name) for name in NAMES]
    cameras[:blinded] = [replace(one, figures=CameraFigures(saturated=saturated)) for one in cameras[:blinded]]
    found = verdict_of(night(cameras=cameras)).findings
    assert [finding.kind for finding in found] == (["pictures-soft"] if degraded else [])


@pytest.mark.parametrize(("contrast", "faint", "degraded"), [(17.0, 4, False), (8.8, 1, False), (8.8, 4, True)])
def test_low_contrast_in_pictures_of_several_cameras_degrades_the_night(contrast: float, faint: int, degraded: bool) -> None:
    cameras = [camera(name) for name in NAMES]
    cameras[:faint] = [replace(one, figures=CameraFigures(contrast=contrast)) for one in cameras[:faint]]
    found = verdict_of(night(cameras=cameras)).findings
    assert [finding.kind for finding in found] == (["pictures-soft"] if degraded else [])


@pytest.mark.parametrize("figures", [CameraFigures(blur_px=4.0), CameraFigures(noise_left=14.0), CameraFigures(coarseness=1.8)])
def test_a_single_blurred_noisy_or_coarse_camera_is_named(figures: CameraFigures) -> None:
    cameras = [camera(name) for name in NAMES]
    cameras[1] = replace(cameras[1], figures=figures)
    finding = only(night(cameras=cameras))
    assert (finding.kind, finding.subject) == ("pictures-soft", (NAMES[1],))


def test_detail_and_misfit_of_a_single_camera_are_not_a_finding() -> None:
    cameras = [camera(name) for name in NAMES]
    cameras[1] = replace(cameras[1], figures=CameraFigures(detail_px=2.0, misfit=3.0))
    assert night(cameras=cameras).exit_code == ExitCode.GOOD


def test_a_camera_common_to_all_disagreeing_depths_is_named() -> None:
    def dense(name: str, **offset_px: float) -> CameraRecord:
        return CameraRecord(
            name, "ok", figures=CameraFigures(offset_px={p.replace("_", "--"): px for p, px in offset_px.items()})
        )

    cameras = [dense("gate", crane_mast=1.5, mast_roof=0.1), dense("mast", crane_gate=0.9), dense("roof", crane_mast=0.6)]
    finding = only(night(cameras=[*cameras, dense("crane")]))
    assert (finding.kind, finding.subject) == ("pairs-disagree", ("crane",))
    assert "1.5 px" in finding.text
    assert verdict_of(night(cameras=[dense("gate", crane_mast=0.2), *map(dense, ("crane", "mast", "roof"))])).good
    solved = replace(dense("gate", crane_mast=0.4), figures=CameraFigures(offset_px={"crane--mast": 0.4}, pose_from="solved"))
    others = [*map(dense, ("crane", "mast", "roof"))]
    assert verdict_of(night(cameras=[solved, *others])).good, "matches tell its pose no better"
    assert verdict_of(night(cameras=[dense("gate", crane_mast=0.4), *others])).good, "what one view alone has, no pose explains"
    assert not verdict_of(night(cameras=[dense("gate", crane_mast=0.6), *others])).good
    assert not verdict_of(night(cameras=[dense("gate", crane_mast=0.4), *others[:2], dense("roof", crane_mast=0.3)])).good
    assert verdict_of(night(cameras=[dense("gate", crane_mast=79.0), *others])).good, "a pair that sees look-alikes"
    once = [
        dense("gate", crane_mast=0.6, mast_roof=0.1, crane_roof=0.1),
        dense("mast", crane_gate=0.1),
        dense("roof", crane_mast=0.1),
    ]
    finding = only(night(cameras=[*once, dense("crane")]))
    assert finding.subject == () and "no single camera explains it" in finding.text
    corner = CalibrationCheck(3000, 12, True, 1.0, True, cause="principal-points-corner", sigmas=5.0)
    record = replace(night(cameras=[*cameras, dense("crane")]), poses=PosesSummary(calibration=corner))
    finding = only(judge(record, Facts()))
    assert (finding.kind, finding.subject) == ("calibration-contradicted", ())
    assert "half a pixel less" in finding.text and "subtract 0.5 from cx and cy" in finding.remedy


@pytest.mark.parametrize(("correct_share", "good"), [(None, True), (0.93, True), (0.85, False)])
def test_a_cloud_with_too_few_probably_right_points_degrades_the_night(correct_share: float | None, good: bool) -> None:
    record = night()
    assert record.cloud
    record = judge(replace(record, cloud=replace(record.cloud, correct_share=correct_share)), Facts())
    assert verdict_of(record).good == good
    if not good:
        assert only(record).kind == "cloud-doubtful" and "85.0 % of the cloud's points" in only(record).text


def test_a_stated_camera_without_matches_is_reported_only_after_dense_matching() -> None:
    cameras = [replace(one, figures=replace(one.figures, pose_from="stated")) for one in map(camera, NAMES)]
    tried = [pair(*names, outcome="rejected" if "mast" in names else "ok", matched="mast" not in names) for names in PAIRS]
    until_poses = verdict_of(night(cameras=cameras, pairs=tried, facts=Facts(product=False))).findings
    to_the_end = verdict_of(night(cameras=cameras, pairs=tried)).findings
    kinds = [[f.kind for f in found].count("camera-no-usable-pair") for found in (until_poses, to_the_end)]
    assert kinds == [0, 1]


def test_the_guide_lists_every_finding_with_its_meaning_and_remedy() -> None:
    guide = (Path(__file__).parents[3] / "sites" / "README.md").read_text()
    listed = [line for line in guide.splitlines() if line.startswith(tuple(f"| `{code}`" for code in FINDINGS))]
    assert listed == [f"| `{row.code}` | {row.meaning} | {row.remedy} |" for row in FINDINGS.values()]


CONTRADICTED = tuple(PoseIssue("contradicted", name, "by 5.0 degrees") for name in ("gate", "mast"))


@pytest.mark.parametrize(
    ("figures", "kind", "subject", "words"),
    [
        ({"issues": CONTRADICTED}, "poses-contradicted", ("gate", "mast"), "5.0"),
        ({"distances_off": {"gate--mast": (120.0, 12.0)}}, "distances-contradicted", ("gate", "mast"), "distance is 120 m"),
        ({"points_off": {"control point 2": (2.0, 0.4)}}, "control-contradicted", (), "control point 2"),
        ({"units_off": {"nearest": (8200.0, 1000.0)}}, "units-implausible", (), "millimetres"),
    ],
)
def test_contradicted_statements_of_the_site_file_degrade_the_night(
    figures: dict[str, Any], kind: str, subject: tuple[str, ...], words: str
) -> None:
    record = judge(replace(night(), poses=PosesSummary(**figures)), Facts())
    found = only(record)
    assert (found.kind, found.subject, record.exit_code) == (kind, subject, ExitCode.DEGRADED)
    assert words in found.text


def dense_rows(sigmas: float, contradicted: bool = False, confirmed: bool = False) -> CalibrationCheck:
    cause = "focal-lengths" if contradicted else ""
    return CalibrationCheck(120, 7, confirmed, 1.5, contradicted, cause, (), (-0.005,), sigmas=sigmas)


def test_dense_matches_off_their_rows_contradict_the_calibration() -> None:
    finding = only(judge(replace(night(), poses=PosesSummary(rows=dense_rows(5.0, True))), Facts()))
    assert finding.kind == "calibration-contradicted"
    assert "5 standard deviations off their predicted rows; all focal lengths 0.5 % shorter or more" in finding.text


@pytest.mark.parametrize(("sigmas", "good"), [(2.0, True), (6.0, False)])
def test_slightly_different_depths_are_tolerated_if_dense_matches_lie_on_their_rows(sigmas: float, good: bool) -> None:
    apart = [CameraRecord("gate", "ok", figures=CameraFigures(offset_px={"crane--mast": 0.4, "mast--roof": 0.3}))]
    record = replace(night(cameras=apart), poses=PosesSummary(rows=dense_rows(sigmas)))
    assert (judge(record, Facts()).exit_code == ExitCode.GOOD) == good


@pytest.mark.parametrize(("amount", "words"), [(0.035, "2.01 degrees further clockwise"), (-0.035, "further counterclockwise")])
def test_headings_that_are_off_are_named_with_the_way_to_turn_them(amount: float, words: str) -> None:
    check = CalibrationCheck(164, 5, True, 5.0, True, cause="headings", amount=(amount,))
    assert words in only(judge(replace(night(), poses=PosesSummary(calibration=check)), Facts())).text


def test_rows_name_the_cause_if_keypoints_contradict_without_one() -> None:
    keypoints, rows = CalibrationCheck(217, 7, True, 3.9, True), dense_rows(9.0, True)
    finding = only(judge(replace(night(), poses=PosesSummary(calibration=keypoints, rows=rows)), Facts()))
    assert "all focal lengths 0.5 % shorter or more explain that" in finding.text
    of_one = replace(rows, cause="moved", cameras=("gate",))  # random errors of all cameras fit that, too
    finding = only(judge(replace(night(), poses=PosesSummary(calibration=keypoints, rows=of_one)), Facts()))
    assert finding.subject == () and "neither the lenses nor a single camera explain that" in finding.text


def test_a_camera_that_keypoints_blame_stays_a_finding_despite_good_rows() -> None:
    blamed = CalibrationCheck(9, 5, True, 2.0, True, cause="focal-length", cameras=("gate",), amount=(0.1,))
    poses = PosesSummary(calibration=blamed, rows=dense_rows(2.0, confirmed=True))
    assert only(judge(replace(night(), poses=poses), Facts())).kind == "calibration-contradicted"


@pytest.mark.parametrize(("sigmas", "confirmed", "good"), [(2.0, True, True), (2.0, False, False), (6.0, True, False)])
def test_rows_of_pairs_that_connect_all_cameras_outweigh_contradicting_keypoints(
    sigmas: float, confirmed: bool, good: bool
) -> None:
    """A hall whose sides are alike: third cameras see look-alikes, too, and confirm them."""
    rows = dense_rows(sigmas, confirmed=confirmed)
    for poses in (
        PosesSummary(calibration=CalibrationCheck(217, 7, True, 3.9, True), rows=rows),
        PosesSummary(calibration=CalibrationCheck(217, 7, True, 3.9, True, "distortion", amount=(0.1,)), rows=rows),
        PosesSummary(issues=CONTRADICTED, rows=rows),
    ):
        assert (judge(replace(night(), poses=poses), Facts()).exit_code == ExitCode.GOOD) == good


def test_a_calibration_that_could_not_be_checked_is_unverified_but_no_finding() -> None:
    world = PosesSummary(source="calibration")
    assert world.unverified and judge(replace(night(), poses=world), Facts()).exit_code == ExitCode.GOOD
    assert not PosesSummary(source="solved").unverified
    assert not PosesSummary(source="calibration", calibration=CalibrationCheck(misfit=1.0)).unverified
