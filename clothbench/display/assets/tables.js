// Tables people can use: sorted by a click on a heading, filtered by a word, taken along as text, CSV or JSON.
(() => {
  const SHORT = 4, LONG = 12;  // lines below which a table gets no tools, and from which on it gets a filter
  function words(cell) {  // not innerText, which is empty where a table is folded away
    const walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT), out = [];
    while (walker.nextNode()) out.push(walker.currentNode.data);
    return out.join(" ").replace(/\s+/g, " ").trim();
  }
  const cells = (row) => [...row.cells].map(words);
  const lines = (table) => [...table.tBodies[0].rows].filter((row) => !row.hidden);
  const single = (row) => row.classList.contains("group");
  // "3.7 mm", "+2", "1e-5", "> 100 %" and "▲ at its bound 4 N/m" are ordered as numbers, all else as words,
  // "linen/static-2" and "2026-01-31" too.
  const NUMBER = /^(?:▲ at its bound)?[<>≤≥≈±\s]*([-−+]?\d[\d,]*(?:\.\d+)?(?:e[-+−]?\d+)?)(?![\w.-])/i;
  const number = (text) => { const found = text.match(NUMBER); return found ? +found[1].replace(/,/g, "").replace(/−/g, "-") : NaN; };
  const value = (row, column) => (row.cells[column] ? words(row.cells[column]) : "");
  function compare(a, b, column) {
    const [x, y] = [value(a, column), value(b, column)], [p, q] = [number(x), number(y)];
    if (Number.isNaN(p) || Number.isNaN(q)) return Number.isNaN(p) - Number.isNaN(q) || x.localeCompare(y, undefined, { numeric: true });
    return p - q;
  }
  function sort(table, column, down) {
    const body = table.tBodies[0], parts = [[]];
    for (const row of [...body.rows]) single(row) ? parts.push([row]) : parts.at(-1).push(row);
    for (const part of parts) {
      const [head, rest] = [part.filter(single), part.filter((row) => !single(row))];
      rest.sort((a, b) => (down ? -1 : 1) * compare(a, b, column));
      body.append(...head, ...rest);
    }
  }
  function sortable(table) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.append(...head.childNodes);
      button.title = "sort";
      head.append(button);
      button.addEventListener("click", () => {
        const down = head.ariaSort === "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.ariaSort = down ? "descending" : "ascending";
        sort(table, column, down);
      });
    });
  }
  const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const texts = (table) => [cells(table.tHead.rows[0]), ...lines(table).map(cells)];
  const csv = (table) => texts(table).map((row) => row.map(quoted).join(",")).join("\r\n") + "\r\n";
  function json(table) {
    const heads = cells(table.tHead.rows[0]), out = [];
    let group;
    for (const row of lines(table)) {
      if (single(row)) group = cells(row)[0];
      else out.push(Object.fromEntries([...(group ? [["group", group]] : []), ...cells(row).map((c, i) => [heads[i], c])]));
    }
    return JSON.stringify(out, null, 1);
  }
  function save(name, kind, text) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: kind }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
  async function copy(table, button) {
    const text = texts(table).map((row) => row.join("\t")).join("\n");
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");  // the clipboard's newer door is shut for files that were opened from disk
    area.remove();
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1200);
  }
  function button(name, title, work) {
    const out = document.createElement("button");
    out.textContent = name;
    out.title = title;
    out.addEventListener("click", () => work(out));
    return out;
  }
  function filter(table) {
    const field = document.createElement("input");
    field.type = "search";
    field.placeholder = "filter";
    field.ariaLabel = "filter the lines of the table below";
    field.addEventListener("input", () => {
      const wanted = field.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table.tBodies[0].rows) {
        const text = cells(row).join(" ").toLowerCase();
        row.hidden = !single(row) && !wanted.every((word) => text.includes(word));
      }
    });
    return field;
  }
  function nameOf(table) {
    let place = table.closest(".scroll");
    while (place && !place.querySelector?.("h2, h3") && !/^H[23]$/.test(place.tagName)) {
      place = place.previousElementSibling ?? place.parentElement;
    }
    return (place?.textContent ?? "table").trim().slice(0, 40).replace(/[^\w-]+/g, "-").toLowerCase() || "table";
  }
  function equip(table) {
    const count = table.tBodies[0]?.rows.length ?? 0;
    if (!table.tHead || count < SHORT || table.dataset.plain !== undefined) return;
    sortable(table);
    const tools = document.createElement("div");
    tools.className = "tools";
    if (count >= LONG) tools.append(filter(table));
    tools.append(
      button("copy", "copy as text, for a spreadsheet", (self) => copy(table, self)),
      button("CSV", "save as CSV", () => save(`${nameOf(table)}.csv`, "text/csv", csv(table))),
      button("JSON", "save as JSON", () => save(`${nameOf(table)}.json`, "application/json", json(table))),
    );
    table.closest(".scroll").before(tools);
  }
  // What scrolls by itself is reached by the keyboard, what does not is no stop on the way.
  const boxes = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      const scrolls = target.scrollWidth > target.clientWidth || target.scrollHeight > target.clientHeight;
      if (scrolls) target.tabIndex = 0;
      else target.removeAttribute("tabindex");
    }
  });
  const reachable = (place) => place.querySelectorAll(".scroll, .strip").forEach((box) => boxes.observe(box));
  // Long parts of the page are packed until they come near the window, or what folds them away is opened.
  async function fill(place) {
    const script = place.querySelector("[data-fragment]");
    if (!script) return;
    script.removeAttribute("data-fragment");
    place.innerHTML = await unpacked(script);
    place.querySelectorAll(".scroll > table").forEach(equip);
    reachable(place);
  }
  const close = new IntersectionObserver((entries) => {
    for (const { target } of entries.filter((entry) => entry.isIntersecting)) { close.unobserve(target); fill(target); }
  }, { rootMargin: "800px" });
  document.querySelectorAll(".scroll > table").forEach(equip);
  reachable(document);
  document.querySelectorAll(".later").forEach((place) => close.observe(place));
  addEventListener("beforeprint", () => document.querySelectorAll(".later").forEach(fill));
})();
