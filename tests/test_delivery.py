"""A wheel has all that it needs without the repository, and its metadata names what each package is for."""

from __future__ import annotations

import importlib.util
import re
from importlib.metadata import files, metadata
from pathlib import Path
from types import ModuleType

import pytest

REPOSITORY = Path(__file__).parents[1]
#: Made by `make dist` alone.
OF_DIST = "gelstereo/third-party-licences.txt"


@pytest.fixture(scope="module")
def check() -> ModuleType:
    path = REPOSITORY / "packaging" / "check.py"
    spec = importlib.util.spec_from_file_location("packaging_check", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def installed() -> set[str]:
    """Files of the wheel that is installed."""
    return {str(file) for file in files("gelstereo") or ()}


def test_the_wheel_has_scenes_stubs_and_licence(check: ModuleType, installed: set[str]) -> None:
    assert {
        "gelstereo/scenes/grasp_cylinder.toml",
        "gelstereo/_native.pyi",
        "gelstereo/py.typed",
    } <= installed
    assert "gelstereo/scenes/parts/usb_plug.stl" in installed
    assert check.faults_of_wheel(installed | {OF_DIST}) == []


def test_what_a_wheel_lacks_is_named(check: ModuleType, installed: set[str]) -> None:
    complete = installed | {OF_DIST}
    for name in ("gelstereo/scenes/usb_plug.toml", "gelstereo/_native.pyi", "gelstereo/py.typed", OF_DIST):
        assert check.faults_of_wheel(complete - {name}) == [f"has no {name}"]
    without = {name for name in complete if not name.endswith("LICENSE")}
    assert check.faults_of_wheel(without) == ["has no LICENSE"]
    assert check.faults_of_binary(8_000_000) == []
    assert check.faults_of_binary(8_000_001) == ["has 8000001 bytes; valid is 8000000 or less"]


def test_every_package_but_numpy_has_an_extra_that_names_its_use() -> None:
    plain, extras = set(), dict[str, set[str]]()
    for line in metadata("gelstereo").get_all("Requires-Dist") or ():
        requirement, _, marker = (part.strip() for part in line.partition(";"))
        if extra := re.search(r"extra == ['\"](\w+)['\"]", marker):
            extras.setdefault(extra[1], set()).add(requirement)
        else:
            plain.add(requirement)
    named = set().union(*(extras[name] for name in ("calibration", "meshes", "grippers", "hid")))
    assert [re.split("[<>=]", name)[0] for name in plain - named] == ["numpy"]
    assert named < plain
