"""Domain randomization: random variations of a simulated scene, stated in plain data.

A distribution looks like a scene, with a table in place of every number that varies. The same seed gives the
same scene on every machine: each setting draws from a stream of its own, keyed by the seed and its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error, RandomStream, SceneError, Simulator, parse_toml, se3_exp

__all__ = ["Distribution", "DistributionError", "Draw", "randomized"]

#: Largest seed: settings are 64-bit integers with a sign.
_MAX_SEED = 2**63 - 1
#: Seeds of scenes are exact in any format, JSON included.
_SCENE_SEEDS = 2**53
#: Normal numbers beyond a limit are drawn again. A range of probability 0.01 is missed as often with a
#: chance of 4e-5.
_MAX_TRIES = 1000
#: An unlimited normal distribution is checked this far from its mean, in standard deviations.
_CHECKED_SIGMAS = 4.0
_PRESS = ("position_mm", "rotation_rad", "depth_mm", "force_n", "shear_mm", "twist_rad")


class DistributionError(SceneError):
    """A distribution is not valid, or draws a scene that is not."""


class _Numbers(Protocol):
    """Random numbers, as of `RandomStream`."""

    def uniform(self) -> float: ...
    def log_uniform(self, low: float, high: float) -> float: ...
    def normal(self) -> float: ...
    def below(self, count: int) -> int: ...


class _End:
    """The lowest or the highest numbers in place of random ones."""

    def __init__(self, high: bool) -> None:
        self._high = high

    def uniform(self) -> float:
        return math.nextafter(1.0, 0.0) if self._high else 0.0

    def log_uniform(self, low: float, high: float) -> float:
        return high if self._high else low

    def normal(self) -> float:
        return _CHECKED_SIGMAS if self._high else -_CHECKED_SIGMAS

    def below(self, count: int) -> int:
        return count - 1 if self._high else 0


@dataclass(frozen=True)
class Draw:
    """One draw of a distribution.

    Attributes
    ----------
    settings : dict
        Changes for `Scene.replace`, nested.
    press : dict or None
        The drawn table ``press``.
    """

    settings: dict[str, Any]
    press: dict[str, Any] | None


class Distribution:
    """A distribution over scenes.

    Parameters
    ----------
    settings : mapping
        Settings of a scene, nested or with dotted names. A setting is a constant, or one of these tables:

        - ``{"uniform": [low, high]}``
        - ``{"log_uniform": [low, high]}``: the logarithm is uniform
        - ``{"normal": [mean, standard_deviation]}``, with ``min`` and ``max`` if it is cut off there
        - ``{"integers": [low, high]}``: both ends included
        - ``{"choice": [...]}``, with ``weights`` if some are likelier. A choice may be anything, a table of
          settings with further distributions included.

        Elements of a list may vary, too. ``seed`` of the scene is drawn unless it is stated.

        The table ``press`` adds a contact, which becomes the scene's trajectory of one frame: ``depth_mm`` or
        ``force_n`` (with an elastic layer), and ``position_mm`` (x and y of the part's origin; the gel's
        centre if left out), ``rotation_rad`` (rotation vector), ``shear_mm`` and ``twist_rad``.

    Raises
    ------
    DistributionError
        If a table is not one of these.

    Examples
    --------
    >>> distribution = Distribution({
    ...     "effects.sensor_noise.sigma_levels": {"log_uniform": [0.5, 4.0]},
    ...     "gel": {"thickness_mm": {"normal": [5.0, 0.2], "min": 4.0}},
    ...     "press": {"depth_mm": {"uniform": [0.3, 1.5]}},
    ... })
    >>> draw = distribution.draw(7)
    >>> draw == distribution.draw(7), 0.3 <= draw.press["depth_mm"] <= 1.5
    (True, True)
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        tree = _nested(settings)
        _check(tree, "")
        if "press" in tree:
            _check_press(tree["press"])
        self._tree = tree

    @classmethod
    def from_toml(cls, text: str) -> Distribution:
        """A distribution from TOML text."""
        try:
            return cls(parse_toml(text))
        except DistributionError:
            raise
        except Error as error:
            raise DistributionError(f"a distribution is no TOML: {error}") from error

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Distribution:
        """A distribution from a TOML file."""
        text = Path(path).read_text(encoding="utf-8")
        try:
            return cls.from_toml(text)
        except DistributionError as error:
            raise DistributionError(f"{path}: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """Its plain data, nested."""
        return _copied(self._tree)  # type: ignore[no-any-return]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Distribution) and self._tree == other._tree

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Distribution({self._tree!r})"

    def draw(self, seed: int) -> Draw:
        """Draw one scene's changes; `seed` is 0 to 2^63 - 1."""
        if not (isinstance(seed, (int, np.integer)) and 0 <= seed <= _MAX_SEED):
            raise DistributionError(f"the seed is {seed!r}; valid is a whole number from 0 to 2^63 - 1")
        return self._drawn(lambda name: RandomStream(int(seed), f"randomize {name}"))

    def check(self, simulator: Simulator) -> None:
        """Build the scenes of all lowest and of all highest values, so that a long run does not fail late.

        Unlimited normal distributions are checked at four standard deviations.

        Raises
        ------
        DistributionError
            If one of them is not valid.
        """
        for name, end in (("lowest", _End(False)), ("highest", _End(True))):
            _simulated(simulator, self._drawn(lambda _, end=end: end), f"the {name} values give")  # type: ignore[misc]

    def _drawn(self, stream: Callable[[str], _Numbers]) -> Draw:
        drawn = _draw(self._tree, "", stream)
        drawn.setdefault("seed", stream("seed").below(_SCENE_SEEDS))
        return Draw(drawn, drawn.pop("press", None))


def randomized(
    simulator: Simulator, distribution: Distribution | Mapping[str, Any] | str | PathLike[str], seed: int
) -> Simulator:
    """A simulator of a random variation of another one's scene; `Simulator.randomize` calls it.

    Raises
    ------
    DistributionError
        If the distribution is not valid, or draws a scene that is not.
    """
    if isinstance(distribution, (str, PathLike)):
        distribution = Distribution.load(distribution)
    elif not isinstance(distribution, Distribution):
        distribution = Distribution(distribution)
    return _simulated(simulator, distribution.draw(seed), f"seed {seed} draws")


def _simulated(simulator: Simulator, draw: Draw, who: str) -> Simulator:
    try:
        drawn = simulator.replace(draw.settings)
        return drawn if draw.press is None else _pressed(drawn, draw.press)
    except Error as error:
        raise DistributionError(f"{who} a scene that is not valid: {error}") from error


def _pressed(simulator: Simulator, press: Mapping[str, Any]) -> Simulator:
    """The simulator with a trajectory of one frame, a press."""
    gel = simulator.scene.to_dict()["gel"]
    rotation_rad = press.get("rotation_rad", [0.0, 0.0, 0.0])
    pose: npt.NDArray[np.float64] = np.array(se3_exp([*rotation_rad, 0.0, 0.0, 0.0]))
    pose[:3, 3] = [*press.get("position_mm", gel["centre_mm"]), gel["surface_mm"]]
    if "force_n" in press:
        pose = simulator.pressed_with(pose, press["force_n"])
    else:
        pose = simulator.pressed(pose, press["depth_mm"])
    keyframe = {"time_s": 0.0, "position_mm": pose[:3, 3].tolist(), "rotation_rad": rotation_rad}
    keyframe |= {name: press[name] for name in ("shear_mm", "twist_rad") if name in press}
    return simulator.replace(trajectory=[keyframe])


# Trees of settings


def _nested(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings with dotted names taken apart."""
    if not isinstance(settings, Mapping):
        raise DistributionError(
            f"a distribution is of type {type(settings).__name__}; valid is a mapping of settings"
        )
    tree: dict[str, Any] = {}
    for name, value in settings.items():
        if not isinstance(name, str):
            raise DistributionError(f"a setting is named {name!r}; valid is text")
        *above, last = name.split(".")
        branch = tree
        for part in above:
            branch = branch.setdefault(part, {})
            if not isinstance(branch, dict):
                raise DistributionError(f"{name} is stated twice: {part} has a value of its own")
        value = _nested(value) if isinstance(value, Mapping) else _copied(value)
        if isinstance(branch.get(last), dict) and isinstance(value, dict):
            _merge(branch[last], value, name)
        elif last in branch:
            raise DistributionError(f"{name} is stated twice; state it once")
        else:
            branch[last] = value
    return tree


def _merge(branch: dict[str, Any], more: dict[str, Any], name: str) -> None:
    for key, value in more.items():
        if isinstance(branch.get(key), dict) and isinstance(value, dict):
            _merge(branch[key], value, f"{name}.{key}")
        elif key in branch:
            raise DistributionError(f"{name}.{key} is stated twice; state it once")
        else:
            branch[key] = value


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return _nested(value)
    if isinstance(value, (list, tuple)):
        return [_copied(item) for item in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _children(value: Any) -> Iterable[tuple[str, Any]]:
    if isinstance(value, dict):
        return value.items()
    if isinstance(value, list):
        return ((str(at), item) for at, item in enumerate(value))
    return ()


def _below(name: str, key: str) -> str:
    return f"{name}.{key}" if name else key


def _draw(value: Any, name: str, stream: Callable[[str], _Numbers]) -> Any:
    kind = _kind(value)
    if kind == "choice":
        at = _chosen(value, stream(name))
        return _draw(value["choice"][at], f"{name}.choice.{at}", stream)
    if kind is not None:
        return _KINDS[kind].draw(value, stream(name))
    if isinstance(value, dict):
        return {key: _draw(item, _below(name, key), stream) for key, item in value.items()}
    if isinstance(value, list):
        return [_draw(item, _below(name, str(at)), stream) for at, item in enumerate(value)]
    return value


# Kinds of distributions


@dataclass(frozen=True)
class _Kind:
    """A kind of distribution: the further keys of its table, its check and its draw."""

    more: tuple[str, ...]
    valid: str
    is_valid: Callable[[dict[str, Any]], bool]
    draw: Callable[[dict[str, Any], _Numbers], Any]


def _kind(value: Any) -> str | None:
    """The kind of a table that is a distribution."""
    return next((key for key in _KINDS if key in value), None) if isinstance(value, dict) else None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _pair(value: Any) -> tuple[float, float] | None:
    if isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)):
        return value[0], value[1]
    return None


def _is_range(value: Any, above: float = -math.inf) -> bool:
    pair = _pair(value)
    return pair is not None and above < pair[0] <= pair[1]


def _uniform(table: dict[str, Any], numbers: _Numbers) -> float:
    low, high = table["uniform"]
    # The rounding of the sum may pass the end.
    return min(float(low + (high - low) * numbers.uniform()), float(high))


def _normal(table: dict[str, Any], numbers: _Numbers) -> float:
    mean, sigma = table["normal"]
    low, high = table.get("min", -math.inf), table.get("max", math.inf)
    if isinstance(numbers, _End):
        return float(min(max(mean + sigma * numbers.normal(), low), high))
    for _ in range(_MAX_TRIES):
        value = mean + sigma * numbers.normal()
        if low <= value <= high:
            return float(value)
    raise DistributionError(
        f"{_MAX_TRIES} numbers of the normal distribution {table['normal']} were outside min {low} and max "
        f"{high}; valid are limits that a hundredth of the numbers keep"
    )


def _normal_is_valid(table: dict[str, Any]) -> bool:
    pair = _pair(table["normal"])
    limits = [table.get("min", -math.inf), table.get("max", math.inf)]
    numbers = all(_is_number(table[key]) for key in ("min", "max") if key in table)
    return pair is not None and pair[1] >= 0 and numbers and limits[0] <= limits[1]


def _integers(table: dict[str, Any], numbers: _Numbers) -> int:
    low, high = table["integers"]
    return int(low) + numbers.below(high - low + 1)


def _integers_are_valid(table: dict[str, Any]) -> bool:
    found = table["integers"]
    return _is_range(found) and all(isinstance(x, int) for x in found) and found[1] - found[0] < _SCENE_SEEDS


def _chosen(table: dict[str, Any], numbers: _Numbers) -> int:
    if "weights" not in table:
        return numbers.below(len(table["choice"]))
    weights = table["weights"]
    left = numbers.uniform() * sum(weights)
    likely = [at for at, weight in enumerate(weights) if weight > 0]
    for at in likely:
        left -= weights[at]
        if left < 0:
            return at
    return likely[-1]


def _choice_is_valid(table: dict[str, Any]) -> bool:
    choices, weights = table["choice"], table.get("weights", [1.0])
    if not (isinstance(choices, list) and choices and isinstance(weights, list)):
        return False
    positive = all(_is_number(weight) and weight >= 0 for weight in weights) and sum(weights) > 0
    return positive and ("weights" not in table or len(weights) == len(choices))


_KINDS: dict[str, _Kind] = {
    "uniform": _Kind((), "[low, high]", lambda table: _is_range(table["uniform"]), _uniform),
    "log_uniform": _Kind(
        (),
        "[low, high], both above 0",
        lambda table: _is_range(table["log_uniform"], above=0.0),
        lambda table, numbers: numbers.log_uniform(*map(float, table["log_uniform"])),
    ),
    "normal": _Kind(
        ("min", "max"),
        "[mean, standard deviation], with min below max",
        _normal_is_valid,
        _normal,
    ),
    "integers": _Kind((), "[low, high], two whole numbers", _integers_are_valid, _integers),
    "choice": _Kind(
        ("weights",),
        "a list of at least one, with as many weights from 0 up",
        _choice_is_valid,
        lambda table, numbers: table["choice"][_chosen(table, numbers)],
    ),
}


def _check(value: Any, name: str) -> None:
    """Check all distributions of a tree."""
    kind = _kind(value)
    if kind is not None:
        rule = _KINDS[kind]
        unknown = sorted(set(value) - {kind, *rule.more})
        if unknown:
            also = f", and {' and '.join(rule.more)}" if rule.more else ""
            raise DistributionError(
                f"{name} has {unknown[0]!r} beside {kind!r}; valid is {kind!r} alone{also}"
            )
        if not rule.is_valid(value):
            raise DistributionError(f"{name} is {value!r}; valid for {kind!r} is {rule.valid}")
    for key, item in _children(value):
        _check(item, _below(name, key))


def _check_press(press: Any) -> None:
    if not isinstance(press, dict) or _kind(press) is not None:
        raise DistributionError(f"press is {press!r}; valid is a table of {', '.join(_PRESS)}")
    unknown = sorted(set(press) - set(_PRESS))
    if unknown:
        raise DistributionError(f"press has {unknown[0]!r}; valid is {', '.join(_PRESS)}")
    if ("depth_mm" in press) == ("force_n" in press):
        raise DistributionError("press needs either depth_mm or force_n; state one of them")
    counts = {"position_mm": 2, "shear_mm": 2, "rotation_rad": 3}
    for name, found in press.items():
        numbers = found if isinstance(found, list) else [found]
        # A choice may be a whole list.
        if _kind(found) != "choice" and (isinstance(found, list), len(numbers)) != (
            name in counts,
            counts.get(name, 1),
        ):
            valid = f"a list of {counts[name]}" if name in counts else "one"
            raise DistributionError(f"press.{name} is {found!r}; valid is {valid}")
        for number in numbers:
            if _kind(number) is None and not _is_number(number):
                raise DistributionError(f"press.{name} has {number!r}; valid is a number or a distribution")
