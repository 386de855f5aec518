"""What the site adds to the pages: the kind of each page, and the files of the repository that
pages link to.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.nav import Section
from mkdocs.structure.pages import Page

REPOSITORY = Path(__file__).parents[2]

#: The first level of the navigation, and what to expect of its pages.
KINDS = {
    "Tutorials": "Tutorial: a lesson to follow from top to bottom; every example runs as a test.",
    "How-to": "How-to: steps and settings for one job.",
    "Concepts": "Concept: the ideas and words behind the rest.",
    "Reference": "Reference: everything there is, to look up.",
    "Evidence": "Evidence: what was measured or tested, on which data, by which command.",
    "Help": "Help: what to do when something is wrong, and how to take part.",
}

#: Pages of the site that stand outside docs/.
OUTSIDE = {
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(?=[)#])")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages outside docs/, and copies of the other files of the repository that pages link to."""
    for source, page in OUTSIDE.items():
        content = (REPOSITORY / source).read_text(encoding="utf-8")
        files.append(
            File.generated(config, page, content=LINK.sub(lambda link: _from_docs(link[1]), content))
        )
    for page in list(files.documentation_pages()):
        for target in LINK.findall(page.content_string):
            path = _outside(page.src_uri, target)
            if path is None or path in OUTSIDE or not (REPOSITORY / path).is_file():
                continue
            uri = f"repository/{path}"
            if files.get_file_from_path(uri) is None:
                files.append(File.generated(config, uri, abs_src_path=str(REPOSITORY / path)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """State the kind of the page below its title, and lead links to the repository to the site's copies."""
    here = posixpath.dirname(page.file.src_uri)

    def inside(link: re.Match[str]) -> str:
        path = _outside(page.file.src_uri, link[1])
        if path is None:
            return link[1]
        return posixpath.relpath(OUTSIDE.get(path, f"repository/{path}"), here or ".")

    markdown = LINK.sub(inside, markdown)
    kind = KINDS.get(_first_level(page), "")
    return re.sub(r"(?m)\A(# .*)$", rf"\1\n\n{kind}\n{{ .kind }}\n", markdown, count=1) if kind else markdown


def _first_level(page: Page) -> str:
    titles = [ancestor.title for ancestor in page.ancestors if isinstance(ancestor, Section)]
    return titles[-1] if titles else ""


def _from_docs(target: str) -> str:
    """The link of a file of the repository's root, as a page in docs/ has it."""
    if "://" in target:
        return target
    return target.removeprefix("docs/") if target.startswith("docs/") else f"../{target}"


def _outside(page: str, target: str) -> str | None:
    """The path in the repository of a link that leaves docs/, or None."""
    if "://" in target:
        return None
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return None if path.startswith("docs/") else path
