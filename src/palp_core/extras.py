"""What an install may lack, and the words that say how to get it."""

from __future__ import annotations

import functools
import json
from pathlib import Path

DISTRIBUTION = "palp-core"
"""What to install; ``palp`` is the command, and on the public index somebody else's package."""

_EXTRA_OF = {
    "scipy": "rig",
    "pywt": "rig",
    "skfem": "rig",
    "serial": "rig",
    "can": "rig",
    "matplotlib": "rig",
    "jinja2": "rig",
    "statsmodels": "studies",
    "pandas": "studies",
    "rosbags": "rosbag",
    "rclpy": "ros2",
    "pyarrow": "parquet",
    "pylsl": "lsl",
    "edfio": "emg",
    "h5py": "emg",
    "pyxdf": "emg",
    "distributed": "dask",
    "foxglove": "foxglove",
    "nicegui": "view",
}
"""The extra that brings a module; a module of several has the smallest."""


def install_line(extra: str) -> str:
    """Return the command that installs an extra: from the checkout that palp was installed from, if any."""
    return f"pip install {_installed_from()}[{extra}]'"


@functools.cache
def _installed_from() -> str:
    """Return how the installer is told of palp, up to the extras."""
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import unquote, urlsplit

    try:
        said = json.loads(distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, OSError, ValueError):
        said = {}
    folder = Path(unquote(urlsplit(str(said.get("url", ""))).path))
    if "dir_info" not in said or not (folder / "pyproject.toml").is_file():
        return f"'{DISTRIBUTION}"
    return f"--editable '{folder}" if said["dir_info"].get("editable") else f"'{folder}"


def advice(missing: ImportError) -> str:
    """Return what to do about a module that is not installed; "" if no extra of palp brings it."""
    module = (missing.name or "").partition(".")[0]
    extra = _EXTRA_OF.get(module) if isinstance(missing, ModuleNotFoundError) else None
    return f"{module} is not installed; type: {install_line(extra)}" if extra else ""
