"""Files of images, and pairs of left and right ones."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .errors import CalibrationError, UnpairedImagesError

__all__ = ["ImagePair", "expand", "names_swapped", "pair_images"]


@dataclass(frozen=True)
class ImagePair:
    """Two images of one moment."""

    left: Path
    right: Path

    @property
    def name(self) -> str:
        """Both file names, for messages."""
        return f"{self.left.name} / {self.right.name}"


def expand(patterns: Iterable[str]) -> list[Path]:
    """Files of names and patterns.

    Raises
    ------
    CalibrationError
        A pattern matches no file.
    """
    paths: list[Path] = []
    for pattern in patterns:
        if Path(pattern).is_file():
            paths.append(Path(pattern))
            continue
        folder, name = Path(pattern).parent, Path(pattern).name
        # A pattern without a file name, such as "" or "/", matches nothing.
        matches = sorted(folder.glob(name)) if name else []
        if not matches:
            raise CalibrationError(
                f"no file matches {pattern!r}; valid is an image, or a pattern such as 'left*.png'"
            )
        paths += matches
    return paths


def pair_images(left_paths: Iterable[str | Path], right_paths: Iterable[str | Path]) -> list[ImagePair]:
    """Pair files by the last number in their names (``left07.jpg`` with ``right07.jpg``).

    Files without numbers are paired in the order given. The result is ordered by number.

    Raises
    ------
    UnpairedImagesError
        A file has no partner, or one number occurs twice in a list.
    """
    left = [Path(path) for path in left_paths]
    right = [Path(path) for path in right_paths]
    _refuse_shared_files(left, right)
    left_by_number, right_by_number = _by_number(left), _by_number(right)
    if left_by_number is None or right_by_number is None:
        return _pair_in_order(left, right)
    left_only = [path for number, path in left_by_number.items() if number not in right_by_number]
    right_only = [path for number, path in right_by_number.items() if number not in left_by_number]
    if left_only or right_only:
        raise UnpairedImagesError(_unpaired_message(left_only, right_only), left_only, right_only)
    return [ImagePair(left_by_number[n], right_by_number[n]) for n in sorted(left_by_number)]


def _by_number(paths: Sequence[Path]) -> dict[int, Path] | None:
    """Files by the last number in their names, or ``None`` when a file has none."""
    numbers: dict[int, Path] = {}
    for path in paths:
        found = re.findall(r"\d+", path.stem)
        if not found:
            return None
        number = int(found[-1])
        if number in numbers:
            first = numbers[number]
            message = f"{first.name} and {path.name} carry the same number, {number}; each pair needs its own"
            raise UnpairedImagesError(message, [first, path], [])
        numbers[number] = path
    return numbers


def _pair_in_order(left: Sequence[Path], right: Sequence[Path]) -> list[ImagePair]:
    if len(left) != len(right):
        shorter = min(len(left), len(right))
        left_only, right_only = left[shorter:], right[shorter:]
        message = (
            f"{len(left)} left but {len(right)} right images, and not all names carry a number to pair them "
            "by; name them left01, right01 and so on, or remove the images without a partner"
        )
        raise UnpairedImagesError(message, left_only, right_only)
    return [ImagePair(a, b) for a, b in zip(left, right, strict=True)]


def names_swapped(left: Sequence[Path], right: Sequence[Path]) -> str | None:
    """Say that the left files are named "right" and the right files "left"; `None` if they are not.

    Names do not decide which camera is the left one: the images do, by the places of the cameras.
    """

    def all_named(paths: Sequence[Path], word: str, other: str) -> bool:
        names = [path.stem.lower() for path in paths]
        return bool(names) and all(word in name and other not in name for name in names)

    if all_named(left, "right", "left") and all_named(right, "left", "right"):
        return f"the left images are named right ({left[0].name}) and the right images left ({right[0].name})"
    return None


def _refuse_shared_files(left: Sequence[Path], right: Sequence[Path]) -> None:
    shared = sorted({path.resolve() for path in left} & {path.resolve() for path in right})
    if shared:
        message = f"{_names(shared)} given as left and as right image; each view needs its own files"
        raise UnpairedImagesError(message, shared, shared)


def _unpaired_message(left_only: Sequence[Path], right_only: Sequence[Path]) -> str:
    parts = []
    if left_only:
        parts.append(f"no right image for {_names(left_only)}")
    if right_only:
        parts.append(f"no left image for {_names(right_only)}")
    return "; ".join(parts) + "; add the missing files or remove these"


def _names(paths: Sequence[Path], limit: int = 5) -> str:
    names = ", ".join(path.name for path in paths[:limit])
    return names if len(paths) <= limit else f"{names} and {len(paths) - limit} more"
