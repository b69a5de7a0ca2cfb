const figures = [...document.querySelectorAll('.figure')];
const options = {
  responsive: true,
  displaylogo: false,
  modeBarButtons: [['toImage'], ['zoom2d', 'pan2d'], ['zoomIn2d', 'zoomOut2d', 'autoScale2d', 'resetScale2d']],
  toImageButtonOptions: {format: 'svg'},
};
const narrow = innerWidth <= 700;
if (narrow) options.displayModeBar = false;

// Pictures that have no room side by side get fewer columns.
function regrid(figure, layout) {
  const least = Number(figure.dataset.leastWidth);
  if (!least || figure.clientWidth >= least) return;
  const suffixes = Object.keys(layout).filter(key => /^xaxis\d*$/.test(key)).map(key => key.slice(5));
  const columns = 2, rows = Math.ceil(suffixes.length / columns);
  const pitch = 1 / (rows - 0.32), high = 0.68 * pitch;
  figure.style.height = `${rows * 180 + 40}px`;
  suffixes.forEach((suffix, place) => {
    const left = 0.55 * (place % columns), top = 1 - Math.floor(place / columns) * pitch;
    const x = layout[`xaxis${suffix}`], y = layout[`yaxis${suffix}`];
    x.domain = [left, left + 0.45];
    y.domain = [Math.max(top - high, 0), top];
    x.nticks = 4;
    for (const axis of [x, y]) {
      if (axis.tickvals?.length > 6) axis.tickvals = axis.tickvals.filter(value => Number.isInteger(Math.log10(value)));
    }
    if (left && y.title.text === layout.yaxis.title.text) y.title = {text: ''};
  });
  layout.legend.y = 1 + 0.1 / rows;
}

// A text that is longer than its room is broken in the middle, not within a unit.
function broken(text, room) {
  const spaces = [...text.matchAll(/ (?![^[]*\])/g)].map(match => match.index);
  if (text.length * 6 <= room || !spaces.length) return text;
  const middle = spaces.sort((a, b) => Math.abs(a - text.length / 2) - Math.abs(b - text.length / 2))[0];
  return `${text.slice(0, middle)}<br>${text.slice(middle + 1)}`;
}

function fitTitle(axis, room) {
  const text = axis.title?.text ?? '';
  axis.title = {...axis.title, font: {size: 11}, text: broken(text, room)};
  if (axis.title.text !== text) axis.title.standoff = 20;
  axis.automargin ||= axis.title.text !== text || Boolean(axis.tickvals);
}

for (const figure of figures) {
  const {data, layout} = JSON.parse(figure.nextElementSibling.textContent);
  regrid(figure, layout);
  if (narrow) {
    layout.margin = {...layout.margin, l: Math.min(layout.margin.l, 58), r: 12};
    layout.legend = {...layout.legend, font: {size: 11}};
    const high = figure.clientHeight - 80;
    const entries = data.filter(trace => trace.name && trace.showlegend !== false).length;
    figure.style.height = `${figure.clientHeight + 18 * Math.max(entries - 2, 0)}px`;
    const wide = (figure.clientWidth - 80) * (layout.yaxis?.ticktext ? 0.6 : 1);
    for (const [key, axis] of Object.entries(layout)) {
      const [low, top] = axis.domain ?? [0, 1];
      if (/^xaxis/.test(key)) fitTitle(axis, wide * (top - low));
      if (/^yaxis/.test(key)) fitTitle(axis, high * (top - low));
    }
  }
  if (narrow) for (const trace of data) if (trace.name) trace.name = broken(trace.name, figure.clientWidth - 120);
  Plotly.newPlot(figure, data, layout, options);
}

// plotly places the legend of a figure that gets wider by the margin of the narrower one; drawn again, it is right.
let settling;
addEventListener('resize', () => {
  clearTimeout(settling);
  settling = setTimeout(() => figures.forEach(figure => Plotly.redraw(figure)), 400);
});

// A zoom in time of one figure is a zoom of all.
const overTime = figures.filter(figure => figure.classList.contains('over-time'));
const wholeRun = overTime.length ? [...overTime[0].layout.xaxis.range] : [];
let following = false;
for (const source of overTime) {
  source.on('plotly_relayout', async change => {
    if (following || !Object.keys(change).some(key => key.startsWith('xaxis.'))) return;
    following = true;
    const range = change['xaxis.autorange'] ? wholeRun : [...source.layout.xaxis.range];
    const others = change['xaxis.autorange'] ? overTime : overTime.filter(figure => figure !== source);
    await Promise.all(others.map(figure => Plotly.relayout(figure, {'xaxis.range': [...range]})));
    following = false;
  });
}

// Figures keep their width on the screen, so the complete page is scaled to the width of the paper.
const main = document.querySelector('main');
const paperWidth = 1060;
addEventListener('beforeprint', () => { main.style.zoom = paperWidth / main.offsetWidth; });
addEventListener('afterprint', () => { main.style.zoom = ''; });
