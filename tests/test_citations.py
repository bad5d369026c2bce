"""Catches: citations of documents that no reader of the repository has, and topics that no page
describes.

A citation is good in one form: docs/NAME.md, or docs/NAME.md, "Heading" with a heading of that
page. A heading may be cited without its leading label: "ICP gate" for "A3 ICP gate".
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SKIPPED = ("runs", "dist", "build")  # made by commands; hidden folders are skipped too
SUFFIXES = (".py", ".md", ".toml")

ABSENT = re.compile(r"\b(?:DESIGN|SIMULATION|PAPERS|ANCHORS|DEPENDENCIES)\b(?:\.md)?")
SECTION = re.compile(r"(?P<file>\.md,? )?\b[Ss]ections? (?:\d[\w.]*|[IVX]+(?:-[A-Z])?\b)(?:\.\d+)?")
PAGE = re.compile(r"(?<![\w/.])(?:docs|benchmarks)/[\w./-]*\w\.md\b")
QUOTED = re.compile(
    r"(?P<page>(?<![\w/.])docs/[\w./-]*\w\.md)"
    r"""(?P<headings>(?:(?:,? and|,) (?:"[^"]+"|'[^']+'))+)"""
)
LABEL = re.compile(r"^[A-Z]\d+ ")


def headings_of(page: str) -> set[str]:
    """The headings of a Markdown page, with and without their labels."""
    found = re.findall(r"^#+ (.+?)\s*$", page, re.MULTILINE)
    return {*found, *(LABEL.sub("", h) for h in found)}


def dangling(text: str, pages: Mapping[str, set[str]]) -> list[str]:
    """Citations in a text of documents, sections or headings that are not there. pages: headings
    by path from the root.
    """
    text = re.sub(
        r"\s*\n\s*(?:#+ )?\s*", " ", text
    )  # a citation may run over the lines of a comment
    out = [m.group() for m in ABSENT.finditer(text)]
    out += [m.group() for m in SECTION.finditer(text) if m["file"] is None]
    out += [m.group() for m in PAGE.finditer(text) if m.group() not in pages]
    for m in QUOTED.finditer(text):
        cited = [a or b for a, b in re.findall(r""""([^"]+)"|'([^']+)'""", m["headings"])]
        out += [
            f'{m["page"]}, "{h}"' for h in cited if m["page"] in pages and h not in pages[m["page"]]
        ]
    return out


def files() -> Iterator[Path]:
    """Every file of the repository that may cite something, this one apart, whose examples are
    wrong on purpose.
    """
    for path in sorted(ROOT.rglob("*")):
        folders = path.relative_to(ROOT).parts[:-1]
        skipped = (
            any(f.startswith(".") or f in SKIPPED for f in folders)
            or path == Path(__file__).resolve()
        )
        if path.suffix in SUFFIXES and not skipped and path.is_file():
            yield path


def pages() -> dict[str, set[str]]:
    found = (p for p in files() if p.suffix == ".md")
    return {
        p.relative_to(ROOT).as_posix(): headings_of(p.read_text(encoding="utf-8")) for p in found
    }


# the finder on made-up strings

MADE_UP = {"docs/papers.md": headings_of("# Papers\n\n## A3 ICP gate\n\ntext\n\n### Truth rule \n")}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("as DESIGN says", ["DESIGN"]),
        ("(SIMULATION section 5)", ["SIMULATION", "section 5"]),
        ("SIMULATION's last table", ["SIMULATION"]),
        ("PAPERS.md", ["PAPERS.md"]),
        ("readings PAPERS A1 and A2", ["PAPERS"]),
        ("ANCHORS and DEPENDENCIES", ["ANCHORS", "DEPENDENCIES"]),
        ("(section III-B)", ["section III-B"]),
        ("SIMULATION sections 1, 2", ["SIMULATION", "sections 1"]),
        ("Section 4.2 says", ["Section 4.2"]),
        ("docs/nowhere.md", ["docs/nowhere.md"]),
        ("benchmarks/results/nowhere.md", ["benchmarks/results/nowhere.md"]),
        ('docs/papers.md, "No such"', ['docs/papers.md, "No such"']),
        ("docs/papers.md, 'No such'", ['docs/papers.md, "No such"']),
        ('docs/papers.md, "ICP gate" and "No such"', ['docs/papers.md, "No such"']),
        ('# see docs/papers.md,\n    # "No such"', ['docs/papers.md, "No such"']),
    ],
)
def test_finder_finds(text: str, found: list[str]) -> None:
    """Catches a finder that is blind to one of the forms in which code has cited absent
    documents.
    """
    assert dangling(text, MADE_UP) == found


