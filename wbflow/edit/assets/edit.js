"use strict";
// Everything drawn is in `marks`: polygons and points in pixels of the captures (centres are whole numbers), zones in metres.
// What needs lenses and poses is asked of the server: where zones and guides are in a picture, and how points fit together.
const $ = (selector, root = document) => root.querySelector(selector), $$ = (selector) => [...document.querySelectorAll(selector)];
const canvas = $("#picture"), pen = canvas.getContext("2d");
const edit = { state: null, marks: null, camera: null, tool: "select", draft: null, chosen: null, saved: "", undo: [], pictures: new Map(), seen: null, at: { scale: 1, x: 0, y: 0 } };
const HINTS = {
  select: "Click what is drawn to select it; drag its corners.", privacy: "Click the corners of what nobody may see; Enter closes.",
  mask: "Click the corners of what is not to be used; Enter closes.", unmask: "Click the corners of what may be used after all; Enter closes.",
  zone: "Click the corners of a zone on the ground; Enter closes.", point: "Click the place in this picture, then Tab and click it in the others.",
};
const LOOKS = { privacy: ["#888d", "#ddd"], mask: ["#e03c3c73", "#ff7b7b"], unmask: ["#3cb06466", "#7be0a0"], zone: ["#f5c54222", "#f5c542"] };
const NEAR = 9, MOST_PICTURES = 12;

