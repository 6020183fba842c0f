"""What may harm a run here: clock, cores, limits, memory, disk; what earlier runs have left."""

import contextlib
import ctypes
import os
import platform
import resource
import time
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
COARSEST_CLOCK_S = 1e-6
LARGEST_OFFSET_S = 0.1
CAP_SYS_NICE = 23
STA_UNSYNC, STA_NANO = 0x0040, 0x2000
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")


def _found(where: str, text: str, *, bad: bool = False, level: str = WARN, advice: str = "") -> Trouble:
    """Return what was looked at: ok, or if it is bad, of this level and with advice."""
    return Trouble(where, level, text, advice) if bad else Trouble(where, OK, text)


def examine_host() -> Iterator[Trouble]:
    yield _found("host", f"{platform.platform()}, Python {platform.python_version()}")
    yield from _clocks()
    yield from _cores()
    yield from _limits()
    yield from _space()


def _clocks() -> Iterator[Trouble]:
    step_s = time.get_clock_info("monotonic").resolution
    yield _found(
        "clock",
        f"the monotonic clock resolves {step_s * 1e9:g} ns",
        bad=step_s > COARSEST_CLOCK_S,
        advice="boot the kernel with high-resolution timers",
    )
    with contextlib.suppress(OSError):
        path = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
        source = path.read_text().strip()
        advice = "slow to read; see why the kernel gave up tsc: dmesg"
        yield _found("clock", f"clock source {source}", bad=source in SLOW_CLOCKS, advice=advice)
    yield _synchronised()


class _Timex(ctypes.Structure):
    """The part of Linux' ``struct timex`` (adjtimex(2)) up to the status; the rest is padding."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


def _synchronised() -> Trouble:
    """Ask the kernel what its NTP discipline knows; a mode of 0 changes nothing."""
    state = _Timex()
    try:
        answer = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(state))
    except (OSError, AttributeError):
        answer = -1
    if answer < 0 or state.status & STA_UNSYNC:
        text = (
            "the wall clock is not synchronised by NTP: records of several hosts cannot be compared in time"
        )
        return Trouble("clock", NOTE, text, "run chronyd or systemd-timesyncd")
    offset_s = state.offset / (1e9 if state.status & STA_NANO else 1e6)
    return _found(
        "clock",
        f"the wall clock is {offset_s * 1e3:.3f} ms from NTP, at most {state.maxerror / 1e3:.1f} ms in error",
        bad=abs(offset_s) > LARGEST_OFFSET_S,
        advice="wait until it has settled before recording on several hosts",
    )


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
    over = {str(folder): record.graph for folder, record, lives in runs() if not lives}
    orphans = list(_orphans(over))
    yield from orphans
    yield from _foreign()
    if not orphans:
        yield _found("processes", "no orphans: every process of a run has its launcher")
    if over:
        names = ", ".join(sorted(Path(folder).name for folder in over))
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


def _orphans(over: dict[str, str]) -> Iterator[Trouble]:
    """Find living processes that hold a file in the directory of a run that is over."""
    for process in psutil.process_iter(["uids"]) if over else ():
        try:
            if process.pid == os.getpid() or process.info["uids"].real != os.getuid():
                continue
            held = next((folder for folder in _held(process.pid) if folder in over), None)
            if held is None or process.status() == psutil.STATUS_ZOMBIE:
                continue
            name = " ".join(process.cmdline()[:4])
        except (psutil.Error, OSError, TypeError, AttributeError):
            continue
        text = f"an orphan of graph '{over[held]}' ({held}): its launcher is gone ({name})"
        advice = f"if it is still there in a few seconds: kill {process.pid}"
        yield Trouble(f"process {process.pid}", ERROR, text, advice)


def _held(pid: int) -> Iterator[str]:
    """Yield the folders, and folders of folders, of the files that a process has open."""
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = Path(str(link.readlink()).removesuffix(" (deleted)"))
        except OSError:
            continue
        if target.is_absolute():
            yield from map(str, (target, *target.parents[:2]))
