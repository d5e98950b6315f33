// What the player paints: a picture through the recording's camera, a difference of two, the sheet in space, a curve.
const panes = (() => {
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const dark = () => matchMedia("(prefers-color-scheme: dark)").matches;
  const mix = (a, b, share) => a.map((x, i) => x + (b[i] - x) * share);
  const COLD = [62, 122, 190], HOT = [214, 98, 36], STEEP = 3;  // grey steps are made so many times as plain
  const calm = () => (dark() ? [30, 34, 40] : [246, 247, 249]);

  function blank(canvas, width, height) {
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    return context;
  }
  function put(canvas, [width, height], colourOf) {
    const context = blank(canvas, width, height), image = context.createImageData(width, height);
    for (let i = 0; i < width * height; i++) {
      const [r, g, b] = colourOf(i);
      image.data.set([r, g, b, 255], 4 * i);
    }
    context.putImageData(image, 0, 0);
  }

  // Pictures are {size, rgb(i), grey(i), cloth(i)}: colours 0 to 255, and whether a pixel shows the sheet (null: unknown).
  function filmed(shot, frame) {
    const data = shot.pictures[frame];
    return {
      size: shot.size, rgb: (i) => [data[4 * i], data[4 * i + 1], data[4 * i + 2]], cloth: null,
      grey: (i) => 0.3 * data[4 * i] + 0.59 * data[4 * i + 1] + 0.11 * data[4 * i + 2],
    };
  }
  function drawn(shot, take, frame) {
    const points = shot.surface.refine(take.position[frame], 3), { triangle } = shot.surface, size = shot.size;
    if (shot.optics.projector) {
      const grey = sheet.striped(shot.optics, size, points, triangle);
      return { size, rgb: (i) => [255 * grey[i], 255 * grey[i], 255 * grey[i]], grey: (i) => 255 * grey[i], cloth: null };
    }
    const normal = sheet.normals(points, triangle), { rotation } = shot.optics.camera;
    const facing = Float64Array.from({ length: points.length / 3 }, (_, n) =>
      Math.abs(rotation[2][0] * normal[3 * n] + rotation[2][1] * normal[3 * n + 1] + rotation[2][2] * normal[3 * n + 2]));
    const { nearest, out } = sheet.raster(sheet.project(shot.optics.camera, points), triangle, facing, 1, ...size);
    const grey = (i) => (nearest[i] === Infinity ? 8 : 70 + 160 * out[i]);
    return { size, rgb: (i) => [grey(i), grey(i), grey(i)], grey, cloth: (i) => nearest[i] !== Infinity };
  }
  function difference(canvas, left, right) {
    const ground = calm();
    if (right.cloth) {  // no stripes to compare: the sheet laid over what was filmed
      put(canvas, left.size, (i) => (right.cloth(i) ? mix(left.rgb(i), COLD, 0.45) : left.rgb(i)));
      return;
    }
    put(canvas, left.size, (i) => {
      const away = (STEEP * (right.grey(i) - left.grey(i))) / 255;
      return mix(ground, away > 0 ? HOT : COLD, Math.min(Math.abs(away), 1));
    });
  }

  // An eye that goes round a sheet: yaw and pitch [rad], as a camera of sheet.project.
  function eye({ centre, radius }, yaw, pitch, width, height) {
    const forward = [-Math.cos(pitch) * Math.cos(yaw), -Math.cos(pitch) * Math.sin(yaw), -Math.sin(pitch)];
    const right = [-Math.sin(yaw), Math.cos(yaw), 0];
    const down = [0, 1, 2].map((i) => forward[(i + 1) % 3] * right[(i + 2) % 3] - forward[(i + 2) % 3] * right[(i + 1) % 3]);
    const rotation = [right, down, forward], away = 4.2 * radius, focal = (0.54 * Math.min(width, height) * away) / radius;
    const place = centre.map((c, i) => c - away * forward[i]);
    const translation = rotation.map((row) => -row.reduce((sum, r, i) => sum + r * place[i], 0));
    const matrix = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]];
    return { matrix, rotation, translation, light: mix(forward.map((f) => -f), [0, 0, 1], 0.35) };
  }
  function heat(share) {
    const stops = dark() ? [[86, 98, 116], [214, 150, 90], [232, 84, 60]] : [[206, 215, 226], [236, 170, 105], [190, 46, 38]];
    const at = Math.min(Math.max(share, 0), 1) * 2, i = Math.min(Math.floor(at), 1);
    return mix(stops[i], stops[i + 1], at - i);
  }
  // Points (N * 3) as a sheet coloured by `away` (N) over `most`, with dots where points were seen.
  function space(canvas, { surface, box, points, away, most, seen, yaw, pitch }) {
    const scale = Math.min(devicePixelRatio || 1, 1.5);
    const width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
    if (!width || !height) return;
    const camera = eye(box, yaw, pitch, width, height), fine = surface.refine(points, 3);
    const normal = sheet.normals(fine, surface.triangle), colour = surface.refine(away, 1), count = fine.length / 3;
    const values = new Float64Array(2 * count);
    for (let n = 0; n < count; n++) {
      const lit = Math.abs([0, 1, 2].reduce((sum, k) => sum + camera.light[k] * normal[3 * n + k], 0));
      values.set([colour[n], 0.58 + 0.42 * Math.min(lit, 1)], 2 * n);
    }
    const { nearest, out } = sheet.raster(sheet.project(camera, fine), surface.triangle, values, 2, width, height);
    const context = blank(canvas, width, height), image = context.createImageData(width, height);
    for (let i = 0; i < width * height; i++) {
      if (nearest[i] === Infinity) continue;
      const [r, g, b] = heat(out[2 * i] / most), lit = out[2 * i + 1];
      image.data.set([r * lit, g * lit, b * lit, 255], 4 * i);
    }
    context.putImageData(image, 0, 0);
    if (seen) dots(context, camera, seen, nearest, { width, height, scale, reach: 0.06 * box.radius });
  }
  function dots(context, camera, seen, nearest, { width, height, scale, reach }) {
    const { pixel, depth } = sheet.project(camera, seen);
    context.fillStyle = css("--seen");
    for (let n = 0; n < depth.length; n++) {
      const [x, y] = [Math.round(pixel[2 * n]), Math.round(pixel[2 * n + 1])];
      if (!(x >= 0 && y >= 0 && x < width && y < height) || depth[n] > nearest[y * width + x] + reach) continue;
      context.beginPath();
      context.arc(x, y, 1.7 * scale, 0, 7);
      context.fill();
    }
  }

  // Errors over time: {time, lines: [{values, colour, width}], floor, frame, unit}; gives x → frame.
  function curve(canvas, { time, lines, floor, frame, label }) {
    const scale = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w) return;
    const context = blank(canvas, Math.round(w * scale), Math.round(h * scale)), [l, r, t, b] = [8, 8, 18, 16];
    context.scale(scale, scale);
    const known = lines.flatMap((line) => line.values.filter(Number.isFinite)), top = Math.max(...known, floor ?? 0, 1e-12);
    const x = (s) => l + ((s - time[0]) / (time.at(-1) - time[0] || 1)) * (w - l - r);
    const y = (value) => h - b - (value / top) * (h - t - b);
    context.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    context.strokeStyle = css("--line");
    context.beginPath();
    context.moveTo(l, y(0)); context.lineTo(w - r, y(0));
    context.stroke();
    if (floor) {
      context.setLineDash([4, 4]);
      context.beginPath(); context.moveTo(l, y(floor)); context.lineTo(w - r, y(floor)); context.stroke();
      context.setLineDash([]);
    }
    for (const { values, colour, width } of lines) {
      context.strokeStyle = colour; context.lineWidth = width; context.beginPath();
      let pen = false;
      values.forEach((value, i) => {
        if (!Number.isFinite(value)) { pen = false; return; }
        pen ? context.lineTo(x(time[i]), y(value)) : context.moveTo(x(time[i]), y(value));
        pen = true;
      });
      context.stroke();
    }
    context.strokeStyle = css("--text"); context.lineWidth = 1;
    context.beginPath(); context.moveTo(x(time[frame]), t - 4); context.lineTo(x(time[frame]), h - b); context.stroke();
    context.fillStyle = css("--soft");
    context.fillText(`${label}, up to ${top.toPrecision(3)}`, l, 11);
    context.fillText(`${time[0].toFixed(2)} s`, l, h - 3);
    const end = `${time.at(-1).toFixed(2)} s`;
    context.fillText(end, w - r - context.measureText(end).width, h - 3);
  }
  return { put, filmed, drawn, difference, space, curve, heat, css };
})();
