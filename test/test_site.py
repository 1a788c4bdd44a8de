"""The site of the documents and the public docstrings is built without a warning."""

import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

import evpinn_ros

pytestmark = pytest.mark.build

pytest.importorskip("material", reason="the extra `site` is not installed")
pytest.importorskip("mkdocstrings", reason="the extra `site` is not installed")

ROOT = Path(__file__).parents[1]


def test_it_is_built_strictly_and_has_every_public_name(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0 and "WARNING" not in ended.stderr, ended.stderr
    page = (tmp_path / "reference" / "api" / "index.html").read_text()
    anchors = set(re.findall(r'id="evpinn_ros\.api\.(\w+)"', page))
    assert anchors == set(evpinn_ros.__all__) - {"__version__"}
    first = (tmp_path / "index.html").read_text()
    assert 'src="report.png"' in first and 'href="guides/plan/"' in first
    assert {"default", "slate"} <= set(re.findall(r'data-md-color-scheme="(\w+)"', first))
    documents = (tmp_path / "documents" / "index.html").read_text()
    assert 'href="../guides/replay/"' in documents and 'href="../">README' in documents
    for page in tmp_path.rglob("*.html"):
        fetched = re.findall(
            r'<(?:script|link|img)[^>]+(?:src|href)="https?://[^"]+', page.read_text()
        )
        assert not fetched, page
