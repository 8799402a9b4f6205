"""Was it a good night?  The findings of a run, its level, and its exit code: the one place that decides.

A night is good where there is nothing to look at; it has failed where there is no cloud; it is degraded where a camera that
should give something gave nothing or is not as it should be, where a task failed, and where much less came of it than is usual
(the last good nights with the same settings) or, without these, than its own plan expected.  A pair that finds nothing is no
failure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from ..errors import ExitCode, counted
from ..pipeline.rows import Role
from ..pipeline.stages import STAGES, stage_with
from ..records.record import CameraRecord, Down, Finding, Health, PairRecord, RunRecord, Usual, Verdict
from ..runner.planner import Plan
from ..runner.state import Cause, State
from ..site.models import Expected, Measure
from ..task import Task, camera_of
from .at_fault import at_fault
from .past import Past, figures_of, looks_of, median, pinned_usual, settings_of
from .record import root_cause

PLANNED_PAIRS = 0.5
"""Fewer of the planned pairs than this share are too few on a night without an earlier one to compare with."""
FOUND_SHARE = 0.25
"""A camera of whose pairs fewer than this share of the usual share find common points shows something else."""
SHARP_SHARE = 0.4
"""A picture with less than this share of its usual sharpness is out of focus, or behind drops or dirt."""
MOST_LETTERS = 200
"""A reason has at most so many letters in a finding."""

_BACK = "it is used again by itself as soon as its captures are"


@dataclass(frozen=True)
class Facts:
    """What the verdict rests on, besides the record."""

    failed: tuple[tuple[Task, State], ...] = ()
    """Tasks that failed."""
    product: bool = True
    """Was a cloud asked for?"""
    lacks: str = ""
    """What else was asked for of the whole site and is not there, and why."""
    interrupted: bool = False
    stopped: tuple[State, ...] = ()
    """Of tasks that were not begun since the time was over."""
    behind: Finding | None = None
    """What is not yet where it is to go besides."""

    @staticmethod
    def of(plan: Plan, interrupted: bool, behind: Finding | None = None) -> Facts:
        """Those of a plan that is settled."""
        failed = tuple((task, state) for task, state in plan.states.items() if state.outcome == "failed")
        stopped = tuple(state for state in plan.states.values() if state.code == Cause.STOPPED)
        product = stage_with(Role.PRODUCT) in plan.stages()
        asked = plan.states.get(Task(plan.until)) if plan.until and not product else None
        lacks = f"no {plan.until}: {root_cause(plan, Task(plan.until))}" if plan.until and asked and not asked.usable else ""
        return Facts(failed, product, lacks, interrupted, stopped, behind)


def judged(record: RunRecord, plan: Plan, past: Past, interrupted: bool, behind: Finding | None = None) -> RunRecord:
    """A record with what it was compared with, how its cameras are, its verdict and its exit code.

    Parameters
    ----------
    record : RunRecord
        Of a run that ends now.
    plan : Plan
        With the states of all its tasks.
    past : Past
        The runs before it.
    interrupted : bool
        Was it stopped from outside?
    behind : Finding, optional
        What is not yet where it is to go besides.
    """
    site = plan.site
    settings = settings_of(site)
    usual = past.usual(settings, site.expected.since)
    if plan.reference and not plan.reference.automatic:
        usual = pinned_usual(plan.cache.work, plan.reference.run, settings, usual)
    record = replace(record, settings=settings, usual=usual)
    return judge(record, Facts.of(plan, interrupted, behind), past, site.expected)


def judge(record: RunRecord, facts: Facts, past: Past, expected: Expected) -> RunRecord:
    """The same from the record alone.

    Parameters
    ----------
    record : RunRecord
        With what it is compared with in it.
    facts : Facts
        What the record does not tell.
    past : Past
        The runs before it.
    expected : Expected
        What the site file says of good nights.
    """
    night = _shares(record)
    looks, known = looks_of(record), record.usual.cameras if record.usual else {}
    cameras = tuple(
        _with_health(camera, looks.get(camera.id, {}), known.get(camera.id, {}), night, expected) for camera in record.cameras
    )
    record = replace(record, cameras=cameras)
    cameras = tuple(_with_down(camera, record, past) for camera in cameras)
    record = replace(record, cameras=cameras)
    of_cameras = *_of_cameras(record), *_of_poses(record), *_of_solved(record), *_of_lenses(record)
    found = (*_whole(record, facts), *of_cameras, *_of_tasks(record, facts), *_of_figures(record, facts, expected))
    verdict = Verdict("good", found)
    if facts.interrupted or facts.lacks or (facts.product and not record.cloud):
        verdict = Verdict("failed", found)
    elif any(not _tolerated(finding, record, expected) for finding in found):
        verdict = Verdict("degraded", found)
    return replace(record, verdict=verdict, exit_code=exit_code(verdict, facts.interrupted))


def exit_code(verdict: Verdict, interrupted: bool = False) -> ExitCode:
    """How a run with a verdict ends."""
    if interrupted:
        return ExitCode.INTERRUPTED
    return {"good": ExitCode.GOOD, "degraded": ExitCode.DEGRADED, "failed": ExitCode.FAILED}[verdict.level]


def _whole(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    if facts.stopped:
        text = f"{facts.stopped[0].reason}: {counted(len(facts.stopped), 'task')} not done"
        remedy = "run it again without --stop-at: it goes on from there; begin earlier, or lower `resolution`"
        yield Finding("stopped", (), text, {"tasks": len(facts.stopped)}, remedy=remedy)
    if facts.interrupted:
        yield Finding("interrupted", (), "interrupted; everything finished is kept", remedy="run it again: it goes on from there")
    elif facts.lacks:
        yield Finding("no-result", (), shortened(facts.lacks))
    elif facts.product and not record.cloud:
        yield Finding("no-cloud", (), f"no cloud: {shortened(record.reason or 'nothing says why')}")
    if facts.behind:
        yield facts.behind


def _of_cameras(record: RunRecord) -> Iterator[Finding]:
    faults = at_fault(record)
    excused = {name for others in faults.values() for name in others}
    for camera in record.cameras:
        trouble = _trouble(camera, record)
        if trouble and trouble.kind == "camera-fruitless":
            trouble = None if camera.id in excused else _blamed(trouble, faults.get(camera.id))
        if trouble:
            down = camera.down
            nights = f"; {down.told(left_out=not camera.ok)}" if down and down.nights > 1 else ""
            figures = {"since": down.since, "nights": down.nights} if down else {}
            yield replace(trouble, text=trouble.text + nights, figures={**trouble.figures, **figures})


def _trouble(camera: CameraRecord, record: RunRecord) -> Finding | None:
    """What is wrong with a camera tonight: the first thing that is."""
    subject, pairs = (camera.id,), record.pairs_of(camera.id)
    if (health := camera.health) and not health.ok:
        text = health.text if camera.ok else f"{shortened(health.text)}; left out tonight"
        remedy = health.remedy or _remedy_of_lost(camera)
        return Finding(f"camera-{health.state}", subject, text, health.figures, health.expected, remedy)
    if not camera.ok:
        kind = "camera-unsolved" if camera.code == Cause.UNSOLVED else "camera-lost"
        text = f"{shortened(camera.reason or camera.outcome)}; left out tonight"
        return Finding(kind, subject, text, remedy=_remedy_of_lost(camera))
    if record.poses and camera.id in record.poses.suspects:
        remedy = "look at it; calibrate it anew if it has been moved"
        return Finding("camera-moved", subject, record.poses.suspects[camera.id], remedy=remedy)
    if record.poses and camera.id in record.poses.doubtful:
        remedy = "look at it; if it has been moved, calibrate it anew or leave out its pose"
        return Finding("camera-unverified", subject, record.poses.doubtful[camera.id], remedy=remedy)
    if record.pairs and not pairs:
        text = "no other camera seems to see enough of what it sees: it is in no pair"
        return Finding("camera-alone", subject, text, remedy="look at where it points, and at `pairs:` in the site file")
    tried = [pair for pair in pairs if pair.outcome != "skipped" and pair.figures.get("dense") is not False]
    if tried and not any(pair.ok for pair in tried):
        which = f"none of its {len(tried)} pairs could" if len(tried) > 1 else "its only pair could not"
        text = f"{which} be used: {_most_common(tried)}"
        remedy = "look at where it points, and whether anything stands before it"
        if any(pair.figures.get("known") == "stated" for pair in tried):
            remedy += "; or its pose is not what the site file says: measure it anew, or leave it out to have it solved"
        return Finding("camera-fruitless", subject, text, {Measure.PAIRS: 0}, {Measure.PAIRS: len(tried)}, remedy)
    return None


def _blamed(fruitless: Finding, excused: tuple[str, ...] | None) -> Finding:
    """A camera without a usable pair whose stated pose is at fault for that; excused: others that have none because of it."""
    if excused is None:
        return fruitless
    text = f"{fruitless.text}; its stated pose explains that, and no other camera's explains as much"
    if excused:
        have = "has" if len(excused) == 1 else "have"
        text += f", and {' and '.join(excused)} {have} no pair beside those with it that tells anything"
    remedy = "it does not stand or look as the site file says: measure its pose anew, or leave it out to have it solved"
    return replace(fruitless, text=text, remedy=remedy)


def _of_poses(record: RunRecord) -> Iterator[Finding]:
    """Stated poses that are not known well enough, and that the pictures could not make better."""
    if not record.poses or not record.poses.uncertain:
        return
    names, worst = tuple(record.poses.uncertain), max(record.poses.uncertain.values())
    listed = shortened(", ".join(names))
    text = f"known poses are not exact enough, and tonight's pictures tell them no better: {listed}; what matches may be"
    text += f" up to {worst:.1f} px beside the row where it is looked for: depths may be of look-alikes"
    remedy = "measure these poses more exactly; or leave them out, to have them solved; or add a camera that sees what these see"
    yield Finding("poses-uncertain", names, text, {"row_px": worst}, remedy=remedy)


def _of_solved(record: RunRecord) -> Iterator[Finding]:
    """Cameras that matches of look-alikes have a say in: they fit, and yet may stand elsewhere."""
    if not record.poses or not record.poses.strained:
        return
    names, worst = tuple(record.poses.strained), max(record.poses.strained.values())
    text = f"matches contradict each other: {shortened(', '.join(names))}; those that a third camera confirms fit other poses,"
    text += f" {worst:.0f} times better than noise explains, and cameras are solved from these alone where that can be: something"
    text += " repeats in the scene, or a lens is not as it is stated; cloud and poses may be bent, though they fit the pictures"
    remedy = "state poses and lenses that have been measured; or add a camera between those that stand far apart"
    yield Finding("poses-strained", names, text, {"strain": worst}, remedy=remedy)


def _of_lenses(record: RunRecord) -> Iterator[Finding]:
    """Lenses that nobody stated and tonight's pictures don't tell: all that rests on them may be bent, though it fits."""
    if not record.poses or not record.poses.unsure_lenses:
        return
    unsure = record.poses.unsure_lenses
    focal, border = (max(sigma[name] for sigma in unsure.values()) for name in ("focal", "border_px"))
    text = f"the lens was not stated, and tonight's pictures do not determine it: {shortened(', '.join(unsure))}; noise and what"
    text += f" is wrong in matches leave {100 * focal:.1f} % of its focal length open and {border:.1f} px at the border (standard"
    text += " deviations), often several times as much: cloud and poses may be bent or stretched, though they fit the pictures"
    remedy = "state the lens (wbflow calibrate finds it); or add cameras that see the same things from nearer, farther or aside"
    yield Finding("lens-undetermined", tuple(unsure), text, {"focal": focal, "border_px": border}, remedy=remedy)


def _remedy_of_lost(camera: CameraRecord) -> str:
    if camera.code == Cause.UNSOLVED:
        between = "a camera nearby that sees the same things from an angle between would tie it in"
        return f"state its lens, if the site file does not (wbflow calibrate finds it): wide ones need that; or {between}"
    if camera.code == Cause.NO_CAPTURE:
        return f"see that it delivers: {_BACK}"
    return f"look at the camera: {_BACK}"


def _of_tasks(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Failed tasks, those that failed for the same cause together; the cause of a lost camera is told with the camera."""
    told = {camera.id for camera in record.cameras if not camera.ok}
    groups: dict[tuple[str, str | None], list[tuple[Task, State]]] = {}
    for task, state in facts.failed:
        if not (len(task.subject) == 1 and camera_of(task.subject[0]) in told):
            groups.setdefault((task.stage, state.code), []).append((task, state))
    for (_, code), tasks in groups.items():
        task, state = tasks[0]
        more = f" (and {len(tasks) - 1} more like it)" if len(tasks) > 1 else ""
        remedy = "wbflow run -v SITE.yaml  shows where" if code == Cause.FAULT else ""
        text = f"{task} failed: {shortened(state.reason or '')}{more}"
        yield Finding("task-failed", task.subject, text, {"tasks": len(tasks)}, remedy=remedy)


