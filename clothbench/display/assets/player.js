// The player: one case and recording at a time, a scrubber shared by pictures, sheet and curve.
(() => {
  const root = document.querySelector(".player");
  if (!root) return;
  const part = (name) => root.querySelector(`[data-part="${name}"]`);
  const index = JSON.parse(byId("films").textContent), FILMED = "filmed";
  const state = { clip: null, shot: null, left: FILMED, right: "", frame: 0, yaw: 0, pitch: 0.15, since: 0, wanted: {} };
  const liveliest = index.reduce((best, c) => (c.recordings[0].frames > best.recordings[0].frames ? c : best));
  const sides = ["left", "right"];

  async function pictures(told) {
    if (!told.picture) return [];
    const image = new Image(), [width, height] = told.size;
    image.src = told.picture;
    await image.decode();
    const canvas = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, 0, 0);
    return told.time.map((_, n) => {
      const [column, row] = [n % told.across, Math.floor(n / told.across)];
      return context.getImageData(column * width, row * height, width, height).data;
    });
  }
  async function shotOf(clip) {
    const [told, takes] = await Promise.all([dataOf(clip.recording), dataOf(clip.takes)]);
    const seen = sheet.places(told.seen), shot = {
      ...told, seen, surface: sheet.surface(told.surface), pictures: await pictures(told), cache: new Map(),
      takes: new Map(takes.map((t, n) => [clip.words[n], { position: sheet.places(t.position), error: t.error }])),
    };
    if (!told.picture) shot.size = told.size[0] ? told.size : [0, 0];
    return { ...shot, box: boxOf([...seen, ...[...shot.takes.values()].flatMap((t) => t.position)]) };
  }
  function boxOf(frames) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const points of frames) points.forEach((value, i) => {
      if (value < low[i % 3]) low[i % 3] = value;
      if (value > high[i % 3]) high[i % 3] = value;
    });
    const size = high.map((x, i) => x - low[i]);
    return { centre: high.map((x, i) => (x + low[i]) / 2), radius: Math.hypot(...size) / 2 || 1 };
  }

  const places = (side, frame) => {
    const shot = state.shot, word = state[side];
    return word === FILMED ? shot.seen[frame] : shot.takes.get(word).position[frame];
  };
  // Distance [mm] of points (N * 3) from the nearest of others: of a cloud nobody knows which point is which.
  function nearest(points, others) {
    return Float64Array.from({ length: points.length / 3 }, (_, n) => {
      let least = NaN;
      for (let m = 0; m < others.length; m += 3) {
        const x = points[3 * n] - others[m], y = points[3 * n + 1] - others[m + 1], z = points[3 * n + 2] - others[m + 2];
        const square = x * x + y * y + z * z;
        if (square < least || Number.isNaN(least)) least = square;
      }
      return 1000 * Math.sqrt(least);
    });
  }
  // Distance [mm] of the right side's points from the left side's; across the line of sight where that is all one saw.
  function away(frame) {
    const a = places("right", frame), b = places("left", frame), out = new Float64Array(a.length / 3);
    if (state.shot.cloud && state.left === FILMED) return nearest(a, b);
    const along = state.shot.flat ? state.shot.optics.camera.rotation[2] : null;
    for (let n = 0; n < out.length; n++) {
      const d = [0, 1, 2].map((k) => a[3 * n + k] - b[3 * n + k]), out_of = along ? d.reduce((s, x, k) => s + x * along[k], 0) : 0;
      out[n] = 1000 * Math.sqrt(Math.max(d.reduce((s, x) => s + x * x, 0) - out_of * out_of, 0));
    }
    return out;
  }
  const finite = (values) => Array.from(values).filter(Number.isFinite);
  const mean = (values) => (values.length ? values.reduce((s, x) => s + x, 0) / values.length : NaN);
  function scaleOf() {
    const all = state.shot.time.flatMap((_, t) => finite(away(t))).sort((a, b) => a - b);
    const high = all[Math.floor(0.95 * (all.length - 1))] || 1, ten = 10 ** Math.floor(Math.log10(high));
    return [1, 2, 5, 10].map((k) => k * ten).find((k) => k >= high) ?? high;
  }
  // What was not seen takes the mean of the rest, so that no hole is torn into the colour.
  function filled(values) {
    const middle = mean(finite(values)) || 0;
    return values.map((x) => (Number.isFinite(x) ? x : middle));
  }

  function pictureOf(side) {
    const { shot, frame } = state, word = state[side];
    if (word === FILMED) return shot.pictures.length ? panes.filmed(shot, frame) : null;
    if (!shot.optics || !shot.size[0]) return null;
    const key = `${word} ${frame}`;
    if (!shot.cache.has(key)) shot.cache.set(key, panes.drawn(shot, shot.takes.get(word), frame));
    return shot.cache.get(key);
  }
  function paintPictures() {
    const [left, right] = sides.map(pictureOf);
    for (const name of ["left", "right", "difference"]) part(name).closest("figure").hidden = !(left && right);
    root.querySelector(".stage").classList.toggle("bare", !(left && right));
    if (!left || !right) return;
    panes.put(part("left"), left.size, left.rgb);
    panes.put(part("right"), right.size, right.rgb);
    panes.difference(part("difference"), left, right);
    part("difference-said").textContent = right.cloth ? `${state.right}, laid over` : "difference: orange brighter, blue darker";
  }
  function paintSpace() {
    const { shot, frame, yaw, pitch, most } = state, points = places("right", frame);
    if (!shot.surface.triangle.length) return;
    const seen = state.left === FILMED ? shot.seen[frame] : null;
    panes.space(part("space"), { surface: shot.surface, box: shot.box, points, away: filled(away(frame)), most, seen, yaw, pitch });
  }
  function curveOf(word) {
    if (word === FILMED) return null;
    const { error } = state.shot.takes.get(word);
    return error.some((e) => e !== null) ? error.map((e) => e ?? NaN) : null;
  }
  function paintCurve() {
    const { shot, clip, frame } = state, colours = { right: panes.css("--sim"), left: panes.css("--seen") };
    const lines = [...shot.takes.keys()].map((word) => ({ values: curveOf(word), colour: panes.css("--line"), width: 1 }));
    for (const side of sides) lines.push({ values: curveOf(state[side]), colour: colours[side], width: 2.2 });
    const known = lines.filter((line) => line.values);
    part("curve").hidden = !known.length;
    if (!known.length) return;
    const label = `${clip.metric} [${clip.unit}] of ${state.right}${clip.floor ? "; dashes: floor of noise alone" : ""}`;
    panes.curve(part("curve"), { time: shot.time, lines: known, floor: clip.floor, frame, label });
  }
  function say() {
    const { shot, clip, frame } = state, error = curveOf(state.right)?.[frame], distance = finite(away(frame));
    const parts = [`${shot.time[frame].toFixed(2)} s`];
    if (Number.isFinite(error)) parts.push(`${error.toPrecision(3)} ${clip.unit}`);
    if (distance.length) parts.push(`${mean(distance).toPrecision(3)} mm on average, ${Math.max(...distance).toPrecision(3)} at most`);
    part("said").textContent = parts.join(" · ");
    part("scrub").setAttribute("aria-valuetext", parts.join(", "));
  }
  function paint() {
    part("scrub").value = state.frame;
    paintPictures();
    paintSpace();
    paintCurve();
    say();
  }
  function paired() {
    state.most = scaleOf();
    part("most").textContent = `${state.most} mm`;
    const from = state.left === FILMED ? "where it was seen" : state.left;
    part("space-said").textContent = `${state.right}: distance from ${from}`;
    paint();
  }

  function fill(select, names, chosen) {
    options(select, names);
    select.value = chosen;
    select.disabled = names.length < 2;
  }
  async function open(caseName, recordingName) {
    const one = index.find((c) => c.case === caseName) ?? liveliest;
    const clip = one.recordings.find((r) => r.name === recordingName) ?? one.recordings[0];
    fill(part("case"), index.map((c) => c.case), one.case);
    part("case").closest("label").hidden = index.length < 2;
    options(part("recording"), []);
    part("recording").append(...one.recordings.map((r) => new Option(`${r.name} (${r.split.replace("_", " ")})`, r.name)));
    part("recording").value = clip.name;
    if (state.clip === clip) return;
    state.clip = clip;
    const shot = await shotOf(clip);
    if (state.clip !== clip) return;  // somebody has chosen another one meanwhile
    const keep = (word, other) => (shot.takes.has(word) || (word === FILMED && other === FILMED) ? word : other);
    const aimed = state.shot?.box.radius;
    state.shot = shot;
    state.left = keep(state.wanted.left ?? state.left, FILMED);
    state.right = keep(state.wanted.right ?? state.right, clip.words[0]);
    state.frame = Math.round(0.4 * (shot.time.length - 1));
    if (!aimed) aim(shot);
    fill(part("left-choice"), [FILMED, ...clip.words], state.left);
    fill(part("right-choice"), clip.words, state.right);
    part("scrub").max = shot.time.length - 1;
    root.classList.add("ready");
    paired();
  }
  // The eye begins a little beside the recording's camera, or where the sheet is seen most openly.
  function aim(shot) {
    const forward = shot.optics?.camera.rotation[2] ?? openly(shot);
    state.yaw = Math.atan2(-forward[1], -forward[0]) + 0.45;
    state.pitch = Math.min(Math.max(Math.asin(-forward[2]) + 0.12, -1.3), 1.3);
  }
  function openly(shot) {
    const points = [...shot.takes.values()][0].position[0], normal = sheet.normals(shot.surface.refine(points, 3), shot.surface.triangle);
    const sum = [0, 1, 2].map((k) => mean(Array.from(normal).filter((_, i) => i % 3 === k)));
    const length = Math.hypot(...sum) || 1;
    return length > 1e-6 ? sum.map((x) => -x / length) : [0, 1, 0];
  }

  function step(now) {
    if (!state.since) return;
    const { time } = state.shot, length = time.at(-1) - time[0] + (time[1] - time[0] || 0.1);
    const at = time[0] + (((now - state.since) / 1000) % length), next = time.findLastIndex((t) => t <= at);
    if (next !== state.frame) { state.frame = Math.max(next, 0); paint(); }
    requestAnimationFrame(step);
  }
  function play(on) {
    state.since = on && state.shot ? performance.now() - 1000 * (state.shot.time[state.frame] - state.shot.time[0]) : 0;
    part("play").textContent = state.since ? "❚❚ pause" : "▶ play";
    part("play").ariaPressed = String(Boolean(state.since));
    if (state.since) requestAnimationFrame(step);
  }
  function seek(frame) {
    play(false);
    state.frame = Math.min(Math.max(frame, 0), state.shot.time.length - 1);
    paint();
  }
  function turn(across, up) {
    state.yaw -= across;
    state.pitch = Math.min(Math.max(state.pitch + up, -1.5), 1.5);
    paintSpace();
  }
  function dragged(place, began, moved) {
    let last = null;
    place.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      place.setPointerCapture(event.pointerId);
      began(event);
    });
    place.addEventListener("pointermove", (event) => {
      if (!last) return;
      moved(event, event.clientX - last[0], event.clientY - last[1]);
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) place.addEventListener(end, () => { last = null; });
  }
  function seekAt(event) {
    const box = part("curve").getBoundingClientRect(), { time } = state.shot;
    const at = time[0] + ((event.clientX - box.left - 8) / (box.width - 16)) * (time.at(-1) - time[0]);
    const nearest = time.reduce((best, t, i) => (Math.abs(t - at) < Math.abs(time[best] - at) ? i : best), 0);
    seek(nearest);
  }

  part("case").addEventListener("change", () => address.choose("case", part("case").value));
  part("recording").addEventListener("change", () => address.choose("recording", part("recording").value));
  for (const side of sides) {
    part(`${side}-choice`).addEventListener("change", () => {
      address.keep(side, part(`${side}-choice`).value);
      state[side] = part(`${side}-choice`).value;
      paired();
    });
    address.listen(side, (word) => {
      state.wanted[side] = word;
      if (!state.shot || !(state.shot.takes.has(word) || (side === "left" && word === FILMED))) return;
      state[side] = part(`${side}-choice`).value = word;
      paired();
    });
  }
  part("play").addEventListener("click", () => play(!state.since));
  part("scrub").addEventListener("input", () => seek(Number(part("scrub").value)));
  dragged(part("curve"), seekAt, seekAt);
  dragged(part("space"), () => {}, (_, dx, dy) => turn(dx / 120, dy / 120));
  part("space").addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (way) { event.preventDefault(); turn(...way); }
  });
  new ResizeObserver(() => state.shot && paint()).observe(root);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => state.shot && paint());
  part("heat").style.background = `linear-gradient(90deg, ${[0, 0.25, 0.5, 0.75, 1].map((s) => `rgb(${panes.heat(s).map(Math.round)})`)})`;
  address.listen("case", (name) => open(name, address.get("recording")));
  address.listen("recording", (name) => open(part("case").value || address.get("case"), name));
  painted().then(() => { if (!state.clip) open(address.get("case"), address.get("recording")); });
})();
