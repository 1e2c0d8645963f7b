"""The encoders' table of a recording, angles.csv, as `trackerd twin --record` writes it."""

import csv
from math import isfinite
from pathlib import Path

from trackerd.contract.errors import ConfigError

COLUMNS = "gimbal,frame,t_ns,az_rad,el_rad"


def recorded_angles(file: Path, gimbal: str) -> dict[int, tuple[float, float]]:
    """Encoder angles (az, el) in rad of one gimbal's frames. Raises ConfigError."""
    found: dict[int, tuple[float, float]] = {}
    others: set[str] = set()
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            rows = csv.DictReader(text)
            for row in rows:
                if row["gimbal"] != gimbal:
                    others.add(row["gimbal"])
                    continue
                angles = float(row["az_rad"]), float(row["el_rad"])
                if not all(map(isfinite, angles)):
                    raise ConfigError(
                        f"{file}, line {rows.line_num}: its angles are no finite numbers: az_rad, el_rad = {angles}"
                    )
                found[int(row["frame"])] = angles
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{file}: cannot be read: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{file}: needs the columns {COLUMNS}, with numbers in every row") from None
    if not found:
        raise ConfigError(f"{file}: no row for gimbal {gimbal!r} (there are: {', '.join(sorted(others)) or 'none'})")
    return found
