// Draws the native rendering of a model with WebGPU. The module reads WGSL, passes and arrays from a page of
// `msb web --tier dedicated`. The page and the module use the same script to execute the passes.
import { Dedicated } from "./shared/dedicated.js";
import { shrink, storedArray } from "./shared/store.js";

export class DedicatedPage {
  // Reads the page at `url` and prepares its model for `canvas`. `onProgress(text)` is called with progress messages.
  static async open(url, canvas, onProgress = () => {}) {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`DedicatedPage: ${url} cannot be loaded: HTTP status ${answer.status}`);
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const scene = JSON.parse(page.getElementById("scene")?.textContent || "{}"), about = scene.dedicated;
    if (!about) throw new Error(`DedicatedPage: ${url} is not a page of msb web --tier dedicated`);
    const read = async (name) => {
      const { shrunk: source, ...head } = about.arrays[name];
      return source ? shrink(await read(source.of), source.factor) : storedArray(name, head, page);
    };
    const result = new DedicatedPage(), unit = [...scene.cameras, ...about.tests.map((test) => test.view)][0]?.unit || 1;
    Object.assign(result, { title: about.title, faces: about.faces, background: scene.background, cameras: scene.cameras });
    result.sphere = about.sphere;
    result.canvas = canvas;
    result.record = about.view;
    result.unit = unit;
    result.drawing = await Dedicated.open(about, canvas, read, onProgress);
    return result;
  }

  // Draws onto the canvas with a three.js camera, over `background` (sRGB values, 0 to 1). Resolves when the
  // frame is complete.
  draw(camera, background = this.background) {
    const view = viewOf(camera, this.canvas.width, this.canvas.height, this.unit);
    return this.drawing.draw(view, background, this.record.degree, this.record.own);
  }

  dispose() { this.drawing.device.destroy(); }
}

// Converts a three.js perspective camera to a view of the page: OpenCV axes, focal lengths in pixels.
export function viewOf(camera, width, height, unit = 1) {
  camera.updateMatrixWorld();
  const p = camera.projectionMatrix.elements, m = camera.matrixWorldInverse.elements;
  const row = (k, sign) => [sign * m[k], sign * m[k + 4], sign * m[k + 8], sign * m[k + 12]];
  return {
    width, height, fx: width * p[0] / 2, fy: height * p[5] / 2, cx: width * (1 - p[8]) / 2, cy: height * (1 + p[9]) / 2,
    world_to_camera: [row(0, 1), row(1, -1), row(2, -1), [0, 0, 0, 1]], unit,
  };
}
