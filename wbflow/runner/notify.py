"""Notification by a command of the site file, when the state of the site has changed.

The command is called once for each state of degraded and failed nights (the level, and kinds and subjects of the findings),
again when a state has lasted for a duration of `remind`, and once for the first good night after them; for changes that are new
or have grown; with `heartbeat`, also after every other night.  A night sends one message: where its state is to be told and there
are changes, the event is that of the state, and the changes are in it.  A command that fails or hangs does not affect the night,
and is called again after the next run.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any, Literal

from ..cache.checksum import Damaged, read_checksummed, write_checksummed
from ..cache.layout import RunPaths, WorkFolder
from ..errors import WbflowError
from ..json_dataclass import JsonDataclass
from ..pipeline.summaries import RecordedChange
from ..records.changes import open_changes
from ..records.findings import UNEXPECTED_CHANGE, Verdict
from ..records.finished_run import Run
from ..records.record import RunRecord, moment
from ..site.models import Notify, NotifyChanges
from ..words import counted, format_duration

Occasion = Literal["degraded", "failed", "reminder", "recovered", "heartbeat", "changed"]

MOST_WORDS = 300
"""Longest summary, in characters."""

_PICTURES = {"before": "-before", "after": "-after", "picture": ""}
"""The pictures of a change, and how the names of their files end: of each night alone, and of both side by side."""

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
    """When the first run in this state ended (UTC); "": no run has."""
    bad_since: str = ""
    """When the first degraded or failed run since the last good night ended (UTC); "": there is none."""
    reminders: int = 0
    """Number of reminders of this state that have been sent."""
    changes: Mapping[str, str] = field(default_factory=dict)
    """By id of a change that was reported: the night (ISO 8601) on which it was new, or had grown."""


_ACKNOWLEDGED = "acknowledged"
"""Takes the place of a good night's level if it has acknowledged findings: the site is neither degraded nor recovered."""


def notify(config: Notify, folder: Path, run: Run) -> Occasion | None:
    """Call the command for a published run, at most once; returns the occasion, or None if there is none.

    folder: the site file's, in which the command runs.  Raises NotifyFailed, with the last line of the command's output; all that
    there was to tell is then told after the next run.
    """
    work = run.cache.work
    record = run.record
    assert record.verdict
    last = _last_reported(work)
    now = record.finished

    # 1. What there is to tell: the state, if it has changed or lasts, and changes that are news.
    state = _next_reported(last, _state_of(record.verdict), now, config)
    news = _news(config, last, record)
    occasion = _occasion(last, state, news, record.verdict, config)

    # 2. All of it in one message.
    if occasion:
        duration = ""
        if occasion in {"recovered", "reminder"}:
            duration = format_duration(_seconds(state.bad_since, now))
        recovered = last.state[1:] if occasion == "recovered" else ()
        _call(config, folder, _message(occasion, run.run_folder.paths, record, duration, recovered, news))

    # 3. Remembered only after the call: if it fails, the next run calls again.
    if config.changes and record.compared:
        # those that are gone are forgotten
        told = {name: night for name, night in last.changes.items() if name in record.changes}
        state = replace(state, changes=told | {change.id: change.news for change in news})
    if state != last:
        write_checksummed(work.notified, _FILE_KIND, state.to_json())
    return occasion


def _news(config: Notify, last: _Reported, record: RunRecord) -> list[RecordedChange]:
    """The changes that are new, or have grown, since they were last reported, and that nobody has acknowledged."""
    if not config.changes or not record.compared:
        return []
    news = []
    for change in open_changes(record):
        if _is_wanted(change, config.changes) and last.changes.get(change.id, "") < change.news:
            news.append(change)
    return news


def _is_wanted(change: RecordedChange, wanted: NotifyChanges) -> bool:
    """Does the site file want to hear of a change?"""
    largest = max(change.volume_most, change.volume)  # a function of the site's own may give no interval
    return largest >= wanted.min_volume and (wanted.zones is None or change.zone in wanted.zones)


def _last_reported(work: WorkFolder) -> _Reported:
    try:
        return _Reported.from_json(read_checksummed(work.notified, _FILE_KIND) or {})
    except (Damaged, ValueError):  # what was reported is unknown: report the state again
        return _Reported()


def _state_of(verdict: Verdict) -> tuple[str, ...]:
    """The state of a site that a verdict describes, as `_Reported.state`."""
    level: str = verdict.level
    findings = verdict.findings
    if verdict.good:
        level = _ACKNOWLEDGED
        findings = verdict.acknowledged
    if not findings:
        return ()
    # without figures and texts, which differ every night
    subjects = {" ".join((finding.kind, *finding.subject)) for finding in findings}
    return (level, *sorted(subjects))


def _next_reported(last: _Reported, state: tuple[str, ...], now: str, config: Notify) -> _Reported:
    """Return the state to remember after a night, from the last reported one."""
    is_acknowledged = state[:1] == (_ACKNOWLEDGED,)
    bad_since = last.bad_since if last.state else ""
    if not bad_since and not is_acknowledged:
        bad_since = now
    if state != last.state:
        return _Reported(state, now, bad_since, changes=last.changes)
    if not state or is_acknowledged:
        return last
    since = last.since or now
    # durations that are over; the largest number so far, in case the site file has fewer now
    due = sum(_seconds(since, now) >= seconds for seconds in config.remind)
    return _Reported(state, since, bad_since, max(due, last.reminders), last.changes)


