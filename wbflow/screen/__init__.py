"""What the command line says while a run works, and at its end."""

from .words import findings, next_command, say, stop, summary

__all__ = ["findings", "next_command", "say", "stop", "summary"]
