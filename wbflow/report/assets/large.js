"use strict";
// A picture in a dialog, in the largest stored size; keypoints and inliers are drawn over a camera's picture.
(() => {
  const large = document.querySelector("#large"), image = large.querySelector("img"), canvas = large.querySelector("canvas");
  const bar = large.querySelector(".layers"), caption = large.querySelector("figcaption");
  const shown = {points: true, inliers: true};
  let places = {};

  const bytes = word => Uint8Array.from(word === "-" ? "" : atob(word), c => c.charCodeAt(0));
  const unpacked = word => new Uint16Array(bytes(word).buffer);

  function draw() {
    const [wide, high] = [image.naturalWidth, image.naturalHeight], pen = canvas.getContext("2d");
    canvas.width = wide; canvas.height = high;
    const size = Math.max(1.2, wide / 700);
    for (const [name, colour, r] of [["points", "#ffd23fcc", size], ["inliers", "#2ee6a8", 1.6 * size]]) {
      if (!shown[name] || !places[name]) continue;
      pen.strokeStyle = pen.fillStyle = colour; pen.lineWidth = 0.7 * size; pen.beginPath();
      for (let i = 0; i < places[name].length; i += 2) {
        const x = places[name][i] / 65535 * wide, y = places[name][i + 1] / 65535 * high;
        pen.moveTo(x + r, y); pen.arc(x, y, r, 0, 7);
      }
      name === "points" ? pen.fill() : pen.stroke();
    }
  }
  image.addEventListener("load", draw);
  for (const button of bar.querySelectorAll("button")) button.addEventListener("click", () => {
    const on = shown[button.dataset.layer] = !shown[button.dataset.layer];
    button.setAttribute("aria-pressed", String(on)); draw();
  });

  function open(button) {
    const small = button.querySelector("img"), card = button.closest(".card"), number = card?.id.replace("camera-", "");
    if (!small) return;
    const stored = document.querySelector(`script.large[data-of="${number}"]`), words = stored?.textContent.trim().split(" ");
    places = words ? {points: unpacked(words[1]), inliers: unpacked(words[2])} : {};
    bar.hidden = !(places.points?.length || places.inliers?.length);
    image.src = words ? `data:image/jpeg;base64,${words[0]}` : small.src; image.alt = small.alt;
    caption.textContent = [small.alt, [card?.dataset.keypoints, stored?.dataset.note].filter(Boolean).join("; "), words || !card?.id ? "" : "no room for it as large as it is"].filter(Boolean).join(": ");
    large.showModal();
  }
  for (const button of document.querySelectorAll("[data-large]")) button.addEventListener("click", () => open(button));
  large.addEventListener("click", e => { if (e.target === large || e.target === canvas || e.target === image) large.close(); });
})();
