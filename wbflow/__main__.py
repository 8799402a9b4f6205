"""`python -m wbflow` is `wbflow`."""

from .cli import main

main(prog_name="wbflow")
