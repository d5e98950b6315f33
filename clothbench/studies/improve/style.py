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
