"""Where code is now that launch files, commands and bags made with earlier versions name."""

_MOVED = {
    "palp_core.bag.player": "palp_core.graph.replay.player",
    "palp_core.bag.record": "palp_core.graph.recording.recorder_node",
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
