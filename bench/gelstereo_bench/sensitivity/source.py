"""Constants of Rust source: where they are defined, and where they are used."""

from __future__ import annotations

import re
from bisect import bisect
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Definition", "Source", "sources"]

_BLANKED = re.compile(
    r"//[^\n]*|/\*.*?\*/|\bb?r(#*)\".*?\"\1|b?\"(?:\\.|[^\"\\])*\"|'(?:\\[^']+|[^'\\])'", re.DOTALL
)
# Of an item, not of a generic parameter.
_CONST = re.compile(
    r"(?:^|[;{}\]])\s*(?P<seen>pub(?:\([^)]*\))?\s+)?const\s+(?P<name>[A-Z][A-Z0-9_]*)\s*:(?P<type>[^={}]*)="
)
_STATIC = re.compile(r"\bstatic\s+[A-Z][A-Z0-9_]*\s*:[^=]*=")
_USE = re.compile(r"\buse\s[^;]*;")
_NAME = re.compile(r"\b[A-Z][A-Z0-9_]*\b")


@dataclass(frozen=True)
class Definition:
    """A constant of one file. Offsets are those of bytes."""

    file: str
    name: str
    #: As written, with `pub` if it has it.
    visibility: str
    type: str
    #: Offsets of its expression, and the end of the statement.
    start: int
    end: int
    #: Whether it is an item of the file, not of an `impl` or a test.
    top: bool


class Source:
    """One file: its text, decoded byte by byte, and the same without comments and strings."""

    def __init__(self, root: Path, file: str) -> None:
        self.file = file
        self.text = (root / file).read_bytes().decode("latin-1")
        self.code = _BLANKED.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), self.text)
        tests = re.search(r"#\[cfg\(test\)\]\s*mod \w+ \{", self.code)
        self.code = self.code[: tests.start()] if tests else self.code
        self.definitions = [self._definition(found) for found in _CONST.finditer(self.code)]
        self.statics = [(found.end(), self._end(found.end())) for found in _STATIC.finditer(self.code)]
        self._uses = [(found.start(), found.end()) for found in _USE.finditer(self.code)]
        self.imported = " ".join(self.code[start:end] for start, end in self._uses)

    def _end(self, start: int) -> int:
        """Offset of the semicolon that ends the expression."""
        depth = 0
        for at in range(start, len(self.code)):
            depth += {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}.get(self.code[at], 0)
            if self.code[at] == ";" and depth == 0:
                return at
        raise ValueError(f"{self.file}: a constant without an end")

    def _definition(self, found: re.Match[str]) -> Definition:
        start, end = found.end(), self._end(found.end())
        before = self.code[:start]
        top = before.count("{") == before.count("}")
        return Definition(
            self.file, found["name"], found["seen"] or "", found["type"].strip(), start, end, top
        )

    def value(self, definition: Definition) -> str:
        """The expression with single spaces, without comments."""
        bare = re.sub(r"//[^\n]*", "", self.text[definition.start : definition.end])
        return " ".join(bare.encode("latin-1").decode("utf-8").split())

    def names(self, start: int = 0, end: int | None = None) -> list[tuple[int, str]]:
        """Offsets of names in capitals that are used: not defined, not imported, not of a type."""
        starts = [start for start, _ in self._uses]
        out = []
        for found in _NAME.finditer(self.code, start, len(self.code) if end is None else end):
            use = bisect(starts, found.start()) - 1
            before = self.code[: found.start()].rstrip()[-40:]
            of_type = re.search(r"(?:[A-Z]\w*|\b[fiu](?:8|16|32|64|128|size)|>)\s*::$", before)
            defined = re.search(r"\b(?:const|static)$", before)
            imported = use >= 0 and found.start() < self._uses[use][1]
            if not (of_type or defined or imported):
                out.append((found.start(), found.group()))
        return out

    def path(self, at: int) -> str:
        """The path written before a name, or what the file imports by that name."""
        before = re.search(r"(?:\w+\s*::\s*)+$", self.code[:at][-200:])
        return before.group() if before else ""


def sources(root: Path) -> dict[str, Source]:
    """Every file below a folder, by its path in it."""
    # Tests are not built.
    files = sorted(path.relative_to(root).as_posix() for path in root.rglob("*.rs"))
    return {file: Source(root, file) for file in files if not file.endswith("tests.rs")}