def _of_figures(record: RunRecord, facts: Facts, expected: Expected) -> Iterator[Finding]:
    """What came of the night as a whole, compared with what is usual, or stated, or planned."""
    if facts.interrupted or not facts.product or not record.cloud:
        return
    usual = record.usual or Usual(0, {})
    figures = figures_of(record) | {Measure.CAMERAS: float(sum(camera.ok for camera in record.cameras))}
    units = {s.name: f"{s.reports.expects.unit} {s.reports.expects.words}" for s in STAGES if s.reports and s.reports.expects}
    things: dict[str, str] = {Measure.POINTS: "point", Measure.PAIRS: "pair", Measure.CAMERAS: "camera"}
    for name, value in figures.items():
        limit, much = expected.limit(name), f"{value:,.0f} {units[name]}" if name in units else counted(value, things[name])
        base = float(len(record.cameras)) if name == Measure.CAMERAS else usual.figures.get(name)
        if limit > 1:
            if value < limit:
                yield _fewer(name, value, limit, f"{much}, at least {limit:,.0f} are expected")
        elif name == Measure.CAMERAS:
            continue  # each one that is lost is a finding of its own
        elif base is not None and value < limit * base:
            whose = "the reference's" if usual.reference else "the usual"
            yield _fewer(name, value, base, f"{much}, {100 * value / base:.0f} % of {whose} {base:,.0f}")
        elif base is None and name == Measure.PAIRS and value < PLANNED_PAIRS * len(record.pairs):
            why = _why_few(record)
            planned = float(len(record.pairs))
            yield _fewer(name, value, planned, f"only {value:.0f} of {planned:.0f} pairs could be used; most others: {why}")


