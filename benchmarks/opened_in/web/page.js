// The page of an engine: opens the file once, draws each requested view, and answers with the pixels of the canvas.
"use strict";
const mended = new URLSearchParams(location.search).has("mended");  // use the corrected colour settings

async function shown(canvas, draw, view) {
  await draw(view);
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  return copy.getImageData(0, 0, canvas.width, canvas.height).data;
}

async function obey(open) {
  const answer = (head, ...parts) =>
    fetch("answer", { method: "POST", body: new Blob([JSON.stringify(head), "\n", ...parts]) });
  const asked = async () => {
    // Who told us what to draw has gone: end the browser with its only window.
    try { return await (await fetch("next")).json(); } catch { window.close(); return null; }
  };
  const canvas = document.querySelector("canvas");
  canvas.width = Number(new URLSearchParams(location.search).get("width"));
  canvas.height = Number(new URLSearchParams(location.search).get("height"));
  try {
    const draw = await open(canvas, "model.glb");
    const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    await answer({ browser: navigator.userAgent, device: gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER) });
    for (let view = await asked(); view; view = await asked()) await answer({}, await shown(canvas, draw, view));
  } catch (error) { await answer({ error: String(error && error.message || error) }); }
}
window.addEventListener("unhandledrejection", ({ reason }) => { throw reason; });
