"""Depth from PNG by our own road: every bit as OpenCV's, and OpenCV's word on all the rest."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from dgeval.recording.image_codecs.depth_png import PNG_START, decoded, depth_codes
from hypothesis import given, settings
from hypothesis import strategies as st


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def filtered(codes: np.ndarray, filters: list[int]) -> bytes:
    """Rows as the PNG specification filters them, byte for byte, the slow way."""
    rows = codes.astype(">u2").view(np.uint8).reshape(len(codes), -1).astype(int)
    out = bytearray()
    for y, kind in enumerate(filters):
        out.append(kind)
        above = rows[y - 1] if y else np.zeros_like(rows[0])
        for k, value in enumerate(rows[y]):
            a = rows[y][k - 2] if k > 1 else 0
            b, c = above[k], above[k - 2] if k > 1 else 0
            p = a + b - c
            nearest = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            out.append((value - (0, a, b, (a + b) // 2, nearest)[kind]) % 256)
    return bytes(out)


def png(codes: np.ndarray, filters: list[int], *, depth: int = 16, extra: bytes = b"") -> bytes:
    height, width = codes.shape
    header = struct.pack(">II5B", width, height, depth, 0, 0, 0, 0)
    body = chunk(b"IDAT", zlib.compress(filtered(codes, filters)))
    return PNG_START + chunk(b"IHDR", header) + extra + body + chunk(b"IEND", b"")


def opencv(data: bytes) -> np.ndarray | None:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def same(ours: np.ndarray | None, theirs: np.ndarray | None) -> bool:
    if ours is None or theirs is None:
        return ours is theirs
    return ours.dtype == theirs.dtype and np.array_equal(ours, theirs)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_every_filter_gives_what_was_stored_and_what_opencv_reads(data: st.DataObject) -> None:
    """A filter undone wrongly, and the high byte taken for the low one."""
    height = data.draw(st.integers(1, 9))
    width = data.draw(st.integers(1, 9))
    filters = data.draw(st.lists(st.integers(0, 4), min_size=height, max_size=height))
    seed = data.draw(st.integers(0, 2**32 - 1))
    values = data.draw(st.sampled_from([6, 65536]))  # of few values neighbours are equally near
    codes = np.random.default_rng(seed).integers(0, values, (height, width)).astype(np.uint16)
    made = png(codes, filters)
    assert same(depth_codes(made), codes)
    assert same(opencv(made), codes)


@pytest.mark.parametrize("of", [cv2.IMWRITE_PNG_STRATEGY_DEFAULT, cv2.IMWRITE_PNG_STRATEGY_RLE])
def test_what_opencv_writes_is_read_without_it(of: int) -> None:
    """The quick road never taken, which no digest would show."""
    v, u = np.mgrid[0:48, 0:64]
    codes = (900 + 5 * u + 3 * v).astype(np.uint16)
    codes[10:20, 30:] = 0
    made = cv2.imencode(".png", codes, [cv2.IMWRITE_PNG_STRATEGY, of])[1].tobytes()
    assert same(depth_codes(made), codes)
    assert same(depth_codes(made + b"behind the end"), codes)


@pytest.mark.parametrize(
    ("what", "shape", "kind"),
    [("8 bit", (6, 5), np.uint8), ("16-bit colour", (6, 5, 3), np.uint16)],
)
def test_other_kinds_are_opencvs(what: str, shape: tuple[int, ...], kind: type) -> None:
    picture = np.arange(np.prod(shape)).reshape(shape).astype(kind)
    made = cv2.imencode(".png", picture)[1].tobytes()
    assert depth_codes(made) is None, what
    assert same(decoded(made), picture)


def test_a_chunk_that_may_change_the_readings_is_opencvs() -> None:
    codes = np.arange(30, dtype=np.uint16).reshape(5, 6)
    transparent = png(codes, [0] * 5, extra=chunk(b"tRNS", b"\x00\x05"))
    assert depth_codes(transparent) is None
    assert same(decoded(transparent), opencv(transparent))
    named = png(codes, [4] * 5, extra=chunk(b"tEXt", b"Software\x00camera"))
    assert same(depth_codes(named), codes)


def test_damage_is_judged_as_opencv_judges_it() -> None:
    """A cut or changed picture read as a whole one."""
    rng = np.random.default_rng(0)
    codes = rng.integers(0, 5000, (20, 24)).astype(np.uint16)
    whole = png(codes, list(rng.integers(0, 5, 20)))
    for cut in range(len(PNG_START), len(whole), 29):
        assert same(decoded(whole[:cut]), opencv(whole[:cut])), cut
    for at in range(len(PNG_START), len(whole), 23):
        bent = bytearray(whole)
        bent[at] ^= 0x20
        assert depth_codes(bytes(bent)) is None, at
        assert same(decoded(bytes(bent)), opencv(bytes(bent))), at


def test_rows_of_an_unknown_filter_or_another_number_are_left_alone() -> None:
    codes = np.full((3, 4), 700, np.uint16)
    header = chunk(b"IHDR", struct.pack(">II5B", 4, 3, 16, 0, 0, 0, 0))
    for rows in (b"\x05" + bytes(26), filtered(codes, [0] * 3)[:-1], filtered(codes, [0] * 3) * 2):
        made = PNG_START + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
        assert depth_codes(made) is None