def _fewer(name: str, value: float, base: float, text: str) -> Finding:
    compare = "wbflow compare SITE.yaml  shows what differs"
    remedy = f"{compare}; if this is usual from now on, say so in the site file: expect: {{since: DATE}}"
    return Finding(f"fewer-{name}", (), text, {name: round(value)}, {name: round(base)}, remedy)


def _tolerated(finding: Finding, record: RunRecord, expected: Expected) -> bool:
    """Is it about a camera of a site that may do without some?"""
    limit = expected.limit(Measure.CAMERAS)
    if not finding.kind.startswith("camera-") or limit >= 1:
        return False
    well = sum(camera.down is None for camera in record.cameras)
    return well >= limit * len(record.cameras)


def _shares(record: RunRecord) -> dict[str, float]:
    """How the pictures of most cameras look, as shares of what is usual: what they have in common is the night's, not theirs."""
    shares: dict[str, list[float]] = {}
    of_cameras = looks_of(record)
    for camera in record.cameras:
        looks, usual = of_cameras.get(camera.id, {}), record.usual.cameras.get(camera.id, {}) if record.usual else {}
        for name in looks.keys() & usual.keys():
            if usual[name] > 0:
                shares.setdefault(name, []).append(looks[name] / usual[name])
    return {name: min(median(found), 1.0) for name, found in shares.items()}


