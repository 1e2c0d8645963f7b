"""Programs for machines and robots: every format is read back, and a person's edits are."""

from pathlib import Path

import numpy as np
import pytest

from trackerd.contract.errors import ConfigError
from trackerd.formats.mover import ProgramFormat, Stop, read_program, write_program
from trackerd.geometry.rigid import rotation_about

ENDING = {ProgramFormat.GCODE: "nc", ProgramFormat.CSV: "csv", ProgramFormat.KRL: "src", ProgramFormat.RAPID: "mod"}


def stops(turned: bool = True) -> list[Stop]:
    rng = np.random.default_rng(4)
    axes = rng.normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    turns = [rotation_about(axis, angle) for axis, angle in zip(axes, rng.uniform(-3.0, 3.0, 5), strict=True)]
    turns[1] = rotation_about(np.array((0.0, 1.0, 0.0)), np.pi / 2.0)  # where A and C turn about one axis
    points = rng.uniform(-500.0, 500.0, (5, 3))
    names = ("P01", "P02", "P03", "C01", "C02")
    return [Stop(name, p, 12.5, turn if turned else None) for name, p, turn in zip(names, points, turns, strict=True)]


def written(tmp_path: Path, kind: ProgramFormat, turned: bool = True) -> Path:
    path = tmp_path / f"plan.{ENDING[kind]}"
    path.write_text(write_program(stops(turned), kind, 50.0, "40 points"))
    return path


@pytest.mark.parametrize("kind", ProgramFormat)
def test_a_program_is_read_back_as_it_was_planned(tmp_path: Path, kind: ProgramFormat) -> None:
    turned = kind is not ProgramFormat.GCODE
    for found, meant in zip(read_program(written(tmp_path, kind, turned)), stops(turned), strict=True):
        assert (found.name, found.dwell_s, found.is_check) == (meant.name, 12.5, meant.name[0] == "C")
        np.testing.assert_allclose(found.p_mm, meant.p_mm, atol=1e-4)
        if meant.base_from_tool is not None:
            assert found.base_from_tool is not None
            np.testing.assert_allclose(found.base_from_tool, meant.base_from_tool, atol=1e-6)


def test_gcode_is_metric_absolute_and_has_a_feed_before_its_first_move(tmp_path: Path) -> None:
    lines = written(tmp_path, ProgramFormat.GCODE, turned=False).read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("G1"))
    assert "G21 G90 G94" in lines[:first]
    assert "F3000.0" in lines[:first]
    assert lines[first + 1] == "G4 P12.50"
    assert lines[-2:] == ["M2", "%"]
    assert max(map(len, lines)) < 256


def test_rapid_and_krl_have_balanced_frames(tmp_path: Path) -> None:
    rapid = written(tmp_path, ProgramFormat.RAPID).read_text()
    assert rapid.count("[") == rapid.count("]")
    assert rapid.index("MODULE") < rapid.index("PROC") < rapid.index("ENDPROC") < rapid.index("ENDMODULE")
    krl = written(tmp_path, ProgramFormat.KRL).read_text()
    assert krl.count("{") == krl.count("}") == krl.count("WAIT SEC") == 5
    assert krl.index("DEF ") < krl.index("END\n")


def test_a_hand_written_program_is_read_without_names(tmp_path: Path) -> None:
    path = tmp_path / "own.ngc"
    path.write_text("g21 g90\nG0 X0 Y0 Z100\nG1 X1.5 Y-2 Z.5 F100\nG4 P3.\nG1 X9 Y9 Z9\nG4 P1.5\nG4 P1.5\nM30\n")
    found = read_program(path)
    assert [(stop.p_mm.tolist(), stop.dwell_s) for stop in found] == [([1.5, -2.0, 0.5], 3.0), ([9.0, 9.0, 9.0], 3.0)]
    assert len({stop.name for stop in found}) == 2


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("plan.txt", "", "a mover's program ends in .nc"),
        ("plan.nc", "G21\n", "there is no stop in this gcode program"),
        ("plan.nc", "G91\n", "plan.nc line 1: inches and relative moves are not read"),
        ("plan.nc", "G1 X1 Y2\n", "plan.nc line 1: a move needs X, Y and Z"),
        ("plan.src", "LIN {X 1,Y 2}\n", "plan.src line 1: a move needs X, Y and Z"),
        ("plan.mod", "MoveL [[1,2],[1,0,0,0]]\n", r"plan.mod line 1: a move needs \[x,y,z\] and a quaternion"),
        ("plan.csv", "point,x_mm,y_mm,z_mm,dwell_s\nP1,1,2,nan,3\n", "plan.csv line 2 z_mm = nan: must be a finite number"),
        ("plan.csv", "point,x_mm,y_mm,z_mm,dwell_s\nP1,1,2,3,4\nP1,1,2,3,4\n", "the stop P1 is there twice"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_told_by_its_line(tmp_path: Path, name: str, text: str, words: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_program(path)
