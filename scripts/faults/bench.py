"""Sites whose stages take no time, runs of them in separate processes, and checks of what each run must give."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from jinja2 import Environment

from tests.helpers.toy_site import ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.pipeline.functions import FunctionReader

from .operations import arm
from .processes import Ended, Started, fork, start_interpreter

ONE_PROCESS = ("--jobs", "1", "--backend", "threading")
"""Options that keep a run in one process, so that a fault strikes that process."""


KINDS = ("wrong cloud", "manual step", "traceback", "hang", "wrong exit", "done twice", "memory")


@dataclass
class Row:
    """Tries and losses of one kind of fault."""

    fault: str
    tries: int = 0
    losses: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    cpu_s: float = 0.0

    HEAD: ClassVar[str] = f"{'fault':38} {'tries':>6}  {'  '.join(KINDS)}"

    def add_loss(self, kind: str, what: str) -> None:
        self.counts[kind] += 1
        print(f"    {kind}: {what}", flush=True)
        self.losses.append(f"{kind}: {what}")

    def __str__(self) -> str:
        counts = "  ".join(f"{self.counts[kind]:{len(kind)}}" for kind in KINDS)
        return f"{self.fault:38} {self.tries:6}  {counts}"

    def to_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Strike:
    """A fault at file operation number `at` (from 1; 0: none, operations are only counted); for `kind` see `arm`."""

    at: int
    kind: str = "kill"


class Bench:
    """Makes sites, runs them, and checks the results."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder = folder
        self.random = random.Random(seed)
        self.clouds: dict[str, bytes] = {}
        """Clouds of undisturbed runs, by number of cameras, view and parameters."""
        self._functions = _import_all(folder)
        self._made = 0

    def site(self, cameras: int = 2, without_memo: bool = False, watched: bool = False, **settings: Any) -> ToySite:
        """A new site.

        Parameters
        ----------
        cameras : int
            Number of cameras.
        without_memo : bool
            Without the functions memo.
        watched : bool
            Captures are dated, and cameras are compared with the reference.
        **settings : Any
            Sections of the site file.
        """
        self._made += 1
        ids = ["gate", "roof", "mast-1", "crane"][:cameras]
        toy = ToySite(self.folder / f"site-{self._made}", ids, watched=watched, dated=watched)
        site = json.loads(toy.file.read_text())
        toy.file.write_text(json.dumps({**site, **settings}))
        if not without_memo and "work" not in settings:
            memo = WorkFolder(toy.work).functions_memo
            memo.parent.mkdir(parents=True)
            shutil.copyfile(self._functions, memo)
        return toy

    def copy(self, toy: ToySite) -> ToySite:
        """A byte-for-byte copy of a site with all that its runs have left, independent of the original."""
        self._made += 1
        target = self.folder / f"site-{self._made}"
        shutil.copytree(toy.folder, target, symlinks=True)
        twin = ToySite.__new__(ToySite)
        twin.__dict__ |= {**toy.__dict__, "folder": target}
        return twin

    def discard(self, toy: ToySite) -> None:
        shutil.rmtree(toy.folder, ignore_errors=True)

    def night(self, toy: ToySite, view: str) -> None:
        """Replace all captures with those of a view."""
        for camera in toy.cameras:
            toy.capture(camera).write_text(f"{camera} at {view}")

    def cloud(self, cameras: int, view: str, **parameters: Any) -> bytes:
        """The cloud of an undisturbed run."""
        name = f"{cameras} {view} {parameters}"
        if name not in self.clouds:
            toy = self.site(cameras)
            set_parameters(toy, **parameters)
            self.night(toy, view)
            ended = self.run(toy)
            assert ended.code == 0, ended.output
            self.clouds[name] = toy.cloud
            self.discard(toy)
        return self.clouds[name]

    def run(self, toy: ToySite, *arguments: str, strike: Strike | None = None, command: str = "run") -> Ended:
        """Run a command in a child process, forked from this one, which has already imported everything."""
        options = ONE_PROCESS if command == "run" and "--jobs" not in arguments else ()
        return self._forked(toy, [command, str(toy.file), *options, *arguments], strike).wait()

    def operations(self, toy: ToySite, *arguments: str, command: str = "run") -> int:
        """Number of file operations of a command."""
        self.run(toy, *arguments, strike=Strike(0), command=command)
        return self._counter.stat().st_size

    def start(self, toy: ToySite, *arguments: str, new_interpreter: bool = False) -> Started:
        """Start a run with any number of processes; new_interpreter: instead of a fork of this process."""
        if not new_interpreter:
            return self._forked(toy, ["run", str(toy.file), *arguments], None)
        environment = {**toy.env(), "PYTHONDONTWRITEBYTECODE": "1"}
        return start_interpreter(toy.command("run", str(toy.file), *arguments), environment, self._output())

    def _forked(self, toy: ToySite, arguments: list[str], strike: Strike | None) -> Started:
        self._counter.write_bytes(b"")
        return fork(lambda: _run(toy, arguments, strike, self._counter), self._output())

    @property
    def _counter(self) -> Path:
        return self.folder / "operations"

    def _output(self) -> Path:
        self._made += 1
        return self.folder / f"output-{self._made}"

    def check_recovery(self, row: Row, toy: ToySite, cloud: bytes, what: str, code: int = 0, at_most: int | None = None) -> None:
        """Check that after a fault a plain run gives the expected cloud, without manual steps.

        Parameters
        ----------
        row : Row
            Where losses are recorded.
        toy : ToySite
            The site to run.
        cloud : bytes
            The expected cloud.
        what : str
            Description of the fault.
        code : int
            The expected exit code.
        at_most : int, optional
            Largest number of tasks that may run, since finished tasks must not be repeated.
        """
        ended = self.run(toy)
        self.check_exit(row, ended, what, {code})
        if ended.code != code:
            row.add_loss("manual step", f"{what}: the next run ends with {ended.code}: {ended.output[-300:]}")
            return
        if toy.cloud != cloud:
            row.add_loss("wrong cloud", what)
        record = json.loads((toy.work / "runs" / "latest" / "run.json").read_bytes())
        if at_most is not None and record["tasks"]["ran"] > at_most:
            row.add_loss("done twice", f"{what}: {record['tasks']['ran']} tasks ran, {at_most} were missing")
        left = [str(path) for path in toy.work.rglob("*.tmp")]
        if left:
            row.add_loss("manual step", f"{what}: left behind: {left[:3]}")

    def check_exit(self, row: Row, ended: Ended, what: str, codes: set[int]) -> None:
        """Check that a process ended with one of the exit codes `codes`, without hanging and without a traceback."""
        if ended.hung:
            row.add_loss("hang", what)
        elif ended.code not in codes:
            row.add_loss("wrong exit", f"{what}: {ended.code}: {ended.output[-300:]}")
        if "Traceback" in ended.output or "itself failed" in ended.output:
            row.add_loss("traceback", f"{what}: {ended.output[-500:]}")

    def receipts(self, toy: ToySite) -> set[str]:
        """Paths of the receipts of all finished tasks."""
        return {str(path.relative_to(toy.work)) for path in (toy.work / "cache").glob("*/*/*.json")}


