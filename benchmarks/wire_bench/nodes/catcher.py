"""Note when each message arrives."""

from __future__ import annotations

import time
from pathlib import Path

from meter import sign_in
from plan import Arrivals

from msgs.load import Block, Reply
from palp_core import Node, Params, Pub, Srv, State, Sub, on, serve


class CatcherParams(Params):
    """``out`` is the folder of what is found; ``number`` tells one reader from another."""

    out: str = ""
    number: int = 0


class Catcher(Node):
    """Reply where the message asks for it."""

    params: CatcherParams
    state: State
    block = Sub(Block)
    reply = Pub(Reply)
    answer = Srv(Block, Reply)

    def on_configure(self) -> None:
        folder, number = Path(self.params.out), self.params.number
        self.path = folder / f"arrivals{number}.npy"
        self.arrivals = Arrivals()
        sign_in(folder)

    def on_deactivate(self) -> None:
        self.arrivals.write(self.path)

    @on(block)
    def catch(self, block: Block) -> None:
        arrived_ns = time.monotonic_ns()
        if self.arrivals.take(block.index, block.sent_ns, arrived_ns):
            self.reply.publish(Reply(index=block.index, sent_ns=block.sent_ns, count=self.arrivals.count))

    @serve(answer)
    def tell(self, block: Block) -> Reply:
        self.arrivals.take(block.index, block.sent_ns, time.monotonic_ns())
        return Reply(index=block.index, sent_ns=block.sent_ns, count=self.arrivals.count)
