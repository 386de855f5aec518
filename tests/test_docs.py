"""What the documentation shows runs, everything public is documented, and importing it stays light."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import inspect
import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from chessboards import TrueRig, write_pairs
from own_sensor import write_own_sensor
from step_file import write_pin

import gelstereo
from gelstereo.cli.main import COMMANDS, main
from gelstereo.cli.main import _parser as command_parser

REPOSITORY = Path(__file__).parents[1]
MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(gelstereo.__path__, "gelstereo.")
    if not module.name.endswith(("__main__", "corner_worker"))
)
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
#: Help of each command of the host, from the generated page.
HOST_PAGE = (REPOSITORY / "docs" / "reference" / "host-commands.md").read_text(encoding="utf-8")
HOST_HELP = dict(
    re.findall(r"^## gelstereo-host (\w+)\n(.*?)(?=^## |\Z)", HOST_PAGE, re.DOTALL | re.MULTILINE)
)


def load(path: Path) -> ModuleType:
    """A script that is no module of a package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generator = load(REPOSITORY / ".ci" / "docs" / "commands.py")


def blocks(page: str) -> Iterator[tuple[str, str]]:
    """Fenced blocks with their language, and the text between them with an empty one."""
    parts = re.split(r"^```(\w*).*\n((?:.*\n)*?)```$", page, flags=re.MULTILINE)
    for index in range(0, len(parts), 3):
        yield "", parts[index]
        if index + 1 < len(parts):
            yield parts[index + 1] or "text", parts[index + 2]


def commands(text: str, program: str, fence: str) -> list[list[str]]:
    """Words after a program's name, of every line that starts with it; outside a fence, of indented lines."""
    indent = r" {4,}" if fence == "" else r" *"
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    found = [match[1] for line in lines if (match := re.match(rf"{indent}{program} (\S.*)", line))]
    # Two spaces begin an explanation, other marks a pipe or a file for the output.
    return [shlex.split(re.split(r"\s{2,}| [#|>&]", words)[0]) for words in found]


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
    """A folder as the pages assume it: scenes, meshes, images of chessboards and of a gel, and
    room to write.
    """
    folder = tmp_path_factory.mktemp("desk")
    (folder / "scenes").symlink_to(REPOSITORY / "scenes")
    write_pairs(folder, TrueRig.typical(), 5)
    write_own_sensor(folder)
    shutil.copy(REPOSITORY / "scenes" / "parts" / "usb_plug.stl", folder / "plug.stl")
    write_pin(folder / "pin.step", 4.0, 20.0)
    scene, recording = str(REPOSITORY / "scenes" / "grasp_cylinder.toml"), str(folder / "run.mcap")
    assert main(["live", "--scene", scene, "--frames", "6", "--show", "none", "--record", recording]) == 0
    return folder


PAGES = ["README.md", *sorted(str(path.relative_to(REPOSITORY)) for path in REPOSITORY.glob("docs/**/*.md"))]