@pytest.mark.parametrize(
    "text",
    [
        "docs/papers.md",
        'docs/papers.md, "A3 ICP gate"',
        "docs/papers.md, 'ICP gate'",
        'docs/papers.md, "ICP gate" and "Truth rule"',
        '# docs/papers.md,\n# "Truth rule"',
        "docs/papers.md, section 5",
        "the section in the middle, an intersection 4 m wide, sections of a bottle",
        "MY_DESIGN, designs, PAPERSIZE",
        "/somewhere/docs/else.md, ../docs/else.md",
        'printed "No such"',
    ],
)
def test_finder_leaves_alone(text: str) -> None:
    """Catches a finder that cries at good citations, at words that look like them, or at other
    people's paths.
    """
    assert dangling(text, MADE_UP) == []


# the repository


def test_no_citation_dangles() -> None:
    """Catches a citation of a document, section or heading that the repository does not have."""
    there = pages()
    wrong = []
    for path in files():
        text = path.read_text(encoding="utf-8")
        wrong += [f"{path.relative_to(ROOT)}: {c}" for c in dangling(text, there)]
    assert wrong == []


# topics

TOPIC = re.compile(r"/(?:dgeval|truth)(?:/[a-z_]+)+")


def documented_topics() -> set[str]:
    """First column of the table under "Topics" in docs/simulation.md."""
    page = (ROOT / "docs" / "simulation.md").read_text(encoding="utf-8")
    part = re.split(r"^# Topics\s*$", page, flags=re.MULTILINE)[1]
    part = re.split(r"^# ", part, flags=re.MULTILINE)[0]
    return set(re.findall(r"^\| `(/[^`]+)` \|", part, re.MULTILINE))


def trees() -> Iterator[tuple[Path, ast.AST]]:
    for path in sorted((ROOT / "dgeval").rglob("*.py")):
        yield path, ast.parse(path.read_text(encoding="utf-8"))


def literals(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def pieced_together(tree: ast.AST) -> list[str]:
    """Topic names made of parts, which a search for names can't see."""
    parts: list[ast.expr] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts += node.values
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Mod):
            parts += [node.left, node.right]
    values = [p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)]
    return [v for v in values if v.startswith(("/dgeval/", "/truth/"))]


def test_every_topic_is_documented() -> None:
    """Catches a topic that dgeval writes or reads by name and docs/simulation.md doesn't
    describe.
    """
    used = {value for _, tree in trees() for value in literals(tree) if TOPIC.fullmatch(value)}
    assert used - documented_topics() == set()


def test_every_documented_topic_is_used() -> None:
    """Catches a topic in the table that the code has given up or renamed."""
    used = {value for _, tree in trees() for value in literals(tree)}
    assert documented_topics() - used == set()


def test_topic_names_are_whole() -> None:
    """Catches a name put together from parts, which the two tests above would miss."""
    assert [(str(path), v) for path, tree in trees() for v in pieced_together(tree)] == []
    assert pieced_together(ast.parse('f"/dgeval/belief/{name}"')) == ["/dgeval/belief/"]
    assert pieced_together(ast.parse('"/truth/" + name')) == ["/truth/"]
    assert literals_of('"/dgeval/events"') == ["/dgeval/events"]


def literals_of(source: str) -> list[str]:
    return list(literals(ast.parse(source)))
