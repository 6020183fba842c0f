"""What stops the stage when processes die, and what is left to the emergency stop, in words for a person."""

from palp_core.palpation.devices.protocols import StopLink

_LEFT = "goes on to the end of the move it was sent, a whole sweep at most, or segment_m of the stage"
_GUARDED = (
    "whichever one or two processes are killed, the stage is stopped at once; if the host or the controller's"
    f" link fails as a whole (power, kernel, cable), or three processes are killed at once, it {_LEFT}"
)
_ONE_LINK = (
    "whichever process is killed, the stage is stopped at once; if the host or the link fails as a whole, or"
    f" the link's guard is killed together with the stage's node or the fork server, it {_LEFT}"
)
_UNGUARDED = (
    "the second link has no guard: if the fork server is killed, or the safety and stage nodes at once, the"
    f" stage {_LEFT}, unless its own link is guarded"
)


def dead_man(link: StopLink | None) -> str:
    """Return what holds for a stage with this second link; None: it has but one."""
    if link is None:
        return _ONE_LINK
    return _GUARDED if link.guarded else _UNGUARDED
