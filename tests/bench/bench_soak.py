"""The demo for a long time: is memory flat, and is anything left over?

Every ten seconds the daemon's resident memory, threads, tasks, open files and fixes are looked at; the slope of the memory is a
straight line through what was seen after the first two minutes. At the end the daemon is told to stop, and what is left of its
processes and temporary files is told.

    python tests/bench/bench_soak.py [--minutes 30] [--patient] [--csv FILE]
"""

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import psutil
import zenoh
from judge import Message
from system.cell import DEADLINE_S, DEMO, PATIENT, children, free_port, listen, zenoh_client

PERIOD_S = 10.0
SETTLE_S = 120.0
STALLED = (*PATIENT, "twin.path.dwell_s=30")  # time enough to prove the axes again while the probe stands still


@dataclass(frozen=True, slots=True)
class Sample:
    t_s: float
    resident_mb: float
    twin_mb: float
    threads: int
    tasks: int
    open_files: int
    fixes: int  # since the start
    valid: int
    cpu_share: float
    trouble: str  # what keeps the axes from following


@contextmanager
def demo(folder: Path, overrides: Sequence[str]) -> Iterator[tuple["subprocess.Popen[bytes]", zenoh.Session]]:
    port = free_port()
    command = [sys.executable, "-m", "trackerd", "--config", str(DEMO), "--set", listen(port)]
    command += [word for override in overrides for word in ("--set", override)]
    with (folder.parent / "words").open("wb") as words:
        process = subprocess.Popen(command, stdout=words, stderr=words, env=os.environ | {"TMPDIR": str(folder)})
    try:
        with zenoh_client(port) as session:
            yield process, session
    finally:
        if process.poll() is None:
            process.kill()


def status(session: zenoh.Session) -> Message | None:
    """The daemon's answer, or None while there is none."""
    for reply in session.get("twin/probe/status", timeout=5.0):
        if reply.ok is not None:
            told: Message = json.loads(reply.ok.payload.to_bytes())
            return told
    return None


def sample(began: float, process: psutil.Process, told: Message) -> Sample:
    twin = psutil.Process(told["twin"]["pid"])
    return Sample(
        t_s=round(time.monotonic() - began, 1),
        resident_mb=process.memory_info().rss / 2**20,
        twin_mb=twin.memory_info().rss / 2**20,
        threads=process.num_threads(),
        tasks=told["daemon"]["tasks"],
        open_files=process.num_fds(),
        fixes=told["published"]["fixes"],
        valid=told["published"]["valid"],
        cpu_share=told["daemon"]["cpu_share"],
        trouble="; ".join(f"{name} {axes['state']}: {axes['reason']}" for name, axes in astray(told)),
    )


def astray(told: Message) -> list[tuple[str, Message]]:
    stations = ((name, station["axes"]) for name, station in told["stations"].items())
    return [(name, axes) for name, axes in stations if axes["state"] != "following"]


def samples(process: psutil.Process, session: zenoh.Session, minutes: float) -> Iterator[Sample]:
    began = time.monotonic()
    for n in range(1, round(minutes * 60.0 / PERIOD_S) + 1):
        time.sleep(max(0.0, began + n * PERIOD_S - time.monotonic()))
        told = status(session)
        if told is not None and "daemon" in told:
            yield sample(began, process, told)


def watch(minutes: float, overrides: Sequence[str]) -> tuple[list[Sample], list[str]]:
    """What was seen, and what was left over."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "tmp"
        folder.mkdir()
        with demo(folder, overrides) as (process, session):
            seen, last = [], None
            print("    t s   MB  twin MB  threads  tasks  files   fixes  valid %  cpu %")
            for one in samples(psutil.Process(process.pid), session, minutes):
                seen.append(one)
                print(line(one, last), flush=True)
                last = one
            family = children(process.pid)
            process.send_signal(signal.SIGTERM)
            status_of_exit = process.wait(DEADLINE_S)
        left = [f"process {p.pid}: {' '.join(p.cmdline()[:4])}" for p in psutil.wait_procs(family, timeout=DEADLINE_S)[1]]
        left += [f"file {path.name}" for path in folder.iterdir()]
        if status_of_exit:
            left.append(f"exit status {status_of_exit}: {(folder.parent / 'words').read_text()[-2000:]}")
    return seen, left


def line(now: Sample, before: Sample | None) -> str:
    """The share of valid fixes is that of the time since the line before."""
    fixes = now.fixes - (before.fixes if before else 0)
    valid = 100.0 * (now.valid - (before.valid if before else 0)) / fixes if fixes else float("nan")
    return (
        f"{now.t_s:7.0f} {now.resident_mb:4.0f} {now.twin_mb:8.0f} {now.threads:8} {now.tasks:6} {now.open_files:6}"
        f" {now.fixes:7} {valid:8.1f} {100 * now.cpu_share:6.0f}  {now.trouble}"
    )


def slope_mb_h(seen: Sequence[Sample], what: str) -> tuple[float, float]:
    """After the first two minutes: MB an hour and its 1 sigma; NaN from fewer than three samples."""
    settled = [one for one in seen if one.t_s >= SETTLE_S]
    if len(settled) < 3:
        return float("nan"), float("nan")
    hours = np.array([one.t_s / 3600.0 for one in settled])
    line_mb, cov = np.polyfit(hours, [getattr(one, what) for one in settled], 1, cov="unscaled")
    residuals = np.array([getattr(one, what) for one in settled]) - np.polyval(line_mb, hours)
    sigma = np.sqrt(cov[0, 0] * (residuals**2).sum() / (len(settled) - 2))
    return float(line_mb[0]), float(sigma)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--patient", action="store_true", help="a stalled machine costs fixes, but not the run")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="the samples")
    options = parser.parse_args()
    seen, left = watch(options.minutes, STALLED if options.patient else ())
    for what in ("resident_mb", "twin_mb"):
        slope, sigma = slope_mb_h(seen, what)
        print(f"{what}: {slope:+.2f} +- {sigma:.2f} MB/h after the first {SETTLE_S / 60:.0f} minutes")
    for what in ("threads", "tasks", "open_files"):
        values = [getattr(one, what) for one in seen]
        print(f"{what}: {min(values)} to {max(values)}, {values[-1]} at the end")
    valid, fixes = seen[-1].valid, seen[-1].fixes
    print(f"fixes: {fixes}, {100 * valid / max(1, fixes):.1f} % valid; load average {os.getloadavg()[0]:.1f}")
    print("left over: " + ("; ".join(left) or "nothing"))
    if options.csv is not None:
        with options.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(Sample)])
            writer.writeheader()
            writer.writerows(asdict(one) for one in seen)


if __name__ == "__main__":
    main()
