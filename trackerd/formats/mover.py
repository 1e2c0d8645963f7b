"""Programs that carry the probe from point to point and wait there, for a CNC or a robot; written, and read back.

    gcode   G1 with G21 G90, the wait by G4 P with a decimal point: seconds (LinuxCNC, Haas; Fanuc wants G4 X)
    csv     point,x_mm,y_mm,z_mm,dwell_s[,qw,qx,qy,qz]
    krl     KUKA: LIN with A, B, C in degrees about z, y, x (R = Rz(A) Ry(B) Rx(C)), WAIT SEC
    rapid   ABB: MoveL with a quaternion, WaitTime

A point's name is the comment of its move. Only moves and waits are read back: a program that a person has edited stays readable
as long as each move carries X, Y and Z.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import asin, atan2, degrees, radians
from pathlib import Path

import numpy as np

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.csv_table import Findings, read_rows
from trackerd.geometry.rigid import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_about,
    rotation_about_x,
    rotation_about_y,
)

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
CHECK = "C"  # the first letter of a check point's name
BAR_END = "B"  # and of a bar's end, whose place is only roughly known


class ProgramFormat(StrEnum):
    GCODE = "gcode"
    CSV = "csv"
    KRL = "krl"
    RAPID = "rapid"


ENDINGS = {
    ".nc": ProgramFormat.GCODE,
    ".ngc": ProgramFormat.GCODE,
    ".gcode": ProgramFormat.GCODE,
    ".tap": ProgramFormat.GCODE,
    ".csv": ProgramFormat.CSV,
    ".src": ProgramFormat.KRL,
    ".mod": ProgramFormat.RAPID,
    ".prg": ProgramFormat.RAPID,
}


@dataclass(frozen=True, slots=True)
class Stop:
    """A place where the mover stands still. `base_from_tool` turns the tool; a CNC has none."""

    name: str
    p_mm: Array  # (3,)
    dwell_s: float
    base_from_tool: Array | None = None  # (3, 3)

    @property
    def is_check(self) -> bool:
        """It stays outside the adjustment, and tells what that is worth."""
        return self.name.startswith(CHECK)

    @property
    def is_bar_end(self) -> bool:
        """Its place says where to look, and no more."""
        return self.name.startswith(BAR_END)


def write_program(stops: Sequence[Stop], kind: ProgramFormat, mm_s: float, title: str) -> str:
    """The whole text. `mm_s` is the speed from stop to stop."""
    writers: dict[ProgramFormat, Callable[[Sequence[Stop], float, str], Iterator[str]]] = {
        ProgramFormat.GCODE: _gcode,
        ProgramFormat.CSV: _csv,
        ProgramFormat.KRL: _krl,
        ProgramFormat.RAPID: _rapid,
    }
    return "\n".join(writers[kind](stops, mm_s, title)) + "\n"


def read_program(path: Path) -> list[Stop]:
    """Raises ConfigError for a file that is no such program, and where a move or a wait cannot be read: with its line."""
    kind = ENDINGS.get(path.suffix.lower())
    if kind is None:
        raise ConfigError(f"{path.name}: a mover's program ends in {', '.join(ENDINGS)}")
    stops = list(_read_csv(path) if kind is ProgramFormat.CSV else _read_lines(path, READERS[kind]))
    if not stops:
        raise ConfigError(f"{path.name}: there is no stop in this {kind} program")
    names = [stop.name for stop in stops]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"{path.name}: the stop {twice[0]} is there twice")
    return stops


# ---- writing ---------------------------------------------------------------------------------------------------------


def _gcode(stops: Sequence[Stop], mm_s: float, title: str) -> Iterator[str]:
    yield from ("%", f"({title})", "(X Y Z are the probe's centre; G4 P is in seconds)", "G21 G90 G94", f"F{60.0 * mm_s:.1f}")
    for stop in stops:
        x, y, z = stop.p_mm.tolist()
        yield f"G1 X{x:.4f} Y{y:.4f} Z{z:.4f} ({stop.name})"
        yield f"G4 P{stop.dwell_s:.2f}"
    yield from ("M2", "%")


def _csv(stops: Sequence[Stop], _: float, title: str) -> Iterator[str]:
    turned = all(stop.base_from_tool is not None for stop in stops)
    yield f"# {title}"
    yield "point,x_mm,y_mm,z_mm,dwell_s" + (",qw,qx,qy,qz" if turned else "")
    for stop in stops:
        numbers = [*stop.p_mm.tolist(), stop.dwell_s]
        if turned and stop.base_from_tool is not None:
            numbers += quaternion_from_matrix(stop.base_from_tool).tolist()
        yield f"{stop.name}," + ",".join(f"{number:.9g}" for number in numbers)


def _krl(stops: Sequence[Stop], mm_s: float, title: str) -> Iterator[str]:
    yield from ("&ACCESS RVP", "DEF CELLPLAN( )", f"; {title}", "; $TOOL is the probe's centre, $BASE the frame of the points")
    yield from ("BAS(#INITMOV,0)", "$BASE=BASE_DATA[1]", "$TOOL=TOOL_DATA[1]", f"$VEL.CP={mm_s / 1000.0:.4f}")
    for stop in stops:
        x, y, z = stop.p_mm.tolist()
        a, b, c = (degrees(angle) for angle in _abc(_turn(stop)))
        yield f"LIN {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}}} ; {stop.name}"
        yield f"WAIT SEC {stop.dwell_s:.2f}"
    yield "END"


def _rapid(stops: Sequence[Stop], mm_s: float, title: str) -> Iterator[str]:
    yield from ("MODULE CellPlan", f"  ! {title}", "  ! tool0 is the probe's centre, wobj0 the frame of the points")
    yield f"  CONST speeddata vPlan:=[{mm_s:.1f},30,{mm_s:.1f},30];"
    yield "  PROC main()"
    for stop in stops:
        x, y, z = stop.p_mm.tolist()
        turn = ",".join(f"{q:.9f}" for q in quaternion_from_matrix(_turn(stop)).tolist())
        place = f"[[{x:.4f},{y:.4f},{z:.4f}],[{turn}],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
        yield f"    MoveL {place},vPlan,fine,tool0\\WObj:=wobj0; ! {stop.name}"
        yield f"    WaitTime\\InPos,{stop.dwell_s:.2f};"
    yield from ("  ENDPROC", "ENDMODULE")


def _turn(stop: Stop) -> Array:
    return np.eye(3) if stop.base_from_tool is None else stop.base_from_tool


def _abc(rotation: Array) -> tuple[float, float, float]:
    """KUKA's A, B, C, rad: R = Rz(A) Ry(B) Rx(C)."""
    b = -asin(float(np.clip(rotation[2, 0], -1.0, 1.0)))
    if abs(rotation[2, 0]) > 1.0 - 1e-12:  # A and C turn about one axis: all of it is put into A
        return atan2(-rotation[0, 1], rotation[1, 1]), b, 0.0
    return atan2(rotation[1, 0], rotation[0, 0]), b, atan2(rotation[2, 1], rotation[2, 2])


