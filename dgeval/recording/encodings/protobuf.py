"""Protobuf messages; the schema is a FileDescriptorSet, as MCAP asks for."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

ENCODES = ("protobuf", "protobuf")  # message encoding, schema encoding


@lru_cache(maxsize=256)
def decoder(type_name: str, schema: bytes) -> Callable[[bytes], Any]:
    """The function that decodes one message's bytes.

    KeyError, TypeError or DecodeError for a schema that does not define the type.
    """
    files = {f.name: f for f in FileDescriptorSet.FromString(schema).file}
    pool = DescriptorPool()
    added: set[str] = set()

    def add(file: FileDescriptorProto) -> None:
        """A file after those that it imports; a set may hold them in any order."""
        if file.name in added:
            return
        added.add(file.name)
        for name in file.dependency:
            if name in files:
                add(files[name])
        pool.Add(file)

    for file in files.values():
        add(file)
    message_class = GetMessageClass(pool.FindMessageTypeByName(type_name))
    return lambda data: message_class.FromString(data)
