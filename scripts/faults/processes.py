"""Processes of the campaign: forked from one that has imported everything, or started as new interpreters, as cron does."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from hostile_inputs import time_limit


@dataclass(frozen=True)
class Ended:
    """How a process ended."""

    code: int
    """Exit code; if negative, the signal that killed it."""
    output: str
    hung: bool = False


class Started:
    """A running command in its own session; its output goes to a file."""

    def __init__(self, pid: int, output: Path) -> None:
        self.pid = pid
        self._output = output

    def send(self, signum: int) -> None:
        """Send a signal to the process alone."""
        os.kill(self.pid, signum)

    def kill_all(self) -> None:
        """Kill all processes of its group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)

    def wait(self) -> Ended:
        """Wait until it ends; kill it if it exceeds `time_limit`."""
        began, pause = time.monotonic(), 0.002
        while time.monotonic() - began < time_limit():
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                self.kill_all()
                return self._ended(os.waitstatus_to_exitcode(status))
            time.sleep(pause)
            pause = min(pause * 1.5, 0.02)
        self.kill_all()
        os.waitpid(self.pid, 0)
        return self._ended(-9, hung=True)

    def _ended(self, code: int, hung: bool = False) -> Ended:
        text = self._output.read_text(errors="replace")
        self._output.unlink()
        return Ended(code, text, hung)


def start_interpreter(command: list[str], environment: dict[str, str], output: Path) -> Started:
    """Start a new process, which imports everything itself."""
    pid = os.fork()
    if pid == 0:
        _redirect_output(output)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.execvpe(command[0], command, environment)
    return Started(pid, output)


def fork(work: Callable[[], object], output: Path) -> Started:
    """Fork a child of this process that calls `work` and ends with the exit code that the interpreter would give."""
    pid = os.fork()
    if pid == 0:
        _redirect_output(output)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _end_with(work)
    return Started(pid, output)


def _end_with(work: Callable[[], object]) -> NoReturn:
    code = 70
    try:
        work()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException as error:  # like the interpreter
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
        code = 1
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _redirect_output(output: Path) -> None:
    os.setsid()
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
