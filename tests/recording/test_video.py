"""Catches: pictures of a video given to other stamps, colours by another matrix, and a lost packet
that costs the whole trial.
"""

from __future__ import annotations

import copy
import fractions
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from dgeval.errors import UnreadableError
from dgeval.recording.video import VideoDecoder, codec_of
from rosbags.typesys import get_types_from_msg
from tests.recording.recorders import COLOUR, STORE, TYPES, Message, contents, opened, write

av = pytest.importorskip("av", reason="the extra dgeval[video] is not installed")


# of each encoder: no picture looks ahead, and good quality
OPTIONS = {
    "libx264": {"tune": "zerolatency", "crf": "10", "preset": "ultrafast"},
    "libx265": {
        "tune": "zerolatency",
        "crf": "10",
        "preset": "ultrafast",
        "x265-params": "log-level=none",
    },
    "libsvtav1": {"crf": "2", "preset": "8", "svtav1-params": "pred-struct=1"},
    "libvpx-vp9": {"deadline": "realtime", "lag-in-frames": "0", "crf": "10", "b": "4M"},
    "libvpx": {"deadline": "realtime", "lag-in-frames": "0", "crf": "10", "b": "4M"},
}


def encoded(pictures: list[np.ndarray], gop: int, codec: str = "libx264") -> list[bytes]:
    """One packet per picture, without pictures that look ahead."""
    context = av.CodecContext.create(codec, "w")
    height, width = pictures[0].shape[:2]
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.time_base, context.gop_size = fractions.Fraction(1, 30), gop
    context.options = OPTIONS[codec]
    out = []
    for k, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame.pts = k
        out += [bytes(p) for p in context.encode(frame)]
    return out + [bytes(p) for p in context.encode(None)]


def moving(n: int = 12) -> list[np.ndarray]:
    """Smooth pictures (48, 64, 3) whose light tells their number."""
    base = np.linspace(30, 120, 64)[None, :, None] + np.zeros((48, 64, 3))
    return [(base + np.array([8.0 * k, 40, 10])).clip(0, 255).astype(np.uint8) for k in range(n)]


@pytest.mark.parametrize("gop", [1, 30])
def test_each_picture_has_its_messages_number(gop: int) -> None:
    """Fails where a picture is given to the message after its own."""
    pictures = moving()
    decoder = VideoDecoder("h264")
    got = [pair for packet in encoded(pictures, gop) for pair in decoder.feed(packet)]
    got += list(decoder.rest())
    assert [k for k, _ in got] == list(range(len(pictures)))
    for k, picture in got:
        assert abs(float(picture[..., 0].mean()) - float(pictures[k][..., 0].mean())) < 3


@pytest.mark.parametrize(
    ("encoder", "stated"),
    [("libx265", "h265"), ("libsvtav1", "av1"), ("libvpx-vp9", "vp9"), ("libvpx", "vp8")],
)
def test_every_codec_that_is_named_is_decoded(encoder: str, stated: str) -> None:
    """Fails where a codec is promised by its name alone."""
    if encoder not in av.codecs_available:
        pytest.skip(f"this PyAV has no encoder {encoder}")
    large = np.ones((4, 4, 1), np.uint8)  # AV1's encoder takes no picture under 64 px
    pictures = [np.kron(picture, large) for picture in moving()]
    codec = codec_of(SimpleNamespace(data=b"", format=stated))
    assert codec is not None
    decoder = VideoDecoder(codec)
    got = [pair for packet in encoded(pictures, 30, encoder) for pair in decoder.feed(packet)]
    got += list(decoder.rest())
    assert [k for k, _ in got] == list(range(len(pictures)))
    for k, picture in got:  # neighbours are 8 apart
        assert abs(float(picture[..., 0].mean()) - float(pictures[k][..., 0].mean())) < 4


def test_a_lost_packet_costs_no_other_number() -> None:
    """Fails where the pictures after a broken packet move up by one."""
    pictures = moving()
    packets = encoded(pictures, 1)
    packets[4] = b"\0\0\0\1broken"
    decoder = VideoDecoder("h264")
    got = [pair for packet in packets for pair in decoder.feed(packet)]
    got += list(decoder.rest())
    assert {k for k, _ in got} >= set(range(12)) - {4}
    for k, picture in got:
        if k != 4:
            assert abs(float(picture[..., 0].mean()) - float(pictures[k][..., 0].mean())) < 3


