"""The command line: its commands, and how faults reach the user; nothing else."""

from __future__ import annotations

import sys

import click

from .. import __version__
from ..errors import ExitCode, WbflowError
from . import lens, look, reference, runs, start
from . import run as night
from .words import stop


class _Plain(click.Group):
    """A group whose faults reach the user as one line and what to do; with -v, as a traceback."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is named first; one that there is not is told with the nearest that there is."""
        if args[0] not in self.commands:
            import difflib

            if close := difflib.get_close_matches(args[0], self.commands, 1):
                ctx.fail(f"No such command {args[0]!r}; did you mean  wbflow {close[0]}?")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt:
            sys.exit(ExitCode.INTERRUPTED)
        except WbflowError as error:
            if _tracebacks_wanted() and error.__cause__:
                import traceback

                traceback.print_exception(error.__cause__)
            stop(error.exit_code, str(error))
        except Exception as error:
            if _tracebacks_wanted():
                raise
            stop(ExitCode.FAILED, f"wbflow itself failed: {type(error).__name__}: {error}\n  again with -v shows where")


@click.group(cls=_Plain, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(__version__, prog_name="wbflow")
def main() -> None:
    """A metric, coloured point cloud of a site, every night, from fixed cameras far apart.

    Exit codes: 0 good; 1 no cloud could be made; 2 wrong usage or site file; 3 degraded: a cloud, but look at the findings;
    4 another run holds the work folder; 130 interrupted (everything finished is kept).

    \b
    wbflow init photographs                a site file from a folder of photographs
    wbflow check photographs               what is wrong with it, and with the captures
    wbflow run photographs                 the night's work
    """


for _command in (
    night.run,
    night.status,
    night.check,
    runs.report,
    runs.history,
    runs.compare,
    runs.export,
    runs.clean,
    reference.pin,
    start.demo,
    start.init,
    start.pair,
    lens.calibrate,
    start.stages,
    look.debug,
    look.runs,
    look.site_report,
):
    main.add_command(_command)


def _tracebacks_wanted() -> bool:
    return bool({"-v", "--verbose"} & set(sys.argv))
