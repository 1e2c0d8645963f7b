"""The rules that machines can hold: style, types, layers, and how long a driver's functions and modules may be."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LONGEST_FUNCTION, LONGEST_MODULE = 60, 400  # lines of a driver: more is two ideas

CHECKS = {
    "ruff check": ["-m", "ruff", "check"],
    "ruff format": ["-m", "ruff", "format", "--check"],
    "mypy": ["-m", "mypy"],
    "lint-imports": ["-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"],
}
DRIVERS = sorted((ROOT / "drivers").rglob("*.py"))


@pytest.mark.parametrize("check", CHECKS)
def test_the_code_passes(check: str) -> None:
    done = subprocess.run([sys.executable, *CHECKS[check]], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.fail(f"{check}:\n{done.stdout}{done.stderr}", pytrace=False)


@pytest.mark.parametrize("file", DRIVERS, ids=[str(file.relative_to(ROOT)) for file in DRIVERS])
def test_a_driver_is_short_enough_to_be_read(file: Path) -> None:
    source = file.read_text()
    assert len(source.splitlines()) <= LONGEST_MODULE
    long = [f"{name}: {lines} lines" for name, lines in functions(source) if lines > LONGEST_FUNCTION]
    assert not long


def functions(source: str) -> Iterator[tuple[str, int]]:
    """Name and length in lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            yield node.name, node.end_lineno - node.lineno + 1
