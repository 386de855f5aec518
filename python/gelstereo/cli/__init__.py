"""The command line: `gelstereo demo`, `calibrate`, `localize`, `simulate`, `view` and `frontier`."""

from gelstereo.cli.main import main

__all__ = ["main"]
