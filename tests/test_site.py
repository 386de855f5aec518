"""The documentation builds as a site without a broken link, fetches nothing, and says what each page is."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from test_docs import PUBLIC_MODULES

REPOSITORY = Path(__file__).parents[1]
FETCHED = re.compile(
    r"<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)=[\"']?((?:https?:)?//[^\"'> ]+)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=quiet, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_pages_fetch_nothing(site: Path) -> None:
    pages = [path.read_text(encoding="utf-8") for path in site.rglob("*.html")]
    assert len(pages) > 40
    assert [match for page in pages for match in FETCHED.findall(page)] == []


def test_pages_say_their_kind(site: Path) -> None:
    for folder, kind in (("tutorials", "Tutorial"), ("reference", "Reference")):
        for path in (site / folder).glob("*.html"):
            assert f'class="kind">{kind}: ' in path.read_text(encoding="utf-8"), path.name
    silent = [
        path.name for path in site.glob("*.html") if 'class="kind"' not in path.read_text(encoding="utf-8")
    ]
    assert sorted(silent) == ["404.html", "index.html"]


def test_reference_has_types_and_texts(site: Path) -> None:
    page = (site / "reference" / "sensing.html").read_text(encoding="utf-8")
    assert 'id="gelstereo.Pipeline.process"' in page  # from the stub
    assert "The first frame is the rest frame." in page  # from the library


@pytest.mark.parametrize("name", ["", *PUBLIC_MODULES])
def test_reference_has_an_entry_for_every_public_name(site: Path, name: str) -> None:
    pages = [path.read_text(encoding="utf-8") for path in (site / "reference").glob("*.html")]
    entries = {entry for page in pages for entry in re.findall(r'id="(gelstereo\.[\w.]+)"', page)}
    path = f"gelstereo.{name}".rstrip(".")
    names = set(importlib.import_module(path).__all__) - {"__version__"}
    assert {f"{path}.{key}" for key in names} <= entries


def test_tables_and_lists_are_recognized(site: Path) -> None:
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"<p>\|", text), path.name
        assert not re.search(r"(?m)^- \w", re.sub(r"(?s)<pre.*?</pre>", "", text)), path.name
