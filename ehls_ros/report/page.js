const figures = [...document.querySelectorAll('.figure')];
const options = {
  responsive: true,
  displaylogo: false,
  modeBarButtons: [['toImage'], ['zoom2d', 'pan2d'], ['zoomIn2d', 'zoomOut2d', 'autoScale2d', 'resetScale2d']],
  toImageButtonOptions: {format: 'svg'},
};
const narrow = innerWidth <= 700;
if (narrow) options.displayModeBar = false;
for (const figure of figures) {
  const {data, layout} = JSON.parse(figure.nextElementSibling.textContent);
  if (narrow) {
    layout.margin = {...layout.margin, l: Math.min(layout.margin.l, 58), r: 8};
    layout.legend = {...layout.legend, font: {size: 11}};
  }
  Plotly.newPlot(figure, data, layout, options);
}

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