def _occasion(
    last: _Reported, state: _Reported, news: Sequence[RecordedChange], verdict: Verdict, config: Notify
) -> Occasion | None:
    """What the command is called for, after a night that changed the state from `last` to `state`; None: for nothing.

    The message of a degraded or failed night, of a recovery and of a reminder has the news of changes in it.
    """
    if state.state != last.state and not verdict.good:
        return "failed" if verdict.level == "failed" else "degraded"
    # a good night after one whose findings were all acknowledged is a recovery only if a bad night came before
    was_bad = last.state and (last.state[0] != _ACKNOWLEDGED or last.bad_since)
    if was_bad and not state.state:
        return "recovered"
    if state.reminders > last.reminders:
        return "reminder"
    if news:
        return "changed"
    if config.heartbeat:
        return "heartbeat"
    return None


def _seconds(begin: str, end: str) -> float:
    return (moment(end) - moment(begin)).total_seconds()


def summary(record: RunRecord, duration: str = "", recovered: Sequence[str] = (), news: Sequence[RecordedChange] = ()) -> str:
    """A run in one line, for the subject of a message.

    Parameters
    ----------
    record : RunRecord
        The run.
    duration : str
        How long the site has been, or was, degraded or failed; "" for nothing about it.
    recovered : sequence of str
        Kinds and subjects of findings that are no more.
    news : sequence of RecordedChange
        Changes that are new or have grown.
    """
    verdict = record.verdict or Verdict("good")
    line = f"{record.site} {record.date}: {verdict.level}"
    if duration:
        line += f", back after {duration}" if verdict.good else f", for {duration}"
    if recovered:
        line += f"; no more {', '.join(recovered)}"
    # where no change is expected, each is a finding, too
    told = {change.id for change in news}
    findings = [finding for finding in verdict.findings if finding.kind != UNEXPECTED_CHANGE or not told & {*finding.subject}]
    if findings:
        line += f": {findings[0]}"
    if len(findings) > 1:
        line += f" (and {len(findings) - 1} more)"
    if news:
        texts = []
        for change in news:
            texts.append(f"{change.id} {change.words(record.unit, record.date)}, {change.volume_words(record.unit)}")
        line += f"; {counted(len(news), 'change')}: {'; '.join(texts)}"
    return _on_a_line(line)


def _message(
    occasion: Occasion,
    run: RunPaths,
    record: RunRecord,
    duration: str,
    recovered: Sequence[str],
    news: Sequence[RecordedChange],
) -> dict[str, Any]:
    """What the command reads from its input, as JSON.

    Parameters
    ----------
    occasion : Occasion
        What it is called for.
    run, record : RunPaths, RunRecord
        The run's files, and its record.
    duration, recovered, news : str, sequence of str, sequence of RecordedChange
        As for `summary`.
    """
    message: dict[str, Any] = {"event": occasion, "site": record.site, "date": record.date, "run": record.run}
    message["summary"] = summary(record, duration, recovered, news)
    message |= {"lasted": duration, "recovered": list(recovered)}
    if record.verdict:
        message |= record.verdict.to_json()
    message["exit_code"] = int(record.exit_code)
    message["points"] = record.cloud.points if record.cloud else 0
    message["report"] = str(run.report)
    message["record"] = str(run.record)
    message["cloud"] = str(run.folder / record.cloud.path) if record.cloud else None

    # the changes, with their pictures; those of the first one also by themselves, for commands that read the environment
    entries = []
    for change in news:
        text = change.words(record.unit, record.date)
        entries.append({**change.to_json(), "text": text, **_pictures_of(change, run, record)})
    message["changes"] = entries
    message["open"] = len(open_changes(record))
    for role in _PICTURES:
        message[role] = entries[0][role] if entries else ""
    return message


def _pictures_of(change: RecordedChange, run: RunPaths, record: RunRecord) -> dict[str, str]:
    """The paths of the published pictures of a change, as `_PICTURES`; "" for those that there are not."""
    files = record.compared.files if record.compared else ()
    paths = {}
    for role, ending in _PICTURES.items():
        found = [name for name in files if PurePath(name).stem == f"change-{change.id}{ending}"]
        paths[role] = str(run.folder / found[0]) if found else ""
    return paths


def _call(config: Notify, folder: Path, message: dict[str, Any]) -> None:
    """Call the command with a message: all of it as JSON on its input, and texts and numbers as variables WBFLOW_..."""
    environment = dict(os.environ)
    for name, value in message.items():
        if isinstance(value, str | int):
            environment[f"WBFLOW_{name.upper()}"] = str(value)
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
    """The command in an error: its beginning, since it may hold an address with a token."""
    command = config.command if isinstance(config.command, str) else config.command[0]
    if len(command) >= 60:
        command = f"{command[:57]}..."
    return repr(command)


def _on_a_line(words: str) -> str:
    """A text without line breaks and control characters, and not too long: it becomes the subject of a message."""
    return "".join(letter if letter.isprintable() else " " for letter in words)[:MOST_WORDS]
