// What every script of the page uses, and the order in which they run: what needs no figures at once, figures when the
// browser has painted, each only when it comes near the window.
const byId = (id) => document.getElementById(id);
const options = (select, names) => select.replaceChildren(...names.map((n) => new Option(n, n)));
async function unpacked(place) {
  const bytes = Uint8Array.from(atob(place.textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).text();
}
async function dataOf(id) {
  const place = byId(id);
  if (place.dataset.packed !== undefined) {
    place.textContent = await unpacked(place);
    delete place.dataset.packed;
  }
  return JSON.parse(place.textContent);
}
async function unpackAll() {
  for (const place of document.querySelectorAll("[data-packed]:not(#plotly, [data-later])")) await dataOf(place.id);
}
const painted = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
async function library(id) {
  const script = document.createElement("script");
  script.textContent = await unpacked(byId(id));
  document.head.append(script);
}
