"use strict";
// Measuring in the 3-D view and on the map: clicked points give coordinates, distances, heights, areas and a profile, each with its
// standard deviation if the points have one; a link stores the view and the measurement.

class Measure {
  constructor(view, scene, root) {
    this.view = view; this.axes = scene.axes; this.root = root; this.points = []; this.on = false;
    this.words = document.querySelectorAll(".measured"); this.plan = document.querySelector(".plan"); this.svg = root.querySelector(".profile");
    view.onOverlay = (ink, camera) => this.draw(ink, camera);
    this.plan?.addEventListener("click", e => this.onPlan(e));
  }
  set active(on) {
    this.on = on; this.plan?.classList.toggle("measured-in", on); this.view.picks = on ? p => p && this.add(p) : null; this.view.over.style.cursor = on ? "crosshair" : "grab";
    if (!on) this.points = [];
    this.show();
  }
  add(p) { this.points.push(this.nearest(p)); this.show(); }
  addMiddle() { const box = this.view.over.getBoundingClientRect(), p = this.view.under({clientX: box.left + box.width / 2, clientY: box.top + box.height / 2}); if (p) this.add(p); }
  undo() { this.points.pop(); this.show(); }
  world(p) { const {origin, rows} = this.axes; return [0, 1, 2].map(k => origin[k] + rows[0][k] * p[0] + rows[1][k] * p[1] + rows[2][k] * p[2]); }
  page(w) { const {origin, rows} = this.axes, d = w.map((v, k) => v - origin[k]); return rows.map(row => dot(row, d)); }
  get cloud() { return this.view.sets.find(set => set.name === "product")?.points; }
  nearest(p) { // the point of the cloud nearest to p, with its standard deviation in metres; p itself where none is near
    const cloud = this.cloud, layer = cloud?.layers.sigma;
    let best = Infinity, found = -1;
    for (let i = 0, j = 0; i < (cloud?.n ?? 0); i++, j += 3) {
      const x = cloud.at[j] - p[0], y = cloud.at[j + 1] - p[1], z = cloud.at[j + 2] - p[2], d = x * x + y * y + z * z;
      if (d < best) { best = d; found = i; }
    }
    if (found < 0 || Math.sqrt(best) > 5 * cloud.voxel) return {p, sigma: null};
    // the spacing of the points adds to the error
    return {p: [0, 1, 2].map(k => cloud.at[3 * found + k]), sigma: layer ? Math.hypot(valueOf(layer, layer.of[found]) / 1000, cloud.voxel / Math.sqrt(12)) : null};
  }
  below(x, y) { // the highest point of the cloud at a place of the map; null where none is near
    const cloud = this.cloud;
    for (const reach of cloud ? [0.75 * cloud.voxel, 3 * cloud.voxel] : []) {
      let found = -1;
      for (let i = 0, j = 0; i < cloud.n; i++, j += 3)
        if (Math.abs(cloud.at[j] - x) < reach && Math.abs(cloud.at[j + 1] - y) < reach && (found < 0 || cloud.at[j + 2] > cloud.at[3 * found + 2])) found = i;
      if (found >= 0) return [0, 1, 2].map(k => cloud.at[3 * found + k]);
    }
    return null;
  }
  // ---- figures
  figures() {
    const at = this.points.map(q => this.world(q.p)), up = this.axes.rows[2], n = at.length, between = (a, b) => Math.hypot(...plus(b, a, -1));
    const sigma = k => this.points[k].sigma, both = (...s) => s.some(v => v === null) ? null : Math.hypot(...s);
    const found = [];
    if (n === 1) found.push(["height", dot(at[0], up), sigma(0)]);
    if (n >= 2) {
      const a = at[n - 2], b = at[n - 1], s = both(sigma(n - 2), sigma(n - 1)), rise = dot(plus(b, a, -1), up), d = between(a, b);
      found.push(["distance", d, s], ["across", Math.sqrt(Math.max(0, d * d - rise * rise)), s], ["up", rise, s]);
    }
    if (n >= 3) {
      const flat = this.points.map(q => q.p), turn = k => flat[(k + n) % n], length = at.slice(1).reduce((sum, p, k) => sum + between(at[k], p), 0);
      const area = flat.reduce((sum, p, k) => sum + (p[0] * turn(k + 1)[1] - turn(k + 1)[0] * p[1]) / 2, 0);
      const parts = flat.map((_, k) => sigma(k) === null ? null : sigma(k) * Math.hypot(turn(k + 1)[0] - turn(k - 1)[0], turn(k + 1)[1] - turn(k - 1)[1]) / 2);
      found.push(["length", length, both(...at.map((_, k) => sigma(k)))], ["area", Math.abs(area), both(...parts)]);
    }
    return found;
  }
  text() {
    if (!this.points.length) return "";
    const unit = this.axes.unit, last = this.world(this.points.at(-1).p), place = this.geodetic(last);
    const lines = [last.map(v => v.toFixed(2)).join("  ") + (unit ? ` ${unit}` : "")]; // coordinates are always in the unit of the world
    if (place) lines.push(`${place[0].toFixed(7)}, ${place[1].toFixed(7)}, ${place[2].toFixed(2)} m`);
    for (const [name, value, sigma] of this.figures()) lines.push(`${name} ${inWords(value, name === "area" ? unit && `${unit}²` : unit, sigma)}`);
    return lines.join("\n");
  }
  geodetic(w) { // latitude, longitude (degrees), height: WGS 84
    const {place} = this.axes;
    if (!place) return null;
    const [lat, lon] = place.slice(0, 2).map(v => v * Math.PI / 180), a = 6378137, e2 = 6.69437999014e-3, s = Math.sin(lat), c = Math.cos(lat);
    const n = a / Math.sqrt(1 - e2 * s * s), [e, north, u] = w, x0 = (n + place[2]) * c, z0 = (n * (1 - e2) + place[2]) * s;
    const out = x0 - north * s + u * c, z = z0 + north * c + u * s; // in the meridian's plane, and east of it
    const x = out * Math.cos(lon) - e * Math.sin(lon), y = out * Math.sin(lon) + e * Math.cos(lon), p = Math.hypot(x, y);
    let phi = Math.atan2(z, p * (1 - e2)), h = 0;
    for (let k = 0; k < 6; k++) { const m = a / Math.sqrt(1 - e2 * Math.sin(phi) ** 2); h = p / Math.cos(phi) - m; phi = Math.atan2(z, p * (1 - e2 * m / (m + h))); }
    return [phi * 180 / Math.PI, Math.atan2(y, x) * 180 / Math.PI, h];
  }
  profile() { // heights along the last two points: middle and standard deviation of each step
    const cloud = this.cloud, n = this.points.length;
    if (!cloud || n < 2) return [];
    const a = this.points[n - 2].p, b = this.points[n - 1].p, dx = b[0] - a[0], dy = b[1] - a[1], length = Math.hypot(dx, dy);
    const half = Math.max(1.5 * cloud.voxel, 0.004 * length), steps = Math.max(2, Math.min(160, Math.floor(length / cloud.voxel))), bins = Array.from({length: steps}, () => []);
    if (length < 2 * cloud.voxel) return [];
    const sigma = cloud.layers.sigma, low = Math.min(a[2], b[2]), high = Math.max(a[2], b[2]), room = Math.max(high - low, length);
    for (let i = 0, j = 0; i < cloud.n; i++, j += 3) {
      const x = cloud.at[j] - a[0], y = cloud.at[j + 1] - a[1], t = (x * dx + y * dy) / length;
      if (t < 0 || t >= length || Math.abs(x * dy - y * dx) / length > half || cloud.at[j + 2] < low - room || cloud.at[j + 2] > high + room) continue;
      bins[Math.floor(t / length * steps)].push([cloud.at[j + 2], sigma ? valueOf(sigma, sigma.of[i]) / 1000 : 0]);
    }
    return bins.map((bin, k) => bin.length ? {t: (k + 0.5) / steps * length, z: bin.map(q => q[0]).sort((p, q) => p - q)[bin.length >> 1], s: bin.map(q => q[1]).sort((p, q) => p - q)[bin.length >> 1]} : null);
  }
  // ---- what is shown
  show() {
    const words = this.on ? this.text() || (matchMedia("(hover: none)").matches ? "tap points of the cloud" : "click points of the cloud; Enter takes the middle of the view, Backspace takes one back") : "";
    for (const place of this.words) place.textContent = words;
    const known = this.on ? this.profile().filter(Boolean) : [];
    this.svg.toggleAttribute("hidden", known.length < 2);
    if (known.length >= 2) {
      const low = Math.min(...known.map(q => q.z - q.s)), high = Math.max(...known.map(q => q.z + q.s)), [t0, t1] = [known[0].t, known.at(-1).t];
      const x = t => 4 + 292 * (t - t0) / Math.max(t1 - t0, 1e-9), y = z => 70 - 64 * (z - low) / Math.max(high - low, 1e-9), list = of => of.map(([t, z]) => `${x(t).toFixed(1)},${y(z).toFixed(1)}`).join(" ");
      this.svg.querySelector("polygon").setAttribute("points", list([...known.map(q => [q.t, q.z + q.s]), ...known.toReversed().map(q => [q.t, q.z - q.s])]));
      this.svg.querySelector("polyline").setAttribute("points", list(known.map(q => [q.t, q.z])));
      this.svg.querySelector("text").textContent = inWords(high - low, this.axes.unit);
    }
    this.root.dataset.measured = this.points.length; this.view.draw(); this.drawPlan();
  }
  draw(ink, camera) {
    if (!this.points.length) return;
    const spots = this.points.map(q => this.view.project(q.p, camera));
    ink.strokeStyle = "#ffd400"; ink.fillStyle = "#ffd400"; ink.lineWidth = 2; ink.beginPath();
    spots.forEach((s, k) => { if (s) { if (k && spots[k - 1]) ink.lineTo(s[0], s[1]); else ink.moveTo(s[0], s[1]); } });
    if (spots.length > 2 && spots.every(Boolean)) { ink.closePath(); ink.globalAlpha = 0.15; ink.fill(); ink.globalAlpha = 1; }
    ink.stroke();
    for (const s of spots) if (s) { ink.beginPath(); ink.arc(s[0], s[1], 4, 0, 7); ink.fill(); }
    for (const {text, place, isArea, isLast} of this.labels()) { // all give way to the newest, and to what stands there already
      const s = this.view.project(place, camera);
      if (s) this.view.word(text, s[0], s[1] + (isArea ? 16 : -8), isLast);
    }
  }
  labels() { // what stands beside the line in the view: the length of each of its segments, and the area
    const n = this.points.length, {unit} = this.axes, middle = points => [0, 1, 2].map(k => points.reduce((sum, p) => sum + p[k], 0) / points.length), labels = [];
    for (let k = n - 1; k > 0; k--) { // the newest first
      const [a, b] = [this.points[k - 1], this.points[k]], sigma = a.sigma === null || b.sigma === null ? null : Math.hypot(a.sigma, b.sigma);
      labels.push({text: inWords(Math.hypot(...plus(b.p, a.p, -1)), unit, sigma), place: middle([a.p, b.p]), isLast: k === n - 1});
    }
    const area = this.figures().find(([name]) => name === "area");
    if (area) labels.push({text: inWords(area[1], unit && `${unit}²`, area[2]), place: middle(this.points.map(q => q.p)), isArea: true});
    return labels;
  }
  // ---- the map
  onPlan(e) {
    if (!this.on || e.detail > 1 || e.target.closest("[data-fly]")) return; // a double click is one point
    const {left, top, scale} = this.plan.firstElementChild.dataset, svg = this.plan.querySelector("svg");
    const at = new DOMPoint(e.clientX, e.clientY).matrixTransform(svg.getScreenCTM().inverse()), p = this.below(+left + at.x / scale, top - at.y / scale);
    if (p) this.add(p);
  }
  drawPlan() {
    if (!this.plan) return;
    const {left, top, scale} = this.plan.firstElementChild.dataset, drawing = this.plan.querySelector(".measuring");
    const spots = this.points.map(({p}) => [(p[0] - left) * scale, (top - p[1]) * scale].map(v => v.toFixed(1)));
    drawing.querySelector("polygon").setAttribute("points", spots.join(" ")); drawing.querySelector("path").setAttribute("d", spots.map(s => `M${s}h0`).join(""));
    for (const old of drawing.querySelectorAll("text")) old.remove();
    for (const {text, place, isArea} of this.labels()) {
      const label = drawing.appendChild(document.createElementNS(drawing.namespaceURI, "text"));
      label.textContent = text; label.setAttribute("x", (place[0] - left) * scale); label.setAttribute("y", (top - place[1]) * scale + (isArea ? 20 : -8)); label.setAttribute("text-anchor", "middle");
    }
  }
  // ---- the address
  hash() {
    const {view} = this, few = v => +v.toFixed(4), {clip} = view, parts = new URLSearchParams();
    parts.set("view", [view.yaw, view.pitch, view.distance, view.fov, ...this.world(view.target)].map(few).join(","));
    if (view.mode !== "photograph") parts.set("colour", view.mode);
    if (view.chosen) parts.set("camera", view.chosen.id);
    if (view.wipe) parts.set("wipe", few(view.wipe));
    if (clip) parts.set("clip", clip.map(few).join(","));
    if (this.points.length) parts.set("measure", this.points.map(q => this.world(q.p).map(few).join(",")).join(";"));
    return `#${parts}`;
  }
  read(hash) { // true where the address holds a view
    const parts = new URLSearchParams(hash.replace(/^#/, "")), numbers = text => (text || "").split(",").map(Number), {view} = this;
    const pose = numbers(parts.get("view"));
    if (pose.length !== 7 || !pose.every(Number.isFinite)) return null;
    Object.assign(view, {yaw: pose[0], pitch: pose[1], distance: pose[2], fov: pose[3], target: this.page(pose.slice(4)), flight: null});
    view.chosen = view.scene.cameras.find(cam => cam.id === parts.get("camera")) || null;
    const clip = numbers(parts.get("clip")), points = (parts.get("measure") || "").split(";").map(numbers).filter(p => p.length === 3 && p.every(Number.isFinite));
    view.clip = clip.length === 2 && clip.every(Number.isFinite) ? clip : null;
    return {colour: parts.get("colour"), wipe: Math.max(0, Math.min(1, +parts.get("wipe") || 0)), points: points.map(w => this.page(w))};
  }
}
