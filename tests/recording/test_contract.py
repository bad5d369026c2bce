"""Catches: a topic or event name spelled out beside the contract.

A mistyped name would read as "not recorded".
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import dgeval
import pytest
from dgeval.recording import contract

PACKAGE = Path(dgeval.__file__).parent
CONTRACT = PACKAGE / "recording" / "contract.py"
FILES = sorted(p for p in PACKAGE.rglob("*.py") if p != CONTRACT)
KINDS = get_args(contract.EventKind)
PREFIXES = (contract.DGEVAL_PREFIX, contract.TRUTH_PREFIX)


def texts(node: ast.AST) -> list[ast.Constant]:
    """String constants below a node, the parts of f-strings among them."""
    return [n for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


def docstrings(tree: ast.AST) -> set[int]:
    """The ids of constants that stand alone as a statement: docstrings of any kind."""
    return {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}


def topics_in(tree: ast.AST) -> Iterator[str]:
    """String literals that name a topic of the contract."""
    skipped = docstrings(tree)
    for text in texts(tree):
        if id(text) not in skipped and any(p in text.value for p in PREFIXES):
            yield f"line {text.lineno}: {text.value!r}"


def kinds_in(tree: ast.AST) -> Iterator[str]:
    """Event kinds as literals: compared, looked up by `event_ns`, or written as an event."""
    for node in ast.walk(tree):
        suspects: list[ast.AST] = []
        if isinstance(node, ast.Compare):
            suspects = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            suspects = list(node.args) if node.func.attr in ("event_ns", "first_ns") else []
        elif isinstance(node, ast.Dict):
            suspects = [
                v for k, v in zip(node.keys, node.values, strict=True) if k and _is_event_key(k)
            ]
        for text in (t for s in suspects for t in texts(s) if t.value in KINDS):
            yield f"line {text.lineno}: {text.value!r}"


def _is_event_key(key: ast.expr) -> bool:
    return (isinstance(key, ast.Constant) and key.value == contract.EVENT_KEY) or (
        isinstance(key, ast.Name) and key.id == "EVENT_KEY"
    )


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_topics_and_event_kinds_are_named_by_the_contract_alone(path: Path) -> None:
    """Fails where a file spells out a topic, or compares with an event kind as a literal."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert [*topics_in(tree), *kinds_in(tree)] == []


@pytest.mark.parametrize(
    "code",
    [
        'TOPIC = "/dgeval/events"',
        'path = f"/truth/{name}"',
        'closed = event.kind == "close"',
        'cut = event.kind in ("trial_start", "trial_end")',
        't_ns = trial.event_ns("close")',
        'start = {"event": "lift"}',
        'start = {EVENT_KEY: "lift"}',
    ],
)
def test_the_search_finds_what_it_is_for(code: str) -> None:
    """Fails where the search above has gone blind."""
    tree = ast.parse(code)
    assert [*topics_in(tree), *kinds_in(tree)]


def test_the_search_leaves_docstrings_and_other_words_alone() -> None:
    """Fails where the search refuses a docstring, or a column with the name of an event."""
    tree = ast.parse('"""Reads /dgeval/events."""\nrow = {"close": row["label"]}\n')
    assert [*topics_in(tree), *kinds_in(tree)] == []


def constants() -> dict[str, str]:
    return {n: v for n, v in vars(contract).items() if n.isupper() and isinstance(v, str)}


def test_every_name_stands_once() -> None:
    """Fails where two topics or two event kinds have the same name."""
    topics = [v for n, v in constants().items() if n.endswith("_TOPIC")]
    kinds = [v for n, v in constants().items() if n.endswith("_EVENT")]
    assert len(set(topics)) == len(topics)
    assert sorted(kinds) == sorted(KINDS)
    assert all(t.startswith(PREFIXES) for t in topics)


def test_every_constant_has_a_docstring() -> None:
    """Fails where a topic or key is added without its message type and meaning."""
    body = ast.parse(CONTRACT.read_text(encoding="utf-8")).body
    missing = [
        ast.unparse(node)
        for node, after in zip(body, [*body[1:], None], strict=True)
        if isinstance(node, ast.AnnAssign | ast.Assign)
        and not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant))
    ]
    assert missing == []