// ---------------------------------------------------------------------------------------------------- the server
async function ask(path, body) {
  const reply = await fetch(path, body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  if (!reply.ok) throw new Error(await reply.text());
  return reply;
}
function say(text, bad = false) { const box = $("#message"); box.textContent = text; box.hidden = !text; box.classList.toggle("bad", bad); }
const attempt = (does) => (...given) => Promise.resolve().then(() => does(...given)).catch((error) => say(error.message, true));

async function pictureOf(id) {
  if (!edit.pictures.has(id)) {
    edit.pictures.set(id, (async () => {
      const reply = await ask(`picture/${encodeURIComponent(id)}`), head = JSON.parse(reply.headers.get("X-Picture"));
      head.image = await createImageBitmap(await reply.blob());
      head.shade = head.masked ? await createImageBitmap(await (await ask(`shade/${encodeURIComponent(id)}`)).blob()) : null;
      return head;
    })());
    if (edit.pictures.size > MOST_PICTURES) edit.pictures.delete(edit.pictures.keys().next().value);
  }
  return edit.pictures.get(id);
}

let looking = false, again = false;
async function look() { // one request at a time; what has changed meanwhile is asked for after it
  if (looking) { again = true; return; }
  looking = true;
  try {
    do {
      again = false;
      const { zones, points } = sent(), draft = edit.draft?.kind === "zone" ? [{ was: null, name: "", corners: edit.draft.corners, least_m: 0 }] : [];
      const chosen = edit.chosen?.kind === "point" ? edit.marks.points.indexOf(edit.chosen.item) : -1;
      const found = await (await ask("look", { camera: edit.camera, marks: { points, zones: [...zones, ...draft] }, chosen: chosen < 0 ? null : chosen, ground: ground() })).json();
      edit.seen = { ...found, camera: edit.camera };
    } while (again);
  } finally { looking = false; }
  residuals(); draw();
}
const looked = attempt(look), ground = () => +$("#ground").value || 0;

// ---------------------------------------------------------------------------------------------------- what is drawn
const mine = () => edit.marks.cameras[edit.camera];
const round = (value, digits) => Math.round(value * 10 ** digits) / 10 ** digits;
const packed = () => JSON.stringify(edit.marks);
function change(does) { // everything that can be undone
  const before = packed();
  does();
  if (packed() !== before) { edit.undo.push(before); if (edit.undo.length > 200) edit.undo.shift(); }
  renew();
}
function undo() {
  if (edit.draft) { edit.draft.corners.pop(); if (!edit.draft.corners.length) edit.draft = null; renew(); return; }
  if (!edit.undo.length) return;
  edit.marks = JSON.parse(edit.undo.pop()); edit.chosen = null; renew();
}
function cornersOf(item) { // of a privacy polygon, pixels, also where the file gives shares of width and height
  return item.shares && edit.shown ? item.corners.map(([x, y]) => [x * edit.shown.width - 0.5, y * edit.shown.height - 0.5]) : item.corners;
}
function inPixels(item) { if (item.shares) { item.corners = cornersOf(item).map(([x, y]) => [round(Math.max(0, x), 1), round(Math.max(0, y), 1)]); item.shares = false; } }
function taken(state) {
  const before = edit.marks?.cameras || {};
  edit.state = state;
  edit.marks = {
    cameras: Object.fromEntries(state.cameras.map(({ id, privacy }) => [id, {
      privacy: privacy.map((corners, was) => ({ was, corners, shares: corners.flat().every((v) => v <= 1) })), mask: before[id]?.mask || [] }])),
    zones: state.zones, points: state.points.map((p) => ({ ...p, position: p.position?.length ? p.position : null })),
  };
  edit.undo = []; edit.saved = packed(); edit.chosen = edit.draft = null;
}
function sent() { // as the server takes it
  const cameras = {};
  for (const [id, { privacy, mask }] of Object.entries(edit.marks.cameras)) cameras[id] = { privacy: privacy.map(({ was, corners }) => ({ was, corners })), mask };
  const zones = edit.marks.zones.map(({ was, name, corners, least_m }) => ({ was, name, corners, least_m }));
  const points = edit.marks.points.map(({ was, id, position, pixels }) => ({ was, id, pixels, position: position?.includes(null) ? null : position }));
  return { cameras, zones, points };
}

async function save() {
  if (edit.draft) { say("Close the polygon (Enter) or drop it (Esc) first.", true); return; }
  const drawn = edit.marks, focused = document.activeElement;
  let state;
  document.body.inert = true; // nothing is drawn until it is known what was saved
  try { state = await (await ask("save", { marks: sent(), version: edit.state.version })).json(); }
  finally { document.body.inert = false; focused?.focus({ preventScroll: true }); }
  taken(state);
  const notes = state.unsaved.map((mark) => unsaved(mark, drawn));
  if (state.merged) { edit.pictures.clear(); edit.seen = null; }
  if (state.cameras.some(({ id }) => id === edit.camera) && !state.merged) renew(); else await show((state.cameras.find(({ id }) => id === edit.camera) || state.cameras[0]).id);
  const merged = state.merged ? "; somebody else has changed files meanwhile: their changes are kept, too" : "";
  say([`Saved ${state.file}${merged}`, ...notes].join("\n"), notes.length > 0);
}
function unsaved({ kind, camera, drawn: at, was, why }, drawn) { // puts back what is not in the file; returns a note about it
  if (kind === "mask") { edit.saved = null; return `Not saved: the mask of ${camera}: ${why}`; } // its areas are still drawn
  const listOf = (marks) => ({ point: marks.points, zone: marks.zones, privacy: marks.cameras[camera]?.privacy })[kind];
  const list = listOf(edit.marks), item = at === null ? list[was] : { ...listOf(drawn)[at], was, fault: why };
  if (at !== null && was === null) list.push(item); else if (at !== null) list[was] = item;
  const words = { privacy: `a privacy polygon of ${camera}`, zone: `zone ${item.name}`, point: `control point ${item.id}` }[kind];
  return `Not saved: ${words}: ${why}`;
}
async function done() {
  if (packed() !== edit.saved && !confirm("What was not saved will be lost.")) return;
  await ask("done", {});
  edit.saved = packed(); document.body.replaceChildren(Object.assign(document.createElement("p"), { className: "ended", textContent: "wbflow edit has ended; this page can be closed." }));
}

// ---------------------------------------------------------------------------------------------------- the picture
const toScreen = (x, y) => [(x + 0.5) * edit.at.scale + edit.at.x, (y + 0.5) * edit.at.scale + edit.at.y];
const toPixel = (u, v) => [(u - edit.at.x) / edit.at.scale - 0.5, (v - edit.at.y) / edit.at.scale - 0.5];
function fit() {
  const { clientWidth: w, clientHeight: h } = canvas, { width, height } = edit.shown || { width: 16, height: 9 }, scale = Math.min(w / width, h / height);
  edit.at = { scale, x: (w - width * scale) / 2, y: (h - height * scale) / 2 }; draw();
}
function zoom(factor, u = canvas.clientWidth / 2, v = canvas.clientHeight / 2) {
  const scale = Math.min(60, Math.max(0.02, edit.at.scale * factor)), grown = scale / edit.at.scale;
  edit.at = { scale, x: u + (edit.at.x - u) * grown, y: v + (edit.at.y - v) * grown }; draw();
}
function trace(corners) { pen.beginPath(); corners.forEach(([x, y]) => pen.lineTo(...toScreen(x, y))); }
function polygon(corners, kind, chosen, open = false) {
  const [fill, line] = LOOKS[kind];
  trace(corners); if (!open) pen.closePath();
  pen.fillStyle = fill; pen.globalAlpha = chosen ? 0.5 : 1; // what is chosen shows what is below it
  if (!open) pen.fill();
  pen.globalAlpha = 1; pen.strokeStyle = line; pen.lineWidth = chosen ? 2.5 : 1.5; pen.stroke();
  if (chosen || open) handles(corners, line);
}
function handles(corners, line) {
  for (const corner of corners.filter(Boolean)) { const [u, v] = toScreen(...corner); pen.fillStyle = "#fff"; pen.strokeStyle = line; pen.lineWidth = 2; pen.beginPath(); pen.arc(u, v, 5, 0, 7); pen.fill(); pen.stroke(); }
}
function cross([x, y], colour, text) {
  const [u, v] = toScreen(x, y);
  for (const [width, style] of [[4, "#000a"], [2, colour]]) {
    pen.strokeStyle = style; pen.lineWidth = width; pen.beginPath();
    for (const [a, b] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { pen.moveTo(u + 3 * a, v + 3 * b); pen.lineTo(u + 10 * a, v + 10 * b); }
    pen.stroke();
  }
  if (text) { pen.font = "13px system-ui"; pen.lineWidth = 3; pen.strokeStyle = "#000b"; pen.strokeText(text, u + 9, v - 8); pen.fillStyle = colour; pen.fillText(text, u + 9, v - 8); }
}
function guides() {
  const { guide } = edit.seen, line = (colour) => {
    for (const [width, style, dash] of [[4, "#000a", []], [2, colour, [7, 5]]]) { pen.lineWidth = width; pen.strokeStyle = style; pen.setLineDash(dash); pen.stroke(); }
    pen.setLineDash([]);
  };
  for (const piece of guide.lines || []) { trace(piece); line("#ff5ad0"); }
  for (const [key, radius, colour] of [["at", 12, "#ff5ad0"], ["stated", 7, "#4ad2ff"]]) if (guide[key]) {
    const [u, v] = toScreen(...guide[key]); pen.beginPath(); pen.arc(u, v, radius, 0, 7); line(colour);
  }
}
function zonesHere() {
  edit.seen.zones.forEach(({ lines, corners }, k) => {
    const zone = edit.marks.zones[k], chosen = zone ? edit.chosen?.item === zone : true;
    pen.strokeStyle = LOOKS.zone[1]; pen.lineWidth = chosen ? 3 : 2;
    for (const line of lines) { trace(line); pen.stroke(); }
    if (chosen) handles(corners, LOOKS.zone[1]);
    const first = corners.find(Boolean);
    if (zone && first) { const [u, v] = toScreen(...first); pen.font = "13px system-ui"; pen.fillStyle = LOOKS.zone[1]; pen.fillText(zone.name, u + 8, v - 6); }
  });
}
function draw() {
  const ratio = devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = canvas;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, w, h);
  const shown = edit.shown;
  if (!shown) { pen.fillStyle = "#fff"; pen.font = "14px system-ui"; pen.textAlign = "center"; pen.fillText(edit.fault || "…", w / 2, h / 2, w - 20); pen.textAlign = "left"; return; }
  pen.imageSmoothingEnabled = edit.at.scale < 3;
  for (const image of [shown.image, shown.shade]) if (image) pen.drawImage(image, edit.at.x, edit.at.y, shown.width * edit.at.scale, shown.height * edit.at.scale);
  for (const area of mine().mask) polygon(area.corners, area.use ? "unmask" : "mask", edit.chosen?.item === area);
  for (const item of mine().privacy) polygon(cornersOf(item), "privacy", edit.chosen?.item === item);
  const seen = edit.seen?.camera === edit.camera;
  if (seen) zonesHere();
  if (seen && edit.chosen?.kind === "point") guides();
  for (const point of edit.marks.points) if (point.pixels[edit.camera]) cross(point.pixels[edit.camera], edit.chosen?.item === point ? "#ffe14a" : "#fff", point.id);
  if (edit.draft && edit.draft.kind !== "zone") polygon(edit.draft.corners, edit.draft.kind, false, true);
}

// ---------------------------------------------------------------------------------------------------- pointing
function handleAt(u, v) { // the corner or point under the pointer that can be dragged, of the chosen first
  const near = ([x, y]) => { const [a, b] = toScreen(x, y); return Math.hypot(a - u, b - v) <= NEAR; };
  const found = [];
  edit.marks.points.forEach((item) => { const at = item.pixels[edit.camera]; if (at && near(at)) found.push({ kind: "point", item }); });
  for (const [kind, items] of [["privacy", mine().privacy], ["mask", mine().mask]])
    for (const item of items) cornersOf(item).forEach((at, corner) => { if (near(at)) found.push({ kind, item, corner }); });
  if (edit.seen?.camera === edit.camera) edit.marks.zones.forEach((item, k) => edit.seen.zones[k]?.corners.forEach((at, corner) => { if (at && near(at)) found.push({ kind: "zone", item, corner }); }));
  const chosen = found.find(({ item }) => item === edit.chosen?.item);
  if (edit.tool === "select") return chosen || found[0] || null;
  const kind = edit.tool === "unmask" ? "mask" : edit.tool; // whoever draws near to other things does not mean these
  return chosen?.kind === kind ? chosen : edit.draft || edit.chosen?.kind === kind ? null : found.find((at) => at.kind === kind) || null;
}
function areaAt(u, v) {
  const inside = (corners) => { const path = new Path2D(); corners.forEach(([x, y]) => path.lineTo(...toScreen(x, y))); path.closePath(); pen.save(); pen.setTransform(1, 0, 0, 1, 0, 0); const found = pen.isPointInPath(path, u, v); pen.restore(); return found; };
  for (const [kind, items] of [["privacy", mine().privacy], ["mask", mine().mask]]) for (const item of items) if (inside(cornersOf(item))) return { kind, item };
  if (edit.seen?.camera === edit.camera) for (const [k, item] of edit.marks.zones.entries()) { const corners = edit.seen.zones[k]?.corners || []; if (corners.length && corners.every(Boolean) && inside(corners)) return { kind: "zone", item }; }
  return null;
}
function inside([x, y]) { // corners stay on the picture
  const { width, height } = edit.shown;
  return [round(Math.min(width - 1, Math.max(0, x)), 1), round(Math.min(height - 1, Math.max(0, y)), 1)];
}
async function clicked(u, v) {
  if (!edit.shown) return;
  const pixel = toPixel(u, v), first = edit.draft?.at || edit.draft?.corners[0];
  if (first && edit.draft.corners.length > 2) { const [a, b] = toScreen(...first); if (Math.hypot(a - u, b - v) <= NEAR) { close(); return; } }
  if (edit.tool === "select") { choose(areaAt(u, v)); return; }
  if (edit.tool === "point") { place(pixel); return; }
  if (edit.tool === "zone") {
    const camera = edit.camera, at = await (await ask("ground", { camera, pixel, ground: ground() })).json();
    if (!at) { say(edit.state.cameras.find((c) => c.id === camera).posed && edit.state.upright ? "That is above the horizon: click the ground." : "Zones need cameras whose poses are known: run the site first, or state them.", true); return; }
    if (edit.draft?.kind !== "zone") edit.draft = { kind: "zone", corners: [], at: pixel };
    edit.draft.corners.push(at);
  } else {
    if (edit.draft?.kind !== edit.tool) edit.draft = { kind: edit.tool, corners: [] };
    edit.draft.corners.push(inside(pixel));
  }
  say(""); renew();
}
function place(pixel) {
  const at = inside(pixel).map((v) => round(v, 1));
  if (edit.chosen?.kind !== "point") { newPoint(at); return; }
  change(() => { edit.chosen.item.pixels[edit.camera] = at; });
}
function newPoint(at) {
  let number = edit.marks.points.length + 1;
  while (edit.marks.points.some((p) => p.id === `point-${number}`)) number++;
  const item = { was: null, id: `point-${number}`, position: null, pixels: at ? { [edit.camera]: at } : {} };
  change(() => { edit.marks.points.push(item); edit.chosen = { kind: "point", item }; });
  tool("point");
}
function close() {
  const { kind, corners } = edit.draft || { corners: [] };
  if (corners.length < 3) { say("A polygon has three corners or more.", true); return; }
  edit.draft = null;
  change(() => {
    const item = kind === "zone" ? { was: null, name: `zone-${edit.marks.zones.length + 1}`, corners, least_m: 0 } : kind === "privacy" ? { was: null, corners, shares: false } : { use: kind === "unmask", corners };
    (kind === "zone" ? edit.marks.zones : kind === "privacy" ? mine().privacy : mine().mask).push(item);
    edit.chosen = { kind: kind === "unmask" ? "mask" : kind, item };
  });
}
function remove({ kind, item, corner }) {
  change(() => {
    if (corner !== undefined && item.corners.length > 3) { inPixels(item); item.corners.splice(corner, 1); edit.chosen = { kind, item }; return; }
    const lists = { point: edit.marks.points, zone: edit.marks.zones, privacy: mine().privacy, mask: mine().mask };
    lists[kind].splice(lists[kind].indexOf(item), 1); edit.chosen = null;
  });
}
function choose(what) { edit.chosen = what; renew(); }

const held = new Map();
let drag = null;
const where = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
canvas.addEventListener("pointerdown", (event) => {
  canvas.focus({ preventScroll: true }); canvas.setPointerCapture(event.pointerId);
  const at = where(event); held.set(event.pointerId, at);
  const handle = edit.shown && held.size === 1 && event.button === 0 ? handleAt(...at) : null;
  if (handle) { if (edit.chosen?.item !== handle.item || edit.chosen.corner !== handle.corner) edit.chosen = handle; renew(); }
  drag = { from: at, last: at, handle, moved: held.size > 1, before: packed(), left: event.button === 0 };
});
canvas.addEventListener("pointermove", (event) => {
  if (!held.has(event.pointerId) || !drag) return;
  const at = where(event), others = [...held.entries()].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
  if (others.length) { // two fingers
    const [other] = others, old = held.get(event.pointerId), far = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
    zoom(far(at) / Math.max(1, far(old)), (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
  } else if (drag.moved || Math.hypot(at[0] - drag.from[0], at[1] - drag.from[1]) > 4) {
    drag.moved = true;
    if (drag.handle) moveHandle(drag.handle, at); else { edit.at.x += at[0] - drag.last[0]; edit.at.y += at[1] - drag.last[1]; }
    draw();
  }
  held.set(event.pointerId, at); drag.last = at;
});
function moveHandle({ kind, item, corner }, at) {
  const pixel = inside(toPixel(...at));
  if (kind === "point") item.pixels[edit.camera] = pixel;
  else if (kind === "zone") edit.seen.zones[edit.marks.zones.indexOf(item)].corners[corner] = pixel;
  else { inPixels(item); item.corners[corner] = pixel; }
}
canvas.addEventListener("pointerup", attempt(async (event) => {
  if (!held.delete(event.pointerId) || held.size) return;
  const { handle, moved, before, left } = drag, at = where(event);
  drag = null;
  if (!moved) { if (!handle && left) await clicked(...at); return; }
  if (handle?.kind === "zone") {
    const there = await (await ask("ground", { camera: edit.camera, pixel: inside(toPixel(...at)), ground: ground() })).json();
    if (there) handle.item.corners[handle.corner] = there; else say("That is above the horizon.", true);
  }
  if (packed() !== before) edit.undo.push(before);
  renew();
}));
canvas.addEventListener("pointercancel", (event) => { held.delete(event.pointerId); drag = null; });
canvas.addEventListener("dblclick", () => { if (edit.draft?.corners.length > 2) close(); });
canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.0015), ...where(event)); }, { passive: false });
canvas.addEventListener("contextmenu", (event) => event.preventDefault());

