// Figures: colours of the page, drawn when they come near the window.
const hidden = new Set(), waiting = new Map();
function themed(layout) {
  const css = getComputedStyle(document.documentElement), ink = (name) => css.getPropertyValue(name).trim();
  const out = structuredClone(layout);
  for (const axis of [out.xaxis, out.yaxis]) {
    Object.assign(axis, { gridcolor: ink("--line"), linecolor: ink("--line"), zerolinecolor: ink("--line") });
  }
  const clear = "rgba(0,0,0,0)", family = getComputedStyle(document.body).fontFamily;
  return Object.assign(out, { paper_bgcolor: clear, plot_bgcolor: clear, hovermode: "closest",
    showlegend: layout.showlegend ?? false, font: { color: ink("--text"), size: 13, family },
    modebar: { bgcolor: clear, color: ink("--line"), activecolor: ink("--accent") },
    hoverlabel: { bgcolor: ink("--card"), bordercolor: ink("--line"), font: { color: ink("--text") } } });
}
function paint(place, figure) {
  const buttons = [["zoom2d", "pan2d", "resetScale2d", "toImage"]];
  const config = { responsive: true, displaylogo: false, modeBarButtons: buttons };
  const shown = figure.data.filter((line) => !hidden.has(line.meta));
  Plotly.react(place, structuredClone(shown), themed(figure.layout), config);
}
const near = new IntersectionObserver((entries) => {
  for (const { target } of entries.filter((entry) => entry.isIntersecting)) {
    near.unobserve(target);
    if (waiting.has(target)) paint(target, waiting.get(target));
    waiting.delete(target);
  }
}, { rootMargin: "400px" });
function draw(id, figure) {
  const place = byId(id);
  place.style.height = figure.layout.height + "px";
  const caption = place.closest("figure")?.querySelector("figcaption")?.textContent;
  place.setAttribute("role", "group");  // not a picture: its buttons are to be reached
  place.setAttribute("aria-label", (caption ?? headingOf(place)).replace(/\s+/g, " ").trim());
  waiting.set(place, figure);
  near.unobserve(place);
  near.observe(place);
}
function headingOf(place) {
  let before = place.closest("figure") ?? place;
  while (before && !/^H\d$/.test(before.tagName)) before = before.previousElementSibling;
  return before?.textContent ?? "figure";
}
addEventListener("beforeprint", () => waiting.forEach((figure, place) => paint(place, figure)));
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
