"""What the page of `clothbench improve` looks like beyond the other pages, and how its figures are drawn."""

STYLE = """
.verdict { border: 1px solid var(--line); border-left: 5px solid var(--accent); border-radius: 8px;
  background: var(--card); padding: 14px 20px 8px; margin: 18px 0; }
.verdict p { font-size: 17px; max-width: 95ch; }
.verdict p.soft { font-size: 14.5px; }
.verdict .pill { font-size: 14px; }
.tile { max-width: 260px; }
.beside { display: flex; flex-wrap: wrap; gap: 8px; }
.beside > div { flex: 1 1 360px; min-width: 0; }
.bar { position: relative; min-width: 190px; height: 22px; background: var(--card); border-radius: 4px; }
.bar i { position: absolute; inset: 0 auto 0 0; border-radius: 4px; background: #8a8f98; opacity: 0.55; }
.bar.tried i { background: #d55e00; }
.bar.named i { background: #0077bb; }
.bar span { position: absolute; left: 8px; line-height: 22px; font-size: 13px;
  font-variant-numeric: tabular-nums; }
h1 + p.soft { max-width: none; }
.lacking { display: flex; flex-wrap: wrap; gap: 6px 24px; align-items: flex-start; margin: 10px 0 18px; }
.lacking > div { flex: 1 1 320px; min-width: 0; }
.sketch { width: 250px; max-width: 100%; background: var(--card); border-radius: 10px; fill: none; stroke-width: 2.2;
  stroke-linecap: round; stroke-linejoin: round; }
.sketch .with { stroke: var(--sim); }
.sketch .without { stroke: var(--soft); stroke-dasharray: 5 5; stroke-width: 1.8; }
.sketch .acts { stroke: var(--heat); }
.sketch .axis { stroke: var(--soft); stroke-width: 1.2; }
.sketch .filled, .sketch .grip { fill: var(--sim); }
.sketch .table { fill: var(--line); }
@media (max-width: 640px) {
  .candidates table, .candidates tbody { display: block; }
  .candidates thead { display: none; }
  .candidates tbody tr { display: grid; grid-template-columns: 1fr auto auto; gap: 2px 14px; padding: 9px 10px;
    border-top: 1px solid var(--line); }
  .candidates tbody tr:first-child { border-top: 0; }
  .candidates td { border: 0; padding: 0; }
  .candidates td:nth-child(1) { grid-column: 1 / 3; font-weight: 600; }
  .candidates td:nth-child(2) { color: var(--soft); text-align: right; }
  .candidates td:nth-child(3), .candidates td:nth-child(7) { grid-column: 1 / -1; }
  .candidates td:nth-child(n+4):nth-child(-n+6) { text-align: left; font-size: 13px; }
  .candidates td:nth-child(4)::before { content: "p "; color: var(--soft); }
  .candidates td:nth-child(5)::before { content: "gain "; color: var(--soft); }
  .candidates td:nth-child(6)::before { content: "best in "; color: var(--soft); }
}
tr.group small { font-weight: 400; }
li { max-width: 95ch; margin: 4px 0; }
"""

BLOCKS = """
const found = JSON.parse(byId("found").textContent);
function drawBlock(block) {
  const select = byId(block.id + "-view"), names = Object.keys(block.views);
  const figures = block.views[names[select ? select.selectedIndex : 0]];
  figures.forEach((figure, n) => draw(block.id + "-" + n, figure));
}
function drawAll() {
  byId("legend").replaceChildren(...found.legend.map((entry) => legendButton(entry, drawAll)));
  found.blocks.forEach(drawBlock);
}
for (const block of found.blocks) {
  byId(block.id + "-view")?.addEventListener("change", () => drawBlock(block));
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
drawAll();
"""
