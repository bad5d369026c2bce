"""The demo recording's messages, and what a reader must find in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from tests.recording.recorders import STORE, Message, contents, opened


@pytest.fixture(scope="session")
def messages(demo: Path) -> list[Message]:
    """The demo's messages but the truth."""
    out = []
    with demo.open("rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            if schema is not None and not channel.topic.startswith("/truth/"):
                value = STORE.deserialize_cdr(m.data, schema.name)
                out.append([m.log_time, channel.topic, schema.name, value])
    return out


@pytest.fixture(scope="session")
def original(demo: Path) -> list[tuple[Any, ...]]:
    return contents(opened(demo))
