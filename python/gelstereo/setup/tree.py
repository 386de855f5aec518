"""Trees of settings as flat mappings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["leaves"]


def leaves(tree: Mapping[str, Any], *, open_lists: bool = False, prefix: str = "") -> dict[str, Any]:
    """Values by dotted names, as `Params.replace` takes them.

    A list is one value, or its entries are values by their numbers if lists are to be opened.
    """
    found: dict[str, Any] = {}
    for name, value in tree.items():
        if open_lists and isinstance(value, (list, tuple)):
            value = {str(number): entry for number, entry in enumerate(value)}
        if isinstance(value, Mapping):
            found |= leaves(value, open_lists=open_lists, prefix=f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found
