"""Upper part of the Tune tab: find the numbers of the law in simulation, show the result, and apply it on request."""

from html import escape

from nicegui import ui

from ehls_ros.dashboard.controls import ask, button, document_link
from ehls_ros.dashboard.experiment import ExperimentTab
from ehls_ros.dashboard.graph import TUNING_DOCUMENTS, Answer, Graph, GraphSnapshot, Tuning, TuningResult
from ehls_ros.dashboard.tuning_figures import legend, numbers_table, results_table, trade_off_svg
from ehls_ros.dashboard.tuning_status import law_to_tune, progress_text, why_not_applicable
from ehls_ros.errors import BadInput

ABOUT = (
    "Finds numbers of {law} in simulation, on the rig that the controller knows: about a minute of one processor, at low "
    "priority. Nothing changes in the running graph until you apply them."
)

ON_RIG = "This graph may drive a real rig: let it run with these numbers."
"""Label of the box that permits the application of numbers to a real rig."""


class TuningSection:
    """Buttons, progress and result of a tuning."""

    def __init__(self, graph: Graph, experiment: ExperimentTab) -> None:
        """Build the section in the current slot.

        Args:
            graph: graph whose law is tuned.
            experiment: choice of the experiment while no graph is running.
        """
        self._graph = graph
        self._experiment = experiment
        self._graph_runs = False
        with ui.element("section").classes("tuned"):
            with ui.element("div").classes("row-of"):
                self._begin = ui.button("Tune", on_click=self._tune).props('dense color=positive data-name="tune"')
                self._cancel = button("Cancel tuning", graph.cancel_tuning, "dense outline")
            self._state = ui.label("").classes("note").props('data-name="tuning-state"')
            self._bar = ui.html("", sanitize=False)
            self._refused = ui.label("").classes("refused").props('data-name="refused-tuning"')
            self._result = _Result(graph)

    def show(self, snapshot: GraphSnapshot) -> None:
        """Update the section."""
        tuning = snapshot.tuning
        self._graph_runs = snapshot.rate > 0.0
        running = tuning is not None and tuning.running
        law, why_not = law_to_tune(snapshot, self._experiment.law)
        self._begin.set_visibility(not running)
        self._begin.set_enabled(not why_not)
        self._cancel.set_visibility(running)
        # While a tuning runs, and after one without a result, its fate is more important than what the button does.
        self._state.set_text((progress_text(tuning) if tuning is not None else "") or why_not or ABOUT.format(law=law))
        self._bar.set_visibility(running)
        if tuning is not None:
            # Without a value, the bar moves back and forth.
            done = f'value="{tuning.done}" max="{tuning.most}"' if tuning.most else ""
            self._bar.set_content(f"<progress {done}></progress>")
        self._result.show(snapshot, tuning)

    async def _tune(self) -> None:
        spec, name = None, ""
        try:
            if not self._graph_runs:
                spec, name = self._experiment.chosen()
        except BadInput as error:
            self._refuse(Answer(done=False, message=str(error)))
            return
        self._refuse(await ask(lambda: self._graph.tune(spec, name)))

    def _refuse(self, answer: Answer) -> None:
        self._refused.set_text("" if answer.done else answer.message)


class _Result:
    """Result of a tuning, hidden until there is one."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._shown: TuningResult | None = None
        self._identity = ""
        with ui.element("div").classes("result") as self._all:
            self._sentence = ui.label("").props('data-name="tuning-sentence"')
            self._figures = ui.html("", sanitize=False, tag="div").props('data-name="tuning-figures"')
            self._remarks = ui.html("", sanitize=False, tag="ul")
            self._on_rig = ui.checkbox(ON_RIG).props('dense data-name="tuning-on-rig"')
            with ui.element("div").classes("row-of"):
                self._apply = ui.button("Apply", on_click=self._applied).props('dense data-name="apply-tuning"')
                self._why_not = ui.label("").classes("note").props('data-name="tuning-not-applicable"')
            self._refused = ui.label("").classes("refused").props('data-name="refused-application"')
            self._outcome = ui.label("").classes("note").props('data-name="tuning-applied"')
            links = "".join(document_link(name, title) for name, title in TUNING_DOCUMENTS.items())
            ui.html(links, sanitize=False, tag="div").classes("note files")
            self._folder = ui.label("").classes("note")

    def show(self, snapshot: GraphSnapshot, tuning: Tuning | None) -> None:
        result = None if tuning is None else tuning.result
        self._all.set_visibility(result is not None)
        if tuning is None or result is None:
            return
        if result is not self._shown:
            self._show_result(tuning, result)
        why_not = why_not_applicable(snapshot, tuning)
        needs_consent = snapshot.on_rig and not why_not
        self._on_rig.set_visibility(needs_consent)
        self._apply.set_enabled(not why_not and (self._on_rig.value or not snapshot.on_rig))
        self._why_not.set_text(why_not)
        self._outcome.set_text(tuning.applied)

    def _show_result(self, tuning: Tuning, result: TuningResult) -> None:
        self._shown, self._identity = result, tuning.folder
        self._on_rig.set_value(False)
        self._refused.set_text("")
        self._sentence.set_text(f"{tuning.law} for {tuning.experiment}: {result.sentence}")
        self._sentence.classes(add="level-0" if result.holds else "level-1", remove="level-1" if result.holds else "level-0")
        key = f'<div class="key">{legend(result)}</div>'
        self._figures.set_content(f"{trade_off_svg(result)}{key}{results_table(result)}{numbers_table(result)}")
        self._remarks.set_content("".join(f"<li>{escape(remark)}</li>" for remark in result.remarks))
        self._remarks.set_visibility(bool(result.remarks))
        self._apply.set_text(f"Apply to {tuning.law}")
        self._folder.set_text(f"Files are in {tuning.folder}.")

    async def _applied(self) -> None:
        confirmed = bool(self._on_rig.value)
        # Consent is for one application, and a second click is none. The next update enables the button again where it may be.
        self._on_rig.set_value(False)
        self._apply.set_enabled(False)
        answer = await ask(lambda: self._graph.apply_tuning(self._identity, confirmed=confirmed))
        self._refused.set_text("" if answer.done else answer.message)
