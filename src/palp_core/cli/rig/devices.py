"""``palp devices``: which devices there are, whether one answers, emulated ones, and what one measures."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from palp_core.cli.options import JsonOption, argument, option, until_ctrl_c
from palp_core.cli.output import note, print_json, show
from palp_core.errors import DeviceError

app = typer.Typer()

RAISED_M = 0.020  # where an emulated rig begins: a sensor is tared while the probe hangs free
KINDS = ("stage", "ring", "torque", "emg")
MOVES = {
    "stage": "the stage moves up to 20 mm to either side of y = 0, and raises and lowers the probe",
    "ring": "the ring moves up to 10 mm",
}
"""What the contract of a kind moves."""
DeviceArgument = Annotated[str, argument("Its name, as list prints it, or a driver: MODULE:CLASS.", "DEVICE")]
OptionsArgument = Annotated[
    list[str] | None, argument("Options of its driver, as in a launch file.", "[name:=value]...")
]

FirstDataOption = Annotated[
    float, option("Longest wait for a sensor's first data.", "--patience", metavar="S")
]
FIRST_DATA_S = 5.0


@app.command("list")
def list_devices(
    drivers: Annotated[
        list[str] | None, argument("Your own drivers; default: those palp knows.", "[MODULE:CLASS]...")
    ] = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """List the devices that have a driver, with its options."""
    from palp_core.cli.rig.device_discovery import device_entries

    found = device_entries([_from_workspace(driver) for driver in drivers or ()])
    wide = max(len(device.name) for device in found)
    lines = []
    for device in found:
        lines.append(f"{device.name:<{wide}}  {device.kind:<6}  {device.link}")
        for name, default in device.options.items() if drivers else ():
            lines.append(f"  {name}" + (f" (default: {default})" if default else ""))
    entries = [{"kind": d.kind, "device": d.name, "options": d.options, "link": d.link} for d in found]
    show(entries, lines, as_json=as_json)


@app.command("probe")
def probe(
    device: DeviceArgument,
    options: OptionsArgument = None,
    *,
    patience: FirstDataOption = FIRST_DATA_S,
    as_json: JsonOption = False,
) -> None:
    """Test whether a device answers; nothing moves.

    Status 1: it does not answer.
    """
    from palp_core.cli.rig.device_discovery import discover, unverified

    device, given = _from_workspace(device), _options(options)
    try:
        with until_ctrl_c():
            found = discover(device, given, patience)
            open_points = unverified(device, given)
    except DeviceError as error:
        if as_json:
            print_json({"device": device, "answers": False, "text": str(error)})
        else:
            note(str(error))
        sys.exit(1)
    show(
        {"device": device, "answers": True, **found, "unverified": open_points},
        [
            f"{device} answers",
            *(f"  {name}: {_number(value)}" for name, value in found.items()),
            *(f"  not verified: {name}: {check}" for name, check in open_points.items()),
        ],
        as_json=as_json,
    )


@app.command("emulate")
def emulate(
    devices: Annotated[list[str] | None, argument("Which; default: a whole rig.", "[DEVICE]...")] = None,
    *,
    host: Annotated[str, option("Address of their TCP ports.")] = "127.0.0.1",
    phantoms: Annotated[Path | None, option("YAML file of phantoms by code.")] = None,
    seed: Annotated[int, option("Random seed.")] = 1,
    settings: Annotated[
        str, option("All of RigSettings, in place of the options above.", metavar="JSON")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Start emulated devices and print their options.

    Then obey lines: fault DEVICE NAME, clear DEVICE, disconnect DEVICE, connect DEVICE, mount CODE,
    load N_MM, truth, axes, log SINCE_NS, stop-link, quit.
    """
    from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
    from palp_core.palpation.devices.emulator.axis import AxisSettings
    from palp_core.palpation.devices.emulator.commands import read_settings, serve
    from palp_core.palpation.devices.emulator.contact import ContactSettings

    sys.setswitchinterval(0.0005)  # the solver's thread must not hold up the wires
    raised = AxisSettings(soft_low_m=-0.001, home_m=RAISED_M)
    contact = ContactSettings(touch={} if phantoms is None else {"phantoms": str(phantoms)})
    given = RigSettings(contact=contact, z_axis=raised, seed=seed, host=host)
    if settings:
        given = read_settings(settings)
    rig = EmulatedRig(given, devices) if devices else EmulatedRig(given)
    with until_ctrl_c(), rig:
        lines = [
            f"{name} " + " ".join(f"{key}:={_text(value)}" for key, value in options.items())
            for name, options in rig.options.items()
        ]
        if rig.stop_link:
            lines.append(f"aerotech's second port: {rig.stop_link}")
        show(rig.options, lines, as_json=as_json)
        sys.stdout.flush()
        serve(rig, sys.stdin, sys.stdout)


