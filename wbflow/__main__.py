"""`python -m wbflow` is `wbflow`."""

from .cli.main import main

main(prog_name="wbflow")
