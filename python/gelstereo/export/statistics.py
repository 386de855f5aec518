"""Statistics of a dataset's features, under LeRobot's names."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
_QUANTILE_NAMES = ("q01", "q10", "q50", "q90", "q99")

Statistics = dict[str, npt.NDArray[np.float64]]


def statistics(values: npt.NDArray[np.generic]) -> Statistics:
    """Statistics of each column, (K,), of values (T, ..., K); ``count`` is T.

    Quantiles are exact; LeRobot estimates them from a histogram.
    """
    columns = np.asarray(values, dtype=np.float64).reshape(-1, values.shape[-1] if values.ndim > 1 else 1)
    quantiles = np.quantile(columns, _QUANTILES, axis=0)
    return {
        "min": columns.min(axis=0),
        "max": columns.max(axis=0),
        "mean": columns.mean(axis=0),
        "std": columns.std(axis=0),
        "count": np.array([len(values)], dtype=np.float64),
        **dict(zip(_QUANTILE_NAMES, quantiles, strict=True)),
    }


def image_statistics(levels: npt.NDArray[np.generic], count: int) -> Statistics:
    """Statistics of grey images as three equal colours from 0 to 1, (3, 1, 1), from sampled levels (0 to
    255).
    """
    grey = statistics(np.asarray(levels, dtype=np.float64).reshape(-1) / 255.0)
    out = {name: np.broadcast_to(value.reshape(1, 1, 1), (3, 1, 1)) for name, value in grey.items()}
    return {**out, "count": np.array([count], dtype=np.float64)}


def pooled(parts: list[Statistics]) -> Statistics:
    """Pooled statistics of several episodes. Quantiles are averaged by count, as in LeRobot."""
    counts = np.array([part["count"][0] for part in parts])

    def mean(values: list[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
        return np.tensordot(counts / counts.sum(), np.stack(values), axes=1)

    centre = mean([part["mean"] for part in parts])
    squares = mean([part["std"] ** 2 + (part["mean"] - centre) ** 2 for part in parts])
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": centre,
        "std": np.sqrt(squares),
        "count": np.array([counts.sum()]),
        **{name: mean([part[name] for part in parts]) for name in _QUANTILE_NAMES},
    }
