"use strict";
// The points of the page: unpacked from their stream (see stages/exports/view.py) and drawn without a graphics card
// into the pixels of a canvas.  Half a million points take about 20 ms.

async function unpackPoints(base64, axes) {
  const text = atob(base64.trim()), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  const length = new DataView(bytes.buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  const packed = new Blob([bytes.subarray(4 + length)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(packed).arrayBuffer());
  const n = head.n;
  const at = new Float32Array(3 * n), rgb = new Uint8Array(3 * n), layers = {};
  for (const layer of head.layers) layers[layer.name] = {...layer, of: new Uint8Array(n)};
  // neighbours on the curve are spread over the whole order, so that the first points, however few, show the whole scene
  let stride = Math.max(1, Math.round(n * 0.6180339887));
  const gcd = (a, b) => (b ? gcd(b, a % b) : a);
  while (gcd(stride, n || 1) !== 1) stride++;
  const [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = axes.rows, step = head.step;
  const [x0, y0, z0] = [0, 1, 2].map(k => head.low[k] - axes.origin[k]), of = head.layers.map(layer => layers[layer.name].of);
  let x = 0, y = 0, z = 0;
  for (let i = 0, to = 0; i < n; i++, to = (to + stride) % n) {
    x = x + planes[i] + (planes[3 * n + i] << 8) & 65535; y = y + planes[n + i] + (planes[4 * n + i] << 8) & 65535; z = z + planes[2 * n + i] + (planes[5 * n + i] << 8) & 65535;
    const u = x0 + x * step, v = y0 + y * step, w = z0 + z * step, k = 3 * to;
    at[k] = ax * u + ay * v + az * w; at[k + 1] = bx * u + by * v + bz * w; at[k + 2] = cx * u + cy * v + cz * w;
    rgb[k] = planes[6 * n + i]; rgb[k + 1] = planes[7 * n + i]; rgb[k + 2] = planes[8 * n + i];
    for (let l = 0; l < of.length; l++) of[l][to] = planes[(9 + l) * n + i];
  }
  const heights = Float32Array.from({length: Math.min(n, 20000)}, (_, i) => at[3 * i + 2]).sort();
  const low = heights[Math.floor(0.01 * heights.length)] || 0, high = heights[Math.floor(0.99 * heights.length)] || 1;
  const height = new Uint8ClampedArray(n), share = 255 / Math.max(high - low, 1e-9);
  for (let i = 0; i < n; i++) height[i] = share * (at[3 * i + 2] - low);
  const level = cx * axes.origin[0] + cy * axes.origin[1] + cz * axes.origin[2]; // heights as the world counts them
  layers.height = {name: "height", low: low + level, high: high + level, unit: axes.unit, of: height};
  return {n, at, rgb, layers, voxel: head.voxel, total: head.total};
}

// 256 colours from dark to light through green (after viridis, by Nathaniel Smith and Stéfan van der Walt, CC0), packed as pixels
const RAMP = (() => {
  const stops = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];
  return Uint32Array.from({length: 256}, (_, i) => {
    const x = i / 255 * (stops.length - 1), k = Math.min(stops.length - 2, Math.floor(x)), t = x - k;
    const [r, g, b] = [0, 1, 2].map(c => Math.round(stops[k][c] * (1 - t) + stops[k + 1][c] * t));
    return (255 << 24 | b << 16 | g << 8 | r) >>> 0;
  });
})();
const DIVERGING = Uint32Array.from({length: 256}, (_, i) => { // blue: lower than on the other night; red: higher
  const t = Math.abs(i - 128) / 128, [r, g, b] = (i < 128 ? [50, 110, 255] : [255, 70, 40]).map(c => Math.round(150 * (1 - t) + c * t));
  return (255 << 24 | b << 16 | g << 8 | r) >>> 0;
});
const rampOf = mode => mode === "difference" ? DIVERGING : RAMP;
const rampCss = ramp => `linear-gradient(90deg, ${[0, 64, 128, 192, 255].map(i => `rgb(${ramp[i] & 255},${ramp[i] >> 8 & 255},${ramp[i] >> 16 & 255})`).join(", ")})`;

// A value, with its standard deviation if it has one, as a person would say it: lengths as 8.44 m, 3.2 cm or 4 mm.
function inWords(value, unit, sigma = null) {
  const isLength = unit === "m" || unit === "mm", metres = isLength && unit === "mm" ? 0.001 : 1;
  const size = metres * Math.max(Math.abs(value), sigma ?? 0);
  let [factor, shown, digits] = [metres, isLength ? "m" : unit, size >= 100 ? 0 : 2];
  if (isLength && size > 0 && size < 0.01) [factor, shown, digits] = [1000 * metres, "mm", 1];
  else if (isLength && size > 0 && size < 1) [factor, shown, digits] = [100 * metres, "cm", size < 0.1 ? 1 : 0];
  const number = v => (factor * v).toFixed(digits), short = text => text.includes(".") ? text.replace(/\.?0+$/, "") : text;
  const words = sigma === null ? short(number(value)) : `${number(value)} ± ${number(sigma)}`;
  return shown ? `${words} ${shown}` : words;
}

// The value of a layer's byte, in the layer's unit.
const valueOf = (layer, byte) => layer.most ? layer.least * (layer.most / layer.least) ** (byte / 255) : layer.low + (layer.high - layer.low) * byte / 255;

const greyOf = (rgb, i) => 0.3 * rgb[3 * i] + 0.6 * rgb[3 * i + 1] + 0.1 * rgb[3 * i + 2];
const KINDS = {new: 0, unchanged: 1, vanished: 2};
const kindOf = (changes, i) => Math.round(valueOf(changes.layers.kind, changes.layers.kind.of[i]));
function tinted(rgb, i, [r, g, b]) { // a colour that keeps the light and shade of the point, so that its shape can be seen
  const light = 0.55 + 0.45 * greyOf(rgb, i) / 255;
  return (255 << 24 | b * light << 16 | g * light << 8 | r * light) >>> 0;
}

// Colours of the night's points: those whose nearest point in the changes is new are red, all others grey.
function changedPixels(points, changes) {
  const pixels = pixelsOf(points, "change"), reach = 3 * changes.voxel, low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < changes.n; i++) if (kindOf(changes, i) === KINDS.new) for (let k = 0; k < 3; k++) {
    low[k] = Math.min(low[k], changes.at[3 * i + k] - reach); high[k] = Math.max(high[k], changes.at[3 * i + k] + reach);
  }
  if (low[0] === Infinity) return pixels;
  // cells as large as the reach: what is near to a point is in its own cell or beside it
  const extent = low.map((v, k) => high[k] - v), cell = Math.max(reach, Math.cbrt(extent[0] * extent[1] * extent[2] / 3e6));
  const [wide, deep, tall] = extent.map(v => Math.floor(v / cell) + 1), first = new Int32Array(wide * deep * tall).fill(-1), next = new Int32Array(changes.n);
  const cellOf = (at, i) => {
    const x = Math.floor((at[3 * i] - low[0]) / cell), y = Math.floor((at[3 * i + 1] - low[1]) / cell), z = Math.floor((at[3 * i + 2] - low[2]) / cell);
    return x < 0 || y < 0 || z < 0 || x >= wide || y >= deep || z >= tall ? -1 : (z * deep + y) * wide + x;
  };
  for (let i = 0; i < changes.n; i++) {
    const k = kindOf(changes, i) === KINDS.vanished ? -1 : cellOf(changes.at, i);
    if (k >= 0) { next[i] = first[k]; first[k] = i; }
  }
  for (let i = 0; i < points.n; i++) {
    const k = cellOf(points.at, i);
    if (k < 0) continue;
    const x = k % wide, y = Math.floor(k / wide) % deep, z = Math.floor(k / (wide * deep));
    let best = reach * reach, found = -1;
    for (let c = Math.max(0, z - 1); c <= Math.min(tall - 1, z + 1); c++)
      for (let b = Math.max(0, y - 1); b <= Math.min(deep - 1, y + 1); b++)
        for (let a = Math.max(0, x - 1); a <= Math.min(wide - 1, x + 1); a++)
          for (let j = first[(c * deep + b) * wide + a]; j >= 0; j = next[j]) {
            const u = changes.at[3 * j] - points.at[3 * i], v = changes.at[3 * j + 1] - points.at[3 * i + 1], w = changes.at[3 * j + 2] - points.at[3 * i + 2], d = u * u + v * v + w * w;
            if (d < best) { best = d; found = j; }
          }
    if (found >= 0 && kindOf(changes, found) === KINDS.new) pixels[i] = tinted(points.rgb, i, [255, 98, 48]);
  }
  return pixels;
}

// The vanished points among the changes, which are drawn where they were.
function vanishedOf(changes) {
  const kept = [];
  for (let i = 0; i < changes.n; i++) if (kindOf(changes, i) === KINDS.vanished) kept.push(i);
  const pick = (of, width) => of.constructor.from({length: width * kept.length}, (_, k) => of[width * kept[Math.floor(k / width)] + k % width]);
  return {...changes, n: kept.length, at: pick(changes.at, 3), rgb: pick(changes.rgb, 3), layers: {}};
}

function pixelsOf(points, mode) {
  const {n, rgb} = points, pixels = new Uint32Array(n), layer = points.layers[mode], ramp = rampOf(mode);
  const colours = layer && ramp.map((_, byte) => ramp[Math.round(255 * Math.max(0, Math.min(1, (valueOf(layer, byte) - layer.low) / (layer.high - layer.low || 1))))]);
  for (let i = 0; i < n; i++) {
    if (layer) pixels[i] = colours[layer.of[i]];
    else if (mode === "change") { // grey, so that what has changed stands out
      const grey = 40 + 0.55 * greyOf(rgb, i);
      pixels[i] = (255 << 24 | grey << 16 | grey << 8 | grey) >>> 0;
    } else pixels[i] = (255 << 24 | rgb[3 * i + 2] << 16 | rgb[3 * i + 1] << 8 | rgb[3 * i]) >>> 0;
  }
  return pixels;
}

// Draws the first `count` points of a set as squares of their voxel's size, the nearest in front.
// eye, right, up, ahead: position and axes of the viewer, in the axes of the points; focal: pixels.
// clip: lowest and highest height that is drawn; null: all.  frame.from, frame.to: columns that are drawn into.
function splat(frame, points, pixels, count, camera, clip, grow) {
  const {width, height, depth, image, from, to} = frame, at = points.at;
  const [low, high] = clip || [-Infinity, Infinity], [ex, ey, ez] = camera.eye, [rx, ry, rz] = camera.right, [ux, uy, uz] = camera.up, [fx, fy, fz] = camera.ahead;
  const focal = camera.focal, cx = width / 2, cy = height / 2, near = camera.near, size = 0.62 * points.voxel * grow * focal;
  for (let i = 0, j = 0; i < count; i++, j += 3) {
    const x = at[j] - ex, y = at[j + 1] - ey, z = at[j + 2] - ez;
    const w = x * fx + y * fy + z * fz;
    if (w < near || at[j + 2] < low || at[j + 2] > high) continue;
    const q = focal / w, u = cx + (x * rx + y * ry + z * rz) * q, v = cy - (x * ux + y * uy + z * uz) * q;
    if (!(u >= from && v >= 0 && u < to && v < height)) continue;
    const half = size / w, colour = pixels[i];
    if (half < 0.75) {
      const k = (v | 0) * width + (u | 0);
      if (w < depth[k]) { depth[k] = w; image[k] = colour; }
      continue;
    }
    const reach = half > 6 ? 6 : half;
    const left = Math.max(from, u - reach + 0.5 | 0), right = Math.min(to - 1, u + reach - 0.5 | 0);
    const bottom = Math.min(height - 1, v + reach - 0.5 | 0);
    for (let row = Math.max(0, v - reach + 0.5 | 0); row <= bottom; row++)
      for (let k = row * width + left, end = row * width + right; k <= end; k++)
        if (w < depth[k]) { depth[k] = w; image[k] = colour; }
  }
}

// Darkens pixels that are farther away than their neighbours, so that edges and shapes show without any light
// (eye-dome lighting: Boucheny, Interactive scientific visualization of large datasets, 2009; by ratios of depths).
function shade(frame, strength) {
  const {width, height, depth, image} = frame, far = 2 * width;
  for (let row = 2; row < height - 2; row++)
    for (let k = row * width + 2, end = (row + 1) * width - 2; k < end; k++) {
      const here = depth[k];
      if (here > 1e30) continue;
      const a = depth[k - 2], b = depth[k + 2], c = depth[k - far], d = depth[k + far];
      const nearer = (a < here ? here - a : 0) + (b < here ? here - b : 0) + (c < here ? here - c : 0) + (d < here ? here - d : 0);
      const dark = strength * nearer / here;
      if (dark < 0.02) continue;
      const light = dark > 3 ? 64 : (256 / (1 + dark)) | 0, pixel = image[k]; // in 256ths
      image[k] = -16777216 | ((pixel >> 16 & 255) * light >> 8) << 16 | ((pixel >> 8 & 255) * light >> 8) << 8 | (pixel & 255) * light >> 8;
    }
}
