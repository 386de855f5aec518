"""Reading of recordings (MCAP); a truncated or damaged file is read up to the damage.

Reading needs the extra ``recording``: ``pip install gelstereo[recording]``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gelstereo._native import Error, parse_toml
from gelstereo.extras import said
from gelstereo.view.messages import RecordingError

_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class Recorded:
    """A message as stored in the file."""

    topic: str
    log_ns: int
    #: Time on the frame source's clock.
    source_ns: int
    data: bytes


@dataclass
class Header:
    """Data before the messages."""

    config: dict[str, Any] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)


def read_messages(path: Path) -> Iterator[Recorded]:
    """All messages in the order of the file.

    Raises
    ------
    RecordingError
        If the file is not a recording, or a package is missing.
    FileNotFoundError
        If there is no such file.
    Exception
        From the reader, if the file is truncated or damaged; see `end_at_damage`.
    """
    try:
        import lz4  # noqa: F401 (mcap imports it when it meets the first chunk)
        from mcap.reader import NonSeekingReader
    except ImportError as error:
        raise RecordingError(said("reading recordings", error)) from error
    with path.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise RecordingError(
                f"{path} is not an MCAP file; valid is a recording by gelstereo-host, or a folder"
            )
        stream.seek(0)
        for _, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
            yield Recorded(channel.topic, message.log_time, message.publish_time, message.data)


def end_at_damage(path: Path, error: Exception, any_frame: bool) -> None:
    """Handle an error in reading or decoding a file's messages.

    Messages before the damage are valid and are used. The reader and its decompressors have no common base
    class of errors.

    Raises
    ------
    Error, OSError
        `error` itself if it is a gelstereo or system error; `RecordingError` if no frame was read before it.
    """
    if isinstance(error, (Error, OSError)):
        raise error
    if not any_frame:
        reason = str(error) or "it ends before the first frame"
        raise RecordingError(f"{path} cannot be read as MCAP: {reason}") from error


def read_header(path: Path) -> Header:
    """Configuration and attachments, as far as readable."""
    from mcap.records import Attachment, Metadata
    from mcap.stream_reader import StreamReader

    header = Header()
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Metadata) and "config_toml" in record.metadata:
                    header.config = parse_toml(record.metadata["config_toml"])
                elif isinstance(record, Attachment):
                    header.attachments[record.name] = record.data
        except Exception:  # of any type, as in `end_at_damage`
            return header  # truncated or damaged; the header comes first
    return header
