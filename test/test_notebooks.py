"""Notebooks run from their first cell to their last, and are committed without outputs."""

import os
from pathlib import Path
import shutil

import pytest

pytestmark = pytest.mark.nightly

nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")

ROOT = Path(__file__).parents[1]
FOLDER = Path("examples", "notebooks")
NOTEBOOKS = sorted((ROOT / FOLDER).glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, tmp_path, monkeypatch):
    for name in ("bags", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    (tmp_path / "benchmarks").symlink_to(ROOT / "benchmarks")
    installed = tmp_path / "installed"  # the package alone, as pip installs it
    installed.mkdir()
    (installed / "evpinn_ros").symlink_to(ROOT / "evpinn_ros")
    # As where Jupyter was started without activating the environment: no `evpinn` is on the PATH.
    monkeypatch.setenv("PATH", os.defpath)
    monkeypatch.setenv("PYTHONPATH", str(installed))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    book = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(tmp_path / FOLDER)}}
    nbclient.NotebookClient(book, timeout=120, resources=where).execute()
    *_, last = [cell for cell in book.cells if cell.cell_type == "code"]
    assert last.outputs and all(output.output_type != "error" for output in last.outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_committed_as_it_is_read(path):
    """No outputs, so no machine's paths; numbers of execution would change with every run."""
    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    for cell in book.cells:
        if cell.cell_type == "code":
            assert not cell.outputs and cell.execution_count is None
    assert path.stat().st_size < 20_000
