"use strict";
// The 3-D view: one orbiting eye, moved by mouse, touch and keys; cameras as frusta that can be clicked.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const l = Math.hypot(...a) || 1; return a.map(x => x / l); };
const FOV = 50 * Math.PI / 180, MOST_PIXELS = 1.4e6, FRAME_MS = 30;
const VANISHED_GROWTH = 2; // vanished points are spaced unevenly: so large, their squares close the surface
const TWICE_MS = 400, TWICE_PX = 8; // the second click of a double click comes so soon, and so near

class CloudView {
  constructor(root, scene) {
    this.root = root; this.scene = scene; this.sets = []; this.mode = "photograph"; this.size = [root.clientWidth, root.clientHeight];
    this.canvas = root.querySelector("canvas.points"); this.over = root.querySelector("canvas.over");
    this.pen = this.canvas.getContext("2d"); this.ink = this.over.getContext("2d");
    this.clip = null; this.wipe = 0; this.showCameras = true; this.chosen = null; this.dirty = false; this.budget = 150000;
    this.home = this.start(); Object.assign(this, this.home); this.frames = [];
    new ResizeObserver(() => this.resize()).observe(root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    this.listen(); this.resize();
  }
  start() {
    const {middle, radius, heading, cameras} = this.scene, [width, height] = this.size;
    const look = Object.assign(this, {target: middle, yaw: heading, pitch: 0.62, distance: 1.5 * radius, fov: FOV});
    const inside = p => p && p[0] > 30 && p[0] < width - 30 && p[1] > 24 && p[1] < height - 14;
    const most = 2.6 * radius * Math.max(1, height / width);
    while (look.distance < most && !cameras.every(cam => inside(this.project(cam.C, this.eye())))) look.distance *= 1.05; // cameras far away may be outside
    return this.pose();
  }
  add(points, name) {
    for (const set of this.sets) set.pixels = {}; // what has changed may colour the points that are there
    if (name === "change") { this.changes = points; this.sets.push({points: vanishedOf(points), name, pixels: {}}); }
    else this.sets.push({points, name, pixels: {}});
    this.draw();
  }
  colours(set) {
    if (set.name === "track") return pixelsOf(set.points, "photograph");
    if (this.mode !== "change") return pixelsOf(set.points, this.mode);
    if (set.name === "change") return Uint32Array.from({length: set.points.n}, (_, i) => tinted(set.points.rgb, i, [70, 150, 255]));
    return set.name === "product" && this.changes ? changedPixels(set.points, this.changes) : pixelsOf(set.points, this.mode);
  }
  resize() {
    const box = this.root.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const scale = Math.min(ratio, Math.sqrt(MOST_PIXELS / Math.max(1, box.width * box.height)));
    const width = Math.max(1, Math.round(box.width * scale)), height = Math.max(1, Math.round(box.height * scale));
    if (this.frame && this.frame.width === width && this.frame.height === height) return;
    this.canvas.width = width; this.canvas.height = height;
    this.over.width = Math.round(box.width * ratio); this.over.height = Math.round(box.height * ratio);
    this.ratio = ratio; this.size = [box.width, box.height];
    const data = new ImageData(width, height);
    this.frame = {width, height, data, image: new Uint32Array(data.data.buffer), depth: new Float32Array(width * height)};
    this.draw();
  }
  eye() {
    const c = Math.cos(this.pitch), back = [c * Math.cos(this.yaw), c * Math.sin(this.yaw), Math.sin(this.pitch)];
    const ahead = back.map(x => -x), right = unit(cross(ahead, Math.abs(back[2]) > 0.9999 ? [Math.cos(this.yaw), Math.sin(this.yaw), 0] : [0, 0, 1]));
    const flip = Math.abs(back[2]) > 0.9999 ? [-Math.sin(this.yaw), Math.cos(this.yaw), 0] : right;
    return {eye: plus(this.target, back, this.distance), ahead, right: flip, up: cross(flip, ahead), near: 1e-3 * this.scene.radius};
  }
  // ---- drawing
  draw() {
    if (this.dirty) return;
    this.dirty = true;
    requestAnimationFrame(() => { this.dirty = false; this.paint(this.moving); });
  }
  touch() { // something moves: fewer points now, all of them when it has come to rest
    this.moving = true;
    clearTimeout(this.rest);
    this.rest = setTimeout(() => { this.moving = false; this.draw(); }, 160);
    this.draw();
  }
  paint(quick) {
    const began = performance.now(), {frame} = this, camera = this.eye();
    camera.focal = frame.height / 2 / Math.tan(this.fov / 2);
    frame.image.fill(0); frame.depth.fill(Infinity);
    let drawn = 0;
    const edge = Math.round(this.wipe * frame.width); // left of it the other night is drawn
    for (const set of this.sets) {
      if (set.name === "change" && this.mode !== "change") continue;
      if (set.name === "track" && !this.showCameras) continue; // it belongs to the cameras that it has placed
      [frame.from, frame.to] = set.name === "then" ? [0, edge] : [edge, frame.width];
      if (frame.from >= frame.to) continue;
      const pixels = set.pixels[this.mode] ||= this.colours(set);
      const count = quick && set.name !== "change" ? Math.min(set.points.n, Math.round(this.budget)) : set.points.n;
      splat(frame, set.points, pixels, count, camera, this.clip, Math.sqrt(set.points.n / Math.max(1, count)) * (set.name === "change" ? VANISHED_GROWTH : 1));
      drawn += count;
    }
    if (!quick || this.budget > 250000) shade(frame, 12);
    this.pen.putImageData(frame.data, 0, 0);
    this.overlay(camera);
    const took = performance.now() - began;
    if (quick && drawn) this.budget = Math.max(40000, Math.min(1e6, this.budget * Math.min(1.4, Math.max(0.6, FRAME_MS / took))));
    this.frames.push(took); if (this.frames.length > 600) this.frames.shift();
    this.root.dataset.drawn = drawn; this.root.dataset.mode = this.mode;
    this.root.dataset.pose = [this.yaw, this.pitch, this.distance, ...this.target].map(v => v.toFixed(4)).join(" ");
  }
  project(p, camera) {
    const d = [p[0] - camera.eye[0], p[1] - camera.eye[1], p[2] - camera.eye[2]], w = dot(d, camera.ahead);
    if (w < camera.near) return null;
    const q = this.size[1] / 2 / Math.tan(this.fov / 2) / w;
    return [this.size[0] / 2 + dot(d, camera.right) * q, this.size[1] / 2 - dot(d, camera.up) * q, w];
  }
  hidden(spot) {
    const k = Math.floor(spot[1] / this.size[1] * this.frame.height) * this.frame.width + Math.floor(spot[0] / this.size[0] * this.frame.width);
    return this.frame.depth[k] < 0.97 * spot[2];
  }
  overlay(camera) {
    const ink = this.ink, style = getComputedStyle(this.root), colour = name => style.getPropertyValue(name).trim();
    ink.setTransform(this.ratio, 0, 0, this.ratio, 0, 0); ink.clearRect(0, 0, ...this.size);
    ink.font = "600 12px system-ui, sans-serif"; ink.textAlign = "center"; ink.lineJoin = "round";
    this.spots = []; this.words = [];
    const many = Math.min(1, Math.sqrt(20 / Math.max(1, this.scene.cameras.length))), rank = {bad: 0, warn: 1, good: 2};
    const close = this.flown && Math.hypot(...plus(camera.eye, this.flown.C, -1)) < 0.05 * this.scene.radius;
    const order = [...this.scene.cameras].sort((a, b) => (b === this.chosen) - (a === this.chosen) || rank[a.state] - rank[b.state]);
    if (this.showCameras) for (const cam of order) { // if there is no room for all names, cameras that need attention keep theirs
      if (close && cam === this.flown) continue;
      const tip = this.project(cam.C, camera);
      const far = 0.055 * many * this.scene.radius, corners = cam.rays.map(ray => this.project(plus(cam.C, ray, far), camera));
      if (!tip) continue;
      ink.globalAlpha = this.hidden(tip) ? 0.4 : 1; ink.strokeStyle = ink.fillStyle = colour(`--${cam.state}`); ink.lineWidth = cam === this.chosen ? 3 : 1.6;
      ink.beginPath();
      if (corners.length && corners.every(Boolean)) {
        corners.forEach((c, k) => { ink.moveTo(tip[0], tip[1]); ink.lineTo(c[0], c[1]); const next = corners[(k + 1) % 4]; ink.lineTo(next[0], next[1]); });
        ink.stroke(); ink.globalAlpha *= 0.18; ink.fill(); ink.globalAlpha /= 0.18;
      }
      ink.beginPath(); ink.arc(tip[0], tip[1], 2 + 2 * many, 0, 7); ink.fill();
      if (cam.state === "bad") { ink.beginPath(); ink.moveTo(tip[0] - 6, tip[1] - 6); ink.lineTo(tip[0] + 6, tip[1] + 6); ink.moveTo(tip[0] + 6, tip[1] - 6); ink.lineTo(tip[0] - 6, tip[1] + 6); ink.stroke(); }
      this.word(cam.id, tip[0], tip[1] - 10);
      this.spots.push({x: tip[0], y: tip[1], w: tip[2], cam});
    }
    if (this.mode === "change") for (const mark of this.scene.marks) {
      const spot = this.project(mark.at, camera);
      if (!spot) continue;
      ink.globalAlpha = 1; ink.fillStyle = colour(mark.kind === "vanished" ? "--gone" : "--new");
      this.word(`${mark.name}: ${mark.kind}`, spot[0], spot[1] - 14);
      this.spots.push({x: spot[0], y: spot[1], w: spot[2], mark});
    }
    ink.globalAlpha = 1;
    if (this.wipe > 0 && this.wipe < 1) { const x = this.wipe * this.size[0]; ink.strokeStyle = "#fffc"; ink.lineWidth = 2; ink.beginPath(); ink.moveTo(x, 0); ink.lineTo(x, this.size[1]); ink.stroke(); }
    this.onOverlay?.(ink, camera);
    this.compass(ink, camera);
  }
  word(text, x, y, always = false) {
    const ink = this.ink, half = ink.measureText(text).width / 2, [wide, high] = this.size;
    if (!always && (x < 0 || x > wide || y < -14 || y > high + 14)) return;
    x = Math.max(half + 4, Math.min(wide - half - 4, x)); y = Math.max(14, Math.min(high - 4, y)); // none is cut off at the edge
    if (!always && this.words.some(w => Math.abs(w.x - x) < w.half + half && Math.abs(w.y - y) < 13)) return;
    this.words.push({x, y, half}); ink.save(); ink.strokeStyle = "#000c"; ink.lineWidth = 3.5; ink.strokeText(text, x, y);
    ink.fillStyle = "#fff"; ink.fillText(text, x, y); ink.restore();
  }
  compass(ink, camera) { // where north (or the world's y) is
    const x = this.size[0] - 34, y = this.size[1] - 34, c = [camera.right[1], -camera.up[1]], l = Math.hypot(...c) || 1;
    if (l < 0.05) return;
    ink.strokeStyle = "#fff9"; ink.lineWidth = 2; ink.beginPath(); ink.moveTo(x - 14 * c[0], y - 14 * c[1]); ink.lineTo(x + 14 * c[0], y + 14 * c[1]); ink.stroke();
    this.word(this.scene.north, x + 22 * c[0] / l, y + 22 * c[1] / l + 4);
  }
  // ---- moving
  listen() {
    const canvas = this.over, fingers = new Map();
    let before = null, moved = 0;
    const spread = () => { const [a, b] = [...fingers.values()]; return {x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, d: Math.hypot(a.x - b.x, a.y - b.y)}; };
    canvas.addEventListener("pointerdown", e => {
      canvas.setPointerCapture(e.pointerId); canvas.focus({preventScroll: true}); fingers.set(e.pointerId, {x: e.clientX, y: e.clientY});
      before = fingers.size === 2 ? spread() : null; moved = fingers.size === 1 ? 0 : 99; this.flight = null;
    });
    canvas.addEventListener("pointermove", e => {
      const was = fingers.get(e.pointerId);
      if (!was) { canvas.style.cursor = this.nearest(e) ? "pointer" : "grab"; return; }
      const dx = e.clientX - was.x, dy = e.clientY - was.y;
      moved += Math.abs(dx) + Math.abs(dy); was.x = e.clientX; was.y = e.clientY;
      if (fingers.size === 2) { const now = spread(); if (before) { this.pan(now.x - before.x, now.y - before.y); this.zoom(before.d / now.d); } before = now; }
      else if (e.buttons & 6 || e.shiftKey) this.pan(dx, dy);
      else this.turn(-dx * 0.006, dy * 0.006);
    });
    const up = e => { fingers.delete(e.pointerId); before = null; };
    canvas.addEventListener("pointerup", e => { up(e); if (moved < 6) this.click(e); });
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("contextmenu", e => e.preventDefault());
    canvas.addEventListener("wheel", e => {
      if (document.activeElement !== canvas && !e.ctrlKey) { this.root.classList.add("hint"); setTimeout(() => this.root.classList.remove("hint"), 1500); return; }
      e.preventDefault(); this.flight = null; this.zoom(Math.exp(0.0012 * Math.max(-300, Math.min(300, e.deltaY))));
    }, {passive: false});
    canvas.addEventListener("dblclick", e => { const p = this.picks ? null : this.under(e); if (p) this.fly({...this.pose(), target: p, distance: this.distance * 0.6}); });
    canvas.addEventListener("keydown", e => {
      if (this.picks && this.keys?.(e.key)) { e.preventDefault(); return; }
      const does = {ArrowLeft: () => this.turn(-0.1, 0), ArrowRight: () => this.turn(0.1, 0), ArrowUp: () => this.turn(0, 0.08), ArrowDown: () => this.turn(0, -0.08),
        "+": () => this.zoom(0.85), "-": () => this.zoom(1.18), "0": () => this.reset(), Escape: () => this.reset()}[e.key];
      if (does) { e.preventDefault(); does(); }
    });
  }
  pose() { return {target: this.target, yaw: this.yaw, pitch: this.pitch, distance: this.distance, fov: this.fov}; }
  turn(yaw, pitch) { this.yaw += yaw; this.pitch = Math.max(-1.2, Math.min(1.5707, this.pitch + pitch)); this.touch(); }
  zoom(by) { this.distance = Math.max(0.01 * this.scene.radius, Math.min(12 * this.scene.radius, this.distance * by)); this.touch(); }
  pan(dx, dy) {
    const camera = this.eye(), length = 2 * this.distance * Math.tan(this.fov / 2) / this.size[1];
    this.target = plus(plus(this.target, camera.right, -dx * length), camera.up, dy * length); this.touch();
  }
  spot(e) { const box = this.over.getBoundingClientRect(); return [e.clientX - box.left, e.clientY - box.top]; }
  nearest(e) {
    const [x, y] = this.spot(e);
    return (this.spots || []).filter(s => Math.hypot(s.x - x, s.y - y) < 22).sort((a, b) => Math.hypot(a.x - x, a.y - y) - Math.hypot(b.x - x, b.y - y))[0];
  }
  under(e) { // the point of the cloud below the pointer
    const [x, y] = this.spot(e), {frame} = this, camera = this.eye();
    const u = Math.round(x / this.size[0] * frame.width), v = Math.round(y / this.size[1] * frame.height);
    let depth = Infinity, nearest = Infinity; // of the pixel nearest to the pointer that shows anything
    for (let a = -3; a <= 3; a++) for (let b = -3; b <= 3; b++) {
      const here = frame.depth[(v + a) * frame.width + u + b] ?? Infinity;
      if (here !== Infinity && a * a + b * b < nearest) { depth = here; nearest = a * a + b * b; }
    }
    if (depth === Infinity) return null;
    const q = 2 * Math.tan(this.fov / 2) / this.size[1] * depth;
    return plus(plus(plus(camera.eye, camera.ahead, depth), camera.right, (x - this.size[0] / 2) * q), camera.up, (this.size[1] / 2 - y) * q);
  }
  click(e) {
    if (this.picks) {
      const last = this.picked, again = last && e.timeStamp - last.timeStamp < TWICE_MS && Math.hypot(e.clientX - last.clientX, e.clientY - last.clientY) < TWICE_PX;
      this.picked = e;
      if (!again) this.picks(this.under(e)); // a double click is one point
      return;
    }
    const found = this.nearest(e);
    if (found?.cam) this.flyTo(found.cam);
    else if (found?.mark) this.flyToMark(found.mark);
    else this.onPlace?.(this.under(e));
  }
  flyTo(cam) { // see the cloud as this camera does
    this.chosen = this.flown = cam;
    const ahead = cam.ahead, reach = 0.25 * this.scene.radius, pitch = Math.asin(Math.max(-1, Math.min(1, -ahead[2])));
    this.fly({target: plus(cam.C, ahead, reach), distance: reach, yaw: Math.atan2(-ahead[1], -ahead[0]), pitch, fov: cam.fov || FOV});
    this.onCamera?.(cam);
  }
  flyToMark(mark) { this.fly({...this.pose(), target: mark.at, distance: 0.35 * this.scene.radius}); }
  reset() { this.chosen = null; this.onCamera?.(null); this.fly(this.home); }
  above() { this.fly({...this.home, yaw: -Math.PI / 2, pitch: 1.5707}); }
  fly(to) {
    const from = this.pose(), began = performance.now(), flight = this.flight = {};
    const turn = ((to.yaw - from.yaw + Math.PI) % (2 * Math.PI) + 2 * Math.PI) % (2 * Math.PI) - Math.PI;
    const step = () => {
      if (this.flight !== flight) return;
      const t = Math.min(1, (performance.now() - began) / 700), s = t * t * (3 - 2 * t), mix = (a, b) => a + (b - a) * s;
      this.target = from.target.map((v, k) => mix(v, to.target[k])); this.yaw = from.yaw + turn * s;
      this.pitch = mix(from.pitch, to.pitch); this.distance = Math.exp(mix(Math.log(from.distance), Math.log(to.distance))); this.fov = mix(from.fov, to.fov);
      this.touch();
      if (t < 1) requestAnimationFrame(step); else this.root.dataset.flown = this.chosen ? this.chosen.id : "";
    };
    step();
  }
}
