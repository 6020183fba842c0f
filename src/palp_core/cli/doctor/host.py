"""What the machine itself may do to a run: clock, cores, limits, memory, disk."""

import contextlib
import ctypes
import os
import platform
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from palp_core.cli.doctor.diagnostic import Diagnostic, error, fine, remark, warning
from palp_core.user_folders import runtime_folder

FEWEST_FILES = 1024
LEAST_DISK_BYTES = 200e6
LEAST_MEMORY_PART = 0.1
COARSEST_CLOCK_S = 1e-6
LARGEST_OFFSET_S = 0.1
CAP_SYS_NICE = 23
STA_UNSYNC, STA_NANO = 0x0040, 0x2000


def examine_host() -> Iterator[Diagnostic]:
    """Yield findings about this machine."""
    yield fine("host", f"{platform.platform()}, Python {platform.python_version()}")
    yield _monotonic()
    yield _clock_source()
    yield _synchronised()
    yield from _cores()
    yield from _limits()
    yield _realtime()
    yield from _space()


def _monotonic() -> Diagnostic:
    resolution_s = time.get_clock_info("monotonic").resolution
    if resolution_s > COARSEST_CLOCK_S:
        return warning(
            "clock",
            f"the monotonic clock counts in steps of {resolution_s * 1e6:g} us",
            "boot the kernel with high-resolution timers",
        )
    return fine("clock", f"the monotonic clock resolves {resolution_s * 1e9:g} ns")


def _clock_source() -> Diagnostic:
    path = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    try:
        source = path.read_text().strip()
    except OSError:
        return remark("clock", "the kernel's clock source is not known here")
    if source in ("hpet", "acpi_pm", "jiffies", "refined-jiffies"):
        return warning(
            "clock", f"clock source {source} is slow to read", "see why the kernel gave up tsc: dmesg"
        )
    return fine("clock", f"clock source {source}")


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


def _synchronised() -> Diagnostic:
    """Ask the kernel what its NTP discipline knows; a mode of 0 changes nothing."""
    state = _Timex()
    try:
        answer = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(state))
    except (OSError, AttributeError):
        answer = -1
    if answer < 0:
        return remark("clock", "the kernel does not tell whether the wall clock is synchronised")
    if state.status & STA_UNSYNC:
        return remark(
            "clock",
            "the wall clock is not synchronised by NTP; runs use the monotonic one, but records of several "
            "hosts cannot be laid side by side",
            "run chronyd or systemd-timesyncd",
        )
    offset_s = state.offset / (1e9 if state.status & STA_NANO else 1e6)
    said = (
        f"the wall clock is {offset_s * 1e3:.3f} ms from NTP, at most {state.maxerror / 1e3:.1f} ms in error"
    )
    if abs(offset_s) > LARGEST_OFFSET_S:
        return warning("clock", said, "wait until it has settled before recording on several hosts")
    return fine("clock", said)


def _cores() -> Iterator[Diagnostic]:
    total, usable = os.cpu_count() or 1, len(os.sched_getaffinity(0))
    yield fine("cores", f"{usable} of {total} usable")
    load = os.getloadavg()[0]
    if load > usable:
        yield warning(
            "cores",
            f"load {load:.1f} on {usable} cores: nodes wait for a core, latencies and overruns grow",
            "end other work, or run in simulated time, which does not depend on load",
        )
    else:
        yield fine("cores", f"load {load:.1f}")
    governors = set()
    for path in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"):
        with contextlib.suppress(OSError):
            governors.add(path.read_text().strip())
    if governors - {"performance"}:
        yield remark(
            "cores",
            f"frequency governor {', '.join(sorted(governors))}: a core may be slow when a message wakes it",
            "for a rig: cpupower frequency-set -g performance",
        )
    elif governors:
        yield fine("cores", "frequency governor performance")


def _limits() -> Iterator[Diagnostic]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < FEWEST_FILES:
        yield warning("limits", f"{soft} open files", f"ulimit -n {min(hard, 65536) if hard > 0 else 65536}")
    else:
        yield fine("limits", f"{soft} open files")
    processes = resource.getrlimit(resource.RLIMIT_NPROC)[0]
    if 0 <= processes < 256:
        yield warning("limits", f"{processes} processes and threads", "ulimit -u 4096")
    else:
        yield fine("limits", "processes: " + ("unlimited" if processes < 0 else str(processes)))


def _realtime() -> Diagnostic:
    """Tell whether SCHED_FIFO would be granted, without asking for it."""
    priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    capable = any(
        line.startswith("CapEff:") and int(line.split()[1], 16) >> CAP_SYS_NICE & 1
        for line in Path("/proc/self/status").read_text().splitlines()
    )
    if capable or priority > 0 or priority == resource.RLIM_INFINITY:
        return fine("limits", "real-time priority is allowed" + ("" if capable else f" up to {priority}"))
    return remark(
        "limits",
        "real-time priority is not allowed: realtime_priority in a launch file will have no effect",
        "as root: a line '@palp - rtprio 80' in /etc/security/limits.conf, then log in anew",
    )


def _space() -> Iterator[Diagnostic]:
    memory = psutil.virtual_memory()
    said = f"{memory.available / 1e9:.1f} of {memory.total / 1e9:.1f} GB free"
    if memory.available < LEAST_MEMORY_PART * memory.total:
        yield warning("memory", said, "end other work: a node that is swapped out misses its deadlines")
    else:
        yield fine("memory", said)
    base = runtime_folder()
    folder = next(path for path in [base, *base.parents] if path.exists())
    free = psutil.disk_usage(str(folder)).free
    if not os.access(folder, os.W_OK | os.X_OK):
        yield error(
            str(folder), "run directories cannot be made here", "set XDG_RUNTIME_DIR to a folder of yours"
        )
    elif free < LEAST_DISK_BYTES:
        yield warning(str(folder), f"{free / 1e6:.0f} MB free for logs", "make room")
    else:
        yield fine(str(folder), f"{free / 1e9:.1f} GB free for run directories")
