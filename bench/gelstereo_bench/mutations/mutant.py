"""A fault for the tests to find."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

__all__ = ["SWITCH", "Mutant", "mutants"]

#: Environment variable with the number of the one mutant that is on.
SWITCH = "GELSTEREO_MUTANT"


@dataclass(frozen=True)
class Mutant:
    """One change of the source."""

    #: Identifier, in this list only.
    name: str
    #: Path from the repository's root.
    file: str
    #: A Rust or Python expression, or Rust statements, that occurs once in the file; and what replaces it.
    old: str
    new: str
    #: What is wrong with it.
    breaks: str
    #: Where to look first: parts of Rust test names, and files of Python tests.
    tests: list[str]
    #: Why no test can find it; empty if one can.
    equivalent: str = ""

    @property
    def digest(self) -> str:
        """Of the change: results of another change of this name are void."""
        return hashlib.sha256("\0".join((self.file, self.old, self.new)).encode()).hexdigest()[:12]

    def switched(self, number: int, text: str) -> str:
        """The file's text, with the change where `SWITCH` has this number."""
        if text.count(self.old) != 1:
            raise ValueError(
                f"mutant {self.name}: its old text occurs {text.count(self.old)} times in {self.file}; valid "
                "is once"
            )
        if self.file.endswith(".py"):
            asked = f'__import__("os").environ.get("{SWITCH}") == "{number}"'
            return text.replace(self.old, f"(({self.new}) if {asked} else ({self.old}))")
        # A constant function cannot read the switch.
        before, _, after = text.partition(self.old)
        head, function, body = before.rpartition("fn ")
        text = head.removesuffix("const ") + function + body + self.old + after
        crate = "crate" if self.file.startswith("crates/gelstereo-core/") else "::gelstereo_core"
        choice = f"if {crate}::mutant({number}) {{ {self.new} }} else {{ {self.old} }}"
        return text.replace(self.old, choice if self.old.endswith(";") else f"({choice})")


def mutants() -> list[Mutant]:
    """All of them, in the order of the data flow."""
    text = Path(__file__).with_name("mutants.json").read_text(encoding="utf-8")
    return [Mutant(**each) for each in json.loads(text)]