# ---- reading ---------------------------------------------------------------------------------------------------------

Parsed = tuple[Stop | None, float | None]  # a move, or the seconds of a wait


def _read_lines(path: Path, read: Callable[[str], Parsed]) -> Iterator[Stop]:
    """Moves, each with the waits that follow it."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path.name}: cannot be read: {error}") from None
    stop: Stop | None = None
    for number, line in enumerate(lines, start=1):
        try:
            moved, waited = read(line)
        except ValueError as error:
            raise ConfigError(f"{path.name} line {number}: {error}: {line.strip()}") from None
        if moved is not None:
            if stop is not None and stop.dwell_s > 0.0:
                yield stop
            stop = moved if moved.name else replace(moved, name=f"P{number:04d}")
        elif waited is not None and stop is not None:
            stop = replace(stop, dwell_s=stop.dwell_s + waited)
    if stop is not None and stop.dwell_s > 0.0:
        yield stop


def _read_gcode(line: str) -> Parsed:
    name = re.search(r"\(([^)]*)\)", line)
    code = re.sub(r"\([^)]*\)|;.*", "", line).upper()
    words: dict[str, str] = dict(re.findall(rf"([A-Z])\s*({NUMBER})", code))
    if "G" in words and float(words["G"]) in (20.0, 91.0):
        raise ValueError("inches and relative moves are not read (G21 G90)")
    if "G" in words and float(words["G"]) == 4.0:
        return None, float(words.get("P", words.get("X", "0")))
    if words.keys() & {"X", "Y", "Z"}:
        if not words.keys() >= {"X", "Y", "Z"}:
            raise ValueError("a move needs X, Y and Z")
        return Stop(name[1].strip() if name else "", np.array([float(words[axis]) for axis in "XYZ"]), 0.0), None
    return None, None


def _read_krl(line: str) -> Parsed:
    code, _, comment = line.partition(";")
    if wait := re.match(rf"\s*WAIT\s+SEC\s+({NUMBER})", code, re.IGNORECASE):
        return None, float(wait[1])
    if not (move := re.match(r"\s*(?:LIN|PTP)\s*\{([^}]*)\}", code, re.IGNORECASE)):
        return None, None
    words = {key.upper(): float(value) for key, value in re.findall(rf"\b([A-Z])\s+({NUMBER})", move[1], re.IGNORECASE)}
    if not words.keys() >= {"X", "Y", "Z"}:
        raise ValueError("a move needs X, Y and Z")
    turn = None
    if words.keys() >= {"A", "B", "C"}:
        a, b, c = (radians(words[key]) for key in "ABC")
        turn = rotation_about(np.array((0.0, 0.0, 1.0)), a) @ rotation_about_y(b) @ rotation_about_x(c)
    return Stop(comment.strip(), np.array([words[key] for key in "XYZ"]), 0.0, turn), None


def _read_rapid(line: str) -> Parsed:
    code, _, comment = line.partition("!")
    if wait := re.match(rf"\s*WaitTime\s*(?:\\InPos\s*,)?\s*({NUMBER})", code, re.IGNORECASE):
        return None, float(wait[1])
    if not (move := re.match(r"\s*Move[JL]\s*\[\[([^\]]*)\],\[([^\]]*)\]", code, re.IGNORECASE)):
        return None, None
    p_mm, quaternion = (np.array([float(number) for number in part.split(",")]) for part in (move[1], move[2]))
    if p_mm.shape != (3,) or quaternion.shape != (4,):
        raise ValueError("a move needs [x,y,z] and a quaternion")
    return Stop(comment.strip(), p_mm, 0.0, matrix_from_quaternion(quaternion)), None


READERS: dict[ProgramFormat, Callable[[str], Parsed]] = {
    ProgramFormat.GCODE: _read_gcode,
    ProgramFormat.KRL: _read_krl,
    ProgramFormat.RAPID: _read_rapid,
}


def _read_csv(path: Path) -> Iterator[Stop]:
    findings = Findings()
    turned = ("qw", "qx", "qy", "qz")
    for row in read_rows(path, ("point", "x_mm", "y_mm", "z_mm", "dwell_s"), turned, findings):
        p_mm = np.array([row.number(column) for column in ("x_mm", "y_mm", "z_mm")])
        turn = matrix_from_quaternion(np.array([row.number(column) for column in turned])) if row.has(*turned) else None
        yield Stop(row.text("point"), p_mm, row.number("dwell_s"), turn)
    findings.raise_any()
