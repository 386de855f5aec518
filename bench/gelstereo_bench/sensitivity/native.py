"""Scales constants of the scratch build that this process has loaded."""

from __future__ import annotations

import ctypes

import gelstereo._native

__all__ = ["Constants"]


class Constants:
    """The constants of the loaded library, by number."""

    def __init__(self) -> None:
        self._library = ctypes.CDLL(str(gelstereo._native.__file__))
        self._library.gelstereo_scale_constant.argtypes = [ctypes.c_uint32, ctypes.c_double]
        self._library.gelstereo_scale_constant.restype = None
        self._library.gelstereo_constant_was_read.argtypes = [ctypes.c_uint32]
        self._library.gelstereo_constant_was_read.restype = ctypes.c_uint8

    def scale(self, number: int, factor: float) -> None:
        """Multiply a constant; integers become the nearest other integer."""
        self._library.gelstereo_scale_constant(number, factor)

    def was_read(self, number: int) -> bool:
        """Whether the constant was read since this was last asked."""
        return bool(self._library.gelstereo_constant_was_read(number))
