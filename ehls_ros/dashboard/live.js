// Draws what the server sends: the minimum and maximum of each signal in every short interval.
// The page calls ehlsLive.begin once and ehlsLive.extend several times a second.
"use strict";

const ehlsLive = (() => {
  const GONE_AFTER = 3000; // without a message from the server [ms]
  let interval, charts, kept, signals, first, era, heard, paused, awaited;

  function begin(settings) {
    ({ interval, charts, kept } = settings);
    signals = {};
    first = 0;
    era = -1;
    paused = awaited = false;
    heard = performance.now();
    paint();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => setTimeout(paint));
    setInterval(watch, 500);
  }

  // part.low and part.high: by signal, one value per interval, null where there is none.
  function extend(part) {
    heard = performance.now();
    if (part.era !== era || part.first !== first + length()) {
      signals = {};
      first = part.first;
      era = part.era;
    }
    for (const [name, low] of Object.entries(part.low)) {
      const signal = (signals[name] ??= { low: [], high: [] });
      signal.low.push(...low);
      signal.high.push(...part.high[name]);
    }
    const surplus = Math.max(0, length() - kept);
    for (const { low, high } of surplus ? Object.values(signals) : []) {
      low.splice(0, surplus);
      high.splice(0, surplus);
    }
    first += surplus;
    if (!paused && !awaited) {
      awaited = true;
      requestAnimationFrame(draw);
    }
  }

  function length() {
    const [any] = Object.values(signals);
    return any ? any.low.length : 0;
  }

  // Draws the new data, then pauses for as long as that took, so that a slow machine keeps time for the rest of the page.
  function draw() {
    const begun = performance.now();
    const end = (first + length()) * interval;
    for (const { id, lines } of charts) {
      const chart = chartOf(id);
      if (!chart) continue;
      const series = lines.map(({ signal, factor }) => ({ data: points(signals[signal], factor, end) }));
      chart.setOption({ series });
    }
    setTimeout(() => (awaited = false), performance.now() - begun);
  }

  // Times are relative to now. The two values of an interval sit at its quarter points, so that a line through them shows every peak.
  function points(signal, factor, end) {
    const data = new Float64Array(signal ? 4 * signal.low.length : 0);
    for (let i = 0; i < data.length / 4; i++) {
      const time = (first + i) * interval - end;
      const low = signal.low[i];
      const high = signal.high[i];
      const rising = i === 0 || signal.low[i - 1] <= low;
      data[4 * i] = time + 0.25 * interval;
      data[4 * i + 1] = value(rising ? low : high, factor);
      data[4 * i + 2] = time + 0.75 * interval;
      data[4 * i + 3] = value(rising ? high : low, factor);
    }
    return data;
  }

  function value(number, factor) {
    return number === null ? NaN : factor * number;
  }

  function chartOf(id) {
    return document.getElementById(`c${id}`) ? getElement(id)?.chart : undefined;
  }

  // Colours come from the stylesheet, which follows the system's light or dark mode.
  function paint() {
    const style = getComputedStyle(document.body);
    const colour = (name) => style.getPropertyValue(name).trim();
    const text = { color: colour("--ink"), fontSize: 11 };
    const axis = { axisLabel: text, nameTextStyle: text, axisLine: { lineStyle: { color: colour("--grid") } } };
    const grid = { splitLine: { lineStyle: { color: colour("--grid") } } };
    for (const { id, lines } of charts) {
      const chart = chartOf(id);
      if (!chart) return setTimeout(paint, 50);
      chart.setOption({
        xAxis: { ...axis, ...grid },
        yAxis: { ...axis, ...grid },
        tooltip: { backgroundColor: colour("--card"), borderColor: colour("--grid"), textStyle: text },
        series: lines.map(({ colour: index }) => ({ itemStyle: { color: colour(`--line-${index}`) } })),
      });
    }
  }

  function watch() {
    document.body.classList.toggle("cut-off", performance.now() - heard > GONE_AFTER);
  }

  function pause(wanted) {
    paused = wanted;
  }

  // For tests and scripts: the newest value of a signal.
  function newest(name) {
    return signals[name]?.high.at(-1) ?? null;
  }

  return { begin, extend, pause, newest, last: () => first + length() };
})();
