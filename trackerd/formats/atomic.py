"""Files that are replaced in one step: a reader, or a power cut, sees the old one or the new one, whole."""

import os
import re
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomli_w

NUMBERS = re.compile(r"\[\n((?:\s+[-+.\deE]+,\n)+)\s*\]")  # a list of numbers, which tomli_w spreads over many lines


def write_atomically(path: Path, text: str) -> None:
    """UTF-8. What was there stays where anything fails. Raises OSError."""
    replace_file(path, text.encode())


def replace_file(path: Path, content: bytes) -> None:
    """As `write_atomically`."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(temporary).unlink()
        raise
    _sync_folder(path.parent)


def toml_text(tables: dict[str, Any]) -> str:
    """As TOML, each list of numbers in one line."""
    return NUMBERS.sub(_one_line, tomli_w.dumps(tables))


def _one_line(numbers: re.Match[str]) -> str:
    return "[" + ", ".join(numbers[1].replace(",", " ").split()) + "]"


def _sync_folder(folder: Path) -> None:
    """Makes the new name durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
