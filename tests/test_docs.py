"""What the documentation shows runs, everything public is documented, and importing it stays light."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest
from chessboards import TrueRig, write_pairs

import gelstereo

REPOSITORY = Path(__file__).parents[1]
MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(gelstereo.__path__, "gelstereo.")
    if not module.name.endswith(("__main__", "corner_worker"))
)
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


@pytest.mark.parametrize("name", ["gelstereo", *MODULES])
def test_examples_of_docstrings(name: str) -> None:
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=FLAGS, extraglobs=vars(gelstereo))
    assert result.failed == 0


def test_examples_are_found() -> None:
    finder = doctest.DocTestFinder(exclude_empty=True)
    found = {test.name for test in finder.find(gelstereo) if test.examples}
    assert {"gelstereo.Params", "gelstereo.Rig", "gelstereo.SensorMount"} <= found


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the pages assume it: the scenes, images of a chessboard, and room to write."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "scenes").symlink_to(REPOSITORY / "scenes")
    write_pairs(folder, TrueRig.typical(), 5)
    return folder


PAGES = ["README.md", *sorted(f"docs/{path.name}" for path in REPOSITORY.glob("docs/*.md"))]


@pytest.mark.parametrize("page", PAGES)
def test_examples_of_pages(page: str, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    # A fence ends what an example prints, as an empty line does.
    text = re.sub(r"^```.*$", "", (REPOSITORY / page).read_text(encoding="utf-8"), flags=re.MULTILINE)
    examples = doctest.DocTestParser().get_doctest(text, {}, page, page, 0)
    result = doctest.DocTestRunner(optionflags=FLAGS).run(examples)
    assert result.failed == 0
    assert result.attempted > 40 or page != "docs/python.md"


def public_objects() -> list[tuple[str, object]]:
    out: list[tuple[str, object]] = []
    for name in gelstereo.__all__:
        thing = getattr(gelstereo, name)
        out.append((name, thing))
        if inspect.isclass(thing):
            members = vars(thing).items()
            out += [(f"{name}.{key}", getattr(thing, key)) for key, _ in members if not key.startswith("_")]
    return out


def test_everything_public_is_documented() -> None:
    silent = [name for name, thing in public_objects() if name != "__version__" and not inspect.getdoc(thing)]
    assert silent == []


@pytest.mark.parametrize("name", [name for name in gelstereo.__all__ if name != "__version__"])
def test_public_names_say_where_they_belong(name: str) -> None:
    thing = getattr(gelstereo, name)
    if inspect.isclass(thing):
        assert thing.__module__.startswith("gelstereo")


def test_importing_gelstereo_imports_numpy_only() -> None:
    code = "import sys; before = set(sys.modules); import gelstereo; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    foreign = {name for name in loaded if name not in sys.stdlib_module_names and not name.startswith("_")}
    assert foreign <= {"numpy", "gelstereo"}
    assert "numpy" in loaded


def test_marker_states_are_the_cores() -> None:
    from gelstereo import MarkerState

    assert gelstereo._native.marker_states() == {state.name: state.value for state in MarkerState}
