"""Writes self-contained HTML pages with a content security policy."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from functools import cache
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.writer import write_file

if TYPE_CHECKING:
    from jinja2 import Environment

BROWSER = Path(__file__).with_name("browser")  # scripts and styles of the pages
UPLOT = BROWSER / "uplot"  # version 1.6.32 from npm, with its licence
TEMPLATES = Path(__file__).with_name("templates")


def write_page(
    path: Path, template: str, *, title: str, command: str, plots: Any = None, **values: Any
) -> None:
    """Write a page from a template; its content security policy allows only its own scripts.

    `plots`, plain values for JSON, is drawn by `browser/drive.js`; None: a page without scripts.
    OSError: the file cannot be written.
    """
    styles, scripts = [_text(BROWSER / "page.css")], []
    if plots is not None:
        styles.insert(0, _text(UPLOT / "uPlot.min.css"))
        uplot = f"/*\n{_text(UPLOT / 'LICENSE')}*/\n{_text(UPLOT / 'uPlot.iife.min.js')}"
        scripts = [uplot, _text(BROWSER / "drive.js")]
    page = (
        _templates()
        .get_template(template)
        .render(
            values,
            title=title,
            command=command,
            plots=plots,
            styles=styles,
            scripts=scripts,
            policy=_policy(scripts),
        )
    )
    write_file(path, page.encode("utf-8", "replace"))  # a path may be no UTF-8


@cache
def _templates() -> Environment:
    with optional_imports():
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_in_print,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return environment


def _in_print(value: Any) -> Any:
    """Text with ± in place of +-, which is for terminals; safe markup is kept."""
    return value.replace("+- ", "± ") if type(value) is str else value


def _policy(scripts: Iterable[str]) -> str:
    """Content security policy: only these scripts, and the page's own styles and pictures."""
    hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes) or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
