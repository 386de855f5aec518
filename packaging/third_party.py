"""Licence texts of all crates that are linked into a package: `third_party.py PACKAGE TARGET > FILE`.

Equal texts are printed once, under the names of all crates that carry them.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

NO_TEXT = "The crate carries no text; its licence is the one named above."
TEXTS = ("LICENSE*", "LICENCE*", "COPYING*", "NOTICE*", "UNLICENSE*", "license*")


def metadata(target: str) -> dict[str, Any]:
    """What cargo knows of the workspace and its dependencies, for one target."""
    command = ["cargo", "metadata", "--format-version", "1", "--filter-platform", target]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return found


def linked(known: dict[str, Any], package: str) -> set[str]:
    """Identities of the crates that a package links; what only builds it is left out."""
    nodes = {node["id"]: node for node in known["resolve"]["nodes"]}
    kinds = {one["id"]: {kind for t in one["targets"] for kind in t["kind"]} for one in known["packages"]}
    open_ids = [one["id"] for one in known["packages"] if one["name"] == package]
    if not open_ids:
        raise SystemExit(f"the workspace has no package {package}")
    reached: set[str] = set()
    while open_ids:
        at = open_ids.pop()
        if at in reached or "proc-macro" in kinds[at]:
            continue
        reached.add(at)
        for dep in nodes[at]["deps"]:
            if any(kind["kind"] is None for kind in dep["dep_kinds"]):
                open_ids.append(dep["pkg"])
    return reached


def texts(manifest: Path) -> set[str]:
    """The licence texts beside a crate's manifest."""
    files = {path for pattern in TEXTS for path in manifest.parent.glob(pattern) if path.is_file()}
    return {path.read_text(encoding="utf-8", errors="replace").strip() for path in files}


def main(package: str, target: str) -> None:
    """Write the texts to the standard output."""
    known = metadata(target)
    theirs = linked(known, package) - set(known["workspace_members"])
    carriers: dict[str, list[str]] = defaultdict(list)
    for one in known["packages"]:
        if one["id"] in theirs:
            name = f"{one['name']} {one['version']} ({one['license'] or 'see its text'})"
            for text in texts(Path(one["manifest_path"])) or {
                "The crate carries no text; its licence is the one named above."
            }:
                carriers[text].append(name)
    for text, names in sorted(carriers.items(), key=lambda entry: entry[1]):
        print("\n".join(sorted(names)), text, "=" * 80, sep="\n\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