def _with_health(
    camera: CameraRecord, looks: Mapping[str, float], usual: Mapping[str, float], night: Mapping[str, float], expected: Expected
) -> CameraRecord:
    """Its looks compared with the usual, where nobody who looked more closely has found anything.

    Parameters
    ----------
    camera : CameraRecord
        Whose.
    looks, usual : mapping
        Figures of its picture, tonight's and the usual ones.
    night : mapping
        The share of the usual that most cameras have tonight.
    expected : Expected
        What the site file says of good nights.
    """
    if not camera.ok or not usual or (camera.health and not camera.health.ok):
        return camera
    health = _health(looks, usual, night, expected)
    return camera if camera.health and health.ok else replace(camera, health=health)


def _health(looks: Mapping[str, float], usual: Mapping[str, float], night: Mapping[str, float], expected: Expected) -> Health:
    """How a camera is by its looks.

    Parameters
    ----------
    looks, usual : mapping
        Figures of its picture, tonight's and the usual ones.
    night : mapping
        The share of the usual that most cameras have tonight.
    expected : Expected
        What the site file says of good nights.
    """
    shared = [name for name in looks if name in usual]
    figures, base = {name: looks[name] for name in shared}, {name: usual[name] for name in shared}
    shares = {name: looks[name] / usual[name] for name in shared if usual[name] > 0}
    if shares.get(Measure.BRIGHTNESS, 1.0) < expected.limit(Measure.BRIGHTNESS) * night.get(Measure.BRIGHTNESS, 1.0):
        text = f"its picture has {100 * shares[Measure.BRIGHTNESS]:.0f} % of its usual brightness"
        return Health("blind", text, figures, base, "look at its light, its exposure, and what stands before it")
    if shares.get("sharpness", 1.0) < SHARP_SHARE * night.get("sharpness", 1.0):
        text = f"its picture has {100 * shares['sharpness']:.0f} % of its usual sharpness"
        return Health("blind", text, figures, base, "look at its focus and its glass: drops, dirt, fog")
    if shares.get("matched_share", 1.0) < FOUND_SHARE:
        now, then = (f"{100 * entry['matched_share']:.0f} %" for entry in (looks, usual))
        text = f"{now} of its pairs find common points, usually {then} do: it shows something else, or has been turned"
        return Health("foreign", text, figures, base, "look at its picture, and where it points")
    return Health("ok", figures=figures, expected=base)


