"""Decoders of image messages: one file per kind, tried in order.

A new kind is one file with `accepts(message) -> bool` and `decode(message) -> Pixels`, and one line
here.
"""

from __future__ import annotations

from dgeval.recording.image_codecs import compressed, compressed_depth, raw

CODECS = (raw, compressed_depth, compressed)