// ---------------------------------------------------------------------------------------------------- keys
const TOOLS = ["select", "privacy", "mask", "unmask", "zone", "point"];
function tool(name) { edit.tool = name; if (edit.draft && edit.draft.kind !== name) edit.draft = null; renew(); }
function step(by) { const ids = edit.state.cameras.map((c) => c.id); attempt(show)(ids[(ids.indexOf(edit.camera) + by + ids.length) % ids.length]); }
document.addEventListener("keydown", (event) => {
  const control = event.ctrlKey || event.metaKey, typing = event.target.matches("input"), onPicture = event.target === canvas || event.target === document.body;
  const does = (action) => { event.preventDefault(); action(); };
  if (control && event.key === "s") return does(attempt(save));
  if (typing || event.altKey) return undefined;
  if (control && event.key === "z") return does(undo);
  if (control) return undefined;
  if (event.key === "Escape") return does(() => { if (edit.draft) edit.draft = null; else if (edit.chosen) edit.chosen = null; else canvas.blur(); renew(); });
  if (event.key === "Delete" && edit.chosen) return does(() => remove(edit.chosen));
  if (!onPicture) return undefined;
  if (event.key === "Tab" && event.target === canvas) return does(() => step(event.shiftKey ? -1 : 1));
  if (event.key === "Enter" && edit.draft) return does(close);
  if (event.key === "Backspace" && edit.draft) return does(undo);
  if (event.key === "0") return does(fit);
  if (event.key === "+" || event.key === "-") return does(() => zoom(event.key === "+" ? 1.25 : 0.8));
  if (TOOLS["123456".indexOf(event.key)]) return does(() => tool(TOOLS["123456".indexOf(event.key)]));
  const arrow = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  if (arrow) return does(() => { edit.at.x += 40 * arrow[0]; edit.at.y += 40 * arrow[1]; draw(); });
  return undefined;
});

