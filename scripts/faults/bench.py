"""Sites whose stages take no time, runs of them in processes of their own, and what each run must come to."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from tests.helpers.toy_site import ToySite

from .operations import arm

HANG_SECONDS = 60.0
QUICK = ("--jobs", "1", "--backend", "threading")
"""In one process: the one that is struck."""


KINDS = ("wrong cloud", "manual step", "traceback", "hang", "wrong exit", "done twice")


@dataclass
class Row:
    """What a sort of fault has cost."""

    fault: str
    tries: int = 0
    losses: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))

    HEAD: ClassVar[str] = f"{'fault':34} {'tries':>6}  wrong cloud  manual step  traceback  hang  wrong exit  done twice"

    def lost(self, kind: str, what: str) -> None:
        self.counts[kind] += 1
        print(f"    {kind}: {what}", flush=True)
        self.losses.append(f"{kind}: {what}")

    def __str__(self) -> str:
        c = [self.counts[kind] for kind in KINDS]
        return f"{self.fault:34} {self.tries:6}  {c[0]:11}  {c[1]:11}  {c[2]:9}  {c[3]:4}  {c[4]:10}  {c[5]:10}"

    def to_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    """Negative: the signal that killed it."""
    said: str
    hung: bool = False


@dataclass(frozen=True)
class Strike:
    """A fault at one of the operations on files."""

    at: int
    kind: str = "kill"


class Bench:
    """Makes sites, and runs them."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder = folder
        self.random = random.Random(seed)
        self.clouds: dict[str, bytes] = {}
        """What undisturbed runs give, by night."""
        _import_all(folder)
        self._made = 0

    def site(self, cameras: int = 2, **settings: Any) -> ToySite:
        """A new site; settings: sections of its file."""
        self._made += 1
        toy = ToySite(self.folder / f"site-{self._made}", ["gate", "roof", "mast-1", "crane"][:cameras])
        site = json.loads(toy.file.read_text())
        toy.file.write_text(json.dumps({**site, **settings}))
        return toy

    def copy(self, toy: ToySite) -> ToySite:
        """A site with all that its runs have left, by bytes: what happens to one happens to no other."""
        self._made += 1
        target = self.folder / f"site-{self._made}"
        shutil.copytree(toy.folder, target, symlinks=True)
        twin = ToySite.__new__(ToySite)
        twin.__dict__ |= {**toy.__dict__, "folder": target}
        return twin

    def discard(self, toy: ToySite) -> None:
        shutil.rmtree(toy.folder, ignore_errors=True)

    def night(self, toy: ToySite, view: str) -> None:
        """Other captures."""
        for camera in toy.cameras:
            toy.capture(camera).write_text(f"{camera} at {view}")

    def cloud(self, cameras: int, view: str, **parameters: Any) -> bytes:
        """What an undisturbed run gives."""
        name = f"{cameras} {view} {parameters}"
        if name not in self.clouds:
            toy = self.site(cameras)
            set_parameters(toy, **parameters)
            self.night(toy, view)
            ended = self.run(toy)
            assert ended.code == 0, ended.said
            self.clouds[name] = toy.cloud
            self.discard(toy)
        return self.clouds[name]

    def run(self, toy: ToySite, *arguments: str, strike: Strike | None = None, command: str = "run") -> Ended:
        """A command in a process of its own: a child of this one, which has everything imported already."""
        quick = QUICK if command == "run" and "--jobs" not in arguments else ()
        output = self.folder / "said"
        counter = self.folder / "operations"
        counter.write_bytes(b"")
        child = os.fork()
        if child == 0:
            _become(toy, output, [command, str(toy.file), *quick, *arguments], strike, counter)
        return self._wait(child, output)

    def operations(self, toy: ToySite, *arguments: str, command: str = "run") -> int:
        """How many operations on files a command takes."""
        self.run(toy, *arguments, strike=Strike(0), command=command)
        return (self.folder / "operations").stat().st_size

    def start(self, toy: ToySite, *arguments: str) -> subprocess.Popen[str]:
        """A run in a process that is started anew, as cron does."""
        environment = {**toy.env(), "PYTHONDONTWRITEBYTECODE": "1"}
        command = toy.command("run", str(toy.file), *arguments)
        pipes: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(command, env=environment, start_new_session=True, preexec_fn=_heed, **pipes)

    def recovered(self, row: Row, toy: ToySite, cloud: bytes, what: str, code: int = 0, at_most: int | None = None) -> None:
        """After a fault, a plain run has to give the cloud, without anybody's help.

        Parameters
        ----------
        row : Row
            Where losses are noted.
        toy : ToySite
            Whose run.
        cloud : bytes
            What it has to give.
        what : str
            The fault, in words.
        code : int
            The exit code that is right.
        at_most : int, optional
            How many tasks may run: what was finished stays.
        """
        ended = self.run(toy)
        self.sane(row, ended, what, {code})
        if ended.code != code:
            row.lost("manual step", f"{what}: the next run ends with {ended.code}: {ended.said[-300:]}")
            return
        if toy.cloud != cloud:
            row.lost("wrong cloud", what)
        record = json.loads((toy.work / "runs" / "latest" / "run.json").read_bytes())
        if at_most is not None and record["tasks"]["ran"] > at_most:
            row.lost("done twice", f"{what}: {record['tasks']['ran']} tasks ran, {at_most} were missing")
        left = [str(path) for path in toy.work.rglob("*.tmp")]
        if left:
            row.lost("manual step", f"{what}: left behind: {left[:3]}")

    def sane(self, row: Row, ended: Ended, what: str, codes: set[int]) -> None:
        """A process may end in one of these ways, and never with a traceback."""
        if ended.hung:
            row.lost("hang", what)
        elif ended.code not in codes:
            row.lost("wrong exit", f"{what}: {ended.code}: {ended.said[-300:]}")
        if "Traceback" in ended.said or "itself failed" in ended.said:
            row.lost("traceback", f"{what}: {ended.said[-500:]}")

    def receipts(self, toy: ToySite) -> set[str]:
        """Of the tasks that are finished."""
        return {str(path.relative_to(toy.work)) for path in (toy.work / "cache").glob("*/*/*.json")}

    def _wait(self, child: int, output: Path) -> Ended:
        end = time.monotonic() + HANG_SECONDS
        while time.monotonic() < end:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)
                return Ended(os.waitstatus_to_exitcode(status), output.read_text(errors="replace"))
            time.sleep(0.02)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return Ended(-9, output.read_text(errors="replace"), hung=True)