def _with_down(camera: CameraRecord, record: RunRecord, past: Past) -> CameraRecord:
    """Counted over the nights; a camera that is well again says so."""
    before = past.camera(camera.id)
    last = before[1].down if before else None
    if _trouble(camera, record):
        nights = last.nights + (before is not None and before[0] != record.date) if last else 1
        return replace(camera, down=Down(last.since if last else record.date, nights))
    if last:
        note = f"back after {last.nights} night{'s' * (last.nights != 1)}: it was down since {last.since}"
        return replace(camera, notes=(*camera.notes, note))
    return camera


def _most_common(pairs: Iterable[PairRecord]) -> str:
    return shortened(Counter(str(pair.reason) for pair in pairs).most_common(1)[0][0])


def _why_few(record: RunRecord) -> str:
    """Why most of the pairs that were not used were not."""
    unused = [pair for pair in record.pairs if not pair.ok]
    gone = {camera.id for camera in record.cameras if not camera.ok}
    theirs = [pair for pair in unused if gone & {camera_of(pair.left), camera_of(pair.right)}]
    if 2 * len(theirs) > len(unused):
        return f"with cameras that are left out ({shortened(', '.join(sorted(gone)))})"
    return _most_common(unused)


def shortened(reason: str) -> str:
    """A reason of bounded length: stages may say a lot, and name every file; the record of the camera, pair or task has all."""
    return reason if len(reason) <= MOST_LETTERS else f"{reason[: MOST_LETTERS - 3]}..."
