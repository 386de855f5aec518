"""STEP files of a box and of a pin, written entity by entity (ISO 10303-21 and -214)."""

from __future__ import annotations

from itertools import product
from pathlib import Path

HEAD = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('a part'),'2;1');
FILE_NAME('part','2021-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
"""


class _Step:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, entity: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={entity};")
        return f"#{len(self.lines)}"

    def triple(self, kind: str, values: tuple[float, ...]) -> str:
        return self.add(f"{kind}('',({','.join(f'{float(v):.9f}' for v in values)}))")


def write_box(path: Path, sides: tuple[float, float, float], unit: str = "SI_UNIT(.MILLI.,.METRE.)") -> None:
    """Write a box from the origin to `sides`, in the unit."""
    step = _Step()
    places = list(product(*((0.0, side) for side in sides)))
    points = {p: step.triple("CARTESIAN_POINT", p) for p in places}
    vertices = {p: step.add(f"VERTEX_POINT('',{points[p]})") for p in places}
    edges: dict[tuple[tuple[float, ...], tuple[float, ...]], str] = {}
    for a in places:
        for b in places:
            along = [y - x for x, y in zip(a, b, strict=True)]
            if sum(v != 0.0 for v in along) == 1 and max(along) > 0.0:
                direction = step.triple("DIRECTION", tuple(float(v > 0.0) for v in along))
                vector = step.add(f"VECTOR('',{direction},1.)")
                line = step.add(f"LINE('',{points[a]},{vector})")
                edges[a, b] = step.add(f"EDGE_CURVE('',{vertices[a]},{vertices[b]},{line},.T.)")
    faces = []
    for axis, side in product(range(3), (0, 1)):
        u, v = [(axis + 1) % 3, (axis + 2) % 3][:: 1 if side else -1]
        ring = []
        for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner = [0.0, 0.0, 0.0]
            corner[axis], corner[u], corner[v] = side * sides[axis], i * sides[u], j * sides[v]
            ring.append(tuple(corner))
        bounds = []
        for a, b in zip(ring, [*ring[1:], ring[0]], strict=True):
            sense, key = (".T.", (a, b)) if (a, b) in edges else (".F.", (b, a))
            bounds.append(step.add(f"ORIENTED_EDGE('',*,*,{edges[key]},{sense})"))
        loop = step.add(f"EDGE_LOOP('',({','.join(bounds)}))")
        bound = step.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        unit_of = lambda k, sign=1.0: tuple(sign * float(k == n) for n in range(3))  # noqa: E731
        normal = step.triple("DIRECTION", unit_of(axis, 1.0 if side else -1.0))
        place = step.add(
            f"AXIS2_PLACEMENT_3D('',{points[ring[0]]},{normal},{step.triple('DIRECTION', unit_of(u))})"
        )
        plane = step.add(f"PLANE('',{place})")
        faces.append(step.add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    _write(path, step, faces, unit)


def write_pin(path: Path, radius: float, length: float, unit: str = "SI_UNIT(.MILLI.,.METRE.)") -> None:
    """Write a cylinder along z from the origin, in the unit; its side is one face with a seam."""
    step = _Step()
    along, across = step.triple("DIRECTION", (0.0, 0.0, 1.0)), step.triple("DIRECTION", (1.0, 0.0, 0.0))
    down = step.triple("DIRECTION", (0.0, 0.0, -1.0))
    place = lambda z, axis: step.add(  # noqa: E731
        f"AXIS2_PLACEMENT_3D('',{step.triple('CARTESIAN_POINT', (0.0, 0.0, z))},{axis},{across})"
    )
    starts = [step.triple("CARTESIAN_POINT", (radius, 0.0, z)) for z in (0.0, length)]
    low, high = (step.add(f"VERTEX_POINT('',{start})") for start in starts)
    rings = []
    for vertex, z in ((low, 0.0), (high, length)):
        circle = step.add(f"CIRCLE('',{place(z, along)},{radius:.9f})")
        rings.append(step.add(f"EDGE_CURVE('',{vertex},{vertex},{circle},.T.)"))
    vector = step.add(f"VECTOR('',{along},1.)")
    line = step.add(f"LINE('',{starts[0]},{vector})")
    seam = step.add(f"EDGE_CURVE('',{low},{high},{line},.T.)")
    side = step.add(f"CYLINDRICAL_SURFACE('',{place(0.0, along)},{radius:.9f})")
    bottom, top = (step.add(f"PLANE('',{place(*end)})") for end in ((0.0, down), (length, along)))
    faces = []
    for surface, edges in (
        (side, ((rings[0], ".T."), (seam, ".T."), (rings[1], ".F."), (seam, ".F."))),
        (bottom, ((rings[0], ".F."),)),
        (top, ((rings[1], ".T."),)),
    ):
        turned = [step.add(f"ORIENTED_EDGE('',*,*,{edge},{sense})") for edge, sense in edges]
        loop = step.add(f"EDGE_LOOP('',({','.join(turned)}))")
        bound = step.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        faces.append(step.add(f"ADVANCED_FACE('',({bound}),{surface},.T.)"))
    _write(path, step, faces, unit)


def _write(path: Path, step: _Step, faces: list[str], unit: str) -> None:
    shell = step.add(f"CLOSED_SHELL('',({','.join(faces)}))")
    body = step.add(f"MANIFOLD_SOLID_BREP('part',{shell})")
    _product(step, body, unit)
    path.write_text(HEAD + "\n".join(step.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n")


def _inch(step: _Step) -> str:
    """The unit that is no SI unit, by what it is in millimetres."""
    millimetre = step.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    is_so_long = step.add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),{millimetre})")
    exponents = step.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
    return step.add(f"(CONVERSION_BASED_UNIT('INCH',{is_so_long})LENGTH_UNIT()NAMED_UNIT({exponents}))")


def _product(step: _Step, body: str, unit: str) -> None:
    length = _inch(step) if unit == "INCH" else step.add(f"(LENGTH_UNIT()NAMED_UNIT(*){unit})")
    angle = step.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = step.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    fuzz = step.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-6),{length},'','')")
    context = step.add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({fuzz}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid_angle}))REPRESENTATION_CONTEXT('',''))"
    )
    shape = step.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({body}),{context})")
    application = step.add("APPLICATION_CONTEXT('')")
    step.add(f"APPLICATION_PROTOCOL_DEFINITION('','automotive_design',2000,{application})")
    product_context = step.add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    part = step.add(f"PRODUCT('part','part','',({product_context}))")
    formation = step.add(f"PRODUCT_DEFINITION_FORMATION('','',{part})")
    design = step.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = step.add(f"PRODUCT_DEFINITION('design','',{formation},{design})")
    of_shape = step.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    step.add(f"SHAPE_DEFINITION_REPRESENTATION({of_shape},{shape})")
