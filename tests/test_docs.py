"""The pages: lines of at most 100 characters, links that lead somewhere, and one script in two places."""

import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("experiments/*.md")])


def prose(page: pathlib.Path) -> list[str]:
    """The lines of a page without its code."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return [line for line in text.splitlines() if not line.startswith("    ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_lines_are_wrapped(page: pathlib.Path) -> None:
    """Tables and code cannot be wrapped."""
    assert not [line for line in prose(page) if len(line) > 100 and not line.startswith("|")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: pathlib.Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)", "\n".join(prose(page)))
    assert not [link for link in links if not (page.parent / link).exists()]


def test_files_that_the_architecture_names_are_there() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    names = re.findall(r"`([a-z_]+/[a-z_/]*(?:\.[a-z]+)?)`", page)
    assert len(names) > 20
    assert not [name for name in names if not ((ROOT / name).exists() or (ROOT / "agile_jax" / name).exists())]


def test_the_readme_has_the_script_of_the_python_page() -> None:
    """That script is run by tests/test_python.py."""
    scripts = [
        re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
        for page in (ROOT / "README.md", ROOT / "docs/python.md")
    ]
    assert scripts[0][0] == scripts[1][0]
