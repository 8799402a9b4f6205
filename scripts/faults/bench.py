"""Sites whose stages take no time, runs of them in processes of their own, and what each run must come to."""

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
from .processes import Ended, Started, forked, started_anew

QUICK = ("--jobs", "1", "--backend", "threading")
"""In one process: the one that is struck."""


KINDS = ("wrong cloud", "manual step", "traceback", "hang", "wrong exit", "done twice", "memory")


@dataclass
class Row:
    """What a sort of fault has cost."""

    fault: str
    tries: int = 0
    losses: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    cpu_s: float = 0.0

    HEAD: ClassVar[str] = f"{'fault':38} {'tries':>6}  {'  '.join(KINDS)}"

    def lost(self, kind: str, what: str) -> None:
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
        self._functions = _import_all(folder)
        self._made = 0

    def site(self, cameras: int = 2, unread: bool = False, watched: bool = False, **settings: Any) -> ToySite:
        """A new site.

        Parameters
        ----------
        cameras : int
            How many.
        unread : bool
            Nothing is remembered of its functions yet.
        watched : bool
            Its captures are dated, and its cameras compared with the reference.
        **settings : Any
            Sections of its file.
        """
        self._made += 1
        ids = ["gate", "roof", "mast-1", "crane"][:cameras]
        toy = ToySite(self.folder / f"site-{self._made}", ids, watched=watched, dated=watched)
        site = json.loads(toy.file.read_text())
        toy.file.write_text(json.dumps({**site, **settings}))
        if not unread and "work" not in settings:
            memo = WorkFolder(toy.work).functions_memo
            memo.parent.mkdir(parents=True)
            shutil.copyfile(self._functions, memo)
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
        return self._forked(toy, [command, str(toy.file), *quick, *arguments], strike).wait()

    def operations(self, toy: ToySite, *arguments: str, command: str = "run") -> int:
        """How many operations on files a command takes."""
        self.run(toy, *arguments, strike=Strike(0), command=command)
        return self._counter.stat().st_size

    def start(self, toy: ToySite, *arguments: str, anew: bool = False) -> Started:
        """A run of as many processes as it likes; anew: none of them is forked from this one."""
        if not anew:
            return self._forked(toy, ["run", str(toy.file), *arguments], None)
        environment = {**toy.env(), "PYTHONDONTWRITEBYTECODE": "1"}
        return started_anew(toy.command("run", str(toy.file), *arguments), environment, self._output())

    def _forked(self, toy: ToySite, arguments: list[str], strike: Strike | None) -> Started:
        self._counter.write_bytes(b"")
        return forked(lambda: _run(toy, arguments, strike, self._counter), self._output())

    @property
    def _counter(self) -> Path:
        return self.folder / "operations"

    def _output(self) -> Path:
        self._made += 1
        return self.folder / f"said-{self._made}"

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


def set_parameters(toy: ToySite, **parameters: Any) -> None:
    """Parameters by stage, in the site file as it is."""
    site = json.loads(toy.file.read_text())
    for stage, values in parameters.items():
        site["stages"][stage] |= values
    toy.file.write_text(json.dumps(site))


def _run(toy: ToySite, arguments: list[str], strike: Strike | None, counter: Path) -> None:
    """In the child: the command line, struck where it is to be."""
    os.environ.update(toy.env())
    from wbflow.cache import memo
    from wbflow.cli.main import main

    memo._SETTLED_NS = -(10**18)  # captures that are new are remembered, too
    if strike:
        arm(counter, strike.at, strike.kind)
    main.main(args=arguments, prog_name="wbflow", standalone_mode=True)


def _read_once() -> None:
    """Source files and the report's template are read once in the campaign: that takes longer than all else of a toy night."""
    remembered = FunctionReader._remembered
    known: dict[tuple[str, str], Any] = {}

    def read_once(self: FunctionReader, what: str, dotted: str, read: Callable[[], Any]) -> Any:
        def once() -> Any:
            if (what, dotted) not in known:
                known[what, dotted] = read()
            return known[what, dotted]

        return remembered(self, what, dotted, once)

    FunctionReader._remembered = read_once  # type: ignore[method-assign]
    compile_now = Environment.compile
    compiled: dict[str, Any] = {}

    def compile_once(self: Environment, source: str, *rest: Any, **named: Any) -> Any:
        if source not in compiled:
            compiled[source] = compile_now(self, source, *rest, **named)
        return compiled[source]

    Environment.compile = compile_once  # type: ignore[method-assign, assignment]


def _import_all(folder: Path) -> Path:
    """What a run imports is imported once, before processes are split off: by a run.  Returns what it remembers of functions."""
    _read_once()
    toy = ToySite(folder / "first", ["gate", "roof"])
    before = dict(os.environ)
    os.environ.update(toy.env())
    from click.testing import CliRunner

    from wbflow.cli.main import main

    for command in (["run", str(toy.file), *QUICK], ["history", str(toy.file)], ["status", str(toy.file)]):
        ended = CliRunner().invoke(main, command)
        assert ended.exit_code == 0, ended.output
    os.environ.clear()
    os.environ.update(before)
    return WorkFolder(toy.work).functions_memo
