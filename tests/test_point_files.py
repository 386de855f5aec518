"""Point clouds in files: what is written is read, and a damaged file gives a message of the package's own."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import Error, Template
from gelstereo.point_files import PointFileError, read_points

POINTS = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32).astype(np.float64)
#: Words that only NumPy, trimesh or Python would say.
FOREIGN = (
    "unpack",
    "codec",
    "data type",
    "could not convert",
    "index out of",
    "variable",
    "dtype",
    "attribute",
)
BOX = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], float)


def ply(order: str, faces: bool) -> tuple[bytes, bytes]:
    """Header and data of a PLY file of a tetrahedron with normals."""
    lines = ["ply", f"format {order} 1.0", "comment of a test", "element vertex 4"]
    lines += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    if faces:
        lines += ["element face 4", "property list uchar int vertex_indices"]
    header = "\n".join([*lines, "end_header", ""]).encode()
    rows = np.hstack([BOX, np.ones((4, 3))])
    if order == "ascii":
        text = [" ".join(map(str, row)) for row in rows]
        text += [" ".join(map(str, [3, *t])) for t in triangles] if faces else []
        return header, "\n".join([*text, ""]).encode()
    byte = "<" if "little" in order else ">"
    data = rows.astype(f"{byte}f4").tobytes()
    if faces:
        data += b"".join(b"\x03" + np.array(t, f"{byte}i4").tobytes() for t in triangles)
    return header, data


def pcd(path: Path, data: str, columns: str = "x y z") -> None:
    """Write a PCD file, of a colour beside the coordinates when the columns name one."""
    width = len(columns.split())
    header = f"# .PCD v0.7\nVERSION 0.7\nFIELDS {columns}\nSIZE {'4 ' * width}\nTYPE {'F ' * width}\n"
    header += f"COUNT {'1 ' * width}\nWIDTH {len(POINTS)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
    header += f"POINTS {len(POINTS)}\nDATA {data}\n"
    rows = np.zeros((len(POINTS), width))
    for axis, name in enumerate("xyz"):
        rows[:, columns.split().index(name)] = POINTS[:, axis]
    body = (
        rows.astype("<f4").tobytes()
        if data == "binary"
        else b"\n".join(" ".join(f"{v:.17g}" for v in row).encode() for row in rows)
    )
    path.write_bytes(header.encode() + body)


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("faces", [False, True])
@pytest.mark.parametrize("blank", [" ", "\t", " \t "])
def test_ply(order: str, faces: bool, blank: str, tmp_path: Path) -> None:
    header, data = ply(order, faces)
    path = tmp_path / "box.ply"
    path.write_bytes(header.replace(b" ", blank.encode()) + data)
    assert (read_points(path) == BOX).all()


def test_ply_of_another_author(tmp_path: Path) -> None:
    trimesh.PointCloud(POINTS).export(tmp_path / "cloud.ply")
    assert np.allclose(read_points(tmp_path / "cloud.ply"), POINTS, rtol=1e-6)


@given(data=st.data())
def test_a_damaged_ply_is_refused_in_our_words(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    header, body = ply(
        data.draw(st.sampled_from(["ascii", "binary_little_endian"])), data.draw(st.booleans())
    )
    at = data.draw(st.integers(0, len(header) - 1))
    byte = data.draw(st.sampled_from([b"\t", b" ", b"\n", b"\xff", b"0", b""]))
    skip = data.draw(st.integers(0, 2))
    path = tmp_path_factory.getbasetemp() / "damaged.ply"
    path.write_bytes(header[:at] + byte + header[at + skip :] + body)
    try:
        read_points(path)
    except Error as error:
        assert not any(word in str(error) for word in FOREIGN), str(error)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            Template.from_mesh(path, units="mm", spacing_mm=1.0)
        except Error as error:
            assert "data type" not in str(error) and "unpack" not in str(error), str(error)


@pytest.mark.parametrize("data", ["ascii", "binary"])
@pytest.mark.parametrize("columns", ["x y z", "x y z rgb", "rgb z y x"])
def test_pcd(data: str, columns: str, tmp_path: Path) -> None:
    pcd(tmp_path / "cloud.pcd", data, columns)
    assert (read_points(tmp_path / "cloud.pcd") == POINTS).all()


def test_points_of_a_pcd_that_the_scanner_did_not_see_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    pcd(path, "ascii")
    lines = path.read_text().splitlines()
    lines[-3] = "nan nan nan"
    path.write_text("\n".join(lines))
    assert len(read_points(path)) == len(POINTS) - 1


def test_a_compressed_pcd_is_refused_with_the_command_that_unpacks_it(tmp_path: Path) -> None:
    pcd(tmp_path / "cloud.pcd", "binary_compressed")
    with pytest.raises(PointFileError, match="pcl_convert_pcd_ascii_binary"):
        read_points(tmp_path / "cloud.pcd")


@pytest.mark.parametrize("kind", [".csv", ".txt", ".xyz"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "  ", ", "])
@pytest.mark.parametrize(
    "header", ["", "x,y,z", "# made by a scanner", "x_mm,y_mm,z_mm", "X [mm],Y [mm],Z [mm]"]
)
def test_text(kind: str, separator: str, header: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{kind}"
    if separator in ("\t", ";"):
        header = header.replace(",", separator)
    lines = [separator.join(f"{value:.17g}" for value in point) for point in POINTS]
    path.write_text("\n".join([*filter(None, [header]), *lines, "", ""]))
    assert (read_points(path) == POINTS).all()


def test_columns_by_name(tmp_path: Path) -> None:
    path = tmp_path / "cloud.csv"
    path.write_text("time,z,y,x,quality\n" + "\n".join(f"0.5,{z},{y},{x},9" for x, y, z in POINTS.tolist()))
    assert (read_points(path) == POINTS).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2,3\n4,5\n", "line 2 is '4,5'"),
        ("1,2,3,4\n", "line 1 is '1,2,3,4'"),
        ("1,2;2,5;3,0\n", "decimal points"),
        ("1 2 3\n4 five 6\n", "line 2 is '4 five 6'"),
        ("x,y,z\n", "no lines of numbers"),
    ],
)
def test_text_that_is_no_cloud(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.txt"
    path.write_text(text)
    with pytest.raises(PointFileError, match=r"cloud\.txt") as caught:
        read_points(path)
    assert said in str(caught.value) and not any(word in str(caught.value) for word in FOREIGN)


def test_an_unknown_kind_names_those_that_are_read(tmp_path: Path) -> None:
    (tmp_path / "cloud.las").touch()
    with pytest.raises(PointFileError, match=r"ends in \.las; valid is one of .*\.pcd"):
        read_points(tmp_path / "cloud.las")
