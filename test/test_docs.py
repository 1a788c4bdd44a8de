"""Reference pages equal the code they are made from, and links in the docs lead somewhere."""

import importlib.util
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def generator():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["topics.md", "parameters.md", "vehicles.md"])
def test_page_is_what_the_code_says(name):
    page = generator().PAGES[name]()
    assert (ROOT / "docs" / name).read_text() == page, "stale: run python docs/generate.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text())
    missing = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert not missing


def test_readme_names_every_topic():
    readme = (ROOT / "README.md").read_text()
    missing = [
        t.name for t in generator().TOPICS if t.name not in readme and "estimate/" not in t.name
    ]
    assert not missing
