"""Notification by a command of the site file, when the state of the site has changed.

The command is called once for each state of degraded and failed nights (the level, and kinds and subjects of the findings),
again when a state has lasted for a duration of `remind`, and once for the first good night after them; with `heartbeat`, also
after every other night.  A command that fails or hangs does not affect the night, and is called again after the next run.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..cache.checksum import Damaged, read_checksummed, write_checksummed
from ..cache.layout import RunPaths, WorkFolder
from ..errors import WbflowError
from ..json_dataclass import JsonDataclass
from ..records.findings import Verdict
from ..records.finished_run import Run
from ..records.record import RunRecord, moment
from ..site.models import Notify
from ..words import format_duration

Occasion = Literal["degraded", "failed", "reminder", "recovered", "heartbeat"]

MOST_WORDS = 300
"""Longest summary, in characters."""

_FILE_KIND = "notified"
"""Kind of the checksummed file with the last reported state."""


class NotifyFailed(WbflowError):
    """The command could not be started, failed, or took too long."""


@dataclass(frozen=True)
class _Reported(JsonDataclass):
    """The state of a site that was last reported."""

    state: tuple[str, ...] = ()
    """The level, and kind and subject of each finding; empty for a good night without acknowledged findings."""
    since: str = ""
    bad_since: str = ""
    """When the first run in this state ended, and the first degraded or failed run since the last good night (UTC); "": none."""
    reminders: int = 0
    """Number of reminders of this state that have been sent."""


_ACKNOWLEDGED = "acknowledged"
"""Takes the place of a good night's level if it has acknowledged findings: the site is neither degraded nor recovered."""


def _state_of(verdict: Verdict) -> tuple[str, ...]:
    level, findings = (_ACKNOWLEDGED, verdict.acknowledged) if verdict.good else (verdict.level, verdict.findings)
    return (level, *sorted({" ".join((f.kind, *f.subject)) for f in findings})) if findings else ()


def notify(config: Notify, folder: Path, run: Run) -> Occasion | None:
    """Call the command for a published run; returns the occasion, or None if there is none.

    folder: the site file's, in which the command runs.  Raises NotifyFailed, with the last line of the command's output.
    """
    work, record = run.cache.work, run.record
    assert record.verdict
    last, now = _last_reported(work), record.finished
    state = _next_reported(last, _state_of(record.verdict), now, config)
    occasion: Occasion | None = "heartbeat" if config.heartbeat else None
    if state.state != last.state and not record.verdict.good:
        occasion = "failed" if record.verdict.level == "failed" else "degraded"
    elif last.state and not state.state and (last.state[0] != _ACKNOWLEDGED or last.bad_since):
        occasion = "recovered"
    elif state.reminders > last.reminders:
        occasion = "reminder"
    if occasion:
        duration = format_duration(_seconds(state.bad_since, now)) if occasion in {"recovered", "reminder"} else ""
        _call(config, folder, _message(occasion, duration, run.run_folder.paths, record))
    if state != last:
        write_checksummed(work.notified, _FILE_KIND, state.to_json())
    return occasion


def _next_reported(last: _Reported, state: tuple[str, ...], now: str, config: Notify) -> _Reported:
    """Return the state to remember after a night, from the last reported one."""
    is_acknowledged = state[:1] == (_ACKNOWLEDGED,)
    bad_since = (last.bad_since if last.state else "") or ("" if is_acknowledged else now)
    if state != last.state:
        return _Reported(state, now, bad_since)
    if not state or is_acknowledged:
        return last
    since = last.since or now
    due = sum(_seconds(since, now) >= seconds for seconds in config.remind)
    return _Reported(state, since, bad_since, max(due, last.reminders))


def _last_reported(work: WorkFolder) -> _Reported:
    try:
        return _Reported.from_json(read_checksummed(work.notified, _FILE_KIND) or {})
    except (Damaged, ValueError):  # what was reported is unknown: report the state again
        return _Reported()


def _seconds(begin: str, end: str) -> float:
    return (moment(end) - moment(begin)).total_seconds()


def summary(record: RunRecord, duration: str = "") -> str:
    """A run in one line, for the subject of a message.  duration: how long the site has been, or was, degraded or failed."""
    verdict = record.verdict or Verdict("good")
    time = f", {'back after' if verdict.good else 'for'} {duration}" if duration else ""
    head = f"{record.site} {record.date}: {verdict.level}{time}"
    others = f" (and {len(verdict.findings) - 1} more)" if len(verdict.findings) > 1 else ""
    line = f"{head}: {verdict.findings[0]}{others}" if verdict.findings else head
    return _on_a_line(line)


def _message(occasion: Occasion, duration: str, run: RunPaths, record: RunRecord) -> dict[str, Any]:
    head = {"event": occasion, "site": record.site, "date": record.date, "run": record.run}
    head |= {"summary": summary(record, duration), "lasted": duration}
    outcome = {**(record.verdict.to_json() if record.verdict else {}), "exit_code": int(record.exit_code)}
    cloud = str(run.folder / record.cloud.path) if record.cloud else None
    points = record.cloud.points if record.cloud else 0
    return {**head, **outcome, "points": points, "report": str(run.report), "record": str(run.record), "cloud": cloud}


def _call(config: Notify, folder: Path, message: dict[str, Any]) -> None:
    scalars = {name: value for name, value in message.items() if isinstance(value, str | int)}
    environment = os.environ | {f"WBFLOW_{name.upper()}": str(value) for name, value in scalars.items()}
    with tempfile.TemporaryFile() as stdin, tempfile.TemporaryFile() as output:  # files: its children could keep pipes open
        stdin.write(json.dumps(message).encode())
        stdin.seek(0)
        try:
            process = subprocess.Popen(
                config.command,
                shell=isinstance(config.command, str),
                stdin=stdin,
                stdout=output,
                stderr=output,
                env=environment,
                cwd=folder,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise NotifyFailed(f"notify: {_command(config)} could not be started: {error}") from error
        try:
            code = process.wait(timeout=config.seconds)
        except subprocess.TimeoutExpired:
            raise NotifyFailed(f"notify: {_command(config)} had not ended after {config.seconds:g} s, and was killed") from None
        finally:
            if process.poll() is None:  # kill its child processes, too
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        if code:
            output.seek(0)
            lines = output.read(100_000).decode(errors="replace").strip().splitlines() or ["no output"]
            raise NotifyFailed(f"notify: {_command(config)} ended with {code}: {_on_a_line(lines[-1])}")


def _command(config: Notify) -> str:
    command = config.command if isinstance(config.command, str) else config.command[0]
    return repr(command if len(command) < 60 else f"{command[:57]}...")


def _on_a_line(words: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in words)[:MOST_WORDS]
