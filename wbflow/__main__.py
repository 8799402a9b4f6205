"""`python -m wbflow` runs the command `wbflow`."""

from .cli.main import main

main(prog_name="wbflow")