// ---------------------------------------------------------------------------------------------------- lists beside it
function element(tag, given = {}, ...inner) { const made = Object.assign(document.createElement(tag), given); made.append(...inner); return made; }
function field(value, takes, given = {}) {
  const input = element("input", { value: value ?? "", ...given });
  input.addEventListener("change", () => change(() => takes(input.value)));
  return input;
}
function row(kind, item, words) {
  const name = typeof words === "string" ? element("button", { className: "name", textContent: words }) : words;
  if (typeof words === "string") name.addEventListener("click", () => choose({ kind, item }));
  else name.addEventListener("focus", () => { if (edit.chosen?.item !== item) { edit.chosen = { kind, item }; mark(); looked(); } });
  const cut = element("button", { textContent: "×", title: "Remove", ariaLabel: `Remove ${kind}` });
  cut.addEventListener("click", () => remove({ kind, item }));
  const made = element("li", { className: item.fault ? "fault" : "" }, element("div", { className: "row" }, name, cut));
  if (item.fault) made.append(element("p", { className: "why", textContent: `not saved: ${item.fault}` }));
  made.item = item;
  return made;
}
function mark() { for (const li of $$("aside li")) li.classList.toggle("chosen", edit.chosen?.item === li.item); draw(); }
function fill(list, items, build) { // rows that stay are not built anew: somebody may type in them, or go to their next field
  const rows = [...list.children];
  if (rows.length === items.length && rows.every((li, k) => li.item === items[k])) for (const li of rows) li.renew();
  else list.replaceChildren(...items.map(build));
}
function put(input, value) { const text = String(value ?? ""); if (input.value !== text) input.value = text; }
function polygons() {
  const areas = mine().mask.map((item) => row("mask", item, `${item.use ? "use again" : "leave out"}, ${item.corners.length} corners`));
  const there = mine().privacy.map((item) => row("privacy", item, `privacy, ${item.corners.length} corners`));
  $("#polygons").replaceChildren(...there, ...areas);
  if (!there.length && !areas.length) $("#polygons").append(element("p", { className: "soft", textContent: "Nothing is drawn here." }));
}
function zones() {
  fill($("#zones"), edit.marks.zones, (zone) => {
    const name = field(zone.name, (text) => { zone.name = text; }, { ariaLabel: "Name of the zone" });
    const least = field(zone.least_m, (text) => { zone.least_m = Math.max(0, +text || 0); }, { type: "number", step: "0.1", min: "0" });
    const made = row("zone", zone, name);
    made.append(element("label", { className: "inline soft" }, "changes from", least, "m"));
    made.renew = () => { put(name, zone.name); put(least, zone.least_m); };
    return made;
  });
}
function points() {
  const names = edit.state.geodetic ? ["latitude", "longitude", "height"] : ["x", "y", "z"];
  fill($("#points"), edit.marks.points, (point) => {
    const name = field(point.id, (text) => { point.id = text; }, { ariaLabel: "Name of the point" }), made = row("point", point, name);
    const inputs = names.map((axis) => element("input", { type: "number", step: "any", placeholder: axis, ariaLabel: axis }));
    for (const input of inputs) input.addEventListener("change", () => {
      const typed = inputs.map((i) => (i.value === "" ? null : Number(i.value))); // half of it is kept, too, but is no position yet
      change(() => { point.position = typed.every((v) => v === null) ? null : typed; });
    });
    made.append(element("div", { className: "place" }, ...inputs), element("div", { className: "off" }));
    made.renew = () => {
      put(name, point.id);
      inputs.forEach((input, k) => { put(input, point.position?.[k]); input.setAttribute("aria-invalid", String(Boolean(point.fault) && input.value === "")); });
    };
    made.renew();
    return made;
  });
  residuals();
}
function residuals() {
  edit.marks.points.forEach((point, k) => {
    const box = $("#points").children[k]?.querySelector(".off"), found = edit.seen?.residuals[k];
    if (!box) return;
    const words = Object.keys(point.pixels).map((camera) => {
      const off = found?.pixels[camera];
      return element("span", { className: off > 2 ? "much" : "", textContent: off === undefined || off === null ? camera : `${camera} ${off.toFixed(1)} px` });
    });
    if (found && found.metres !== null && found.metres !== undefined) words.push(element("span", { className: found.metres > 0.05 ? "much" : "", textContent: `${found.metres < 1 ? `${(1000 * found.metres).toFixed(0)} mm` : `${found.metres.toFixed(2)} m`} from its coordinates` }));
    box.replaceChildren(...words.flatMap((word, i) => (i ? [" · ", word] : [word])));
    if (!words.length) box.textContent = "not seen in any picture yet";
  });
}
function cameras() {
  $("#cameras").replaceChildren(...edit.state.cameras.map(({ id }) => {
    const { privacy, mask } = edit.marks.cameras[id], count = privacy.length + mask.length + edit.marks.points.filter((p) => p.pixels[id]).length;
    const button = element("button", { textContent: id, title: count ? `${count} drawn` : "" });
    if (count) button.append(element("span", { className: "count", textContent: count }));
    button.setAttribute("aria-current", String(id === edit.camera));
    button.addEventListener("click", () => attempt(show)(id));
    return button;
  }));
}
function renew() {
  for (const button of $$("[data-tool]")) button.setAttribute("aria-pressed", String(button.dataset.tool === edit.tool));
  $("[data-do=undo]").disabled = !edit.undo.length && !edit.draft;
  $("[data-do=save]").disabled = packed() === edit.saved;
  $("#hint").textContent = HINTS[edit.tool];
  cameras(); polygons(); zones(); points(); mark(); looked();
}
async function show(id) {
  edit.camera = id; edit.shown = null; edit.fault = ""; canvas.dataset.camera = "";
  if (edit.draft && edit.draft.kind !== "zone") edit.draft = null;
  if (edit.draft) edit.draft.at = null;
  if (edit.chosen && edit.chosen.kind !== "point" && edit.chosen.kind !== "zone") edit.chosen = null;
  renew();
  $("#cameras [aria-current=true]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
  try {
    const shown = await pictureOf(id);
    if (edit.camera === id) edit.shown = shown;
  } catch (error) { edit.pictures.delete(id); if (edit.camera === id) edit.fault = error.message; }
  if (edit.camera === id) { fit(); renew(); canvas.dataset.camera = id; }
}

// ---------------------------------------------------------------------------------------------------- the start
const ACTIONS = { undo, save: attempt(save), done: attempt(done), in: () => zoom(1.25), out: () => zoom(0.8), fit, "new-point": () => newPoint(null) };
for (const button of $$("[data-do]")) button.addEventListener("click", () => { ACTIONS[button.dataset.do](); if (button.dataset.do === "new-point") canvas.focus(); });
for (const button of $$("[data-tool]")) button.addEventListener("click", () => { tool(button.dataset.tool); canvas.focus({ preventScroll: true }); });
$("#ground").addEventListener("change", looked);
addEventListener("beforeunload", (event) => { if (edit.marks && packed() !== edit.saved) event.preventDefault(); });
new ResizeObserver(() => { if (edit.marks) fit(); }).observe(canvas);
attempt(async () => {
  taken(await (await ask("state")).json());
  $("#site").textContent = edit.state.site; $("#file").textContent = `${edit.state.file}, night of ${edit.state.night}`; $("#ground").value = edit.state.ground;
  document.title = `${edit.state.site} · wbflow edit`;
  await show(edit.state.cameras[0].id);
  canvas.focus({ preventScroll: true });
})();
