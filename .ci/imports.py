"""Checks which file of the core imports which: no cycle of files, and no folder that imports from one above
it.

usage: imports.py SOURCE_FOLDER
"""

from __future__ import annotations

import re
import sys
from graphlib import CycleError, TopologicalSorter
from itertools import accumulate
from pathlib import Path

#: Folders and files, those that serve others first. None imports from a later line.
FLOORS = (
    ("stop", "digest"),
    ("math", "image"),
    ("frames", "spatial", "camera", "layer"),
    ("rig", "surface"),
    ("params",),
    ("color",),
    ("detect",),
    ("lattice",),
    ("track",),
    ("triangulate",),
    ("contact",),
    ("force",),
    ("slip",),
    ("motion",),
    ("register",),
    ("pipeline",),
)

Module = tuple[str, ...]


def trees(text: str) -> list[str]:
    """What a `use` with groups stands for, each by itself."""
    head, brace, rest = text.partition("{")
    if not brace:
        return [part.strip() for part in text.split(",") if part.strip()]
    depths = accumulate(((letter == "{") - (letter == "}") for letter in rest), initial=1)
    end = list(depths).index(0) - 1
    before, _, prefix = head.rpartition(",")
    return trees(before) + [prefix.strip() + item for item in trees(rest[:end])] + trees(rest[end + 1 :])


def resolved(path: Module, texts: dict[Module, str]) -> Module:
    """The module that defines what a path names; what a module re-exports is defined elsewhere."""
    module = path
    while module not in texts:
        module = module[:-1]
    if len(path) > len(module):
        exports = re.findall(r"^(?:pub(?:\([^)]*\))? )?use ([^;]+);", texts[module], re.M)
        for item in (item for export in exports for item in trees(export)):
            parts = tuple(item.split("::"))
            if parts[-1] == path[len(module)] and (*module, parts[0]) in texts:
                return resolved((*module, *parts), texts)
    return module


def imports(own: Module, texts: dict[Module, str]) -> set[Module]:
    """Modules that one names in its code, re-exports and tests aside."""
    text = re.sub(r"//[^\n]*|pub\(in [^)]*\)", "", texts[own]).split("#[cfg(test)]\nmod ")[0]
    uses = [item for use in re.findall(r"^\s*use ([^;]+);", text, re.M) for item in trees(use)]
    children = "|".join(module[-1] for module in texts if module[:-1] == own)
    first = f"crate|super|self|{children}" if children else "crate|super|self"
    uses += re.findall(rf"(?<!::)\b((?:{first})(?:::\w+)+)", re.sub(r"^.*\buse [^;]+;", "", text, flags=re.M))
    found = set()
    for use in uses:
        first, *rest = (part.split(" as ")[0] for part in use.split("::"))
        base = {"crate": (), "super": own[:-1], "self": own}.get(first)
        if base is None:
            base, rest = own, [first, *rest]
            if (*own, first) not in texts:
                continue
        while rest and rest[0] == "super":
            base, rest = base[:-1], rest[1:]
        found.add(resolved((*base, *rest), texts))
    return found - {own, ()}


def main() -> int:
    source, texts = Path(sys.argv[1]), {}
    for file in sorted(source.rglob("*.rs")):
        parts = file.relative_to(source).with_suffix("").parts
        texts[parts[:-1] if parts[-1] in ("mod", "lib") else parts] = file.read_text(encoding="utf-8")
    floor = {name: number for number, names in enumerate(FLOORS) for name in names}
    faults, graph = [], {}
    for own in filter(None, texts):
        graph[own] = imports(own, texts)
        above = [o for o in sorted(graph[own]) if o[0] != own[0] and floor[o[0]] >= floor[own[0]]]
        faults += [f"{'/'.join(own)} imports {'/'.join(other)}, which is not below it" for other in above]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        faults.append("files import each other: " + " <- ".join("/".join(part) for part in error.args[1]))
    sys.stdout.writelines(fault + "\n" for fault in faults)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