def set_parameters(toy: ToySite, **parameters: Any) -> None:
    """Set parameters by stage in the site's present file."""
    site = json.loads(toy.file.read_text())
    for stage, values in parameters.items():
        site["stages"][stage] |= values
    toy.file.write_text(json.dumps(site))


def _run(toy: ToySite, arguments: list[str], strike: Strike | None, counter: Path) -> None:
    """In the child process: run the command line, with the fault armed."""
    os.environ.update(toy.env())
    from wbflow.cache import memo
    from wbflow.cli.main import main

    memo._STABLE_NS = -(10**18)  # reuse the digests of new captures, too
    if strike:
        arm(counter, strike.at, strike.kind)
    main.main(args=arguments, prog_name="wbflow", standalone_mode=True)


def _read_once() -> None:
    """Let the campaign read source files and the report's template only once: this takes longer than the rest of a toy run."""
    from_memo = FunctionReader._from_memo
    known: dict[tuple[str, str], Any] = {}

    def read_once(self: FunctionReader, kind: str, dotted: str, read: Callable[[], Any]) -> Any:
        def once() -> Any:
            if (kind, dotted) not in known:
                known[kind, dotted] = read()
            return known[kind, dotted]

        return from_memo(self, kind, dotted, once)

    FunctionReader._from_memo = read_once  # type: ignore[method-assign]
    compile_now = Environment.compile
    compiled: dict[str, Any] = {}

    def compile_once(self: Environment, source: str, *rest: Any, **named: Any) -> Any:
        if source not in compiled:
            compiled[source] = compile_now(self, source, *rest, **named)
        return compiled[source]

    Environment.compile = compile_once  # type: ignore[method-assign, assignment]


def _import_all(folder: Path) -> Path:
    """Import everything once, by a run, before processes are forked.  Returns the functions memo of that run."""
    _read_once()
    toy = ToySite(folder / "first", ["gate", "roof"])
    before = dict(os.environ)
    os.environ.update(toy.env())
    from click.testing import CliRunner

    from wbflow.cli.main import main

    for command in (["run", str(toy.file), *ONE_PROCESS], ["history", str(toy.file)], ["status", str(toy.file)]):
        ended = CliRunner().invoke(main, command)
        assert ended.exit_code == 0, ended.output
    os.environ.clear()
    os.environ.update(before)
    return WorkFolder(toy.work).functions_memo
