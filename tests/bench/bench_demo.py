"""The demo as it is installed, its figures beside their limits: errors, lock, frames, latency, load, start.

Errors are those of every valid fix at its own stamp against the twin's truth there: nothing is aligned or shifted. Encoders are
simulated twice: 2 arcsec white, and 2 arcsec as a function of the angle. Arrivals are those of a subscriber in a process of its
own. A missed figure is marked, and is no failure of the command.

    python tests/bench/bench_demo.py [--seconds 20] [--json FILE]
"""

import argparse
import json
import os
import sysconfig
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from judge import (
    Figures,
    Heard,
    Judged,
    Message,
    against_truth,
    along_and_across,
    delays,
    lengths,
    listening,
    read,
    spread,
)
from system.cell import Cell, running_cell

GIMBALS = ("left", "right")
FRAME_HZ = 55.0
SPEED_MM_S = 250.0
HALF_EXPOSURE_MS = 1.0  # config/demo.toml: exposure_us = 2000
TRANSFER_MS = 8.0  # config/demo.toml: transfer_us = 8000
SETTLED_NS = 200_000_000  # frames under way have arrived and been told by then, and no stream is given up yet
ENCODERS = {
    "white": (),
    "fixed": (
        "twin.encoder.white_arcsec=0",
        "twin.encoder.fixed_arcsec=2",
        *(f"gimbal.{name}.{key}" for name in GIMBALS for key in ("encoder_fixed_arcsec=2", "encoder_sigma_arcsec=0.1")),
    ),
}


@dataclass(frozen=True, slots=True)
class Load:
    """Of one process: share of one core over the time, largest resident memory seen."""

    cpu_share: float
    resident_mb: float


@dataclass(frozen=True, slots=True)
class Demo:
    """One run, as it was heard and watched."""

    ready_unix_ns: int
    positions: list[Heard]
    truths: list[Heard]
    statuses: list[Heard]
    exposed: Message  # the twin's statistics, a camera each
    accounted: Message  # a status of the same time
    daemon: Load
    twin: Load
    load_average: float  # of the machine, 1 min, at the end

    def judged(self, lowest_mm_s: float, highest_mm_s: float) -> list[Judged]:
        """The valid fixes at these speeds of the probe."""
        fixes = [fix for fix in self.positions if fix.message["valid"]]
        return [one for one in against_truth(fixes, self.truths) if lowest_mm_s <= one.speed_mm_s <= highest_mm_s]


# ---- running ---------------------------------------------------------------------------------------------------------


def run_demo(overrides: Sequence[str], seconds: float) -> Demo:
    with tempfile.TemporaryDirectory() as folder, running_cell(*overrides) as cell:
        file = Path(folder) / "heard"
        with listening(cell.port, file, "twin/**"):
            ready = cell.ready()["t_unix_ns"]
            watched = [psutil.Process(pid) for pid in (cell.process.pid, cell.twin()["pid"])]
            daemon, twin = watch(watched, ready * 1e-9 + seconds)
            exposed, accounted = all_frames(cell)
            assert cell.stop() == 0, cell.words()
        heard = (read(file, key) for key in ("/position", "/truth", "/status"))
        return Demo(ready, *heard, exposed, accounted, daemon, twin, os.getloadavg()[0])


def watch(processes: Sequence[psutil.Process], until: float) -> list[Load]:
    """Looks at them twice a second."""
    began, used = time.monotonic(), [cpu_s(process) for process in processes]
    resident = [0.0] * len(processes)
    while time.time() < until:
        time.sleep(0.5)
        resident = [max(mb, p.memory_info().rss / 2**20) for mb, p in zip(resident, processes, strict=True)]
    duration_s = time.monotonic() - began
    shares = [(cpu_s(process) - before) / duration_s for process, before in zip(processes, used, strict=True)]
    return [Load(share, mb) for share, mb in zip(shares, resident, strict=True)]


def cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def all_frames(cell: Cell) -> tuple[Message, Message]:
    """The streams are stopped, so that the twin's count and the daemon's are of the same frames."""
    for name in GIMBALS:
        cell.control(do="stop_stream", camera=name)
    settled = time.time_ns() + SETTLED_NS
    accounted = cell.status(lambda s: s["t_published_unix_ns"] > settled)
    return cell.control(do="statistics"), accounted


def start_s(overrides: Sequence[str] = ()) -> float:
    """From the start of the process to READY."""
    began = time.time_ns()
    with running_cell(*overrides) as cell:
        return float((cell.ready()["t_unix_ns"] - began) * 1e-9)


def forget_files() -> None:
    """Installed packages and our own leave the page cache: what is read next comes from the disk."""
    ours = Path(__file__).parents[2]
    for folder in (Path(sysconfig.get_path("platlib")), ours / "trackerd", ours / "drivers"):
        for path in folder.rglob("*"):
            if path.is_file() and (path.suffix in {".py", ".pyc"} or ".so" in path.suffixes):
                descriptor = os.open(path, os.O_RDONLY)
                os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
                os.close(descriptor)


# ---- figures ---------------------------------------------------------------------------------------------------------


def accuracy(run: Demo, encoders: str) -> Figures:
    still, circle = run.judged(0.0, 0.0), run.judged(0.99 * SPEED_MM_S, 1.01 * SPEED_MM_S)
    figures = Figures(f"errors, encoders 2 arcsec {encoders}, mm", ("rms", "95 %", "max"))
    figures.add(f"still, 3D ({len(still)} fixes)", *spread(lengths(still)), most=0.07)
    figures.add(f"circle at 250 mm/s, 3D ({len(circle)} fixes)", *spread(lengths(circle)), most=0.12)
    if circle:
        along, across = along_and_across(circle)
        figures.add("circle, along the path", *spread(along))
        figures.add("circle, across the path", *spread(across))
        figures.add("circle, mean along the path (negative: behind)", float(along.mean()))
    return figures


def behaviour(run: Demo) -> Figures:
    figures = Figures("behaviour", ("",))
    first = next((fix.arrived_unix_ns for fix in run.positions if fix.message["valid"]), None)
    lock_s = float("nan") if first is None else (first - run.ready_unix_ns) * 1e-9
    figures.add("READY to the first valid fix", lock_s, unit="s", most=3.0)
    begin = next((t.message["t_unix_ns"] for t in run.truths if any(t.message["velocity_mm_s"])), run.ready_unix_ns)
    fixes = [fix.message for fix in run.positions if fix.message["t_unix_ns"] >= begin]
    stamps = sorted(fix["t_unix_ns"] for fix in fixes if fix["valid"])
    rate_hz = (len(stamps) - 1) / ((stamps[-1] - stamps[0]) * 1e-9) if len(stamps) > 1 else 0.0
    figures.add("valid fixes while moving", rate_hz, unit="Hz", least=0.99 * FRAME_HZ)
    figures.add("other fixes while moving", len(fixes) - len(stamps))
    figures.add("largest offset from the centre while moving", largest_offset(run.statuses, begin), unit="px", most=20.0)
    return figures


def largest_offset(statuses: Sequence[Heard], since_unix_ns: int) -> float:
    """Of both stations, as the status tells ten times a second."""
    stations = [s for h in statuses if h.message["t_published_unix_ns"] > since_unix_ns for s in h.message["stations"].values()]
    return max((s["axes"]["offset_px"] or 0.0 for s in stations), default=float("nan"))