def set_parameters(toy: ToySite, **parameters: Any) -> None:
    """Parameters by stage, in the site file as it is."""
    site = json.loads(toy.file.read_text())
    for stage, values in parameters.items():
        site["stages"][stage] |= values
    toy.file.write_text(json.dumps(site))


def _become(toy: ToySite, output: Path, arguments: list[str], strike: Strike | None, counter: Path) -> None:
    """In the child: run the command line, struck where it is to be; never returns."""
    code = 70
    try:
        os.setsid()
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        os.environ.update(toy.env())
        from wbflow.cli import main
        from wbflow.store import digests

        digests._SETTLED_NS = -(10**18)  # captures that are new are remembered, too
        if strike:
            arm(counter, strike.at, strike.kind)
        main.main(args=arguments, prog_name="wbflow", standalone_mode=True)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException as error:  # as the interpreter would end
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
        code = 1
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _heed() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _import_all(folder: Path) -> None:
    """What a run imports is imported once, before processes are split off: by a run."""
    toy = ToySite(folder / "first", ["gate", "roof"])
    before = dict(os.environ)
    os.environ.update(toy.env())
    from click.testing import CliRunner

    from wbflow.cli import main

    for command in (["run", str(toy.file), *QUICK], ["history", str(toy.file)], ["status", str(toy.file)]):
        ended = CliRunner().invoke(main, command)
        assert ended.exit_code == 0, ended.output
    os.environ.clear()
    os.environ.update(before)
