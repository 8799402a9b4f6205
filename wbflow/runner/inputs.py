"""Where the inputs of a task come from: earlier tasks, the site file, the captures, the reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass

from ..pipeline.stages import FRAMES, HEALTH, PAIRS, Source, Stage, stage_named
from ..site.capture_files import CaptureFile
from ..site.captures import file_of_stage, nothing_matches
from ..task import Subject, Task, camera_of
from .night import Night
from .spec import Files, Input, Joined, Stored, site_input, stored_input
from .state import Cause, Impossible, Waiting, blocked_by
from .subjects import Subjects


@dataclass
class Inputs:
    """Finds the inputs of a night's tasks."""

    night: Night
    subjects: Subjects
    """Cameras, pairs and components, with the states of the tasks that have ended; they change during the run."""
    from_reference: Callable[[Source, Task], Input]
    """An input from the reference or from the nights since then."""
    unfit: Callable[[Subject], Impossible | None]
    """Why a subject is of no use tonight: a camera shows nothing of the site; None if no camera is known to."""

    def inputs_of(self, task: Task, needs: Mapping[str, Source], earlier: Set[Task]) -> dict[str, Input]:
        """All inputs of a task by argument name.  Raises Waiting if one is not ready, Impossible if one cannot be made.

        earlier: tasks before it in the same chain; inputs from these are not resolved yet.
        """
        inputs: dict[str, Input] = {}
        faults: dict[str, Impossible] = {}
        for name, need in needs.items():
            try:
                inputs[name] = self.input_of(task, need, earlier)
            except Impossible as error:
                if not need.unless:
                    raise
                inputs[name] = None
                faults[name] = error
        # an input may be missing only if all those that make up for it are there
        for name, fault in faults.items():
            for other in needs[name].unless:
                if inputs.get(other) is None:
                    raise fault
        return inputs

    def input_of(self, task: Task, need: Source, earlier: Set[Task]) -> Input:
        """One input of a task; parameters and exceptions as for `inputs_of`."""
        if need.kind == "site":
            return self._from_site(need, task)
        if need.kind == "file":
            return self._named_file(need.name, file_of_stage(task.stage, need.name))
        if need.kind in {"reference", "history", "previous"}:
            return self.from_reference(need, task)
        if not self._is_made(need):
            return Joined({}) if need.joins else None  # what the function takes for a missing input
        if need.joins:
            return self._join(stage_named(need.name), need, task)
        wanted = stored_input(need, task)
        return wanted if wanted.task in earlier else self._stored(wanted, need)

    def upstreams(self, task: Task, needs: Mapping[str, Source]) -> list[Task]:
        """The tasks that provide the inputs of a task, as far as they are listed yet."""
        upstreams: dict[Task, None] = {}
        for need in needs.values():
            if need.kind != "stage" or not self._is_made(need):
                continue
            origin = stage_named(need.name)
            if need.joins and origin.scope != "site":
                tasks = self.subjects.joined(origin, need, task)
            else:
                tasks = [stored_input(need, task).task]
            upstreams |= dict.fromkeys(tasks)
        return list(upstreams)

    def _is_made(self, need: Source) -> bool:
        """Does the site need this input from a stage, and does the stage take part (or must it be waited for)?"""
        is_needed = need.needed_if is None or need.needed_if(self.night.site)
        return is_needed and (self.night.takes_part(need.name) or not need.may_lack(self.night.site))

    def _stored(self, wanted: Stored, need: Source) -> Input:
        """The result of one task; exceptions as for `inputs_of`."""
        state = self.subjects.states.get(wanted.task)
        if state is None and not self.subjects.is_unmatched(wanted.task):
            raise Waiting(wanted.task)
        stored = wanted.resolved(state.receipt) if state else None
        if stored:
            return stored
        if need.may_lack(self.night.site):
            return None
        # the reason why there is nothing
        if state is None:
            raise Impossible(f"{'--'.join(wanted.task.subject)} was not matched", Cause.NO_PAIRS)
        if state.usable:
            raise Impossible(f"{wanted.task} has nothing for {wanted.entry or wanted.field}", Cause.UNSOLVED)
        raise blocked_by(wanted.task, state)

    def _join(self, origin: Stage, need: Source, task: Task) -> Input:
        """The results of many tasks, or many entries of a site-wide result, by subject."""
        subjects = self.subjects
        states = self.subjects.states
        # which tasks there are depends on the pair graph
        needs_pairs = origin.scope == "pair" or need.of in {"around", "near"}
        if needs_pairs and subjects.pairs(origin.dense or origin.scope != "pair") is None:
            raise Waiting(None)
        joined = subjects.joined(origin, need, task)
        if origin.scope == "site":  # its entries: one artifact, not many
            return self._entries(Task(origin.name), need.part, [other.subject[0] for other in joined])
        for upstream in reversed(joined):  # the last in the list is usually the last to end
            if upstream not in states:
                raise Waiting(upstream)
        items: dict[Subject, Stored] = {}
        faults: list[Impossible] = []
        for upstream in joined:
            # health examines every camera, also one that shows nothing of the site
            unfit = None if task.stage == HEALTH else self.unfit(upstream.subject)
            if unfit:
                faults.append(unfit)
                continue
            stored = Stored(upstream, need.part).resolved(states[upstream].receipt)
            if stored:
                items[upstream.subject] = stored
            else:
                faults.append(blocked_by(upstream, states[upstream]))
        # the quorum: what is there is joined, as long as it is something
        if not items and not need.may_lack(self.night.site):
            raise self._why_empty(origin, faults)
        return Joined(items)

    def _entries(self, upstream: Task, part: str, cameras: list[str]) -> Joined:
        """The entries for some cameras in a mapping from a site-wide stage."""
        state = self.subjects.states.get(upstream)
        if state is None:
            raise Waiting(upstream)
        items: dict[Subject, Stored] = {}
        for camera in cameras:
            entry = Stored(upstream, part, camera).resolved(state.receipt)
            if entry:
                items[camera,] = entry
        if not items:
            raise blocked_by(upstream, state)
        return Joined(items)

    def _why_empty(self, origin: Stage, faults: list[Impossible]) -> Impossible:
        """Why a mapping input has no entries: the captures, if fewer than two cameras have any; else what its tasks lack."""
        first_fault = f": {faults[0]}" if faults else ""
        usable: list[str] = []
        nothing_captured = True
        for view in self.night.site.views:
            frame = self.subjects.states.get(Task(FRAMES, (view.id,)))
            if frame and frame.usable and view.camera not in usable:
                usable.append(view.camera)
            if frame is None or frame.code != Cause.NO_CAPTURE:
                nothing_captured = False
        if nothing_captured:
            reason = f"no camera has a usable capture of this night: {nothing_matches(self.night.site, self.night.date)}"
            return Impossible(reason, Cause.TOO_FEW_CAMERAS)
        if not usable:
            return Impossible(f"no camera has a usable capture{first_fault}", Cause.TOO_FEW_CAMERAS)
        if len(usable) == 1:
            reason = f"only camera {usable[0]} has a usable capture, a cloud needs two that see the same things{first_fault}"
            return Impossible(reason, Cause.TOO_FEW_CAMERAS)
        # two cameras or more have captures, so the reason lies between the captures and this stage
        if faults:
            return Impossible(f"no {origin.name} to work on{first_fault}", faults[0].code)
        if origin.scope != "pair":
            return Impossible(f"no {origin.name} to work on", Cause.UPSTREAM)
        pairs = self.subjects.states.get(Task(PAIRS))
        if pairs and not pairs.usable:
            return blocked_by(Task(PAIRS), pairs)
        return Impossible("no two cameras see enough in common to be matched", Cause.NO_PAIRS)

    def _from_site(self, need: Source, task: Task) -> Input:
        """What the site file states, or files that it names; raises Impossible for files that cannot be read."""
        if need.name == "captures":
            return Files(self._readable_captures(camera_of(task.subject[0])))
        if need.name == "mask":
            return self._named_file("mask", camera_of(task.subject[0]))
        return site_input(self.night.site, need, task)

    def _named_file(self, kind: str, key: str) -> Input:
        """A file that the site file names.  kind: such as "mask", for the message; key: its key in `NightFiles.named`."""
        file = self.night.files.named.get(key)
        if file and not file.digest:
            raise Impossible(f"{kind} {file.name} {file.fault}", Cause.BAD_INPUT)
        return Files((file,), single=True) if file else None

    def _readable_captures(self, camera: str) -> tuple[CaptureFile, ...]:
        """A camera's captures without the unreadable ones; raises Impossible if none is left."""
        files = self.night.files.captures[camera]
        if not files:
            raise Impossible(f"no capture: {self.night.missing.get(camera, 'there is no file for it')}", Cause.NO_CAPTURE)
        readable = tuple(file for file in files if file.digest)
        if not readable:
            raise Impossible(f"no capture: {files[0].name} {files[0].fault}", Cause.NO_CAPTURE)
        return readable
