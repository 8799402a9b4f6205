"use strict";
// The interactive parts of the page.
(() => {
  const $ = (q, of = document) => of.querySelector(q), $$ = (q, of = document) => [...of.querySelectorAll(q)];

  for (const copy of $$("img[data-same]")) { // each picture is embedded only once
    const first = document.getElementById(copy.dataset.same);
    if (first?.src) copy.src = first.src; else if (first) copy.replaceWith(first.cloneNode(true)); else copy.remove();
  }

  for (const head of $$("table.sortable thead th")) head.firstElementChild.addEventListener("click", () => {
    const table = head.closest("table"), column = [...head.parentNode.children].indexOf(head);
    const down = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    const key = row => row.children[column].dataset.value ?? row.children[column].textContent, rows = [...table.tBodies[0].rows];
    const numbers = rows.every(r => key(r) === "" || !isNaN(key(r)));
    rows.sort((a, b) => {
      if (key(a) === "" || key(b) === "") return (key(a) === "") - (key(b) === ""); // unknown values come last
      return down * (numbers ? key(a) - key(b) : key(a).localeCompare(key(b), undefined, {numeric: true}));
    });
    for (const other of head.parentNode.children) other.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", down > 0 ? "ascending" : "descending");
    table.tBodies[0].append(...rows);
  });

  for (const table of $$(".scroll table")) for (const row of table.tBodies[0].rows) $$("th", table).forEach((head, column) => {
    const cell = row.children[column], words = head.firstElementChild?.title; // a figure has the name and explanation of its column
    cell.dataset.label = head.textContent;
    if (words) cell.title = words;
  });

  if (matchMedia("(max-width: 700px)").matches) for (const fold of $$("details.at-length")) fold.open = false; // on a phone, to keep the page short

  const meaning = $("#meaning");
  let shown = 0;
  addEventListener("click", e => { // where no pointer can rest, a tap shows what would appear below it
    if (!matchMedia("(hover: none)").matches || e.target.closest("a, button, input, summary")) return;
    const described = e.target.closest("[title], :has(> title)"), text = described?.title || described?.querySelector("title")?.textContent || "";
    clearTimeout(shown); meaning.hidden = !text; meaning.textContent = text;
    if (text) shown = setTimeout(() => { meaning.hidden = true; }, 6000);
  });

  addEventListener("beforeprint", () => { for (const fold of $$("details")) fold.open = true; });

  const words = $("#first .words"), more = () => words.classList.toggle("more", words.scrollHeight - words.clientHeight - words.scrollTop > 8);
  words.addEventListener("scroll", more); addEventListener("resize", more); more();

  for (const name of $$(".plan .dot text, .plan .mark text")) { // none is cut off at the edge
    const box = name.getBBox(), wide = name.ownerSVGElement.viewBox.baseVal.width, beyond = Math.max(0, box.x + box.width + 6 - wide) || Math.min(0, box.x - 6);
    if (beyond) name.setAttribute("x", +name.getAttribute("x") - beyond);
  }

  const stored = $("#scene"), root = $("#view");
  if (!stored || !root) return;
  const message = $(".message", root);
  const scene = JSON.parse(stored.textContent), view = window.view = new CloudView(root, scene);

  const axes = scene.axes, legend = $(".legend"), changesKey = $(".key.changes");
  function colour(mode) {
    view.mode = mode; view.draw();
    for (const button of $$("[data-mode]")) button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
    const layer = view.sets[0]?.points.layers[mode];
    legend.hidden = !layer;
    if (changesKey) changesKey.hidden = mode !== "change";
    if (!layer) return;
    $(".low", legend).textContent = inWords(layer.low, layer.unit); $(".high", legend).textContent = inWords(layer.high, layer.unit);
    $(".ramp", legend).style.background = rampCss(rampOf(mode));
  }
  for (const button of $$("[data-mode]")) button.addEventListener("click", () => colour(button.dataset.mode));
  const does = {
    home: () => view.reset(), above: () => view.above(),
    cameras: b => { view.showCameras = !view.showCameras; b.setAttribute("aria-pressed", String(view.showCameras)); view.draw(); },
    full: () => document.fullscreenElement ? document.exitFullscreen() : root.parentNode.requestFullscreen?.(),
  };
  for (const button of $$("[data-do]")) button.addEventListener("click", () => does[button.dataset.do](button));

  const measure = window.measure = new Measure(view, scene, root.parentNode), [lowest, highest] = $$("[data-clip]");
  view.keys = key => key === "Enter" ? (measure.addMiddle(), true) : key === "Backspace" ? (measure.undo(), true) : key === "Escape" ? (does.measure(), true) : false;
  Object.assign(does, {
    measure: () => { measure.active = !measure.on; for (const button of $$("[data-do=measure]")) button.setAttribute("aria-pressed", String(measure.on)); $(".place", root).textContent = ""; },
    undo: () => measure.undo(),
    copy: b => copied(b, measure.text() || $(".place", root).textContent),
    blink: () => window.nights?.blink(!window.nights.timer),
    link: b => { history.replaceState(null, "", measure.hash()); copied(b, location.href); },
  });
  function copied(button, text) {
    navigator.clipboard?.writeText(text).catch(() => {}); button.dataset.copied = text; button.classList.add("done"); setTimeout(() => button.classList.remove("done"), 900);
  }
  function clips() { // only points between the two heights are drawn
    const cut = v => view.span[0] + (view.span[1] - view.span[0]) * v / 1000, [low, high] = [+lowest.value, +highest.value];
    view.clip = low <= 0 && high >= 1000 ? null : [low <= 0 ? -1e9 : cut(low), high >= 1000 ? 1e9 : cut(high)]; view.draw();
    sayClips();
  }
  function sayClips() { // beside the sliders, heights as the world counts them
    const cut = v => view.span[0] + (view.span[1] - view.span[0]) * v / 1000 + dot(axes.rows[2], axes.origin);
    for (const slider of [lowest, highest]) slider.parentNode.querySelector("output").textContent = inWords(cut(+slider.value), axes.unit);
  }
  for (const slider of [lowest, highest]) slider.addEventListener("input", clips);
  function openLink() {
    const found = measure.read(location.hash);
    if (!found) return;
    if (found.points.length) { if (!measure.on) does.measure(); measure.points = []; for (const p of found.points) measure.add(p); }
    window.nights?.show(found.wipe);
    colour(found.colour || "photograph"); view.onCamera(view.chosen);
  }
  addEventListener("hashchange", openLink);

  const inset = $(".inset", root);
  view.onCamera = cam => { // what it saw, beside the cloud as it sees it
    const shot = cam && $$(".card").find(card => $("[data-fly]", card)?.dataset.fly === cam.id);
    const image = shot && $(".shot img", shot);
    inset.hidden = !cam;
    if (!cam) return;
    $("img", inset).hidden = !image; if (image) $("img", inset).src = image.src;
    $("figcaption", inset).textContent = [cam.id, cam.note].filter(Boolean).join(": ");
  };
  view.onPlace = p => { // where that is, in the world
    const world = p && [0, 1, 2].map(k => axes.origin[k] + axes.rows[0][k] * p[0] + axes.rows[1][k] * p[1] + axes.rows[2][k] * p[2]);
    $(".place", root).textContent = world ? world.map(v => v.toFixed(2)).join("  ") + (axes.unit ? ` ${axes.unit}` : "") : "";
  };
  for (const link of $$("[data-fly]")) link.addEventListener("click", e => {
    const cam = scene.cameras.find(c => c.id === link.dataset.fly);
    if (!cam) return;
    e.preventDefault(); root.scrollIntoView({behavior: "smooth", block: "nearest"}); view.flyTo(cam);
  });
  for (const link of $$("[data-mark]")) link.addEventListener("click", e => {
    const mark = scene.marks.find(m => m.name === link.dataset.mark);
    if (!mark) return;
    e.preventDefault(); root.scrollIntoView({behavior: "smooth", block: "nearest"}); colour("change"); view.flyToMark(mark);
  });

  function drawPlan(points) { // the same points from above, below the drawing
    const canvas = $(".plan canvas");
    if (!canvas) return;
    const [left, top, scale, wide, high] = ["left", "top", "scale", "width", "height"].map(k => +canvas.dataset[k]);
    const width = canvas.width = Math.round(wide), height = canvas.height = Math.round(high), data = new ImageData(width, height);
    const image = new Uint32Array(data.data.buffer), heights = new Float32Array(image.length).fill(-Infinity), pixels = pixelsOf(points, "photograph");
    const reach = Math.max(0, Math.min(3, Math.round(points.voxel * scale / 2)));
    for (let i = 0; i < points.n; i++) {
      const x = Math.round((points.at[3 * i] - left) * scale), y = Math.round((top - points.at[3 * i + 1]) * scale), z = points.at[3 * i + 2];
      for (let v = Math.max(0, y - reach); v <= Math.min(height - 1, y + reach); v++) for (let u = Math.max(0, x - reach); u <= Math.min(width - 1, x + reach); u++) {
        const k = v * width + u;
        if (z > heights[k]) { heights[k] = z; image[k] = pixels[i]; }
      }
    }
    const pen = canvas.getContext("2d"), draw = () => {
      pen.setTransform(1, 0, 0, 1, 0, 0); pen.globalAlpha = 1; pen.putImageData(data, 0, 0);
      for (const button of $$("[data-on-map][aria-pressed=true]")) { // a picture of the ground over the points
        const layer = document.getElementById(`layer-${button.dataset.onMap}`);
        pen.setTransform(...layer.dataset.matrix.split(" ").map(Number)); pen.globalAlpha = 0.75; pen.imageSmoothingEnabled = false;
        pen.drawImage(layer, 0, 0, 1, 1);
      }
    };
    for (const button of $$("[data-on-map]")) button.addEventListener("click", () => {
      const on = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(on)); $(`.legend-of[data-of="${button.dataset.onMap}"]`).hidden = !on; draw();
    });
    draw();
  }
  (async () => {
    for (const stream of $$("script.points")) {
      try {
        const points = await unpackPoints(stream.textContent, axes);
        view.add(points, stream.dataset.of);
        if (stream.dataset.of === "product") { drawPlan(points); message.hidden = true; }
      } catch (error) { message.textContent = `the points cannot be shown here: ${error.message}`; root.dataset.state = "failed"; return; }
    }
    window.nights = new Nights(view, $(".nights"));
    root.dataset.state = view.sets.length ? "ready" : "empty";
    const heights = view.sets[0]?.points.at.filter((_, k) => k % 3 === 2).sort() || [0, 1];
    view.span = [heights[Math.floor(0.001 * heights.length)], heights[Math.ceil(0.999 * (heights.length - 1))]];
    if (lowest) sayClips();
    if (location.hash.startsWith("#colour=")) colour(location.hash.slice(8)); else openLink();
  })();
})();
