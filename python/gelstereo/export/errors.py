"""Errors of exports."""

from __future__ import annotations

from gelstereo._native import Error


class ExportError(Error):
    """A recording or data set cannot be exported, or the target cannot be used."""
