"use strict";
// Starts the page: applies the options in its address, opens the model and shows the first view.
// `loader.js` calls this function after all scripts.
async function main() {
  byId("panel").hidden = query.has("bare");
  const kind = ["dedicated", "baked"].find((name) => start[name]) || "mesh";
  for (const part of document.querySelectorAll("[data-for]")) part.hidden = part.dataset.for !== kind;
  byId("panel").open = window.innerWidth > 1200;
  byId("up").value = start.up;
  byId("background").value = "#" + start.background
    .map((value) => Math.round(255 * Math.min(1, Math.max(0, value))).toString(16).padStart(2, "0")).join("");
  setCameras(start.cameras);
  if (!await openFirst()) return false;
  const wanted = query.get("camera");  // name or number of the first camera
  const index = wanted === null ? Math.min(0, views.length - 1)
    : views.findIndex((view, i) => view.name === wanted || String(i) === wanted);
  if (index >= 0) byId("cameras").value = String(index);
  if (index >= 0) choose(index); else fit();
  return true;
}
