"""Where the real data is that nobody on this project made."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("GELSTEREO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def needs(folder: str) -> pytest.MarkDecorator:
    """Skip, saying so, where a folder of the real data is absent."""
    reason = f"the real data folder {folder} is absent (GELSTEREO_DATA)"
    return pytest.mark.skipif(not (DATA / folder).is_dir(), reason=reason)
