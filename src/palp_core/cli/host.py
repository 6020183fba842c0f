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

FEWEST_FILES = 1024
LEAST_DISK_BYTES = 200e6
LEAST_MEMORY_PART = 0.1
COARSEST_CLOCK_S = 1e-6
LARGEST_OFFSET_S = 0.1
CAP_SYS_NICE = 23
STA_UNSYNC, STA_NANO = 0x0040, 0x2000


def examine_host() -> Iterator[Trouble]:
    yield Trouble("host", OK, f"{platform.platform()}, Python {platform.python_version()}")
    yield _monotonic()
    yield _clock_source()
    yield _synchronised()
    yield from _cores()
    yield from _limits()
    yield _realtime()
    yield from _space()


def _monotonic() -> Trouble:
    resolution_s = time.get_clock_info("monotonic").resolution
    if resolution_s > COARSEST_CLOCK_S:
        return Trouble(
            "clock",
            WARN,
            f"the monotonic clock counts in steps of {resolution_s * 1e6:g} us",
            "boot the kernel with high-resolution timers",
        )
    return Trouble("clock", OK, f"the monotonic clock resolves {resolution_s * 1e9:g} ns")


def _clock_source() -> Trouble:
    path = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    try:
        source = path.read_text().strip()
    except OSError:
        return Trouble("clock", NOTE, "the kernel's clock source is not known here")
    if source in ("hpet", "acpi_pm", "jiffies", "refined-jiffies"):
        return Trouble(
            "clock", WARN, f"clock source {source} is slow to read", "see why the kernel gave up tsc: dmesg"
        )
    return Trouble("clock", OK, f"clock source {source}")


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
    if answer < 0:
        return Trouble("clock", NOTE, "the kernel does not report whether the wall clock is synchronised")
    if state.status & STA_UNSYNC:
        return Trouble(
            "clock",
            NOTE,
            "the wall clock is not synchronised by NTP; runs use the monotonic one, but records of several "
            "hosts cannot be laid side by side",
            "run chronyd or systemd-timesyncd",
        )
    offset_s = state.offset / (1e9 if state.status & STA_NANO else 1e6)
    text = (
        f"the wall clock is {offset_s * 1e3:.3f} ms from NTP, at most {state.maxerror / 1e3:.1f} ms in error"
    )
    if abs(offset_s) > LARGEST_OFFSET_S:
        return Trouble("clock", WARN, text, "wait until it has settled before recording on several hosts")
    return Trouble("clock", OK, text)


def _cores() -> Iterator[Trouble]:
    total, usable = os.cpu_count() or 1, len(os.sched_getaffinity(0))
    yield Trouble("cores", OK, f"{usable} of {total} usable")
    load = os.getloadavg()[0]
    if load > usable:
        yield Trouble(
            "cores",
            WARN,
            f"load {load:.1f} on {usable} cores: nodes wait for a core, latencies and overruns grow",
            "end other work, or run in simulated time, which does not depend on load",
        )
    else:
        yield Trouble("cores", OK, f"load {load:.1f}")
    governors = set()
    for path in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"):
        with contextlib.suppress(OSError):
            governors.add(path.read_text().strip())
    if governors - {"performance"}:
        yield Trouble(
            "cores",
            NOTE,
            f"frequency governor {', '.join(sorted(governors))}: a core may be slow when a message wakes it",
            "for a rig: cpupower frequency-set -g performance",
        )
    elif governors:
        yield Trouble("cores", OK, "frequency governor performance")


def _limits() -> Iterator[Trouble]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < FEWEST_FILES:
        yield Trouble(
            "limits", WARN, f"{soft} open files", f"ulimit -n {min(hard, 65536) if hard > 0 else 65536}"
        )
    else:
        yield Trouble("limits", OK, f"{soft} open files")
    processes = resource.getrlimit(resource.RLIMIT_NPROC)[0]
    if 0 <= processes < 256:
        yield Trouble("limits", WARN, f"{processes} processes and threads", "ulimit -u 4096")
    else:
        yield Trouble("limits", OK, "processes: " + ("unlimited" if processes < 0 else str(processes)))


def _realtime() -> Trouble:
    """Tell whether SCHED_FIFO would be granted, without asking for it."""
    priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    capable = any(
        line.startswith("CapEff:") and int(line.split()[1], 16) >> CAP_SYS_NICE & 1
        for line in Path("/proc/self/status").read_text().splitlines()
    )
    if capable or priority > 0 or priority == resource.RLIM_INFINITY:
        return Trouble(
            "limits", OK, "real-time priority is allowed" + ("" if capable else f" up to {priority}")
        )
    return Trouble(
        "limits",
        NOTE,
        "real-time priority is not allowed: realtime_priority in a launch file will have no effect",
        "as root: a line '@palp - rtprio 80' in /etc/security/limits.conf, then log in again",
    )


def _space() -> Iterator[Trouble]:
    memory = psutil.virtual_memory()
    text = f"{memory.available / 1e9:.1f} of {memory.total / 1e9:.1f} GB free"
    if memory.available < LEAST_MEMORY_PART * memory.total:
        yield Trouble("memory", WARN, text, "end other work: a node that is swapped out misses its deadlines")
    else:
        yield Trouble("memory", OK, text)
    base = runtime_folder()
    folder = next(path for path in [base, *base.parents] if path.exists())
    free = psutil.disk_usage(str(folder)).free
    if not os.access(folder, os.W_OK | os.X_OK):
        yield Trouble(
            str(folder),
            ERROR,
            "run directories cannot be made here",
            "set XDG_RUNTIME_DIR to a folder of yours",
        )
    elif free < LEAST_DISK_BYTES:
        yield Trouble(str(folder), WARN, f"{free / 1e6:.0f} MB free for logs", "make room")
    else:
        yield Trouble(str(folder), OK, f"{free / 1e9:.1f} GB free for run directories")


def examine_runs() -> Iterator[Trouble]:
    over = {str(folder): record.graph for folder, record, lives in runs() if not lives}
    orphans = list(_orphans(over))
    yield from orphans
    yield from _foreign()
    if not orphans:
        yield Trouble("processes", OK, "no orphans: every process of a run has its launcher")
    if over:
        names = ", ".join(sorted(Path(folder).name for folder in over))
        yield Trouble(
            str(runtime_folder()),
            OK,
            f"{counted(len(over), 'run directory', 'run directories')} of runs that are over; the "
            f"latest {KEEP_ENDED} are kept: {names} "
            f"({KEEP_ENDED_BYTES >> 20} MiB of logs at most)",
        )


def _foreign() -> Iterator[Trouble]:
    """Find what is among the run directories and may be another user's: no verb looks into it."""
    base = runtime_folder()
    for folder in sorted(base.iterdir()) if base.is_dir() else ():
        with contextlib.suppress(FileNotFoundError):  # a run has just ended
            if mistake := folder_mistake(folder):
                yield Trouble(str(base), WARN, f"{mistake}; it is passed over", "find out who put it there")


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
        yield Trouble(
            f"process {process.pid}",
            ERROR,
            f"an orphan of graph '{over[held]}' ({held}): its launcher is gone ({name})",
            f"if it is still there in a few seconds: kill {process.pid}",
        )


def _held(pid: int) -> Iterator[str]:
    """Yield the folders, and folders of folders, of the files that a process has open."""
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = Path(str(link.readlink()).removesuffix(" (deleted)"))
        except OSError:
            continue
        if target.is_absolute():
            yield from map(str, (target, *target.parents[:2]))
