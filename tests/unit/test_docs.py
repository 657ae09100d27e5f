"""The reference pages are what the code says, and links in the docs lead somewhere."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from docs import generate

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("name", sorted(generate.PAGES))
def test_a_reference_page_is_what_the_code_says(name: str) -> None:
    if name == "commands.md" and sys.version_info[:2] != (3, 11):
        pytest.skip("argparse words its help differently in each Python")
    written = (generate.FOLDER / name).read_text(encoding="utf-8")
    assert generate.PAGES[name]() == written, "run python -m docs.generate"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if not (page.parent / link).exists()]
    assert missing == []


@pytest.mark.parametrize("package", ["vision", "bench"])
def test_the_design_names_every_file(package: str) -> None:
    design = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    shelf = design[design.index(f"### {package}/") :].split("\n### ")[0]
    built = "\n".join(line for line in shelf.splitlines() if "*(planned)*" not in line)
    names = set(re.findall(r"`([a-z_]+\.py)`", built))
    files = {path.name for path in (ROOT / package).glob("*.py")} - {"__init__.py"}
    assert names == files, f"not named: {sorted(files - names)}; not there: {sorted(names - files)}"
