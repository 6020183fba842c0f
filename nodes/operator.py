"""Ask a person to put on a phantom, and tell the experiment when it is there."""

from msgs.experiment import Mount, MountedReply, MountedRequest, PhantomTruth
from palp_core import Node, Params, Pub, Srv, State, Sub, on, serve
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.session.named_files import file_mistakes
from palp_core.units import MillimetresNonNegative


class OperatorParams(Params):
    """Set in the launch file.

    ``scene``, ``ring_error``, ``height_sd_mm`` and ``noise`` are arguments of every rig's launch file; here
    gel, ring and mounting are what they are, and these only go into the record.
    """

    phantoms: str = ""
    scene: str = ""
    ring_error: str = ""
    height_sd_mm: MillimetresNonNegative = 0.0
    noise: str = ""


class OperatorState(State):
    """What a replacement inherits: the phantom that is waited for."""

    code: str = ""
    remount: int = -1
    mounted: bool = True


class Operator(Node):
    """Wait for ``palp service call /phantom/mounted`` after each request for a phantom."""

    simulates = True  # its port `truth` says what the phantom was made as
    examine = staticmethod(file_mistakes)
    params: OperatorParams
    state: OperatorState
    mount = Sub(Mount)
    truth = Pub(PhantomTruth)
    mounted = Srv(MountedRequest, MountedReply)

    def on_configure(self) -> None:
        self.phantoms = load_phantoms(self.params.phantoms)

    @on(mount)
    def ask(self, mount: Mount) -> None:
        if mount.code not in self.phantoms:
            raise ValueError(f"no phantom '{mount.code}'; there are {', '.join(sorted(self.phantoms))}")
        state = self.state
        state.code, state.remount, state.mounted = mount.code, mount.remount, False
        self.log.warning("put on phantom %s, then: palp service call /%s/mounted", mount.code, self.name)

    @serve(mounted)
    def confirm(self, request: MountedRequest) -> MountedReply:
        state = self.state
        if state.mounted:
            return MountedReply(done=False, code=state.code)
        if request.code and request.code != state.code:
            return MountedReply(done=False, code=state.code)
        state.mounted = True
        bead = self.phantoms[state.code].bead
        self.truth.publish(
            PhantomTruth(
                stamp_ns=self.now_ns(),
                code=state.code,
                remount=state.remount,
                depth_m=bead.depth_m if bead is not None else 0.0,
                height_offset_m=0.0,
                rung="",
                bound=0.0,
            )
        )
        return MountedReply(done=True, code=state.code)
