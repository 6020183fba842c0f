"""Lead a person through the palpation experiment: who it is, MVC, training, estimation, and the record."""

from collections.abc import Callable, Sequence

from msgs.emg import EmgBlock
from msgs.human import Countdown, EffortBars, HumanTrialBegun, HumanTrialDone, MuscleCue
from msgs.operator import AnswerReply, AnswerRequest, Prompt
from nodes.human.params import HumanParams, HumanState, begin_step_again, design_of, find_mistakes
from palp_core import Alarm, Node, Progress, Pub, Qos, Srv, Sub, Timer, on, serve
from palp_core.errors import NodeError, PalpError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.perception.emg.quality import clipped
from palp_core.palpation.session.audit import note_redone, to_be_redone
from palp_core.palpation.session.human import plan, questions
from palp_core.palpation.session.human.effort import judged, mvc_trouble, rms, stretch
from palp_core.palpation.session.human.plan import HumanStep, HumanTrial
from palp_core.palpation.session.human.record import HumanRow, HumanWriter, emg_name
from palp_core.palpation.session.plan import resume
from palp_core.palpation.session.sheet.identity import consent_id, subject_code
from palp_core.palpation.session.sheet.sheet import read_sheet
from palp_core.units import Float64Array

_LATCHED = Qos(durability="transient_local", depth=1)
_WORDS_OF = {"rest": "Hand still.", "mvc": "Contract as hard as you can."}


