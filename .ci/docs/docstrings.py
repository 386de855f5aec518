"""Docstrings of the compiled bindings, for the reference: the stub has the types, the library the texts."""

from __future__ import annotations

import importlib
import inspect
from typing import Any

import griffe

#: What the stub calls types that it shares, in words of NumPy.
ALIASES = {"_Floats": "ndarray[float64]", "_Bytes": "ndarray[uint8]", "_Path": "str | PathLike"}


class BindingsDocstrings(griffe.Extension):
    """Give every object of ``gelstereo._native`` that has no docstring the one of the library."""

    def on_package(self, *, pkg: griffe.Module, **_others: Any) -> None:
        """Fill the stub's objects once the package is read."""
        if pkg.path == "gelstereo":
            fill(pkg.members["_native"], importlib.import_module("gelstereo._native"))


def fill(parent: griffe.Object | griffe.Alias, live_parent: object) -> None:
    """Fill the members of a module or class."""
    for name, member in parent.members.items():
        live = getattr(live_parent, name, None)
        if member.is_alias or live is None or name.startswith("_"):
            continue
        text = inspect.getdoc(live)
        if text and not member.docstring:
            member.docstring = griffe.Docstring(text, parent=member, parser="numpy")
        spell_out(member)
        if member.is_class:
            fill(member, live)
            # The reference shows a class with the parameters of `__init__`; the bindings have `__new__`
            # alone.
            if "__new__" in member.members:
                member.members["__init__"] = member.members["__new__"]


def spell_out(member: griffe.Object | griffe.Alias) -> None:
    """Replace the stub's private aliases in the types of an attribute or function."""
    types = [getattr(member, "annotation", None), getattr(member, "returns", None)]
    types += [parameter.annotation for parameter in getattr(member, "parameters", ())]
    for type_ in types:
        for part in [type_, *type_.iterate(flat=True)] if isinstance(type_, griffe.Expr) else ():
            if isinstance(part, griffe.ExprName) and part.name in ALIASES:
                part.name = ALIASES[part.name]