def frames(run: Demo) -> Figures:
    figures = Figures("frames, from the first to the last exposure", GIMBALS)
    told = [run.accounted["stations"][name]["frames"] for name in GIMBALS]
    exposed = [run.exposed[name]["exposed"] for name in GIMBALS]
    figures.add("exposed by the twin", *exposed)
    figures.add("processed with angles", *(f["processed"] - f["no_angle"] for f in told))
    for what, key in (
        ("no angle", "no_angle"),
        ("skipped: a newer one was there", "skipped"),
        ("dropped on the way", "dropped"),
    ):
        figures.add(what, *(f[key] for f in told))
    delivered = [run.exposed[name]["exposed"] - run.exposed[name]["dropped"] for name in GIMBALS]
    missing = [count - f["processed"] - f["skipped"] for count, f in zip(delivered, told, strict=True)]
    figures.add("not accounted for", *sorted(map(abs, missing), reverse=True), most=0.0)
    for what, key in (
        ("dropped by the twin, or cut off where a stream was stopped", "dropped"),
        ("doorbells that nobody took", "missed_doorbells"),
    ):
        figures.add(what, *(run.exposed[name][key] for name in GIMBALS))
    figures.add("rendered too late by the twin", *(run.exposed[name]["overruns"] for name in GIMBALS))
    figures.add("the latest of them by", *(run.exposed[name]["worst_overrun_ns"] * 1e-6 for name in GIMBALS), unit="ms")
    return figures


def latency(run: Demo) -> Figures:
    fixes = [fix for fix in run.positions if fix.message["state"] == "tracking"]
    complete, put = (np.array([fix.message[key] for fix in fixes]) for key in ("t_received_unix_ns", "t_published_unix_ns"))
    exposed = np.array([fix.message["t_unix_ns"] for fix in fixes])
    arrived = np.array([fix.arrived_unix_ns for fix in fixes])
    figures = Figures(f"latency of {len(fixes)} fixes, ms", ("p50", "p99", "max"))
    figures.add("exposure: its second half (configured)", HALF_EXPOSURE_MS)
    figures.add("readout and transfer (configured)", TRANSFER_MS)
    late_ms = (complete - exposed) * 1e-6 - HALF_EXPOSURE_MS - TRANSFER_MS
    figures.add("beyond: the twin's rendering, doorbell, driver", *delays(late_ms))
    for name, station in run.accounted["stations"].items():
        for stage, words in (("angles", "angles known"), ("work", "(the tracker alone)"), ("tracked", "tracked")):
            row = station["stages"][stage]
            figures.add(f"  complete in the driver -> {name}: {words}", row["p50_ms"], row["p99_ms"], row["max_ms"])
    figures.add("  complete in the driver -> published", *delays((put - complete) * 1e-6))
    p50, p99, top = delays((arrived - complete) * 1e-6)
    figures.add("complete in the driver -> subscriber, median", p50, most=5.0)
    figures.add("complete in the driver -> subscriber, 99 %", p99, top, most=15.0)
    whole = delays((arrived - exposed) * 1e-6)
    figures.add("mid-exposure -> subscriber: all of it", *whole)
    figures.add("  as v t at 250 mm/s, mm", *(SPEED_MM_S * 1e-3 * value for value in whole))
    return figures


def load(run: Demo, cold_s: float, warm_s: Sequence[float]) -> Figures:
    figures = Figures("load and start", ("",))
    figures.add("daemon: share of one core", 100 * run.daemon.cpu_share, unit="%", most=60.0)
    figures.add("daemon: resident memory", run.daemon.resident_mb, unit="MB", most=300.0)
    figures.add("twin: share of one core", 100 * run.twin.cpu_share, unit="%")
    figures.add("start to READY, the quickest of three warm ones", min(warm_s), unit="s", most=2.0)
    figures.add("start to READY, the slowest of them", max(warm_s), unit="s")
    figures.add("start to READY, cold", cold_s, unit="s")
    figures.add("load average of the machine while measured, 1 min", run.load_average)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="of each of the two runs, from READY (the probe moves after 5)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="the same figures for programs")
    options = parser.parse_args()
    runs = {name: run_demo(overrides, options.seconds) for name, overrides in ENCODERS.items()}
    forget_files()
    cold_s = start_s()
    warm_s = [start_s() for _ in range(3)]
    tables = [accuracy(run, name) for name, run in runs.items()]
    tables += [part(runs["white"]) for part in (behaviour, frames, latency)]
    tables.append(load(runs["white"], cold_s, warm_s))
    for table in tables:
        table.print()
    if options.json is not None:
        options.json.write_text(json.dumps({table.title: table.plain() for table in tables}, indent=1))


if __name__ == "__main__":
    main()
