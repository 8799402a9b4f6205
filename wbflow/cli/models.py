"""`wbflow models`: the published models of networks, and their files on this machine."""

from __future__ import annotations

import sys

import click

from .common import echo, echo_json, json_option


@click.group(invoke_without_command=True)
@json_option
@click.pass_context
def models(context: click.Context, as_json: bool) -> None:
    """List published models for learned keypoints and matching.  Each with what it is for, and whether it is on this machine.

    A site file names one, e.g. `features: {detector: onnx, model: aliked-n32}`. A run never downloads.

    \b
    wbflow models
    wbflow models get aliked-n32
    """
    if context.invoked_subcommand:
        return
    from ..commands.models import published_models
    from ..site.published_models import FOLDER_VARIABLE, models_folder
    from ..words import format_size

    rows = published_models()
    if as_json:
        echo_json({"folder": str(models_folder()), "models": rows})
        return
    echo(f"{models_folder()}  (another folder: {FOLDER_VARIABLE})")
    for row in rows:
        echo(
            f"{row['name']:17} {format_size(row['size_bytes']):>8}  {row['state']:8} {row['stage']}: {row['purpose']}", indent=37
        )
        echo(f"{'':37}{row['licence']}; {row['url']}", indent=37)
        echo(f"{'':37}SHA-256 {row['sha256']}", indent=37)
        if row["state"] == "wrong":
            echo(f"{'':37}{row['fault']}", indent=37)


@models.command("get")
@click.argument("name", metavar="NAME")
@click.option("--from", "source", default="", metavar="URL_OR_FILE", help="Take it from here (default: where it is published).")
def _get(name: str, source: str) -> None:
    """Download a published model.  Goes on where an earlier download stopped; the checksum is verified.

    \b
    wbflow models get aliked-n32
    wbflow models get aliked-n32 --from aliked-n32.onnx        on a machine without network
    """
    from ..commands.models import get_model, model_named

    model = model_named(name)
    if not model.fault():
        echo(f"{model.path} is there, and whole")
        return
    with click.progressbar(length=model.size_bytes, label=name, file=sys.stderr) as bar:
        get_model(model, source, lambda there: bar.update(there - bar.pos))
    echo(f"{model.path}: now name it in a site file:  {model.stage}: {{model: {name}}}")
