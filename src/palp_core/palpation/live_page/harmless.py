"""What may be seen of a blinded session: what tells neither depth nor accuracy.

No torque is among it: its peak is what the depth is told by. A phantom's code is, for somebody has to put it
on: those of a blinded session are drawn for it, and say nothing.
"""

from __future__ import annotations

from palp_core.view.source.blind import WHOLE, Harmless

HARMLESS = Harmless(
    fields={
        "StagePose": (WHOLE,),
        "SweepGoal": (WHOLE,),
        "SweepStatus": (WHOLE,),
        "RingCommand": (WHOLE,),
        "RingState": (WHOLE,),
        "Mount": (WHOLE,),
        "Prompt": (WHOLE,),  # which phantom to put on, by its code
        "Trial": ("stamp_ns", "trial", "phase", "number"),
        "TrialResult": ("stamp_ns", "trial", "probe_count", "verdict"),
        "Progress": ("stamp_ns", "phase", "done_count", "total_count"),
        "EmgBlock": (WHOLE,),
        "EmgReport": (WHOLE,),
        "CoContraction": (WHOLE,),
        "SafetyBeat": (
            "stamp_ns",
            "state",
            "permits",
            "acknowledged_count",
            "cause",
            "text",
        ),  # a warning has torques
        "StageReport": (WHOLE,),
        "RingReport": (WHOLE,),
        "Trip": ("stamp_ns", "cause", "text", "cause_ns", "written_ns", "disabled_ns"),
        "LoadReport": ("stamp_ns", "sample_ns", "sample_count", "faulty_count", "gap_count", "condition"),
    },
    speakers=("SafetyBeat", "SweepStatus", "RingState", "EmgBlock"),
    calls=("stop", "acknowledge", "status", "answer"),
)