@pytest.mark.parametrize("page", PAGES)
def test_examples_of_pages(page: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(desk, tmp_path / "desk", symlinks=True)
    monkeypatch.chdir(tmp_path / "desk")
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    names: dict[str, object] = {}
    # Commands of a tutorial run between its Python examples, in the order of the page.
    for fence, text in blocks((REPOSITORY / page).read_text(encoding="utf-8")):
        if fence == "sh" and page.startswith("docs/tutorials/"):
            for words in commands(text, "gelstereo", fence):
                assert main(words) == 0, words
        elif fence != "sh":
            test = doctest.DocTestParser().get_doctest(text, names, page, page, 0)
            runner.run(test, clear_globs=False)
            names = test.globs
    assert runner.failures == 0
    assert runner.tries > 40 or page != "docs/python.md"


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_pages_are_valid(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for fence, text in blocks((REPOSITORY / page).read_text(encoding="utf-8")):
        for words in commands(text, "gelstereo", fence):
            if words[0] in COMMANDS:
                try:
                    command_parser(words)[0].parse_args(words)
                except SystemExit as end:
                    assert end.code == 0, f"{page}: gelstereo {shlex.join(words)}: {capsys.readouterr().err}"
            else:
                assert words[0] in ("COMMAND", "--help"), f"{page}: there is no command {words[0]}"
        for words in commands(text, "gelstereo-host", fence):
            assert words[0] in HOST_HELP, f"{page}: there is no command {words[0]}"
            unknown = [word for word in words if word.startswith("--") and word not in HOST_HELP[words[0]]]
            assert not unknown, f"{page}: gelstereo-host {words[0]} has no {unknown}"


#: What others print.
FOREIGN = {"gelstereo: command not found"}


def test_messages_of_troubleshooting_are_in_the_source() -> None:
    page = (REPOSITORY / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    messages = re.findall(r"^### `(.*)`$", page, re.MULTILINE)
    assert len(messages) > 50
    folders = (
        "crates/gelstereo-core/src",
        "crates/gelstereo-sim/src",
        "firmware-host/src",
        "python/gelstereo",
    )
    sources = [
        path
        for folder in folders
        for path in (REPOSITORY / folder).rglob("*")
        if path.suffix in (".rs", ".py")
    ]
    # A message is one text, although it is written on several lines.
    texts = [re.sub(r'\\\n\s*|"\n\s*f?"', "", path.read_text(encoding="utf-8")) for path in sources]
    for message in sorted(set(messages) - FOREIGN):
        fixed = [words.strip(" ,;") for words in message.split("...")]
        assert any(all(words in text for words in fixed) for text in texts), message


def test_cell_file_of_the_page_is_the_example() -> None:
    page = (REPOSITORY / "docs" / "reference" / "cell.md").read_text(encoding="utf-8")
    assert (REPOSITORY / "examples" / "cell" / "cell.toml").read_text(encoding="utf-8") in page


def test_pages_of_commands_are_current() -> None:
    pages = REPOSITORY / "docs" / "reference"
    remedy = "write it by: python .ci/docs/commands.py"
    assert (pages / "commands.md").read_text(encoding="utf-8") == generator.python_page(), remedy
    if host := os.environ.get("GELSTEREO_HOST"):
        found = (pages / "host-commands.md").read_text(encoding="utf-8")
        assert found == generator.host_page(REPOSITORY / host), remedy


def test_reference_has_every_public_name() -> None:
    pages = [path.read_text(encoding="utf-8") for path in REPOSITORY.glob("docs/reference/*.md")]
    listed = [name for page in pages for name in re.findall(r"^::: gelstereo\.(\w+)$", page, re.MULTILINE)]
    wanted = set(gelstereo.__all__) - {"__version__"}
    assert wanted <= set(listed)
    assert len(listed) == len(set(listed))


#: Modules for users beside the package itself; the site's test looks for each of their names.
PUBLIC_MODULES = [
    *(
        "calibrate",
        "cameras",
        "datasets",
        "extras",
        "force",
        "geometry",
        "grippers",
        "hid",
        "inspection",
        "live",
        "part_surface",
        "parts",
        "point_files",
    ),
    *(
        "progress",
        "randomization",
        "recordings",
        "scattered",
        "setup",
        "streams",
        "templates",
        "tune",
        "view",
    ),
]


def test_modules_are_public_or_internal_on_purpose() -> None:
    inside = {"cli", "export", "simulation", "states"}  # commands, and what the package itself re-exports
    found = {module.name for module in pkgutil.iter_modules(gelstereo.__path__)} - {"_native"}
    assert found == set(PUBLIC_MODULES) | inside


@pytest.mark.parametrize("name", PUBLIC_MODULES)
def test_public_modules_are_in_the_reference_and_documented(name: str) -> None:
    pages = [path.read_text(encoding="utf-8") for path in REPOSITORY.glob("docs/reference/*.md")]
    module = importlib.import_module(f"gelstereo.{name}")
    assert any(re.search(rf"^::: gelstereo\.{name}\b", page, re.MULTILINE) for page in pages)
    things = [getattr(module, key) for key in module.__all__]
    documented = [thing for thing in things if inspect.isclass(thing) or inspect.isroutine(thing)]
    silent = [thing for thing in documented if not inspect.getdoc(thing)]
    assert silent == []


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
