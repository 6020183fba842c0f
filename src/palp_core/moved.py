"""Where code is now that launch files, commands and bags made with earlier versions name."""

_MOVED = {
    "palp_core.bag.player": "palp_core.graph.replay.player",
    "palp_core.bag.record": "palp_core.graph.recording.recorder_node",
    "palp_core.devices.aerotech": "palp_core.palpation.devices.stage.aerotech",
    "palp_core.devices.ati": "palp_core.palpation.devices.torque.ati",
    "palp_core.devices.lsl": "palp_core.palpation.devices.emg.lsl",
    "palp_core.devices.maestro": "palp_core.palpation.devices.ring.maestro",
    "palp_core.devices.netft": "palp_core.palpation.devices.torque.netft",
    "palp_core.devices.noraxon": "palp_core.palpation.devices.emg.noraxon",
    "palp_core.devices.sim.emg": "palp_core.palpation.devices.sim.emg",
    "palp_core.devices.sim.ring": "palp_core.palpation.devices.sim.ring",
    "palp_core.devices.sim.stage": "palp_core.palpation.devices.sim.stage",
    "palp_core.devices.sim.torque": "palp_core.palpation.devices.sim.torque",
    "palp_core.devices.spikershield": "palp_core.palpation.devices.emg.spikershield",
    "palp_core.studies.report": "palp_core.palpation.session.report",
}


def present_name(name: str) -> str:
    """Return what ``module`` or ``module:attribute`` is called now.

    >>> present_name("palp_core.studies.report:session")
    'palp_core.palpation.session.report:session'
    >>> present_name("nodes.stage:Stage")
    'nodes.stage:Stage'
    """
    module, colon, attribute = name.partition(":")
    return _MOVED.get(module, module) + colon + attribute
