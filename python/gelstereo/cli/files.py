"""Reading and writing images; errors name the file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Error, ImageError
from gelstereo.extras import needs

_IMAGES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}


class FileError(Error):
    """A file cannot be used by the command."""


def write_image(path: Path, image: npt.NDArray[np.uint8]) -> None:
    """Write an image; create missing folders."""
    with needs(__name__):
        import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() not in _IMAGES:
        raise FileError(f"{path} does not end like an image file; valid is one of {sorted(_IMAGES)}")
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path} could not be written")


def read_image(path: Path) -> npt.NDArray[np.uint8]:
    """A grey image, (H, W) uint8."""
    with needs(__name__):
        import cv2

    if not path.is_file():
        raise FileNotFoundError(2, "No such image", str(path))
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError(f"{path} cannot be read as an image")
    return np.asarray(image, dtype=np.uint8)


def read_color_image(path: Path) -> npt.NDArray[np.uint8]:
    """An image as its file has it: (H, W) uint8 if it is grey, (H, W, 3) in the order blue, green, red
    otherwise.
    """
    import cv2

    if not path.is_file():
        raise FileNotFoundError(2, "No such image", str(path))
    image = cv2.imread(str(path), cv2.IMREAD_ANYCOLOR)
    if image is None:
        raise ImageError(f"{path} cannot be read as an image")
    return np.asarray(image, dtype=np.uint8)


def as_grey(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The grey image of what `read_color_image` returns."""
    import cv2

    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def stereo_pairs(folder: Path) -> list[tuple[Path, Path]]:
    """Images with the same name in ``left`` and ``right``, in natural order: ``3.png`` before ``29.png``."""
    if not folder.is_dir():
        raise FileNotFoundError(2, "No such folder", str(folder))
    views = [{path.name: path for path in _images(folder / view)} for view in ("left", "right")]
    alone = sorted(set(views[0]) ^ set(views[1]))
    if alone:
        raise FileError(
            f"{alone[0]} exists in only one of {folder}/left and {folder}/right; pairs need equal names"
        )
    if not views[0]:
        raise FileError(f"{folder} has no images; valid is left/NAME.png with right/NAME.png")
    return [(views[0][name], views[1][name]) for name in sorted(views[0], key=natural_key)]


def natural_key(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Sorting key that compares numbers in names by value, as `gelstereo-host` sorts a folder's images.

    Names that differ only in leading zeros are ordered as text.
    """
    parts = [part for part in re.split(r"([0-9]+)", name) if part]
    return [_part_key(part) for part in parts], name


def _part_key(part: str) -> tuple[int, int, str]:
    # Digits sort where their text would: after characters below "0", before characters above "9".
    if part[0] in "0123456789":
        digits = part.lstrip("0")
        return ord("0"), len(digits), digits
    return ord(part[0]), 0, part


def _images(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [path for path in folder.iterdir() if path.suffix.lower() in _IMAGES]
