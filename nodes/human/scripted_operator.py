"""An operator who is a script: answers every prompt after a fixed time; for simulated people."""

from typing import Literal

from msgs.operator import AnswerReply, AnswerRequest, Prompt
from palp_core import Alarm, Client, Node, Params, State, Sub, on
from palp_core.units import Seconds


class ScriptedOperatorParams(Params):
    """Set in the launch file.

    ``by``: ``script`` answers; ``terminal`` leaves it to a person (`palp session operate`). ``palpation_s``
    after its begin a trial is ended, ``answer_s`` after the question it is answered with one of the choices
    at random, or some depth. ``texts`` are the answers to the first questions that want a text.
    """

    by: Literal["script", "terminal"] = "script"
    palpation_s: Seconds = 5.0
    answer_s: Seconds = 1.0
    texts: list[str] = []


class ScriptedOperatorState(State):
    """What a replacement inherits: the latest prompt, and what is to be answered."""

    number: int = 0
    text: str = ""
    text_count: int = 0


class ScriptedOperator(Node):
    """Answer for somebody who is not there."""

    simulates = True
    params: ScriptedOperatorParams
    state: ScriptedOperatorState
    prompt = Sub(Prompt)
    answer = Client(AnswerRequest, AnswerReply)
    think = Alarm()

    @on(prompt)
    def read(self, prompt: Prompt) -> None:
        state, params = self.state, self.params
        self.think.clear()
        if params.by != "script" or prompt.kind == "none":
            return
        state.number, state.text, after_s = prompt.number, "", 0.0
        if prompt.kind == "enter":
            after_s = params.palpation_s if prompt.ends_ns else 0.0
        elif prompt.kind == "choice":
            state.text, after_s = str(self.rng.choice(prompt.choices)), params.answer_s
        elif state.text_count < len(params.texts):
            state.text, state.text_count = params.texts[state.text_count], state.text_count + 1
        else:
            state.text, after_s = f"{self.rng.uniform(1.0, 9.0):.1f}", params.answer_s
        self.think.set(self.now_ns() + round(after_s * 1e9))

    @on(think)
    def say(self) -> None:
        self.answer.call(AnswerRequest(number=self.state.number, text=self.state.text, by="script"))

    @on(answer)
    def hear(self, reply: AnswerReply) -> None:
        if not reply.taken:
            self.log.warning("the script's answer was not taken: %s", reply.text)
