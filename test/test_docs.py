"""Reference pages equal the code they are made from, and links in the docs lead somewhere."""

import importlib.util
from pathlib import Path
import re
import subprocess

import pytest

from evpinn_ros.core.vehicle.files import vehicle_names
from evpinn_ros.topics import NAMESPACE, TOPICS

pytestmark = pytest.mark.build

ROOT = Path(__file__).parents[1]
PAGES = [  # all that git tracks; of an export, which it knows nothing of, the documents
    ROOT / name
    for name in subprocess.run(
        ["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
] or [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


def script(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


GENERATOR = script("generate")


@pytest.mark.parametrize("name", GENERATOR.PAGES)
def test_page_is_what_the_code_says(name):
    page = GENERATOR.PAGES[name]()
    assert (ROOT / "docs" / name).read_text() == page, "stale: run python docs/generate.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    missing = []
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)", page.read_text()):
        if "://" in target:
            continue
        linked = page.parent / target if target else page
        if not linked.exists() or (anchor and anchor not in anchors(linked.read_text())):
            missing.append(f"{target}#{anchor}")
    assert not missing


def anchors(text: str) -> set[str]:
    """Where a link into a page may lead, by the names that forges give headings."""
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_each_promise_names_its_attack():
    """Of each row below Promises and Limits: a test, or a file of tests, that exists."""
    page = (ROOT / "docs" / "explanation" / "security.md").read_text()
    sections = re.findall(r"^## (?:Promises|Limits)$(.*?)(?=^## )", page, re.MULTILINE | re.DOTALL)
    rows = re.findall(r"^\| (?!---)(.+) \|$", "".join(sections), re.MULTILINE)
    tests = {path: path.read_text() for path in (ROOT / "test").rglob("test_*.py")}
    names = set(re.findall(r"^(?:async )?def (test_\w+)", "".join(tests.values()), re.MULTILINE))
    names |= {str(path.relative_to(ROOT)) for path in tests}
    for row in rows:
        attacks = re.findall(r"`([^`]+)`", row.rpartition(" | ")[2])
        assert row.endswith("| attack") or (attacks and names.issuperset(attacks)), row
    assert len(rows) > 50 and set(re.findall(r"`(test_\w+)`", page)) <= names


def test_the_files_of_the_core_in_one_hour_are_there():
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
    files = re.findall(r"^\| `(core/[\w/]+\.py)` \|", page, re.MULTILINE)
    assert len(files) == 7 and all((ROOT / "evpinn_ros" / name).is_file() for name in files)


@pytest.mark.parametrize("name", ["foxglove.json", "plotjuggler.xml"])
def test_the_ready_layouts_show_topics_that_exist(name):
    text = (ROOT / "config" / "views" / name).read_text()
    topics = {topic.under(NAMESPACE) for topic in TOPICS}
    shown = re.findall(r"/ev/\w+/\w+", re.sub(r"/studio_script/ev/\w+", "", text))
    assert len(set(shown)) > 9 and set(shown) <= topics
    assert not [vehicle for vehicle in vehicle_names() if vehicle in text], "they suit any car"


def test_the_scores_on_the_pages_are_those_of_the_file() -> None:
    """One home of what was measured: the page has its table, the README the same numbers."""
    picture = script("benchmarks_picture")
    page = (ROOT / "docs" / "project" / "benchmarks.md").read_text()
    lines = picture.table().splitlines()
    assert len(lines) > 4 and all(line in page for line in lines[2:])
    readme = (ROOT / "README.md").read_text()
    for car in picture.cars():
        numbers = (
            car[name]
            for name in ("drives", picture.OURS, "vehicle file alone", "energy per km so far")
        )
        shown = " | ".join(map(str, numbers)) + f" | {car[picture.HOLDS]} % |"
        assert shown in readme, car
