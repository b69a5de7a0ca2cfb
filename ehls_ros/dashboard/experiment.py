"""The Experiment tab: start and stop a graph and its recordings, with effects hidden in the simulated rig."""

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from ehls_ros.dashboard.controls import ask, button, document_link
from ehls_ros.dashboard.graph import EVALUATIONS, Answer, Graph, GraphSnapshot, Timing
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.spec import Spec, load_spec
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse, effects_from_list
from ehls_ros.schema import declarations


class EffectsForm:
    """The effects hidden in the rig from the next start."""

    def __init__(self) -> None:
        """Build the form in the current slot."""
        self._chosen: list[EffectUse] = []
        self._entries: dict[str, Any] = {}
        with ui.element("div").classes("row-of"):
            # A table found in data is not typed in.
            typed = [name for name in EFFECTS.names() if not getattr(EFFECTS.load(name), "LEARNT", False)]
            names = {name: name.replace("_", " ") for name in typed}
            self._name = ui.select(names, label="hidden effect", on_change=self._offer, with_input=True)
            self._name.props('dense data-name="effect"').style("flex: 1")
            ui.button("Add", on_click=self._add).props('dense flat data-name="add effect"')
        self._fields = ui.element("div").classes("fields")
        self._refused = ui.label("").classes("refused")
        self._list = ui.element("div").classes("row-of")

    def chosen(self) -> tuple[EffectUse, ...]:
        """Return the effects added."""
        return tuple(self._chosen)

    def _offer(self) -> None:
        """Show the parameter fields of the selected effect."""
        self._fields.clear()
        self._entries = {}
        self._refused.set_text("")
        if not self._name.value:
            return
        with self._fields:
            for declared in declarations(EFFECTS.load(self._name.value).Parameters):
                unit = f" [{declared.unit}]" if declared.unit not in {"", "1"} else ""
                entry = ui.number(f"{declared.name.replace('_', ' ')}{unit}", value=declared.default)
                entry.props(f'dense outlined stack-label step=any data-name="effect-{declared.name}"').tooltip(
                    declared.description
                )
                self._entries[declared.name] = entry

    def _add(self) -> None:
        if not self._name.value:
            return
        values = {name: entry.value for name, entry in self._entries.items() if entry.value is not None}
        try:
            self._chosen += effects_from_list([{"name": self._name.value, **values}], "hidden effects")
        except BadInput as error:
            self._refused.set_text(str(error))
            return
        self._name.set_value(None)
        self._show()

    def _show(self) -> None:
        self._list.clear()
        with self._list:
            for number, use in enumerate(self._chosen):
                chip = ui.chip(use.name.replace("_", " "), removable=True).props("dense square")
                chip.on_value_change(lambda _, number=number: self._drop(number))
                chip.tooltip(", ".join(f"{name} {value:g}" for name, value in use.parameters._asdict().items()))

    def _drop(self, number: int) -> None:
        del self._chosen[number]
        self._show()


class _Result:
    """Result of an evaluation, with a link to its document."""

    def __init__(self, verb: str, title: str) -> None:
        with ui.element("div").classes("note") as self._row:
            ui.html(document_link(verb, title), sanitize=False)
            self._sentence = ui.label("").props(f'data-name="result-{verb}"')

    def show(self, sentence: str) -> None:
        self._row.set_visibility(bool(sentence))
        self._sentence.set_text(sentence)


class ExperimentTab:
    """Tab to start and stop a graph and to record it."""

    def __init__(self, graph: Graph, spec: Path | None, timing: Timing) -> None:
        """Build the tab in the current slot.

        Args:
            graph: the graph to start and stop.
            spec: experiment file preselected; None: the 10 kN sine.
            timing: preselected.
        """
        self._graph = graph
        self._recording = False
        self._law = ("", "")
        folder = config_folder() / "experiments"
        first = str(spec or folder / "sine_fd2.yaml")
        files = sorted({first, *map(str, folder.glob("*.yaml"))})
        names = {file: Path(file).name if Path(file).parent == folder else file for file in files}
        self._spec = ui.select(names, value=first, label="experiment file").props("dense").style("width: 100%")
        timings = {choice: choice.value for choice in Timing}
        self._timing = ui.select(timings, value=timing, label="time").props('dense data-name="timing"').style("width: 100%")
        self._effects = None
        if graph.simulated:
            ui.label("Effects hidden in the simulated rig; the controller does not know them.").classes("note")
            self._effects = EffectsForm()
        with ui.element("div").classes("row-of"):
            self._start = ui.button("Start", on_click=self._start_graph).props('dense color=positive data-name="start"')
            self._stop = button("Stop", graph.stop, "dense outline")
            self._record = ui.button("Record", on_click=self._toggle_recording).props('dense outline data-name="record"')
        self._refused = ui.label("").classes("refused").props('data-name="refused-start"')
        self._activity = ui.label("").classes("note").props('data-name="activity"')
        with ui.element("div").classes("row-of"):
            self._evaluations = {
                verb: button(f"{verb.capitalize()} recording", partial(graph.evaluate, verb), "dense outline")
                for verb in EVALUATIONS
            }
        self._results = {verb: _Result(verb, title) for verb, title in EVALUATIONS.items()}

    def show(self, snapshot: GraphSnapshot) -> None:
        """Update buttons and status line."""
        here, there = snapshot.started_here, snapshot.rate > 0.0
        self._recording = snapshot.recording
        self._start.set_enabled(not here and not there)
        self._stop.set_enabled(here)
        self._record.set_enabled(there or self._recording)
        self._record.set_text("End recording" if self._recording else "Record")
        self._activity.set_text(snapshot.activity)
        for verb, pressed in self._evaluations.items():
            pressed.set_enabled(snapshot.recorded)
            self._results[verb].show(snapshot.results.get(verb, ""))

    async def _start_graph(self) -> None:
        try:
            spec, name = self.chosen()
        except BadInput as error:
            self._refused.set_text(str(error))
            return
        self._say(await ask(lambda: self._graph.start(spec, name, self._timing.value)))

    def law(self) -> str:
        """Return the law of the chosen experiment.

        Raises:
            BadInput: the experiment's file is wrong.
        """
        file = str(self._spec.value)
        if file != self._law[0]:
            self._law = file, load_spec(Path(file)).controller.name
        return self._law[1]

    def chosen(self) -> tuple[Spec, str]:
        """Return the chosen experiment, with its hidden effects, and its name.

        Raises:
            BadInput: the experiment's file is wrong.
        """
        path = Path(str(self._spec.value))
        spec = load_spec(path)
        return spec if self._effects is None else spec._replace(rig=spec.rig.with_effects(self._effects.chosen())), path.stem

    async def _toggle_recording(self) -> None:
        on = not self._recording
        self._say(await ask(lambda: self._graph.record(on=on)))

    def _say(self, answer: Answer) -> None:
        self._refused.set_text("" if answer.done else answer.message)
