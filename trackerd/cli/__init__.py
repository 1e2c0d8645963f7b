"""The commands. They parse, call, and turn errors into words and an exit status; the logic is elsewhere."""

from trackerd.cli.main import main

__all__ = ["main"]