@app.command("monitor")
def monitor(
    device: DeviceArgument,
    options: OptionsArgument = None,
    *,
    seconds: Annotated[float, option("How long; 0: until Ctrl-C.", "--for", metavar="S")] = 0.0,
    every: Annotated[float, option("How often a line.", metavar="S", min=0.05)] = 1.0,
    patience: FirstDataOption = FIRST_DATA_S,
    as_json: JsonOption = False,
) -> None:
    """Show a sensor's rate, gaps, drift, mean and spread."""
    from palp_core.cli.rig.device_discovery import unverified, watch

    device, given, noted = _from_workspace(device), _options(options), False
    with until_ctrl_c():
        for row in watch(device, given, seconds, every, patience):
            if not noted:
                noted = True
                for name, check in unverified(device, given).items():
                    note(f"not verified: {name}: {check}")
            line = "  ".join(f"{name} {_number(value)}" for name, value in row.items())
            show(row, [line], as_json=as_json)
            sys.stdout.flush()


@app.command("contract")
def contract(
    device: DeviceArgument,
    options: OptionsArgument = None,
    *,
    moves: Annotated[bool, option("It may move, as far as is printed without this.", "--moves")] = False,
    simulated: Annotated[
        bool, option("It follows the time it is given, not the machine's.", "--sim")
    ] = False,
    patience: Annotated[float, option("Longest wait for what it does.", metavar="S", min=1.0)] = 60.0,
    as_json: JsonOption = False,
) -> None:
    """Check a driver against the contract of its kind.

    Status 1: it breaks a promise.
    """
    from palp_core.cli.rig.device_discovery import why_broken
    from palp_core.palpation.devices.contract import Subject, promises_of
    from palp_core.palpation.devices.registry import kind_of

    device, given = _from_workspace(device), _options(options)
    kind = kind_of(device)
    if kind in MOVES and not (moves or simulated):
        raise DeviceError(
            f"{device}: {MOVES[kind]}; clear the way and add --moves, or --sim if nothing moves"
        )
    broken = []
    with until_ctrl_c():
        for promise, check in promises_of(kind).items():
            why = why_broken(check, Subject(kind, device, given, simulated, patience))
            broken += [promise] if why else []
            line = f"BROKEN  {promise}\n        {why}" if why else f"kept    {promise}"
            show({"promise": promise, "kept": not why, "text": why}, [line], as_json=as_json)
            sys.stdout.flush()
    if broken:
        sys.exit(1)


def _from_workspace(device: str) -> str:
    """Return a driver, a module of which is looked for in the workspace one is in."""
    if ":" in device:
        from palp_core.graph.description.launch_file import find_workspace
        from palp_core.graph.node.loading import enter_workspace

        enter_workspace(find_workspace(Path("x")))
    return device


def _options(words: list[str] | None) -> dict[str, Any]:
    from palp_core.cli.values import assignments
    from palp_core.graph.discovery.message_yaml import parse_yaml

    return {name: parse_yaml(value, name) for name, value in assignments("option", words).items()}


def _text(value: Any) -> str:
    """Return a value so that a shell and YAML read it again."""
    return str(value) if isinstance(value, str) else "'" + json.dumps(value) + "'"


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
