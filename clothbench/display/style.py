"""What the page looks like and how its menus work: a style sheet and a script; nothing from the network."""

CSS = """
:root { --ground: #ffffff; --card: #f6f7f9; --text: #1c2128; --soft: #5b6470; --line: #d9dde3;
  --accent: #0069a8; --good: #146c3f; --good-bg: #e2f4e9; --bad: #a01c1c; --bad-bg: #fdeaea;
  --warn: #7a5200; --warn-bg: #fdf2d8; }
@media (prefers-color-scheme: dark) {
  :root { --ground: #14171c; --card: #1c2027; --text: #e6e9ee; --soft: #9fa8b5; --line: #343a44;
    --accent: #6cb8f0; --good: #7fd6a4; --good-bg: #173526; --bad: #ff9c9c; --bad-bg: #431d1f;
    --warn: #f0c060; --warn-bg: #3c2f12; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--text); line-height: 1.5;
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 26px; margin: 0 0 4px; letter-spacing: -0.01em; }
h2 { font-size: 19px; margin: 40px 0 8px; }
h3 { font-size: 15px; margin: 24px 0 2px; }
p { margin: 6px 0 12px; max-width: 80ch; }
.soft, figcaption { color: var(--soft); }
code { font: 13px/1.4 ui-monospace, "DejaVu Sans Mono", Menlo, monospace; background: var(--card);
  padding: 1px 5px; border-radius: 4px; }
.tiles { display: flex; flex-wrap: wrap; gap: 10px; margin: 18px 0; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 8px;
  padding: 8px 16px 10px; min-width: 110px; }
.tile b { display: block; font-size: 22px; font-variant-numeric: tabular-nums; }
.tile.bad { background: var(--bad-bg); border-color: var(--bad); color: var(--bad); }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px; margin: 8px 0 12px; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
th, td { padding: 6px 11px; text-align: left; vertical-align: top; border-top: 1px solid var(--line); }
thead th { border-top: 0; background: var(--card); color: var(--soft); font-weight: 600;
  white-space: nowrap; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td small { color: var(--soft); }
tr.group td { background: var(--card); font-weight: 600; border-top: 2px solid var(--line); }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 2px 14px; font-size: 13.5px;
  color: var(--soft); }
dd { margin: 0; }
.pill { border-radius: 10px; padding: 1px 9px; font-size: 12.5px; font-weight: 600; white-space: nowrap;
  background: var(--bad-bg); color: var(--bad); }
.pill.ok { background: var(--good-bg); color: var(--good); }
.pill.note { background: var(--warn-bg); color: var(--warn); }
.failures { border: 1px solid var(--bad); background: var(--bad-bg); border-radius: 8px;
  padding: 10px 16px; margin: 16px 0; }
.failures ul { margin: 6px 0 0; padding-left: 18px; }
.failures li { overflow-wrap: anywhere; }
details { margin: 8px 0; }
summary { cursor: pointer; color: var(--accent); }
figure { margin: 0 0 8px; }
.strip { display: flex; gap: 10px; overflow-x: auto; }
.strip img { height: 190px; border-radius: 6px; }
select { font: inherit; color: inherit; background: var(--card); border: 1px solid var(--line);
  border-radius: 6px; padding: 5px 8px; max-width: 100%; }
.menu { display: flex; gap: 8px; align-items: center; flex-wrap: wrap; }
#legend, #test-legend { display: flex; flex-wrap: wrap; gap: 4px 6px; flex-basis: 100%; max-height: 132px;
  overflow-y: auto; }
#legend button, #test-legend button { font: inherit; font-size: 13px; color: inherit; background: none;
  border: 1px solid var(--line); border-radius: 12px; padding: 1px 10px; cursor: pointer;
  display: flex; align-items: center; gap: 7px; }
#legend button[aria-pressed="false"], #test-legend button[aria-pressed="false"] { opacity: 0.45;
  text-decoration: line-through; }
#legend i, #test-legend i { width: 22px; height: 0; border-top: 3px solid; }
.menu.top { position: sticky; top: 0; z-index: 5; background: var(--ground); padding: 8px 0;
  border-bottom: 1px solid var(--line); }
footer { margin-top: 48px; color: var(--soft); font-size: 13px; }
"""

DRAWING = """
const byId = (id) => document.getElementById(id);
const options = (select, names) => select.replaceChildren(...names.map((n) => new Option(n, n)));
const hidden = new Set();
function themed(layout) {
  const css = getComputedStyle(document.documentElement), ink = (name) => css.getPropertyValue(name).trim();
  const out = structuredClone(layout);
  for (const axis of [out.xaxis, out.yaxis]) {
    Object.assign(axis, { gridcolor: ink("--line"), linecolor: ink("--line"), zerolinecolor: ink("--line") });
  }
  const clear = "rgba(0,0,0,0)", family = getComputedStyle(document.body).fontFamily;
  return Object.assign(out, { paper_bgcolor: clear, plot_bgcolor: clear, hovermode: "closest",
    showlegend: false, font: { color: ink("--text"), size: 13, family },
    modebar: { bgcolor: clear, color: ink("--line"), activecolor: ink("--accent") },
    hoverlabel: { bgcolor: ink("--card"), bordercolor: ink("--line"), font: { color: ink("--text") } } });
}
function draw(id, figure) {
  const buttons = [["zoom2d", "pan2d", "resetScale2d", "toImage"]];
  const config = { responsive: true, displaylogo: false, modeBarButtons: buttons };
  const shown = figure.data.filter((line) => !hidden.has(line.meta));
  byId(id).style.height = figure.layout.height + "px";
  Plotly.react(byId(id), structuredClone(shown), themed(figure.layout), config);
}
function legendButton([name, colour, dash], redraw) {
  const button = document.createElement("button"), line = document.createElement("i");
  line.style.borderColor = colour;
  line.style.borderTopStyle = { solid: "solid", dot: "dotted" }[dash] ?? "dashed";
  button.append(line, name);
  button.ariaPressed = String(!hidden.has(name));
  button.title = "show or hide";
  button.addEventListener("click", () => { hidden.delete(name) || hidden.add(name); redraw(); });
  return button;
}
"""
