// The switch for the metric; a click anywhere in a line of the table opens its case.
(() => {
  const show = (metric) => {
    for (const place of document.querySelectorAll("section.matrix")) {
      const names = [...place.querySelectorAll(".metric")].map((part) => part.dataset.metric);
      if (!names.includes(metric)) continue;
      place.querySelectorAll(".metric").forEach((part) => { part.hidden = part.dataset.metric !== metric; });
      place.querySelectorAll(".switch").forEach((button) => { button.ariaPressed = String(button.dataset.metric === metric); });
    }
  };
  for (const place of document.querySelectorAll("section.matrix")) {
    const first = place.querySelector(".metric");
    place.querySelectorAll(".metric").forEach((part) => { part.hidden = part !== first; });
    place.querySelectorAll(".switch").forEach((button) => {
      button.addEventListener("click", () => address.choose("metric", button.dataset.metric));
    });
    for (const row of place.querySelectorAll("tbody tr")) {
      row.addEventListener("click", (event) => { if (!event.target.closest("a")) row.querySelector("a")?.click(); });
    }
  }
  address.listen("metric", show);
})();
