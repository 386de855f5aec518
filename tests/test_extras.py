"""What needs a library that is not installed says so in one sentence, which names what brings it."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from gelstereo.cli.main import COMMANDS
from gelstereo.extras import REQUIREMENTS, MissingExtra, needs

# Imports every module, then asks every command for help; what is blocked is as if it were not installed.
CHILD = """
import contextlib, importlib, io, json, pkgutil, sys
sys.modules[sys.argv[1]] = None
import gelstereo
from gelstereo.cli.main import COMMANDS, main
said = {}
modules = list(pkgutil.walk_packages(gelstereo.__path__, "gelstereo.", onerror=lambda name: None))
# OpenCV and trimesh come with a plain installation, which the benchmarks need.
if sys.argv[1] not in ("gelstereo_bench", "cv2", "trimesh"):
    import gelstereo_bench
    modules += pkgutil.walk_packages(gelstereo_bench.__path__, "gelstereo_bench.", onerror=lambda name: None)
for module in modules:
    # The sweep of constants compiles the repository, and uses bench/outside, which is not installed.
    if module.name.endswith("__main__") or module.name.startswith("gelstereo_bench.sensitivity"):
        continue
    try:
        importlib.import_module(module.name)
    except Exception as error:
        said[module.name] = [type(error).__name__, str(error)]
for command in COMMANDS:
    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = main([command, "--help"])
        except SystemExit as end:
            code = end.code
    said[f"`gelstereo {command}`"] = ["code", code, err.getvalue()]
print(json.dumps(said))
"""


#: Each takes a process of three seconds; the others run with the long tests.
QUICK = ("cv2", "mcap", "scipy", "matplotlib", "gelstereo_bench")
LIBRARIES = [
    library if library in QUICK else pytest.param(library, marks=pytest.mark.long) for library in REQUIREMENTS
]


@pytest.mark.parametrize("library", LIBRARIES)
def test_row_39_what_is_not_installed_is_named_with_its_extra(library: str) -> None:
    child = subprocess.run(
        [sys.executable, "-c", CHILD, library], capture_output=True, text=True, check=True, timeout=300.0
    )
    said = json.loads(child.stdout)
    remedy = f"needs {library}, which is not installed: pip install '{REQUIREMENTS[library]}'"
    for command in COMMANDS:
        _, code, text = said.pop(f"`gelstereo {command}`")
        assert code in (0, 2), (command, text)
        if code == 2:
            assert text == f"gelstereo: `gelstereo {command}` {remedy}\n"
    for module, (kind, text) in said.items():
        assert kind == "MissingExtra", (module, kind, text)
        assert text.endswith(remedy) and text.startswith("gelstereo"), (module, text)
        assert "\n" not in text


def test_row_39_only_what_an_extra_brings_is_an_extra() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module") as raised, needs("this"):
        import no_such_module  # type: ignore[import-not-found]  # noqa: F401
    assert not isinstance(raised.value, MissingExtra)
