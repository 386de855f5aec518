"""Builds all mutants into one copy, and runs the tests with one at a time."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from gelstereo_bench.mutations.mutant import SWITCH, Mutant
from gelstereo_bench.sensitivity.instrument import copy_workspace

__all__ = ["Copy"]

# `make test` fixes the cases of property tests by this seed.
_SEED = {"PROPTEST_RNG_SEED": "20211"}
_PATIENCE_S = 3600
_NOT_COPIED = {"target", "out", "fuzz"}
_CORE = "crates/gelstereo-core/src/lib.rs"
_SWITCH = f"""
extern crate std;

#[allow(missing_docs)]
pub fn mutant(number: u32) -> bool {{
    static CHOSEN: std::sync::OnceLock<u32> = std::sync::OnceLock::new();
    let chosen = || std::env::var("{SWITCH}").ok().and_then(|number| number.parse().ok());
    *CHOSEN.get_or_init(|| chosen().unwrap_or(u32::MAX)) == number
}}
"""
_FAILED_RUST = re.compile(r"^test (\S+)(?: - should panic)? \.\.\. FAILED$", re.MULTILINE)
_FAILED_PYTHON = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


class Copy:
    """A copy of the repository with every mutant in it, switched off, and its build; both in a folder."""

    def __init__(self, repository: Path, scratch: Path) -> None:
        self.repository, self.copy, self.target = repository, scratch / "copy", scratch / "build"
        #: Folder and path of every binary of Rust tests.
        self.tests = scratch / "tests.json"

    def build(self, mutants: Sequence[Mutant]) -> None:
        """Copy the repository, write the mutants into it, and build all that the tests need."""
        before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in self._rewritten(mutants)}
        names = (path.name for path in self.repository.iterdir() if not path.name.startswith("."))
        copy_workspace(self.repository, self.copy, sorted({*names} - _NOT_COPIED))
        for number, mutant in enumerate(mutants):
            path = self.copy / mutant.file
            path.write_text(mutant.switched(number, path.read_text(encoding="utf-8")), encoding="utf-8")
        with (self.copy / _CORE).open("a", encoding="utf-8") as core:
            core.write(_SWITCH)
        # What is the same as in the copy before need not be compiled again.
        for path, (text, time_ns) in before.items():
            if path.read_bytes() == text:
                os.utime(path, ns=(time_ns, time_ns))
        library = ["-p", "gelstereo-python", "--lib", "--features", "pyo3/extension-module,pyo3/abi3-py310"]
        built = self._cargo("test", "--workspace", "--tests", "--no-run", "--message-format=json")
        artifacts = [json.loads(line) for line in built.splitlines()]
        # The digests come last, by themselves.
        tests = [
            (str(Path(each["manifest_path"]).parent), each["executable"])
            for each in artifacts
            if each.get("executable") and each["profile"]["test"] and "same_bits" not in each["manifest_path"]
        ]
        self.tests.write_text(json.dumps(tests), encoding="utf-8")
        self._cargo("build", "-p", "gelstereo-host", "--bins", "--example", "world_server")
        self._cargo("build", "-p", "same-bits", "--bin", "same-bits")
        self._cargo("build", *library)
        shutil.copy(self.target / "debug/lib_native.so", self.copy / "python/gelstereo/_native.abi3.so")

    def _rewritten(self, mutants: Sequence[Mutant]) -> list[Path]:
        files = {_CORE, *(mutant.file for mutant in mutants)}
        return [self.copy / file for file in files if (self.copy / file).exists()]

    def found_by(self, mutant: Mutant, number: int) -> list[str]:
        """The kind of the tests that find a mutant, and the first of their names; empty if none does."""
        kinds: dict[str, Callable[[int | None], list[str]]] = {
            "quick": lambda switch: self.quick(mutant.tests, switch),
            "rust": self.rust,
            "python": self.python,
            "digests": self.digests,
        }
        for kind, run in kinds.items():
            if found := run(number):
                is_named = "(" not in found[0] and kind != "digests"
                fails_anyway = self.quick(found[:5], None) if is_named else run(None)
                if found := [name for name in found[:5] if name not in fails_anyway]:
                    return [kind, *found]
        return []

    def quick(self, tests: Iterable[str], number: int | None) -> list[str]:
        """Those of the named tests that fail; a path is of Python tests, and a word a part of Rust names."""
        rust = [test for test in tests if ".py" not in test]
        python = [test for test in tests if ".py" in test]
        return (self.rust(number, rust) if rust else []) or (self.python(number, python) if python else [])

    def rust(self, number: int | None, filters: Iterable[str] = ()) -> list[str]:
        """The Rust tests that fail in the first binary with any."""
        for folder, binary in json.loads(self.tests.read_text(encoding="utf-8")):
            if failed := self._failed([binary, *filters], number, _FAILED_RUST.findall, Path(folder)):
                return failed
        return []

    def python(self, number: int | None, tests: Iterable[str] = ()) -> list[str]:
        """The first Python test that fails."""
        words = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider"]
        words += ["-m", "not long and not realtime", *tests]
        return self._failed(words, number, _FAILED_PYTHON.findall, self.copy)

    def digests(self, number: int | None) -> list[str]:
        """What `make test-long` compares bit by bit, if it differs."""
        words = [str(self.target / "debug/same-bits")]
        return self._failed(words, number, lambda _: ["the digests alone"], self.copy)

    def _cargo(self, *words: str) -> str:
        words = ("cargo", *words, "--quiet", "--target-dir", str(self.target))
        return subprocess.run(words, cwd=self.copy, check=True, stdout=subprocess.PIPE, text=True).stdout

    def _failed(
        self, words: list[str], number: int | None, names: Callable[[str], list[str]], folder: Path
    ) -> list[str]:
        paths = os.pathsep.join(str(self.copy / name) for name in ("python", "bench"))
        host = str(self.target / "debug/gelstereo-host")
        environment = {**os.environ, **_SEED, "PYTHONPATH": paths, "GELSTEREO_HOST": host}
        environment[SWITCH] = "none" if number is None else str(number)
        try:
            ran = subprocess.run(
                words, cwd=folder, env=environment, capture_output=True, text=True, timeout=_PATIENCE_S
            )
        except subprocess.TimeoutExpired:
            return ["(does not end)"]
        return (names(ran.stdout) or ["(aborts)"]) if ran.returncode else []
