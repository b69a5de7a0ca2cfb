// Draws the data sent by the server: the minimum and maximum of each signal in every short interval.
// The page calls ehlsLive.begin once and ehlsLive.extend several times a second. The choice of signals, units and time span
// is handled and stored in this browser, so that it works on a read-only page too.
"use strict";

const ehlsLive = (() => {
  const MAX_SILENCE = 3000; // without a message from the server [ms]
  const POINTS = 500; // intervals drawn at most: a longer time is drawn in longer intervals
  const COLOURS = 8; // besides grey, in the stylesheet
  const STORAGE_KEY = "ehls-view";
  let settings, signals, first, era, lastMessage, paused, awaited, view;

  function begin(given) {
    settings = given; // interval, kept, spans, units, signals by name, charts: id, title, unit, signals
    view = { span: settings.spans[1], units: {}, shown: {}, ...storedView() };
    signals = {};
    first = 0;
    era = -1;
    paused = awaited = false;
    lastMessage = performance.now();
    buildMenus();
    paint();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => setTimeout(paint));
    setInterval(watch, 500);
  }

  function storedView() {
    try {
      const kept = JSON.parse(localStorage.getItem(STORAGE_KEY)) ?? {};
      const known = (names) => Array.isArray(names) && names.every((name) => name in settings.signals);
      return {
        ...(settings.spans.includes(kept.span) && { span: kept.span }),
        units: Object.fromEntries(Object.entries(kept.units ?? {}).filter(([own, unit]) => settings.units[own]?.[unit])),
        shown: Object.fromEntries(Object.entries(kept.shown ?? {}).filter(([, names]) => known(names))),
      };
    } catch {
      return {}; // storage is forbidden, or has invalid content
    }
  }

  function changed() {
    try {
      localStorage.setItem(STORAGE_KEY, JSON.stringify(view));
    } catch {
      // storage is forbidden: the choice lasts as long as the page
    }
    paint();
    draw();
  }

  // part.low and part.high: by signal, one value per interval, null where there is none.
  function extend(part) {
    lastMessage = performance.now();
    if (part.era !== era || part.first !== first + length()) {
      signals = {};
      first = part.first;
      era = part.era;
    }
    for (const [name, low] of Object.entries(part.low)) {
      const signal = (signals[name] ??= { low: [], high: [], seen: false });
      for (const value of low) signal.low.push(value);
      for (const value of part.high[name]) signal.high.push(value);
      if (!signal.seen && low.some((value) => value !== null)) {
        signal.seen = true;
        setTimeout(paint);
      }
    }
    const surplus = Math.max(0, length() - settings.kept);
    for (const { low, high } of surplus ? Object.values(signals) : []) {
      low.splice(0, surplus);
      high.splice(0, surplus);
    }
    first += surplus;
    if (!paused && !awaited) {
      awaited = true;
      requestAnimationFrame(redraw);
    }
  }

  function length() {
    const [any] = Object.values(signals);
    return any ? any.low.length : 0;
  }

  // Draws the new data, then pauses for as long as that took, so that a slow machine keeps time for the rest of the page.
  function redraw() {
    const begun = performance.now();
    draw();
    setTimeout(() => (awaited = false), performance.now() - begun);
  }

  function draw() {
    for (const chart of settings.charts) {
      const factor = unitOf(chart)[1];
      // By id: the chart keeps its series in the order in which their first data came.
      const series = linesOf(chart).map((line) => ({ id: line.label, type: "line", data: points(line, line.sign * factor) }));
      chartOf(chart.id)?.setOption({ series });
    }
  }

  // The lines of a chart: the chosen signals that have data; a bound twice.
  function linesOf(chart) {
    let colour = 0;
    return chosen(chart)
      .filter((name) => signals[name]?.seen)
      .flatMap((name) => {
        const { short, beneath, mirrored } = settings.signals[name];
        const line = { name, label: short, sign: 1, colour: beneath ? 0 : 1 + (colour++ % COLOURS) };
        return mirrored ? [line, { ...line, label: `-${short}`, sign: -1 }] : [line];
      });
  }

  function chosen(chart) {
    return view.shown[chart.title] ?? chart.signals;
  }

  // A plot that shows another kind of signal than it was made for is named after that signal.
  function titleOf(chart) {
    const [name] = chosen(chart);
    const own = settings.signals[chart.signals[0]].unit;
    return name === undefined || settings.signals[name].unit === own ? chart.title : settings.signals[name].label;
  }

  // Unit of a chart and the factor to it; the chart's own unless another signal or unit was chosen.
  function unitOf(chart) {
    const [name] = chosen(chart);
    const own = name ? settings.signals[name].unit : "";
    const units = settings.units[own] ?? { [own]: 1 };
    const unit = view.units[own] ?? (chart.unit in units ? chart.unit : Object.keys(units)[0]);
    return [unit, units[unit]];
  }

  // Times are relative to now. The two values of an interval sit at its quarter points, so that a line through them shows every peak.
  function points({ name }, factor) {
    const { low, high } = signals[name];
    const wanted = Math.min(low.length, Math.round(view.span / settings.interval));
    const stride = Math.ceil(view.span / settings.interval / POINTS);
    const width = stride * settings.interval;
    // Groups keep their place while the data move on, or the line would flicker.
    const start = Math.ceil((first + low.length - wanted) / stride) * stride - first;
    const groups = Math.max(0, Math.floor((low.length - start) / stride));
    const data = new Float64Array(4 * groups);
    let before = -Infinity;
    for (let i = 0; i < groups; i++) {
      const from = start + i * stride;
      const time = (from - low.length) * settings.interval;
      const lowest = extreme(low, from, stride, Math.min);
      const highest = extreme(high, from, stride, Math.max);
      const rising = before <= lowest;
      data[4 * i] = time + 0.25 * width;
      data[4 * i + 1] = factor * (rising ? lowest : highest);
      data[4 * i + 2] = time + 0.75 * width;
      data[4 * i + 3] = factor * (rising ? highest : lowest);
      before = lowest;
    }
    return data;
  }

  function extreme(values, from, count, better) {
    let found = null;
    for (let i = from; i < from + count; i++) {
      const value = values[i];
      if (value !== null) found = found === null ? value : better(found, value);
    }
    return found === null ? NaN : found;
  }

  function chartOf(id) {
    return document.getElementById(`c${id}`) ? getElement(id)?.chart : undefined;
  }

  // Lines, legends, units and time axis. Colours come from the stylesheet, which follows the system's light or dark mode.
  function paint() {
    const style = getComputedStyle(document.body);
    const colour = (name) => style.getPropertyValue(name).trim();
    const text = { color: colour("--ink"), fontSize: 11 };
    const axis = { axisLabel: text, nameTextStyle: text, axisLine: { lineStyle: { color: colour("--grid") } } };
    const grid = { splitLine: { lineStyle: { color: colour("--grid") } } };
    for (const described of settings.charts) {
      const chart = chartOf(described.id);
      if (!chart) return setTimeout(paint, 50);
      const lines = linesOf(described);
      const options = {
        xAxis: { ...axis, ...grid, min: -view.span },
        yAxis: { ...axis, ...grid, name: unitOf(described)[0].replace(/^1$/, "") },
        tooltip: { backgroundColor: colour("--card"), borderColor: colour("--grid"), textStyle: text },
        series: lines.map(({ label, colour: index, name }) => ({
          type: "line",
          id: label,
          name: label,
          showSymbol: false,
          z: index ? 3 : 2,
          data: [],
          lineStyle: { width: index ? 1 : 3 },
          itemStyle: { color: colour(`--line-${index}`) },
        })),
      };
      chart.setOption(options, { replaceMerge: ["series"] });
      const legend = document.getElementById(`legend-${described.id}`);
      const entries = lines.filter(({ sign }) => sign > 0).map(({ label, colour: index }) => item("span", label, `c${index}`));
      legend.replaceChildren(...entries);
      document.getElementById(`title-${described.id}`).textContent = titleOf(described);
    }
  }

  function item(tag, text, className = "") {
    const made = document.createElement(tag);
    made.textContent = text;
    made.className = className;
    return made;
  }

  // The fields with which time, units and signals are chosen.
  function buildMenus() {
    const place = document.getElementById("view");
    // The page is built after this script has run.
    if (!place || !settings.charts.every(({ id }) => document.getElementById(`signals-${id}`))) return setTimeout(buildMenus, 50);
    place.append(field("time shown", settings.spans, view.span, (span) => (view.span = Number(span)), (span) => `${span} s`));
    const names = { N: "force", Pa: "pressure", m: "length", "m/s": "speed" };
    for (const [own, units] of Object.entries(settings.units)) {
      const choose = (unit) => (unit ? (view.units[own] = unit) : delete view.units[own]);
      const choices = ["", ...Object.keys(units)];
      place.append(field(names[own], choices, view.units[own] ?? "", choose, (unit) => unit || "default"));
    }
    const reset = item("button", "reset");
    reset.onclick = () => {
      view = { span: settings.spans[1], units: {}, shown: {} };
      place.replaceChildren();
      buildMenus();
      changed();
    };
    place.append(reset);
    for (const chart of settings.charts) buildSignalMenu(chart);
  }

  function field(label, choices, chosen, choose, say) {
    const made = item("label", label);
    const select = document.createElement("select");
    select.name = label;
    for (const choice of choices) select.append(new Option(say(choice), choice, false, choice === chosen));
    select.onchange = () => {
      choose(select.value);
      changed();
    };
    made.append(select);
    return made;
  }

  // A plot has one unit: choosing a signal of another kind puts it in place of the others.
  function buildSignalMenu(chart) {
    const list = document.getElementById(`signals-${chart.id}`);
    const boxes = Object.entries(settings.signals).map(([name, { label, unit }]) => {
      const made = item("label", `${label} [${unit}]`);
      const box = document.createElement("input");
      box.type = "checkbox";
      box.name = name;
      box.checked = chosen(chart).includes(name);
      box.onchange = () => {
        const same = chosen(chart).filter((other) => other !== name && settings.signals[other].unit === unit);
        const kept = box.checked ? [...same, name] : chosen(chart).filter((other) => other !== name);
        view.shown[chart.title] = Object.keys(settings.signals).filter((other) => kept.includes(other));
        for (const other of list.querySelectorAll("input")) other.checked = kept.includes(other.name);
        changed();
      };
      made.prepend(box);
      return made;
    });
    list.replaceChildren(...boxes);
  }

  function watch() {
    document.body.classList.toggle("cut-off", performance.now() - lastMessage > MAX_SILENCE);
  }

  function pause(wanted) {
    paused = wanted;
  }

  // For tests and scripts: the newest value of a signal, and the names of a plot's lines.
  function newest(name) {
    return signals[name]?.high.at(-1) ?? null;
  }

  function shown(title) {
    return linesOf(settings.charts.find((chart) => chart.title === title)).map(({ label }) => label);
  }

  return { begin, extend, pause, newest, shown, last: () => first + length() };
})();
