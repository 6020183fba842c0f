"""What an install may lack, and the words that say how to get it."""

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
    "rosbags": "ros2",
    "rclpy": "ros2",
    "pyarrow": "parquet",
    "pylsl": "lsl",
    "edfio": "emg",
    "h5py": "emg",
    "pyxdf": "emg",
    "ezc3d": "emg",
    "distributed": "dask",
    "foxglove": "foxglove",
    "nicegui": "view",
}
"""The extra that brings a module; a module of several has the smallest."""


def install_line(extra: str) -> str:
    """Return the command that installs an extra.

    >>> install_line("lsl")
    "pip install 'palp-core[lsl]'"
    """
    return f"pip install '{DISTRIBUTION}[{extra}]'"


def advice(missing: ImportError) -> str:
    """Return what to do about a module that is not installed; "" if no extra of palp brings it."""
    module = (missing.name or "").partition(".")[0]
    extra = _EXTRA_OF.get(module) if isinstance(missing, ModuleNotFoundError) else None
    return f"{module} is not installed; type: {install_line(extra)}" if extra else ""
