"""Point clouds in files: .npy, .ply, .pcd, and text with three columns (.csv, .txt, .xyz).

PLY and PCD differ in their headers only: both state named columns, the number of points, and whether the
points are text or bytes. Lengths are millimetres; none of these formats states its unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error, ShapeError

__all__ = ["PointFileError", "check_ply", "read_points"]

Floats = npt.NDArray[np.float64]

#: Longest header that is read, lines. Headers of scanners have a few dozen.
_MAX_HEADER_LINES = 10_000
_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_PLY_FORMATS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}


class PointFileError(Error):
    """A file cannot be read as a point cloud."""


def read_points(path: Path) -> Floats:
    """The points of a file, (N, 3) millimetres in the sensor frame.

    Points of a PCD file without coordinates (NaN, where the scanner saw nothing) are left out.

    Raises
    ------
    PointFileError
        If the file cannot be read as a point cloud; the message names the line or the format that can be
        read.
    ShapeError
        If its array is not (N, 3).
    FileNotFoundError
        If there is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(2, "No such point cloud", str(path))
    readers = {
        ".npy": _read_npy,
        ".ply": _read_ply,
        ".pcd": _read_pcd,
        **dict.fromkeys((".csv", ".txt", ".xyz"), _read_text),
    }
    kind = path.suffix.lower()
    if kind not in readers:
        raise PointFileError(f"{path} ends in {kind or 'nothing'}; valid is one of {sorted(readers)}")
    try:
        points = readers[kind](path)
    except PointFileError as error:
        raise PointFileError(f"{path} cannot be read as a point cloud: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"{path} has an array of shape {points.shape}; valid is (N, 3), in millimetres")
    return points


def _read_npy(path: Path) -> Floats:
    try:
        values = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise PointFileError("it is not an array that numpy.save wrote, or has Python objects") from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise PointFileError(
            f"its values are {getattr(values, 'dtype', 'several arrays')}; valid are real numbers"
        )
    return np.asarray(values, dtype=np.float64)


# Text


def _read_text(path: Path) -> Floats:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise PointFileError("it is not text; valid are three columns of numbers") from error
    lines = [(at, line) for at, line in enumerate(text.splitlines(), 1) if line.strip(" \t,;")]
    lines = [(at, line) for at, line in lines if not line.lstrip().startswith("#")]
    columns: list[int] | None = None
    if lines and not any(re.match("[-+.]*[0-9]", cell) for cell in _cells(lines[0][1])):
        columns = _named_columns(_cells(lines[0][1]))
        lines = lines[1:]
    if not lines:
        raise PointFileError("it has no lines of numbers; valid are three columns")
    return np.array([_point(at, line, columns) for at, line in lines], dtype=np.float64)


def _cells(line: str) -> list[str]:
    """The cells of a line: by semicolons, else by commas or tabs, else by spaces."""
    for separator in (";", ",", "\t"):
        if separator in line:
            return [cell.strip() for cell in line.strip().rstrip(separator).split(separator)]
    return line.split()


def _named_columns(header: list[str]) -> list[int] | None:
    """Columns that a header calls x, y and z, with or without a unit; `None` if it does not."""
    names = [re.sub(r"[\s_]*[\[(]?mm[\])]?$", "", cell.strip('"').lower()) for cell in header]
    return [names.index(axis) for axis in "xyz"] if set("xyz") <= set(names) else None


def _point(at: int, line: str, columns: list[int] | None) -> list[float]:
    cells = _cells(line)
    if columns is not None and max(columns) < len(cells):
        cells = [cells[column] for column in columns]
    if len(cells) == 3 and all(_is_number(cell) for cell in cells):
        return [float(cell) for cell in cells]
    found = line.strip()[:60]
    hint = "" if ";" not in line or "," not in line else " with decimal points, not commas"
    raise PointFileError(
        f"line {at} is {found!r}; valid are three numbers{hint}, or a header that names x, y and z"
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# PLY and PCD


@dataclass
class _Table:
    """Columns of points, as a header states them."""

    #: Name and little- or big-endian NumPy type of each column.
    columns: list[tuple[str, str]]
    points: int
    #: Whether the points are bytes; text otherwise.
    binary: bool
    #: Lines or bytes of other elements before the points.
    skipped: int = 0

    def read(self, file: BinaryIO) -> Floats:
        """The coordinates, (points, 3)."""
        names = [name for name, _ in self.columns]
        missing = [axis for axis in "xyz" if axis not in names]
        if missing:
            raise PointFileError(
                f"its points have no {', '.join(missing)}, but {', '.join(names) or 'nothing'}"
            )
        axes = [names.index(axis) for axis in "xyz"]
        return self._from_bytes(file, axes) if self.binary else self._from_text(file, axes)

    def _from_bytes(self, file: BinaryIO, axes: list[int]) -> Floats:
        # The columns' own names may occur twice.
        record = np.dtype([(f"c{at}", kind) for at, (_, kind) in enumerate(self.columns)])
        file.seek(self.skipped, 1)
        data = file.read()
        needed = record.itemsize * self.points
        if len(data) < needed:
            raise PointFileError(
                f"it is cut short: {self.points} points take {needed} bytes, and {len(data)} follow the "
                "header"
            )
        rows = np.frombuffer(data[:needed], record)
        return np.column_stack([rows[f"c{at}"].astype(np.float64) for at in axes])

    def _from_text(self, file: BinaryIO, axes: list[int]) -> Floats:
        lines = file.read().splitlines()[self.skipped :]
        if len(lines) < self.points:
            raise PointFileError(
                f"it is cut short: {len(lines)} lines follow the header of {self.points} points"
            )
        found = np.empty((self.points, 3))
        for at, line in enumerate(lines[: self.points]):
            cells = line.split()
            try:
                found[at] = [float(cells[axis]) for axis in axes]
            except (ValueError, IndexError) as error:
                text = line[:60].decode("ascii", "replace")
                wanted = f"{len(self.columns)} numbers"
                raise PointFileError(f"its point {at} is {text!r}; valid are {wanted}") from error
        return found


def _header_lines(file: BinaryIO, last: str) -> list[tuple[int, list[str]]]:
    """Line numbers and words of the header, up to the line that starts with `last`."""
    lines = []
    for at in range(1, _MAX_HEADER_LINES):
        raw = file.readline(4096)
        words = raw.decode("ascii", "replace").split()
        if not raw:
            break
        if words:
            lines.append((at, words))
        if words[:1] == [last]:
            return lines
    raise PointFileError(f"its header has no line {last!r}")


def _count(words: list[str], at: int) -> int:
    if len(words) != 1 or not words[0].isdecimal() or len(words[0]) > 12:
        raise PointFileError(f"line {at} of its header has {' '.join(words)!r}; valid is a count")
    return int(words[0])


@dataclass
class _Element:
    name: str
    count: int
    columns: list[tuple[str, str]]
    has_lists: bool = False


def _ply_elements(file: BinaryIO) -> tuple[str, list[_Element]]:
    """The encoding and the elements of a PLY header."""
    if file.readline(8).strip() != b"ply":
        raise PointFileError("it does not start with the line 'ply'")
    encoding, elements = "", list[_Element]()
    for at, words in _header_lines(file, "end_header"):
        match words:
            case ["format", str(name), _] if name in _PLY_FORMATS:
                encoding = name
            case ["element", str(name), *rest]:
                elements.append(_Element(name, _count(rest, at + 1), []))
            case ["property", "list", str(length), str(kind), _] if (
                elements and {length, kind} <= _PLY_TYPES.keys()
            ):
                elements[-1].has_lists = True
            case ["property", str(kind), str(name)] if elements and kind in _PLY_TYPES:
                order = _PLY_FORMATS.get(encoding) or "<"
                elements[-1].columns.append((name, order + _PLY_TYPES[kind]))
            case ["comment" | "obj_info" | "end_header", *_]:
                pass
            case _:
                raise PointFileError(
                    f"line {at + 1} of its header is {' '.join(words)[:60]!r}; valid is a line such as "
                    "'format ascii 1.0', 'element vertex 100' or 'property float x'"
                )
    if not encoding:
        raise PointFileError(f"its header states no format; valid is one of {', '.join(_PLY_FORMATS)}")
    return encoding, elements


def check_ply(path: Path) -> None:
    """Refuse a PLY file whose header cannot be read.

    Raises
    ------
    PointFileError
        With the line that is wrong.
    """
    with path.open("rb") as file:
        _ply_elements(file)


def _read_ply(path: Path) -> Floats:
    with path.open("rb") as file:
        encoding, elements = _ply_elements(file)
        binary = encoding != "ascii"
        skipped = 0
        for element in elements:
            if element.name == "vertex":
                if element.has_lists:
                    raise PointFileError("its points have lists; valid are single numbers")
                return _Table(element.columns, element.count, binary, skipped).read(file)
            if element.has_lists and binary:
                raise PointFileError(f"lists ({element.name}) come before its points; valid are points first")
            size = sum(np.dtype(kind).itemsize for _, kind in element.columns) if binary else 1
            skipped += element.count * size
    names = ", ".join(element.name for element in elements)
    raise PointFileError(f"it has no points: its elements are {names or 'none'}; valid is 'vertex'")


def _read_pcd(path: Path) -> Floats:
    with path.open("rb") as file:
        header = {words[0].upper(): (at, words[1:]) for at, words in _header_lines(file, "DATA")}
        absent = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS") if key not in header]
        if absent:
            raise PointFileError(f"its header has no line {' or '.join(absent)}")
        names, sizes, types = (header[key][1] for key in ("FIELDS", "SIZE", "TYPE"))
        counts = header.get("COUNT", (0, ["1"] * len(names)))[1]
        if not len(names) == len(sizes) == len(types) == len(counts):
            raise PointFileError("FIELDS, SIZE, TYPE and COUNT of its header differ in length")
        columns = []
        for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
            if (kind, size) not in _PCD_TYPES or not re.fullmatch("[1-9][0-9]{0,3}", count):
                raise PointFileError(
                    f"its field {name} has type {kind}, size {size} and count {count}; valid is F 4 1"
                )
            columns += [(name, _PCD_TYPES[kind, size])] * int(count)
        encoding = " ".join(header["DATA"][1])
        if encoding not in ("ascii", "binary"):
            raise PointFileError(
                f"its data are {encoding or 'nothing'!r}; valid are 'ascii' and 'binary': "
                "`pcl_convert_pcd_ascii_binary IN.pcd OUT.pcd 1` writes it so"
            )
        at, words = header["POINTS"]
        points = _Table(columns, _count(words, at), encoding == "binary").read(file)
    return points[~np.isnan(points).any(axis=1)]


_PCD_TYPES = {
    **{("F", "4"): "<f4", ("F", "8"): "<f8"},
    **{(kind, size): f"<{kind.lower()}{size}" for kind in "IU" for size in "1248"},
}
