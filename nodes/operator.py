"""Ask a person to put on a phantom, and report to the experiment when it is there."""

from msgs.experiment import Mount, MountedReply, MountedRequest, PhantomTruth
from msgs.operator import AnswerReply, AnswerRequest, Prompt
from palp_core import Node, Params, Pub, Qos, ReadOnly, Srv, State, Sub, on, serve
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.units import Count, MillimetresNonNegative

INDENTATION_M = 0.004
"""Where no scene gives it: as of the simulated phantom (assumed)."""


class OperatorParams(Params):
    """Set in the launch file.

    ``scene``, ``ring_error``, ``height_sd_mm`` and ``noise`` are arguments of every rig's launch file; here
    gel, ring and mounting are what they are, and these only go into the record.
    """

    phantoms: ReadOnly[str] = ""
    scene: ReadOnly[str] = ""
    ring_error: ReadOnly[str] = ""
    height_sd_mm: ReadOnly[MillimetresNonNegative] = 0.0
    noise: ReadOnly[str] = ""


class OperatorState(State):
    """What a replacement inherits: the phantom that is waited for, and the number of what was asked."""

    code: str = ""
    remount: int = -1
    mounted: bool = True
    asked: Count = 0


class Operator(Node):
    """Ask for each phantom, and wait for Enter (`palp session operate`) or for the service ``mounted``."""

    simulates = True  # its port `truth` says what the phantom was made as
    params: OperatorParams
    state: OperatorState
    mount = Sub(Mount)
    truth = Pub(PhantomTruth)
    mounted = Srv(MountedRequest, MountedReply)
    prompt = Pub(Prompt, qos=Qos(durability="transient_local", depth=1))
    answer = Srv(AnswerRequest, AnswerReply)

    @classmethod
    def find_mistakes(cls, params: OperatorParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)

    def on_configure(self) -> None:
        self.phantoms = load_phantoms(self.params.phantoms)
        scene = self.params.scene
        self.indentation_m = read_scene(scene).path.indentation_m if scene else INDENTATION_M

    @on(mount)
    def ask(self, mount: Mount) -> None:
        if mount.code not in self.phantoms:
            raise ValueError(f"no phantom '{mount.code}'; there are {', '.join(sorted(self.phantoms))}")
        state = self.state
        state.code, state.remount, state.mounted = mount.code, mount.remount, False
        self.log.warning("put on phantom %s, then: palp service call /%s/mounted", mount.code, self.name)
        deep = f"{self.indentation_m * 1e3:.1f} mm"
        self._prompt("enter", f"Mount phantom {mount.code}, indent {deep}. Enter when it is there.")

    def _prompt(self, kind: str, text: str) -> None:
        self.state.asked += 1
        self.prompt.publish(Prompt(stamp_ns=self.now_ns(), number=self.state.asked, kind=kind, text=text))

    @serve(answer)
    def take(self, request: AnswerRequest) -> AnswerReply:
        """Take Enter for the phantom that is asked for, or its code, and no other."""
        if request.number != self.state.asked or self.state.mounted:
            return AnswerReply(taken=False, text="that is not asked any more")
        reply = self.confirm(MountedRequest(code=request.text.strip()))
        return AnswerReply(taken=reply.done, text="" if reply.done else f"asked for is phantom {reply.code}")

    @serve(mounted)
    def confirm(self, request: MountedRequest) -> MountedReply:
        state = self.state
        if state.mounted:
            return MountedReply(done=False, code=state.code)
        if request.code and request.code != state.code:
            return MountedReply(done=False, code=state.code)
        state.mounted = True
        self._prompt("none", f"Phantom {state.code} is on.")
        bead = self.phantoms[state.code].bead
        depth_m = bead.depth_m if bead is not None else 0.0
        self.truth.publish(
            PhantomTruth(
                stamp_ns=self.now_ns(),
                code=state.code,
                remount=state.remount,
                depth_m=depth_m,
                height_offset_m=0.0,
                rung="",
                bound=0.0,
            )
        )
        return MountedReply(done=True, code=state.code)
