"""Cost model of registration: instructions over the faces of the part and the markers."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Params
from gelstereo.extras import needs
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, STARTS, Grasp, grasps
from gelstereo_bench.frontier.table import Report, Table
from gelstereo_bench.frontier.timing import InstructionCounter

with needs(__name__):
    import trimesh
    from scipy.optimize import nnls

__all__ = [
    "RegistrationSample",
    "fit_registration",
    "measure_registration_costs",
    "registration_line",
    "registration_table",
]

Array = npt.NDArray[np.float64]

#: Settings by name. Budgets bound the work of a search; `surface_close` needs none of it.
METHODS: Mapping[str, Mapping[str, object]] = {
    "surface_close": {"register.method": "surface_close"},
    **{
        f"surface_search, budget {budget}": {
            "register.method": "surface_search",
            "register.surface_search.budget": budget,
        }
        for budget in (120_000, 370_000)
    },
}
#: Each splits every face into four.
SPLITS = (0, 1, 2)
#: Shares of the markers that are kept.
SHARES = (1.0, 0.5, 0.25)
CONTACTS = 3
#: What instructions grow with.
COLUMNS = ("base", "per salient marker", "per marker", "per salient marker and log2(faces)")


@dataclass(frozen=True)
class RegistrationSample:
    """Instructions of a method on contacts of one part: medians."""

    method: str
    part: str
    faces: int
    salient: float
    markers: float
    instructions: float

    @property
    def row(self) -> Array:
        """Multiple of each coefficient."""
        return np.array([1.0, self.salient, self.markers, self.salient * np.log2(self.faces)])


def thinned(grasp: Grasp, share: float, seed: int) -> tuple[Array, Array]:
    """Salient markers and others of a contact, of which a random share is kept."""
    random = np.random.default_rng([seed, 61])
    salient = {tuple(point) for point in grasp.points_mm}
    others = np.array([point for point in grasp.all_points_mm if tuple(point) not in salient])

    def kept(points: Array) -> Array:
        count = max(1, round(share * len(points)))
        return points[np.sort(random.permutation(len(points))[:count])]

    return kept(grasp.points_mm), kept(others)


def write_part(path: Path, mesh: trimesh.Trimesh) -> Path:
    """A part as the core's program reads it."""
    numbers = [len(mesh.vertices), *np.ravel(mesh.vertices), *np.ravel(mesh.faces)]
    path.write_text("\n".join(f"{number:.17g}" for number in numbers), encoding="utf-8")
    return path


def write_contact(path: Path, guess: Array, covariance: Array, points: tuple[Array, Array]) -> Path:
    """A contact as the core's program reads it: guess, salient markers with their covariances, others."""
    salient, others = points
    upper = covariance[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    rows = np.hstack([salient, np.tile(upper, (len(salient), 1))])
    numbers = [*np.ravel(guess), len(salient), *np.ravel(rows), *np.ravel(others)]
    path.write_text("\n".join(f"{number:.17g}" for number in numbers), encoding="utf-8")
    return path


def measure_registration_costs(source: Path, report: Report, quick: bool = False) -> list[RegistrationSample]:
    """Count the instructions of registrations, for each method on each part, mesh and share of markers."""
    counter = InstructionCounter(source)
    out: list[RegistrationSample] = []
    for press in GRASPED[:1] if quick else GRASPED:
        contacts = list(grasps(press, NOISES[0], range(1, 1 + CONTACTS)))
        out.extend(_of_part(contacts, counter, report))
    return out


def _of_part(
    contacts: Sequence[Grasp], counter: InstructionCounter, report: Report
) -> Iterator[RegistrationSample]:
    mesh = contacts[0].mesh
    for _ in SPLITS:
        for share in SHARES:
            points = [thinned(one, share, seed) for seed, one in enumerate(contacts)]
            for method, settings in METHODS.items():
                name = contacts[0].part
                report(f"cost: {name}, {len(mesh.faces)} faces, {share:.0%} of the markers, {method}")
                counts = _counts(contacts, points, mesh, Params().replace(settings), counter)
                if counts:
                    salient = float(np.median([len(one) for one, _ in points]))
                    markers = float(np.median([len(one) + len(others) for one, others in points]))
                    middle = float(np.median(counts))
                    yield RegistrationSample(method, name, len(mesh.faces), salient, markers, middle)
        mesh = mesh.subdivide()


def _counts(
    contacts: Sequence[Grasp],
    points: Sequence[tuple[Array, Array]],
    mesh: trimesh.Trimesh,
    params: Params,
    counter: InstructionCounter,
) -> list[int]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        params.save(folder / "params.toml")
        files = [folder / "params.toml", write_part(folder / "part.txt", mesh)]
        for k, (one, of_one) in enumerate(zip(contacts, points, strict=True)):
            path = folder / f"contact{k}.txt"
            files.append(write_contact(path, one.guess(STARTS[0], k), one.covariance_mm2[0], of_one))
        return counter.count_each("localize", files)


def fit_registration(samples: Sequence[RegistrationSample]) -> Array:
    """Coefficients of `COLUMNS`, in instructions: non-negative least squares of relative errors."""
    rows = np.array([sample.row / sample.instructions for sample in samples])
    return np.asarray(nnls(rows, np.ones(len(samples)))[0])


def registration_table(samples: Sequence[RegistrationSample]) -> Table:
    """Coefficients of each method, and how far its model is off."""
    rows = []
    for method in dict.fromkeys(sample.method for sample in samples):
        of_method = [sample for sample in samples if sample.method == method]
        found = fit_registration(of_method)
        off = np.array([sample.row @ found / sample.instructions - 1.0 for sample in of_method])
        cells = [f"{1e-6 * found[0]:.2f}", *(f"{1e-3 * each:.1f}" for each in found[1:])]
        rows.append(
            [
                method,
                *cells,
                f"{1e-6 * np.median([sample.instructions for sample in of_method]):.1f}",
                f"{100.0 * np.median(np.abs(off)):.0f}",
                f"{100.0 * off.min():+.0f} to {100.0 * off.max():+.0f}",
            ]
        )
    units = ("10^6", "10^3", "10^3", "10^3")
    head = ["method", *(f"{name}, {unit}" for name, unit in zip(COLUMNS, units, strict=True))]
    return Table("cost-registration", [*head, "median, 10^6", "off, median, %", "range, %"], rows)


def registration_line(samples: Sequence[RegistrationSample]) -> str:
    """What the samples cover."""
    faces = [sample.faces for sample in samples]
    salient = [sample.salient for sample in samples]
    return (
        f"{len({sample.part for sample in samples})} parts with {min(faces)} to {max(faces)} faces, "
        f"{min(salient):.0f} to {max(salient):.0f} salient markers"
    )
