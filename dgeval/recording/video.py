"""Colour as video: H.264, H.265, AV1, VP8 and VP9 in foxglove.CompressedVideo, FFMPEGPacket of
ffmpeg_image_transport, or a CompressedImage that says so.

A picture can depend on the ones before it, so the messages of a topic are decoded in the order of
the file. Planes become RGB by our own arithmetic in whole numbers, since that of the library's
scaler depends on the CPU. Needs the extra `dgeval[video]`; its wheel of PyAV holds encoders under
the GPL.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgeval.recording.image_codecs.yuv import rgb_from

EXTRA = "pip install 'dgeval[video]'"
# part of a format's or an encoder's name -> codec
CODECS = {"264": "h264", "265": "hevc", "hevc": "hevc", "av1": "av1", "vp9": "vp9", "vp8": "vp8"}
# what FFmpeg finds under a codec's own name decodes AV1 on graphics cards only
DECODERS = {"av1": "libdav1d"}
# colour spaces of ITU-T H.273 as FFmpeg counts them -> a key of `yuv.LUMA`; others as BT.601,
# which is also what FFmpeg takes where a stream does not say
MATRICES = {1: "bt709", 9: "bt2020", 10: "bt2020"}
FULL_RANGE = 2  # AVCOL_RANGE_JPEG
# formats of planes -> bits
PLANES = {
    "yuv420p": 8,
    "yuvj420p": 8,
    "yuv422p": 8,
    "yuvj422p": 8,
    "yuv444p": 8,
    "yuvj444p": 8,
    "yuv420p10le": 10,
    "yuv422p10le": 10,
    "yuv444p10le": 10,
}

Picture = NDArray[np.uint8]


def codec_of(message: Any) -> str | None:
    """The codec of a decoded message; None where it is no video."""
    stated = str(getattr(message, "format", "") or getattr(message, "encoding", "")).lower()
    if not hasattr(message, "data") or stated.startswith(("jp", "png", "bayer")):
        return None
    return next((codec for part, codec in CODECS.items() if part in stated), None)


def is_available() -> bool:
    """Whether the extra is installed."""
    try:
        import av  # noqa: F401
    except ImportError:
        return False
    return True


class VideoDecoder:
    """Decodes the messages of one topic in their order. ImportError without the extra."""

    def __init__(self, codec: str) -> None:
        self._codec = codec
        self._given = 0
        self._context = self._fresh()

    def _fresh(self) -> Any:
        import av

        context = av.CodecContext.create(DECODERS.get(self._codec, self._codec), "r")
        context.thread_count = 1
        return context

    def feed(self, data: bytes) -> Iterator[tuple[int, Picture]]:
        """Pictures that a further message completes, each with its message's number from 0.

        A message that can't be decoded, as one before the first key frame, gives none; nor do those
        after it that need it. Nothing is put in their place from the pictures before.
        """
        import av

        packet = av.Packet(data)
        packet.pts = self._given
        self._given += 1
        yield from self._pictures(packet)

    def rest(self) -> Iterator[tuple[int, Picture]]:
        """Pictures that were still waited for after the last message."""
        yield from self._pictures(None)

    def _pictures(self, packet: Any) -> Iterator[tuple[int, Picture]]:
        import av

        try:
            frames = list(self._context.decode(packet))
        except (av.FFmpegError, ValueError, EOFError):
            frames, is_broken = [], True
        else:
            is_broken = any(frame.is_corrupt for frame in frames)
        for frame in frames:
            if frame.pts is not None and frame.format.name in PLANES and not frame.is_corrupt:
                yield int(frame.pts), _rgb(frame)
        if is_broken:
            # what a decoder keeps of a broken message changes pictures that don't need it
            self._context = self._fresh()


def _rgb(frame: Any) -> Picture:
    """(H, W, 3) RGB of a frame whose format is a key of `PLANES`."""
    name = frame.format.name
    wide = PLANES[name] > 8
    planes = []
    for plane in frame.planes:
        row = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: plane.height]
        if wide:
            values = np.ascontiguousarray(row).view("<u2")[:, : plane.width]
            planes.append((values >> (PLANES[name] - 8)).astype(np.uint8))
        else:
            planes.append(row[:, : plane.width])
    full = frame.color_range == FULL_RANGE or name.startswith("yuvj")
    y, u, v = planes
    return rgb_from(y, u, v, MATRICES.get(int(frame.colorspace), "bt601"), full)
