"""Self-contained pages: escaped HTML with embedded pictures, readable offline."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias
from urllib.parse import quote

__all__ = ["Beside", "Block", "Details", "Figure", "Grid", "Heading", "Paragraph", "document"]

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #242c38; background: #fff; max-width: 76rem;
  margin: 2rem auto; padding: 0 1.5rem; }
h1 { font-size: 1.7rem; margin-bottom: .3rem; }
h2 { font-size: 1.25rem; margin-top: 2.4rem; border-bottom: 1px solid #d9dde2; }
h3 { font-size: 1.05rem; margin-top: 1.6rem; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; font-size: .9rem; }
caption { text-align: left; padding-bottom: .3rem; color: #56606e; }
th, td { padding: .2rem .7rem; border-bottom: 1px solid #e6e9ec; text-align: right; vertical-align: top; }
th { background: #f4f6f8; }
th:first-child, td:first-child { text-align: left; }
td.text { text-align: left; overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
figure { margin: 1rem 0; }
figure img { max-width: 100%; }
figcaption { color: #56606e; font-size: .9rem; }
pre { background: #f4f6f8; padding: .7rem; overflow-x: auto; font-size: .8rem; }
details { margin: .4rem 0; }
summary { cursor: pointer; }
"""

_MEDIA = {"png": "image/png", "jpeg": "image/jpeg", "svg": "image/svg+xml"}


@dataclass(frozen=True)
class Heading:
    """A heading; level 2 for a section, 3 for a subsection."""

    text: str
    level: Literal[2, 3] = 2


@dataclass(frozen=True)
class Paragraph:
    """Plain text."""

    text: str


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes
    ----------
    caption
        Description of the table, with units.
    head, rows
        Cells as text; every row has as many as the head.
    words
        Whether the cells are words rather than figures, and aligned to the left.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: bool = False


@dataclass(frozen=True)
class Figure:
    """A picture: the file's bytes, its type, and a description."""

    caption: str
    content: bytes
    kind: Literal["png", "jpeg", "svg"]
    #: Width in pixels. Default: the picture's own width.
    width_px: int | None = None


@dataclass(frozen=True)
class Beside:
    """A picture in a file beside the page, and its description."""

    caption: str
    file: str


@dataclass(frozen=True)
class Details:
    """A collapsed text for reference."""

    title: str
    text: str


Block: TypeAlias = Heading | Paragraph | Grid | Figure | Beside | Details


def document(title: str, blocks: Sequence[Block]) -> str:
    """Write a page.

    Parameters
    ----------
    title
        Title and first heading.
    blocks
        Contents from top to bottom. All text is escaped.

    Returns
    -------
    str
        HTML without external references except `Beside`.
    """
    name = html.escape(title)
    body = "\n".join(_block(block) for block in blocks)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<h1>{name}</h1>\n{body}\n</body>\n</html>\n"
    )


def _block(block: Block) -> str:
    if isinstance(block, Heading):
        return f"<h{block.level}>{html.escape(block.text)}</h{block.level}>"
    if isinstance(block, Paragraph):
        return f"<p>{html.escape(block.text)}</p>"
    if isinstance(block, Grid):
        return _grid(block)
    if isinstance(block, Figure):
        return _figure(block)
    if isinstance(block, Beside):
        return _picture(html.escape(quote(block.file)), "", html.escape(block.caption))
    summary = f"<summary>{html.escape(block.title)}</summary>"
    return f"<details>{summary}<pre>{html.escape(block.text)}</pre></details>"


def _grid(grid: Grid) -> str:
    kind = ' class="text"' if grid.words else ""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in grid.head)
    rows = [
        "<tr>" + "".join(f"<td{kind}>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in grid.rows
    ]
    return (
        f'<div class="wide"><table><caption>{html.escape(grid.caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>"
    )


def _figure(figure: Figure) -> str:
    # As an image, not inline, so that identifiers of several drawings cannot collide.
    data = base64.b64encode(figure.content).decode("ascii")
    width = f' width="{figure.width_px}"' if figure.width_px else ""
    return _picture(f"data:{_MEDIA[figure.kind]};base64,{data}", width, html.escape(figure.caption))


def _picture(source: str, width: str, caption: str) -> str:
    return f'<figure><img src="{source}"{width} alt="{caption}">\n<figcaption>{caption}</figcaption></figure>'
