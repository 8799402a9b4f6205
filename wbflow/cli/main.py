"""The command line: its commands, and how errors are shown.  Commands import what they need only when they run."""

from __future__ import annotations

import difflib
import errno
import sys
import traceback
from importlib import import_module

import click

from .. import __version__
from ..cache.atomic import DISK_FULL_ERRORS, disk_fault
from ..errors import ExitCode, WbflowError
from .common import stop

_UNWRITABLE = {errno.EACCES, errno.EPERM, errno.EROFS}
"""Error numbers of a work folder that may not be written."""


class _Commands(click.Group):
    """A group of commands that prints errors as one line and a remedy; with -v, also a traceback."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the named command; for an unknown one, suggest the most similar."""
        similar = difflib.get_close_matches(args[0], self.commands, 1)
        if similar and args[0] not in self.commands:
            ctx.fail(f"No such command {args[0]!r}; did you mean  wbflow {similar[0]}?")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt:
            sys.exit(ExitCode.INTERRUPTED)
        except WbflowError as error:
            if _wants_tracebacks() and error.__cause__:
                traceback.print_exception(error.__cause__)
            stop(error.exit_code, str(error))
        except Exception as error:
            if _wants_tracebacks():
                raise
            if isinstance(error, OSError) and error.errno in _UNWRITABLE | DISK_FULL_ERRORS:
                stop(ExitCode.FAILED, str(disk_fault(error, "the work folder")))
            stop(ExitCode.FAILED, f"wbflow itself failed: {type(error).__name__}: {error}\n  again with -v shows where")


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(__version__, prog_name="wbflow")
def main() -> None:
    """Make a metric, coloured point cloud of a site every night, from fixed cameras far apart.

    Exit codes: 0 good; 1 no cloud could be made; 2 wrong usage or site file; 3 degraded: a cloud, but look at the findings;
    4 another run holds the work folder; 130 interrupted (everything finished is kept).

    \b
    wbflow init photographs                write a site file for a folder of photographs
    wbflow check photographs               check the file and the captures
    wbflow run photographs                 the night's work
    """


for _module in ("run", "status", "results", "setup", "models", "observe"):
    # by name: the command line knows where its commands are, not what they need
    for _name, _command in vars(import_module(f"{__package__}.{_module}")).items():
        if isinstance(_command, click.Command) and not _name.startswith("_"):  # private: a command of a group
            main.add_command(_command)


def _wants_tracebacks() -> bool:
    return bool({"-v", "--verbose"} & set(sys.argv))
