"""Hooks of MkDocs (mkdocs.yml): first page, page of the API, and links that lead out of docs/."""

from __future__ import annotations

from pathlib import Path
import posixpath
import re
from typing import Any

from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import evpinn_ros

API = "reference/api.md"
BLOCK = """\
::: evpinn_ros.api.{name}
    options:
      heading: ev.{name}
      toc_label: {name}
"""
LINK = re.compile(r"(!?)\[([^]]*)\]\(([^):#\s]+)(#[^)\s]*)?\)")


# Pages that are elsewhere on the site than in the repository, by their place below docs/.
MOVED = {"README.md": "documents.md", "../README.md": "index.md"}


def on_files(files: Files, config: Any) -> Files:
    """Begin with the README of the repository; the page of the API has whole docstrings."""
    names = [name for name in evpinn_ros.__all__ if not name.startswith("_")]
    blocks = "\n".join(BLOCK.format(name=name) for name in names)
    text = f"# Python API\n\n[In use](../guides/python.md): `import evpinn_ros as ev`.\n\n{blocks}"
    files.remove(files.src_uris[API])
    files.append(File.generated(config, API, content=text))
    for source, name in MOVED.items():
        content = Path(config.docs_dir, source).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=content))
    files.remove(files.src_uris["README.md"])
    return files


def on_page_markdown(markdown: str, page: Page, config: Any, files: Files) -> str:
    """Have links lead to pages of the site; of a link to anything else keep the text."""
    here = page.file.src_uri
    source = {moved: source for source, moved in MOVED.items()}.get(here, here)

    def kept(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(source), link[3]))
        target = posixpath.relpath(target, "docs")
        target = MOVED.get(target, target)
        if not files.get_file_from_path(target):
            return link[2]
        place = posixpath.relpath(target, posixpath.dirname(here) or ".")
        return f"{link[1]}[{link[2]}]({place}{link[4] or ''})"

    return LINK.sub(kept, markdown)
