"""One self-contained HTML file: sections, tables, pictures, and the command that made them."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
import hashlib
from html import escape
import io
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from evpinn_ros.common.fsync import replaced

BROWSER = Path(__file__).with_name("browser")  # what runs in the reader's browser
UPLOT = BROWSER / "uplot"  # version 1.6.32 from npm, with its licence


def write_page(
    path: Path, title: str, command: str, sections: Sequence[str], plots: Any = None
) -> None:
    """Write a page of sections that are HTML already.

    The page loads nothing and runs nothing but the scripts it was made with: its policy names
    their hashes, so text that came with a drive could not run even if it were not escaped.

    Args:
        path: of the new file.
        title: text.
        command: that made it, text.
        sections: HTML.
        plots: what `browser/drive.js` draws into the sections, for JSON; None without plots.
    """
    styles = [_text(BROWSER / "page.css")]
    scripts: list[str] = []
    if plots is not None:
        styles.insert(0, _text(UPLOT / "uPlot.min.css"))
        licence = _text(UPLOT / "LICENSE")
        scripts = [f"/*\n{licence}*/\n{_text(UPLOT / 'uPlot.iife.min.js')}"]
        scripts.append(_text(BROWSER / "drive.js"))
    body = "\n".join(sections)
    data = "" if plots is None else _data(plots)
    page = (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>\n"
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(scripts)}">\n'
        "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        "<meta name='color-scheme' content='light dark'>\n"
        f"<title>{escape(title)}</title>\n<style>{''.join(styles)}</style></head>\n<body>\n"
        f"<h1>{escape(title)}</h1>\n"
        f"<p class='command'>Made by <code>{escape(command)}</code></p>\n{body}\n{data}"
        + "".join(f"<script>{script}</script>\n" for script in scripts)
        + "</body></html>\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as draft:
        draft.write_bytes(page.encode("utf-8", "replace"))  # a path may hold what is no text


def embedded(figure: Figure, description: str) -> str:
    """A picture inside the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    image = base64.b64encode(buffer.getvalue()).decode()
    return f"<img alt='{escape(description)}' src='data:image/png;base64,{image}'>"


def table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table of text, which scrolls by itself where the page is narrow."""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f"<div class='wide'><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
    )


def _policy(scripts: Iterable[str]) -> str:
    """Policy for the browser: run these scripts, use styles and pictures of the page itself."""
    hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    allowed = " ".join(f"'sha256-{each}'" for each in hashes) or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _data(plots: Any) -> str:
    """JSON in an element that nothing within it can end."""
    text = json.dumps(plots, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f"<script type='application/json' id='plots'>{text}</script>\n"


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