@pytest.mark.parametrize(
    ("stated", "codec"),
    [
        ({"format": "h264"}, "h264"),
        ({"format": "H.265"}, "hevc"),
        ({"encoding": "libx264"}, "h264"),
        ({"encoding": "hevc;yuv420p;bgr8;bgr8"}, "hevc"),
        ({"format": "av1"}, "av1"),
        ({"format": "jpeg"}, None),
        ({"format": "rgb8; jpeg compressed bgr8"}, None),
        ({"encoding": "bayer_rggb8"}, None),
        ({"encoding": "rgb8"}, None),
    ],
)
def test_video_is_known_by_its_word(stated: dict[str, str], codec: str | None) -> None:
    assert codec_of(SimpleNamespace(data=b"", **stated)) == codec


def as_video(messages: list[Message], gop: int, lost: int | None = None) -> list[Message]:
    """The demo's colour as H.264 in CompressedImage."""
    colours = [m for m in messages if m[1] == COLOUR]
    pictures = [
        cv2.cvtColor(cv2.imdecode(np.asarray(m[3].data, np.uint8), 1), cv2.COLOR_BGR2RGB)
        for m in colours
    ]
    out = [m for m in messages if m[1] != COLOUR]
    for k, (m, packet) in enumerate(zip(colours, encoded(pictures, gop), strict=True)):
        value = copy.deepcopy(m[3])
        value.format = "h264"
        value.data = np.frombuffer(b"x" if k == lost else packet, np.uint8)
        out.append([*m[:3], value])
    return out


VIDEO = "foxglove_msgs/msg/CompressedVideo"
STORE.register(
    get_types_from_msg(
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format", VIDEO
    )
)


def test_video_in_foxgloves_message_of_ros(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where its fields are asked for by the names of a CompressedImage's."""
    as_image = as_video(messages, 15)
    as_its_own = [
        [*m[:2], VIDEO, TYPES[VIDEO](m[3].header.stamp, m[3].header.frame_id, m[3].data, "h264")]
        if m[1] == COLOUR
        else m
        for m in as_image
    ]
    one, other = (
        contents(opened(write(tmp_path / f"{name}.mcap", listed)), 20)
        for name, listed in (("a", as_image), ("b", as_its_own))
    )
    assert one == other


def test_a_recording_with_video(tmp_path: Path, messages: list[Message], demo: Path) -> None:
    """Fails where frames get other stamps or pictures, or a second pass differs from the first."""
    trial = opened(write(tmp_path / "v.mcap", as_video(messages, 15)))
    assert not trial.checks
    plain = {f.t_ns: f for f in opened(demo).frames() if f.index % 7 == 0}
    for _ in range(2):
        frames = list(trial.frames())
        assert len(frames) == len(trial.pairs)
        for f in frames:
            if f.t_ns in plain:
                apart = np.abs(f.colour.astype(int) - plain[f.t_ns].colour)
                assert apart.mean() < 6
                assert np.array_equal(f.depth, plain[f.t_ns].depth)


def test_a_picture_that_is_lost_costs_its_frame(tmp_path: Path, messages: list[Message]) -> None:
    """Fails where the frames behind it wait for it for ever."""
    trial = opened(write(tmp_path / "v.mcap", as_video(messages, 1, lost=20)))
    stamps = [p.t_ns for p in trial.pairs]
    assert [f.t_ns for f in trial.frames()] == stamps[:20] + stamps[21:]
    assert trial.n_undecodable_frames == 1


def test_without_the_extra_the_message_names_it(
    tmp_path: Path, messages: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("scan", "roles"):
        monkeypatch.setattr(f"dgeval.recording.{name}.is_available", lambda: False)
    with pytest.raises(UnreadableError, match=r"dgeval\[video\]"):
        opened(write(tmp_path / "v.mcap", as_video(messages, 1)))


def test_a_damaged_picture_is_lost_and_harms_no_other() -> None:
    """Fails where the decoder puts the picture before in its place, or where what it keeps of the
    damage changes a picture that stands alone.
    """
    pictures = moving()
    packets = encoded(pictures, 1)

    def decoded(given: list[bytes]) -> dict[int, np.ndarray]:
        decoder = VideoDecoder("h264")
        got = dict(pair for packet in given for pair in decoder.feed(packet))
        return got | dict(decoder.rest())

    whole = decoded(packets)
    for at in range(40, len(packets[4]), 11):
        damaged = packets[4][:at] + bytes(8) + packets[4][at + 8 :]
        got = decoded([*packets[:4], damaged, *packets[5:]])
        assert got.keys() - {4} == whole.keys() - {4}
        assert all((got[k] == whole[k]).all() for k in got if k != 4)
        if 4 in got:  # what the change left whole
            assert abs(float(got[4][..., 0].mean()) - float(whole[3][..., 0].mean())) > 3
