"use strict";
// Another night beside this one: a slider that wipes from one to the other, or shows both in turn; heights compared; pictures overlaid.

class Nights {
  constructor(view, root) {
    this.view = view; this.root = root; this.then = view.sets.find(set => set.name === "then"); this.now = view.sets.find(set => set.name === "product");
    if (!root || !this.then || !this.now) return;
    this.slider = root.querySelector("input"); this.button = root.querySelector("[data-do=blink]");
    this.slider.addEventListener("input", () => { this.blink(false); this.show(this.slider.value / 100); });
    differences(this.now.points, this.then.points);
  }
  show(wipe) {
    if (!this.slider) return;
    this.view.wipe = wipe; this.slider.value = 100 * wipe; this.view.draw();
    for (const name of this.root.querySelectorAll("[data-night]")) name.classList.toggle("shown", name.dataset.night === "then" ? wipe > 0 : wipe < 1);
  }
  blink(on) {
    clearInterval(this.timer); this.timer = on ? setInterval(() => this.show(this.view.wipe < 0.5 ? 1 : 0), 800) : 0;
    this.button.setAttribute("aria-pressed", String(on));
    if (on) this.show(this.view.wipe < 0.5 ? 1 : 0);
  }
}

// Adds a layer to both sets: how much higher the later surface, seen from above, is at a point than the earlier one.
function differences(now, then) {
  const cell = 1.5 * Math.max(now.voxel, then.voxel), low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (let i = 0; i < now.n; i++) for (let k = 0; k < 2; k++) { const v = now.at[3 * i + k]; if (v < low[k]) low[k] = v; if (v > high[k]) high[k] = v; }
  const edge = Math.max(cell, Math.sqrt((high[0] - low[0]) * (high[1] - low[1]) / 4e6)), wide = Math.ceil((high[0] - low[0]) / edge) + 3, deep = Math.ceil((high[1] - low[1]) / edge) + 3;
  const place = (points, i) => { const x = Math.floor((points.at[3 * i] - low[0]) / edge) + 1, y = Math.floor((points.at[3 * i + 1] - low[1]) / edge) + 1; return x < 1 || y < 1 || x > wide - 2 || y > deep - 2 ? -1 : y * wide + x; };
  const tops = points => {
    const found = new Float32Array(wide * deep).fill(-Infinity);
    for (let i = 0; i < points.n; i++) { const k = place(points, i); if (k >= 0 && points.at[3 * i + 2] > found[k]) found[k] = points.at[3 * i + 2]; }
    return found;
  };
  const [a, b] = [tops(now), tops(then)], difference = new Float32Array(wide * deep), known = [];
  const nearest = (height, heights, k) => { // an edge may be a cell off
    let best = Infinity;
    for (let v = -wide; v <= wide; v += wide) for (let u = -1; u <= 1; u++) { const d = height - heights[k + v + u]; if (Math.abs(d) < Math.abs(best)) best = d; }
    return best;
  };
  for (let k = wide + 1; k < wide * (deep - 1) - 1; k++) {
    if (a[k] === -Infinity || b[k] === -Infinity) continue;
    const up = nearest(a[k], b, k), down = -nearest(b[k], a, k);
    difference[k] = Math.abs(up) < Math.abs(down) ? up : down;
    known.push(Math.abs(difference[k]));
  }
  known.sort((x, y) => x - y);
  const most = Math.max(known[Math.floor(0.99 * (known.length - 1))] || 0, 3 * edge), unit = now.layers.height.unit;
  for (const points of [now, then]) {
    const of = new Uint8ClampedArray(points.n);
    for (let i = 0; i < points.n; i++) { const k = place(points, i); of[i] = 128 + 127 * (k < 0 ? 0 : difference[k]) / most; }
    points.layers.difference = {name: "difference", low: -most, high: most, unit, of};
  }
}

// The two pictures that lie beside each other in one, with a white gap between them; null if there is only one.
function halvesOf(image) {
  const wide = image.naturalWidth, high = image.naturalHeight, canvas = document.createElement("canvas"), pen = canvas.getContext("2d", {willReadFrequently: true});
  canvas.width = wide; canvas.height = high; pen.drawImage(image, 0, 0);
  const data = pen.getImageData(0, 0, wide, high).data, white = x => {
    for (let y = 0; y < high; y++) for (let c = 0; c < 3; c++) if (data[4 * (y * wide + x) + c] < 200) return false; // less than 255: JPEG blurs it
    return true;
  };
  let left = 0, right = 0; // the widest white strip
  for (let x = Math.floor(0.2 * wide); x < 0.8 * wide; x++) {
    const from = x;
    while (x < 0.8 * wide && white(x)) x++;
    if (x - from > right - left) { left = from; right = x; }
  }
  if (right - left < 2 || right - left > 12) return null;
  return [[0, left], [right, wide]].map(([from, to]) => {
    const half = document.createElement("canvas");
    half.width = to - from; half.height = high; half.getContext("2d").drawImage(image, from, 0, to - from, high, 0, 0, to - from, high);
    return half;
  });
}
for (const place of document.querySelectorAll(".wipe")) { // a change's place on two nights, one over the other
  const lay = () => {
    const image = place.querySelector("img"), halves = image && halvesOf(image);
    if (!halves || place.querySelector(".both")) return;
    const both = document.querySelector("#wipe").content.firstElementChild.cloneNode(true), [then, now] = both.querySelectorAll(".date");
    halves[0].className = "then"; both.prepend(halves[0]); both.querySelector(".now").append(halves[1]);
    then.textContent = place.dataset.then; now.textContent = place.dataset.now;
    both.style.aspectRatio = `${halves[1].width} / ${halves[1].height}`; both.style.setProperty("--wide", halves[1].width / halves[1].height);
    both.querySelector("input").ariaLabel = `left of it: ${place.dataset.then}; right of it: ${place.dataset.now}`;
    both.querySelector("input").addEventListener("input", e => both.style.setProperty("--at", `${e.target.value}%`));
    place.prepend(both); place.classList.add("laid");
  };
  const image = place.querySelector("img");
  if (image?.complete && image.naturalWidth) lay(); else image?.addEventListener("load", lay);
}

for (const both of document.querySelectorAll(".both:has(img.then)")) { // a camera's pictures of two nights, one over the other
  const then = both.querySelector(".then"), H = (then.dataset.onto || "").split(" ").map(Number);
  both.querySelector("input").addEventListener("input", e => both.style.setProperty("--at", `${e.target.value}%`));
  const lay = () => { // from the unit square to pixels of the page
    const w = then.clientWidth, h = then.clientHeight;
    if (H.length !== 9 || !w || !h) return;
    const [a, b, c, d, e, f, g, i, j] = H;
    then.style.transform = `matrix3d(${[a, d * h / w, 0, g / w, b * w / h, e, 0, i / h, 0, 0, 1, 0, c * w, f * h, 0, j].join(",")})`;
  };
  new ResizeObserver(lay).observe(then); lay();
}
