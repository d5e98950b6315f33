// A sheet of cloth: unpacked places, its refined surface, and what a camera or an eye sees of it. The same steps as in
// clothbench.vision (surface, render), so that the page's pictures are those that the metrics compared.
const sheet = (() => {
  const AMBIENT = 0.30, LIT = 0.60, DARK = 0.03, NOWHERE = -32768;

  // {origin, step, shape, steps} → {frames: [Float64Array(N * 3)]}, not a number where a point is not known.
  function places({ origin, step, shape: [frames, nodes], steps }) {
    const bytes = Uint8Array.from(atob(steps), (c) => c.charCodeAt(0)), half = bytes.length / 2;
    const out = Array.from({ length: frames }, () => new Float64Array(nodes * 3)), value = new Int16Array(1);
    for (let c = 0, i = 0; c < 3; c++) {
      for (let n = 0; n < nodes; n++) {
        value[0] = 0;
        for (let t = 0; t < frames; t++, i++) {
          value[0] += bytes[i] | (bytes[half + i] << 8);
          out[t][3 * n + c] = value[0] === NOWHERE ? NaN : value[0] * step + origin[c];
        }
      }
    }
    return out;
  }

  // Weights by which the cubic through the four nearest of some lines reads each of `at`.
  function cubic(lines, at) {
    const count = Math.min(4, lines.length);
    return at.map((x) => {
      const beyond = lines.findIndex((line) => line > x), right = beyond < 0 ? lines.length : beyond;
      const first = Math.min(Math.max(right - 2, 0), lines.length - count), out = new Float64Array(lines.length);
      for (let i = first; i < first + count; i++) {
        out[i] = 1;
        for (let j = first; j < first + count; j++) if (j !== i) out[i] *= (x - lines[j]) / (lines[i] - lines[j]);
      }
      return out;
    });
  }
  const finer = (lines, refine) => [
    ...lines.slice(0, -1).flatMap((line, i) =>
      Array.from({ length: refine }, (_, k) => line + ((lines[i + 1] - line) * k) / refine)), lines.at(-1)];

  // How points become a drawn surface: {triangle: Int32Array, refine(values, channels) → Float64Array}.
  function surface(told) {
    if (told.triangle) return { triangle: Int32Array.from(told.triangle.flat()), refine: (values) => values };
    const { u, v, order, refine } = told, wu = cubic(u, finer(u, refine)), wv = cubic(v, finer(v, refine));
    const across = wu.length, down = wv.length, triangle = [];
    for (let j = 0; j + 1 < down; j++) {
      for (let i = 0; i + 1 < across; i++) {
        const a = j * across + i;
        triangle.push(a, a + across, a + 1, a + 1, a + across, a + across + 1);
      }
    }
    function refined(values, channels) {
      const rows = new Float64Array(v.length * across * channels), out = new Float64Array(down * across * channels);
      for (let j = 0; j < v.length; j++) for (let i = 0; i < across; i++) for (let k = 0; k < u.length; k++) {
        const w = wu[i][k], n = order[j * u.length + k];
        if (w) for (let c = 0; c < channels; c++) rows[(j * across + i) * channels + c] += w * values[n * channels + c];
      }
      for (let j = 0; j < down; j++) for (let k = 0; k < v.length; k++) {
        const w = wv[j][k];
        if (w) for (let i = 0; i < across * channels; i++) out[j * across * channels + i] += w * rows[k * across * channels + i];
      }
      return out;
    }
    return { triangle: Int32Array.from(triangle), refine: refined };
  }

  // World points (M * 3) as a camera has them: pixels (M * 2) and depth (M).
  function project({ matrix: m, rotation: r, translation: t, distortion: d }, points) {
    const count = points.length / 3, pixel = new Float64Array(2 * count), depth = new Float64Array(count);
    for (let n = 0; n < count; n++) {
      const p = points.subarray(3 * n, 3 * n + 3), at = (i) => r[i][0] * p[0] + r[i][1] * p[1] + r[i][2] * p[2] + t[i];
      const z = at(2);
      let [x, y] = z > 0 ? [at(0) / z, at(1) / z] : [NaN, NaN];
      if (d?.some(Boolean)) {
        const q = x * x + y * y, radial = 1 + q * (d[0] + q * (d[1] + q * d[4]));
        [x, y] = [x * radial + 2 * d[2] * x * y + d[3] * (q + 2 * x * x), y * radial + d[2] * (q + 2 * y * y) + 2 * d[3] * x * y];
      }
      pixel[2 * n] = m[0][0] * x + m[0][1] * y + m[0][2];
      pixel[2 * n + 1] = m[1][0] * x + m[1][1] * y + m[1][2];
      depth[n] = z;
    }
    return { pixel, depth };
  }

  // Triangles over an image, the nearest at the middle of every pixel: {nearest (W * H), out (W * H * channels)}, values
  // interpolated with perspective.
  function raster({ pixel, depth }, triangle, values, channels, width, height) {
    const nearest = new Float64Array(width * height).fill(Infinity), out = new Float64Array(width * height * channels);
    for (let f = 0; f < triangle.length; f += 3) {
      const [a, b, c] = [triangle[f], triangle[f + 1], triangle[f + 2]];
      const ax = pixel[2 * a], ay = pixel[2 * a + 1], bx = pixel[2 * b], by = pixel[2 * b + 1], cx = pixel[2 * c], cy = pixel[2 * c + 1];
      const twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
      if (!(Math.abs(twice) > 1e-12 && Math.min(depth[a], depth[b], depth[c]) > 1e-3)) continue;
      const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx))), right = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx)));
      const top = Math.max(0, Math.ceil(Math.min(ay, by, cy))), bottom = Math.min(height - 1, Math.floor(Math.max(ay, by, cy)));
      const ia = 1 / depth[a], ib = 1 / depth[b], ic = 1 / depth[c];
      for (let y = top; y <= bottom; y++) {
        for (let x = left; x <= right; x++) {
          let p = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / twice, q = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / twice;
          let r = 1 - p - q;
          if (Math.min(p, q, r) < -1e-9) continue;
          const z = 1 / (p * ia + q * ib + r * ic), at = y * width + x;
          if (z >= nearest[at]) continue;
          nearest[at] = z;
          p *= ia * z;
          q *= ib * z;
          r *= ic * z;
          for (let k = 0; k < channels; k++) {
            out[at * channels + k] = p * values[a * channels + k] + q * values[b * channels + k] + r * values[c * channels + k];
          }
        }
      }
    }
    return { nearest, out };
  }

  // Grey (W * H, 0 to 1) of points lit by the projector's stripes, as the recording's camera sees them.
  function striped({ camera, projector }, [width, height], points, triangle) {
    const count = points.length / 3, rows = new Float64Array(2 * count), { matrix: m, rotation: r, translation: t } = projector;
    for (let n = 0; n < count; n++) {
      const at = (i) => r[i][0] * points[3 * n] + r[i][1] * points[3 * n + 1] + r[i][2] * points[3 * n + 2] + t[i];
      const [x, y, z] = [at(0), at(1), at(2)];
      rows[2 * n] = m[1][0] * x + m[1][1] * y + m[1][2] * z;
      rows[2 * n + 1] = z;
    }
    const { nearest, out } = raster(project(camera, points), triangle, rows, 2, width, height);
    return Float64Array.from(nearest, (z, i) => z === Infinity ? DARK
      : AMBIENT + LIT * (0.5 + 0.5 * Math.cos((2 * Math.PI * out[2 * i]) / out[2 * i + 1] / projector.period)));
  }

  // Unit normals (M * 3) of a surface, weighted by the area around each point.
  function normals(points, triangle) {
    const out = new Float64Array(points.length);
    for (let f = 0; f < triangle.length; f += 3) {
      const [a, b, c] = [3 * triangle[f], 3 * triangle[f + 1], 3 * triangle[f + 2]], e = [], g = [];
      for (let k = 0; k < 3; k++) { e[k] = points[b + k] - points[a + k]; g[k] = points[c + k] - points[a + k]; }
      const n = [e[1] * g[2] - e[2] * g[1], e[2] * g[0] - e[0] * g[2], e[0] * g[1] - e[1] * g[0]];
      if (!Number.isFinite(n[0] + n[1] + n[2])) continue;
      for (const at of [a, b, c]) for (let k = 0; k < 3; k++) out[at + k] += n[k];
    }
    for (let i = 0; i < out.length; i += 3) {
      const length = Math.hypot(out[i], out[i + 1], out[i + 2]) || 1;
      for (let k = 0; k < 3; k++) out[i + k] /= length;
    }
    return out;
  }

  return { places, surface, project, raster, striped, normals };
})();
