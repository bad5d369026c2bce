"""Catches: one trial counted twice without a word, as its file is there twice, and an archive of a
folder left out in silence.
"""

from __future__ import annotations

import shutil
import tarfile
import zipfile
from pathlib import Path

import pytest
from dgeval.config import Config
from dgeval.errors import UnreadableError
from dgeval.recording.copies import repeats
from dgeval.recording.trials import find_trials, open_trial


def test_a_copy_is_named(tmp_path: Path, demo: Path) -> None:
    for name in ("a.mcap", "copy of a.mcap"):
        shutil.copy(demo, tmp_path / name)
    first, second = find_trials([tmp_path])
    assert (first.repeats, second.repeats) == (None, "the same bytes as a.mcap")
    told = "this file is the same bytes as a.mcap: one trial that counts twice"
    assert told in open_trial(second, Config()).notes
    assert told not in open_trial(first, Config()).notes
    both = find_trials([tmp_path / "a.mcap", tmp_path / "copy of a.mcap"])
    assert [bool(spec.repeats) for spec in both] == [False, True]


def test_a_manifest_may_name_a_file_as_often_as_it_likes(tmp_path: Path, demo: Path) -> None:
    text = ""
    for name in ("a", "b"):
        shutil.copy(demo, tmp_path / f"{name}.mcap")
        text += f'[[trial]]\nid = "{name}"\nrecording = "{name}.mcap"\n'
    (tmp_path / "two.toml").write_text(text)
    assert [spec.repeats for spec in find_trials([tmp_path / "two.toml"])] == [None, None]


def test_what_rosbag_reindex_leaves(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.bag", "a.orig.bag", "b.orig.bag")]
    for k, file in enumerate(files):
        file.write_bytes(b"#ROSBAG V2.0\n" + bytes([k] * 100))  # of one size, and not the same
    found = repeats(files)
    assert found == {files[1]: "what `rosbag reindex` made a.bag from"}


@pytest.mark.parametrize("form", ["night.tar.gz", "night.zip"])
def test_an_archive_of_recordings_is_named(tmp_path: Path, demo: Path, form: str) -> None:
    path = tmp_path / form
    if form.endswith("zip"):
        with zipfile.ZipFile(path, "w") as stored:
            stored.write(demo, "night/a.mcap")
        with zipfile.ZipFile(tmp_path / "code.zip", "w") as stored:
            stored.writestr("main.py", "")
    else:
        with tarfile.open(path, "w:gz") as packed:
            packed.add(demo, "night/a.mcap")
    (tmp_path / "broken.tar").write_bytes(bytes(10))
    (spec,) = find_trials([tmp_path])
    assert spec.recording == path
    with pytest.raises(UnreadableError, match=rf"an archive; unpack it.*{form}"):
        open_trial(spec, Config())