class HumanSession(Node):
    """Ask the plan for the next step, see to it that it is done, and reply to the plan."""

    records = True
    params: HumanParams
    state: HumanState
    emg = Sub(EmgBlock)
    cue = Pub(MuscleCue)
    prompt = Pub(Prompt, qos=_LATCHED)
    bars = Pub(EffortBars)
    countdown = Pub(Countdown)
    begun = Pub(HumanTrialBegun)
    result = Pub(HumanTrialDone)
    progress = Pub(Progress)
    answer = Srv(AnswerRequest, AnswerReply)
    limit = Alarm()
    late = Alarm()
    second = Timer(hz="countdown_hz")

    @classmethod
    def find_mistakes(cls, params: HumanParams, mistakes: Mistakes) -> None:
        find_mistakes(params, mistakes)

    def on_configure(self) -> None:
        self.design = design_of(self.params)
        self.record = HumanWriter(self.params.out)
        self.plan: plan.HumanPlan | None = None
        self.step: HumanStep | None = None
        self.of = {phase: len(self.design.places(phase)) for phase in plan.PHASES}

    def on_activate(self) -> None:
        if not self.state.words and not self.state.stage:
            self.record.start()
        if not self.state.stage:
            self._cue("pause")
        self._advance()

    def on_restore(self) -> None:
        begin_step_again(self.state)
        self.record.go_on(self.state.row)

    def on_deactivate(self) -> None:
        self.record.close()

    # What the plan asks for

    def _advance(self) -> None:
        """Do steps as long as they are done at once; return when one has to be waited for."""
        state = self.state
        if self.plan is None:  # a replacement leads a fresh plan to where the old one was
            self.plan = plan.human(self.design, state.again)
            replies = (plan.HumanReply(word) for word in state.words)  # type: ignore[arg-type]
            self.step = resume(self.plan, replies)
        while self.step is not None:
            word = self._do(self.step)
            if word == "":
                return
            state.words.append(word)
            state.stage = state.doing = ""
            try:
                self.step = self.plan.send(plan.HumanReply(word))  # type: ignore[arg-type]
            except StopIteration:
                self.step = None
        if not state.finished:
            state.finished = True
            self._prompt("none", "The session is over. Thank you.")
        self.finish(0)

    def _do(self, step: HumanStep) -> str:
        """Go on with a step; return its word once it is done, "" while it is not."""
        match step:
            case plan.Identify():
                return self._identify()
            case plan.Rest():
                return self._rest(step.duration_s)
            case plan.Quiet():
                return self._recorded("rest", questions.QUIET, step.duration_s, self._keep_rest)
            case plan.HoldMvc():
                words = questions.mvc_words(step)
                return self._recorded("mvc", words, step.duration_s, self._keep_mvc)
            case plan.HumanTrial():
                same = self.state.phantom == step.phantom
                words = questions.begin_words(step, max(self.of[step.phase], step.number), same=same)
                return self._recorded("palpation", words, step.limit_s, self._keep_trial)
            case plan.Ask():
                return self._ask(step.trial)

    def _identify(self) -> str:
        state, params = self.state, self.params
        state.consent = state.consent or (consent_id(params.consent) if params.consent else "")
        sheet = params.session
        named = params.subject or (read_sheet(sheet, by_hand=True).subject if sheet else "")
        state.subject = state.subject or (subject_code(named) if named else "")
        wanted = "consent" if not state.consent else "subject" if not state.subject else ""
        if wanted and state.doing != wanted:
            state.stage, state.doing = "asked", wanted
            self._prompt("text", questions.IDENTITY[wanted])
        if wanted:
            return ""
        self.record.identity(state.subject, state.consent, order=params.order, source=params.source)
        return "done"

    def _rest(self, duration_s: float) -> str:
        state = self.state
        if duration_s == 0.0 or state.stage == "over":
            self.second.stop()
            return "done"
        if state.stage == "":
            state.stage, state.doing = "running", "break"
            self._begin_limit(duration_s)
            self._prompt("none", "The subject rests.", ends_ns=state.limit_ns)
        return ""

    def _recorded(self, phase: str, words: str, duration_s: float, keep: Callable[[], str]) -> str:
        """Record the muscles while something is done: from Enter to the end of its time, or to Enter."""
        state = self.state
        if state.stage == "":
            state.stage, state.doing, state.blocks = "ready", phase, []
            self._prompt("enter", words)
        elif state.stage == "begin":
            state.stage, state.ended_by = "running", "limit"
            self._begin_limit(duration_s)
            if isinstance(self.step, HumanTrial):
                self._announce(self.step)
            else:
                self._prompt("none", _WORDS_OF[phase], ends_ns=state.limit_ns)
            self._cue(phase, state.phantom if phase == "palpation" else "")
        elif state.stage == "over":
            state.stage, state.end_ns = "settling", self.now_ns()
            self.second.stop()
            self._cue("pause")
            self.late.set(self.now_ns() + round(self.params.settle_s * 1e9))
            self._prompt("none", "Thank you.")
        elif state.stage == "settled":
            self.late.clear()
            return keep()
        return ""

    def _announce(self, trial: HumanTrial) -> None:
        self.state.phantom = trial.phantom
        self._prompt("enter", questions.PALPATING, ("", questions.AGAIN), ends_ns=self.state.limit_ns)
        self.begun.publish(
            HumanTrialBegun(
                stamp_ns=self.now_ns(), trial=trial.index, phase=trial.phase, number=trial.number,
                attempt=trial.attempt, phantom=trial.phantom, told=trial.told,
                depth_m=(trial.depth_m or 0.0) if trial.told else 0.0,
            )
        )  # fmt: skip

    def _ask(self, trial: HumanTrial) -> str:
        state, form = self.state, self.params.answer
        if state.stage == "":
            state.stage, state.doing, state.begin_ns = "asked", "question", self.now_ns()
            choices = [f"{p.depth_m * 1e3:g}" for p in self.design.phantoms] if form == "choice" else []
            words = questions.depth_question(self.design.phantoms, form)
            self._prompt("choice" if choices else "text", words, choices)
        if state.stage != "answered":
            return ""
        self._write(trial, state.answer_mm, self.now_ns() - state.begin_ns)
        return "done"

    # What is kept

    def _samples(self) -> Float64Array:
        return stretch(self.state.blocks, self.state.begin_ns, self.state.end_ns)

    @property
    def _rate_hz(self) -> float:
        return self.state.blocks[0].rate_hz if self.state.blocks else 1.0

    def _keep_rest(self) -> str:
        state, samples = self.state, self._samples()
        if not judged(samples, self._rate_hz):
            raise NodeError(self.name, "no EMG came with the muscles at rest; is the amplifier measuring?")
        state.rest, state.rest_ns = state.blocks, [state.begin_ns, state.end_ns]
        self.record.emg(state.subject, "rest.npz", samples, self._rate_hz)
        return "done"

    def _keep_mvc(self) -> str:
        state, step, samples = self.state, self.step, self._samples()
        assert isinstance(step, plan.HoldMvc)
        if trouble := mvc_trouble(samples, stretch(state.rest, *state.rest_ns), self._rate_hz):
            name = f"mvc_{step.attempt}.npz"
            self.record.emg(state.subject, name, samples, self._rate_hz, discarded=True)
            self.log.warning("this contraction is not an MVC; repeat it: %s", trouble)
            return "repeat"
        self.record.emg(state.subject, "mvc.npz", samples, self._rate_hz)
        return "done"

    def _keep_trial(self) -> str:
        state, trial, samples = self.state, self.step, self._samples()
        assert isinstance(trial, HumanTrial)
        spoilt, found = state.ended_by == "repeat", judged(samples, self._rate_hz)
        state.palpated_ns = state.end_ns - state.begin_ns
        state.lost_count = sum(one.lost_count for one in found)
        state.clipped_count = sum(one.clipped_count for one in found)
        name = emg_name(trial.phase, trial.number, trial.attempt, trial.phantom, trial.depth_m)
        state.emg = (
            self.record.emg(state.subject, name, samples, self._rate_hz, discarded=spoilt) if found else ""
        )
        if not found or state.lost_count or state.clipped_count:
            loss = (
                f"{state.lost_count} samples were lost, {state.clipped_count} clipped"
                if found
                else "none came"
            )
            self.log.warning("EMG of %s trial %d: %s", trial.phase, trial.number, loss)
        if spoilt or trial.told:
            self._write(trial, None, 0)
        return "repeat" if spoilt else "done"

    def _write(self, trial: HumanTrial, answer_mm: float | None, answer_ns: int) -> None:
        state, params = self.state, self.params
        estimate_m = None if answer_mm is None else questions.nearest_depth(answer_mm, self.design.phantoms)
        row = HumanRow(
            row=state.row, subject=state.subject, phase=trial.phase, trial=trial.number,
            attempt=trial.attempt, phantom=trial.phantom, depth_m=trial.depth_m, told=trial.told,
            palpation_s=state.palpated_ns * 1e-9, ended_by=state.ended_by,
            answer_s=None if answer_mm is None else answer_ns * 1e-9, answer_mm=answer_mm,
            estimate_m=estimate_m, emg=state.emg, lost_count=state.lost_count,
            clipped_count=state.clipped_count, source=params.source, answered_by=state.answered_by,
            order=params.order, subject_number=params.subject_number, seed=params.seed, end_ns=self.now_ns(),
        )  # fmt: skip
        self.record.append(row)
        state.row += 1
        state.blocks = []
        self.result.publish(
            HumanTrialDone(
                stamp_ns=self.now_ns(), trial=trial.index, phase=trial.phase, number=trial.number,
                attempt=trial.attempt, phantom=trial.phantom, palpation_s=row.palpation_s,
                ended_by=row.ended_by, answered=answer_mm is not None, answer_s=answer_ns * 1e-9,
                estimate_m=estimate_m or 0.0,
            )
        )  # fmt: skip
        if state.ended_by != "repeat":
            self._do_marked_again(trial)
        self._report(trial, done=state.ended_by != "repeat")

    def _do_marked_again(self, trial: HumanTrial) -> None:
        """Note as which trial another was done again; take up what was marked meanwhile."""
        state, planned = self.state, sum(self.of.values())
        try:
            if trial.index >= planned:
                note_redone(self.record.folder, state.again[trial.index - planned], trial.number)
            marked = to_be_redone(self.record.folder, state.again)
        except PalpError as error:
            self.log.warning("nothing is repeated: %s", error)
            return
        state.again += marked
        for phase, number in marked:
            self.log.warning("%s trial %d will be repeated at the end", phase, number)

    def _report(self, trial: HumanTrial, *, done: bool) -> None:
        self.progress.publish(
            Progress(
                stamp_ns=self.now_ns(),
                phase=trial.phase,
                done_count=trial.number - (not done),
                total_count=max(self.of[trial.phase], trial.number),
                text="trials",
            )
        )

    # Prompts, answers and EMG

    def _cue(self, phase: str, phantom: str = "") -> None:
        self.cue.publish(MuscleCue(stamp_ns=self.now_ns(), phase=phase, phantom=phantom))

    def _prompt(self, kind: str, text: str, choices: Sequence[str] = (), *, ends_ns: int = 0) -> None:
        state = self.state
        state.asked, state.kind = state.asked + 1, kind
        self.prompt.publish(
            Prompt(
                stamp_ns=self.now_ns(),
                number=state.asked,
                kind=kind,
                text=text,
                choices=list(choices),
                ends_ns=ends_ns,
            )
        )

    def _begin_limit(self, duration_s: float) -> None:
        state = self.state
        state.begin_ns = self.now_ns()
        state.limit_ns = state.begin_ns + round(duration_s * 1e9)
        self.limit.set(state.limit_ns)
        self.second.start()
        self.count_down()

    @serve(answer)
    def take(self, request: AnswerRequest) -> AnswerReply:
        """Take an answer to what is asked; one that comes too late, or is none, changes nothing."""
        state = self.state
        if request.number != state.asked or state.kind == "none":
            return AnswerReply(taken=False, text="that is not asked any more")
        try:
            self._understand(request.text.strip())
        except PalpError as error:
            return AnswerReply(taken=False, text=str(error))
        state.kind, state.answered_by = "none", request.by
        self._advance()
        return AnswerReply(taken=True)

    def _understand(self, text: str) -> None:
        """Let an answer be what it says in the step under way."""
        state = self.state
        if state.doing == "consent":
            state.consent = consent_id(text)
        elif state.doing == "subject":
            state.subject = subject_code(text)
        elif state.doing == "question":
            state.answer_mm = questions.depth_answer(text, self.design.phantoms, self.params.answer)
            state.stage = "answered"
        elif state.stage == "ready":
            state.stage = "begin"
        else:
            state.ended_by = questions.ending(text)
            state.stage = "over"
            self.limit.clear()

    @on(limit)
    def end(self) -> None:
        if self.state.stage == "running":
            self.state.stage = "over"
            self._advance()

    @on(second)
    def count_down(self) -> None:
        state = self.state
        left_ns = max(0, state.limit_ns - self.now_ns())
        of_ns = state.limit_ns - state.begin_ns
        self.countdown.publish(
            Countdown(stamp_ns=self.now_ns(), what=state.doing, left_s=left_ns * 1e-9, of_s=of_ns * 1e-9)
        )

    @on(emg)
    def note_emg(self, block: EmgBlock) -> None:
        """Keep what belongs to the step; a block from after its end says that the last one was there."""
        state = self.state
        if state.stage not in ("running", "settling") or state.doing == "break":
            return
        if state.doing == "mvc" and state.stage == "running":
            self._show_bars(block)
        if block.phase == state.doing:
            state.blocks.append(block)
        elif state.stage == "settling" and block.start_ns >= state.end_ns:
            state.stage = "settled"
            self._advance()

    @on(late)
    def settle(self) -> None:
        """Go on without the last samples: the source is silent."""
        if self.state.stage == "settling":
            self.state.stage = "settled"
            self._advance()

    def _show_bars(self, block: EmgBlock) -> None:
        state = self.state
        whole_ns = round(len(block.fds_v) / block.rate_hz * 1e9)
        fds_v, edc_v = rms(stretch([block], block.start_ns, block.start_ns + whole_ns)).tolist()
        most_fds_v, most_edc_v = max(fds_v, state.largest_v[0]), max(edc_v, state.largest_v[1])
        state.largest_v = most_fds_v, most_edc_v
        at_rails = bool(clipped(block.fds_v).any() or clipped(block.edc_v).any())
        self.bars.publish(
            EffortBars(
                stamp_ns=self.now_ns(),
                fds=fds_v / most_fds_v if most_fds_v > 0.0 else 0.0,
                edc=edc_v / most_edc_v if most_edc_v > 0.0 else 0.0,
                clipped=at_rails,
            )
        )
