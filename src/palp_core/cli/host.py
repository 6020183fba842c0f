"""What may harm a run here: clock, cores, limits, memory, disk; what earlier runs have left."""

import contextlib
import os
import platform
import resource
from collections.abc import Iterator
from pathlib import Path

import psutil

from palp_core.counted import counted
from palp_core.graph.discovery.run_directory import KEEP_ENDED, KEEP_ENDED_BYTES, runs
from palp_core.graph.discovery.troubles import ERROR, NOTE, OK, WARN, Trouble
from palp_core.user_folders import folder_mistake, runtime_folder

FEWEST_FILES, FEWEST_PROCESSES = 1024, 256
LEAST_DISK_BYTES = 200e6
LEAST_MEMORY_PART = 0.1
CAP_SYS_NICE = 23
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")


def _found(where: str, text: str, *, bad: bool = False, level: str = WARN, advice: str = "") -> Trouble:
    """Return what was looked at: ok, or if it is bad, of this level and with advice."""
    return Trouble(where, level, text, advice) if bad else Trouble(where, OK, text)


def examine_host() -> Iterator[Trouble]:
    yield _found("host", f"{platform.platform()}, Python {platform.python_version()}")
    yield from _clock()
    yield from _cores()
    yield from _limits()
    yield from _space()


def _clock() -> Iterator[Trouble]:
    with contextlib.suppress(OSError):
        path = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
        source = path.read_text().strip()
        advice = "slow to read; see why the kernel gave up tsc: dmesg"
        yield _found("clock", f"clock source {source}", bad=source in SLOW_CLOCKS, advice=advice)


def _cores() -> Iterator[Trouble]:
    total, usable, load = os.cpu_count() or 1, len(os.sched_getaffinity(0)), os.getloadavg()[0]
    yield _found("cores", f"{usable} of {total} usable")
    yield _found(
        "cores",
        f"load {load:.1f} on {usable} cores",
        bad=load > usable,
        advice="end other work, or run in simulated time: nodes wait for a core, latencies and overruns grow",
    )
    governors = set()
    for path in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"):
        with contextlib.suppress(OSError):
            governors.add(path.read_text().strip())
    if governors:
        yield _found(
            "cores",
            f"frequency governor {', '.join(sorted(governors))}",
            bad=governors != {"performance"},
            level=NOTE,
            advice="a core may wake slowly; for a rig: cpupower frequency-set -g performance",
        )


def _limits() -> Iterator[Trouble]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    advice = f"ulimit -n {min(hard, 65536) if hard > 0 else 65536}"
    yield _found("limits", f"{soft} open files", bad=0 <= soft < FEWEST_FILES, advice=advice)
    most = resource.getrlimit(resource.RLIMIT_NPROC)[0]
    few = 0 <= most < FEWEST_PROCESSES
    yield _found(
        "limits", f"processes: {'unlimited' if most < 0 else most}", bad=few, advice="ulimit -u 4096"
    )
    priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    status = Path("/proc/self/status").read_text().partition("CapEff:")[2].split()
    allowed = priority != 0 or bool(status and int(status[0], 16) >> CAP_SYS_NICE & 1)
    yield _found(
        "limits",
        f"real-time priority is {'allowed' if allowed else 'not allowed: realtime_priority has no effect'}",
        bad=not allowed,
        level=NOTE,
        advice="as root: a line '@palp - rtprio 80' in /etc/security/limits.conf, then log in again",
    )


def _space() -> Iterator[Trouble]:
    memory = psutil.virtual_memory()
    yield _found(
        "memory",
        f"{memory.available / 1e9:.1f} of {memory.total / 1e9:.1f} GB free",
        bad=memory.available < LEAST_MEMORY_PART * memory.total,
        advice="end other work: a node that is swapped out misses its deadlines",
    )
    base = runtime_folder()
    folder = next(path for path in [base, *base.parents] if path.exists())
    if not os.access(folder, os.W_OK | os.X_OK):
        text = "run directories cannot be made here"
        yield Trouble(str(folder), ERROR, text, "set XDG_RUNTIME_DIR to a folder of yours")
        return
    free = psutil.disk_usage(str(folder)).free
    text = f"{free / 1e9:.1f} GB free for run directories"
    yield _found(str(folder), text, bad=free < LEAST_DISK_BYTES, advice="make room for logs")


def examine_runs() -> Iterator[Trouble]:
    yield from _foreign()
    if over := [folder for folder, _, lives in runs() if not lives]:
        names = ", ".join(sorted(folder.name for folder in over))
        count = counted(len(over), "run directory", "run directories")
        kept = f"the latest {KEEP_ENDED} are kept: {names} ({KEEP_ENDED_BYTES >> 20} MiB of logs at most)"
        yield _found(str(runtime_folder()), f"{count} of runs that are over; {kept}")


def _foreign() -> Iterator[Trouble]:
    """Find what is among the run directories and may be another user's: no verb looks into it."""
    base = runtime_folder()
    for folder in sorted(base.iterdir()) if base.is_dir() else ():
        with contextlib.suppress(FileNotFoundError):  # a run has just ended
            if mistake := folder_mistake(folder):
                yield Trouble(
                    str(base), WARN, f"{mistake}; it is passed over", "find out which user created it"
                )
