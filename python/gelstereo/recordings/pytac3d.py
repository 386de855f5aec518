"""The arrays that PyTac3D's recorder writes, one folder per sensor."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo.recordings.clouds import CloudRecording, RecordingError

__all__ = ["load_pytac3d", "pytac3d_example"]

Array = npt.NDArray[np.float64]

_SIDE = 20


def load_pytac3d(folder: str | Path) -> CloudRecording:
    """Read one sensor's folder: ``3D_Positions.npy``, ``3D_Displacements.npy``, ``sendTimestamp.npy``
    and, if it is there, ``index.npy``.

    The sensor frame of PyTac3D has z out of the gel, away from its camera, and millimetres, as gelstereo's.
    The rest frame is the median over the frames of positions minus displacements. The median is needed
    because the recorder zeroes the sensor occasionally, which moves its rest positions by some hundredths of
    a millimetre.

    Raises
    ------
    RecordingError
        A file is missing or has other contents.
    """
    folder = Path(folder)
    points_mm = _read(folder, "3D_Positions.npy")
    displacements_mm = _read(folder, "3D_Displacements.npy")
    time_s = _read(folder, "sendTimestamp.npy")
    if points_mm.shape != displacements_mm.shape or points_mm.ndim != 3 or len(points_mm) == 0:
        raise RecordingError(
            f"{folder}: positions have shape {points_mm.shape} and displacements {displacements_mm.shape}; "
            f"valid is (frames, {_SIDE * _SIDE}, 3) for both"
        )
    rest_mm = np.median(points_mm - displacements_mm, axis=0)
    numbered = (folder / "index.npy").is_file()
    sequence = _read(folder, "index.npy").astype(np.int64) if numbered else None
    return CloudRecording(folder.name, _SIDE, _SIDE, points_mm, rest_mm, time_s, sequence)


def pytac3d_example(example: str, sensor: str) -> Path:
    """Find a recording that is included in the installed wheel, without importing it.

    Raises
    ------
    RecordingError
        The wheel is not installed, or has no such recording.
    """
    spec = find_spec("PyTac3D")
    if spec is None or spec.origin is None:
        raise RecordingError(
            "the wheel pytac3d is not installed; get it with `pip install --no-deps pytac3d==3.3.0.9` (its "
            "recordings need none of its dependencies)"
        )
    root = Path(spec.origin).parent / "example_data"
    folder = root / example / sensor
    if not folder.is_dir():
        there = sorted(f"{path.parent.name}/{path.name}" for path in root.glob("*/*") if path.is_dir())
        raise RecordingError(f"no recording {example}/{sensor} in the wheel; there are {', '.join(there)}")
    return folder


def _read(folder: Path, name: str) -> Array:
    path = folder / name
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except FileNotFoundError:
        raise RecordingError(f"{folder} has no {name}; valid is a folder recorded by PyTac3D") from None
    except (ValueError, OSError) as error:
        raise RecordingError(f"{path} is not an array of numbers: {error}") from error
