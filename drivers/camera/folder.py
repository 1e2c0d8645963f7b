"""The images of a folder, in the order of their names."""

import re
from pathlib import Path

from trackerd.contract.errors import ConfigError


def image_files(device: str, folder: Path, suffixes: frozenset[str]) -> list[Path]:
    """Files with these suffixes; numbers in names count as numbers, so that 2 comes before 10. Raises ConfigError."""
    if not folder.is_dir():
        raise ConfigError(f'{device}: folder = "{folder}": there is no such folder')
    files = [file for file in folder.iterdir() if file.suffix.lower() in suffixes]
    if not files:
        raise ConfigError(f'{device}: folder = "{folder}": holds no image ({", ".join(sorted(suffixes))})')
    return sorted(files, key=_by_number)


def _by_number(file: Path) -> tuple[list[tuple[int, str]], str]:
    parts = re.split(r"(\d+)", file.stem)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts], file.name
