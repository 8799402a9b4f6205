"""Notification by the command that the site file names, when the state of the site has changed; and metrics of a run.

The command is called once for each state of degraded and failed nights (the level, and what the findings are about) and once for
the first good night after them; with `heartbeat`, after every other night too.  One that fails or hangs costs the night nothing,
and is called again after the next.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from ..cache.layout import RunPaths, WorkFolder
from ..cache.signed import Damaged, read_signed, write_signed
from ..errors import WbflowError
from ..records.record import RunRecord, Verdict, moment
from ..site.models import Notify

Occasion = Literal["degraded", "failed", "recovered", "heartbeat"]

MOST_WORDS = 300
"""A summary has at most so many characters."""


_OF = "notified"
"""What the file with the last reported state is of."""


class NotifyFailed(WbflowError):
    """The command could not be started, failed, or took too long."""


def _state(verdict: Verdict) -> list[str]:
    """Return the level of a night, and kind and subject of each finding; nothing of a good night."""
    return [] if verdict.good else [verdict.level, *sorted({" ".join((f.kind, *f.subject)) for f in verdict.findings})]


def notify(how: Notify, folder: Path, work: WorkFolder, run: RunPaths, record: RunRecord) -> Occasion | None:
    """Call the command for a published run; returns the occasion, or None where there is none.

    Parameters
    ----------
    how : Notify
        As the site file says.
    folder : Path
        Where the command runs: the site file's.
    work : WorkFolder
        Which keeps the state that was last reported.
    run : RunPaths
        The run's files.
    record : RunRecord
        The run.

    Raises
    ------
    NotifyFailed
        With the last line of its output.
    """
    assert record.verdict
    state = _state(record.verdict)
    occasion: Occasion | None = "heartbeat" if how.heartbeat else None
    if state != _last(work):
        occasion = "recovered" if not state else "failed" if record.verdict.level == "failed" else "degraded"
    if occasion:
        _call(how, folder, occasion, run, record)
        write_signed(work.notified, _OF, {"state": state})
    return occasion


def _last(work: WorkFolder) -> list[str]:
    try:
        data = read_signed(work.notified, _OF) or {}
    except Damaged:  # nobody knows what was reported: what is wrong is reported once more
        data = {}
    return list(map(str, data.get("state", ())))


def summary(record: RunRecord) -> str:
    """A run in one line, for the subject of a message."""
    verdict = record.verdict or Verdict("good")
    head = f"{record.site} {record.date}: {verdict.level}"
    more = f" (and {len(verdict.findings) - 1} more)" if len(verdict.findings) > 1 else ""
    words = f"{head}: {verdict.findings[0]}{more}" if verdict.findings else head
    return "".join(letter if letter.isprintable() else " " for letter in words)[:MOST_WORDS]


def _message(occasion: Occasion, run: RunPaths, record: RunRecord) -> dict[str, Any]:
    head = {"event": occasion, "site": record.site, "date": record.date, "run": record.run, "summary": summary(record)}
    came_to = {**(record.verdict.to_json() if record.verdict else {}), "exit_code": int(record.exit_code)}
    cloud = str(run.folder / record.cloud.path) if record.cloud else None
    points = record.cloud.points if record.cloud else 0
    return {**head, **came_to, "points": points, "report": str(run.report), "record": str(run.record), "cloud": cloud}


def _call(how: Notify, folder: Path, occasion: Occasion, run: RunPaths, record: RunRecord) -> None:
    message = _message(occasion, run, record)
    plain = {name: value for name, value in message.items() if isinstance(value, str | int)}
    environment = os.environ | {f"WBFLOW_{name.upper()}": str(value) for name, value in plain.items()}
    with tempfile.TemporaryFile() as stdin, tempfile.TemporaryFile() as output:  # pipes could be held open by what outlives it
        stdin.write(json.dumps(message).encode())
        stdin.seek(0)
        try:
            process = subprocess.Popen(
                how.command,
                shell=isinstance(how.command, str),
                stdin=stdin,
                stdout=output,
                stderr=output,
                env=environment,
                cwd=folder,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise NotifyFailed(f"notify: {_shown(how)} could not be started: {error}") from error
        try:
            code = process.wait(timeout=how.seconds)
        except subprocess.TimeoutExpired:
            raise NotifyFailed(f"notify: {_shown(how)} had not ended after {how.seconds:g} s, and was killed") from None
        finally:
            _end(process)
        if code:
            output.seek(0)
            raise NotifyFailed(f"notify: {_shown(how)} ended with {code}: {_last_line(output.read(100_000))}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Of a command that has not ended by itself, nothing is left."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _shown(how: Notify) -> str:
    command = how.command if isinstance(how.command, str) else how.command[0]
    return repr(command if len(command) < 60 else f"{command[:57]}...")


def _last_line(output: bytes) -> str:
    lines = output.decode(errors="replace").strip().splitlines()
    words = lines[-1] if lines else "no output"
    return "".join(letter if letter.isprintable() else " " for letter in words)[:MOST_WORDS]


Labels = dict[str, str]
Rows = list[tuple[Labels, float]]


def metrics(record: RunRecord) -> str:
    """Gauges of a run, one line each (https://prometheus.io/docs/instrumenting/exposition_formats)."""
    verdict, usual = record.verdict, record.usual
    findings = Counter(finding.kind for finding in verdict.findings) if verdict else Counter[str]()
    levels: Rows = [({"level": level}, _is(verdict and verdict.level == level)) for level in ("good", "degraded", "failed")]
    compared: Rows = [({"of": of}, value) for of, value in usual.figures.items()] if usual else []
    volumes, sigmas, areas = _volumes(record)
    rows: list[tuple[str, str, Rows]] = [
        ("verdict", "1 for the level that the night came to.", levels),
        ("findings", "What is to be looked at, by kind.", [({"kind": kind}, count) for kind, count in findings.items()]),
        ("exit_code", "How the run ended.", [({}, int(record.exit_code))]),
        ("finished_timestamp_seconds", "When the run ended.", [({}, moment(record.finished).timestamp())]),
        ("night_timestamp_seconds", "The night of the captures.", [({}, moment(f"{record.date}T00:00:00Z").timestamp())]),
        ("points", "Points of the main cloud.", [({}, record.cloud.points if record.cloud else 0)]),
        ("usual", "What the last good nights gave.", compared),
        ("camera_ok", "1 for a camera that did its part and is as it should be.", _cameras(record)),
        ("camera_nights_down", "For how many nights it has not been.", _nights_down(record)),
        ("camera_pairs", "Pairs of cameras by outcome.", _counted("outcome", (pair.outcome for pair in record.pairs))),
        ("volume_cubic_metres", "Of changes since the reference, by zone (none: the whole site).", volumes),
        ("volume_sigma_cubic_metres", "Standard deviation of that.", sigmas),
        ("compared_square_metres", "Ground that was seen on both nights, and that was not.", areas),
        ("tasks", "Tasks by outcome.", [({"outcome": name}, count) for name, count in record.tasks.to_json().items()]),
        ("wall_seconds", "How long the run took.", [({}, round(record.seconds.wall, 2))]),
        ("cpu_seconds", "CPU time that it took.", [({}, round(record.seconds.cpu, 2))]),
        ("stage_cpu_seconds", "CPU time by stage.", [({"stage": n}, round(s.cpu, 2)) for n, s in record.seconds.stages.items()]),
        ("peak_rss_megabytes", "Memory of the largest worker.", [({}, record.peak_rss_mb)]),
    ]
    lines = []
    for name, meaning, values in rows:
        lines += [f"# HELP wbflow_{name} {meaning}", f"# TYPE wbflow_{name} gauge"]
        lines += [f"wbflow_{name}{{{_labels({'site': record.site, **labels})}}} {value:.12g}" for labels, value in values]
    return "\n".join(lines) + "\n"


def _cameras(record: RunRecord) -> Rows:
    return [({"camera": camera.id}, _is(camera.ok and camera.down is None)) for camera in record.cameras]


def _nights_down(record: RunRecord) -> Rows:
    return [({"camera": camera.id}, camera.down.nights if camera.down else 0) for camera in record.cameras]


def _volumes(record: RunRecord) -> tuple[Rows, Rows, Rows]:
    """Return volumes, their standard deviations, and areas; of a site without a scale none."""
    volumes, sigmas, areas = Rows(), Rows(), Rows()
    known = record.results.values() if record.poses and record.poses.metric else ()
    for zone, part in ((zone, part) for result in known for zone, part in result.volumes.items()):
        labels = {"zone": zone} if zone else {}
        volumes += [({**labels, "change": "gained"}, part.gained), ({**labels, "change": "lost"}, part.lost)]
        sigmas += [({**labels, "change": "gained"}, part.gained_sigma), ({**labels, "change": "lost"}, part.lost_sigma)]
        areas += [({**labels, "seen": "yes"}, part.area), ({**labels, "seen": "no"}, part.unseen)]
    return volumes, sigmas, areas


def _counted(label: str, values: Iterable[str]) -> Rows:
    return [({label: value}, count) for value, count in Counter(values).items()]


def _labels(labels: Labels) -> str:
    return ",".join(f'{name}="{_escaped(value)}"' for name, value in labels.items())


def _escaped(value: str) -> str:
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _is(value: object) -> int:
    return int(bool(value))
