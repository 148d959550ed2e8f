// Draws a model as its own renderer does, on WebGPU. What a frame takes (the method's WGSL, passes and arrays) is
// made by `msb web --tier dedicated`, whose page is read here; what runs it is that page's own script.
import { Dedicated } from "./shared/dedicated.js";
import { shrunk, storedArray } from "./shared/store.js";

export class DedicatedPage {
  // Reads the page at `url` and prepares its model for `canvas`; `told` hears what it waits for.
  static async open(url, canvas, told = () => {}) {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`DedicatedPage: ${url} is not there: status ${answer.status}`);
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const scene = JSON.parse(page.getElementById("scene")?.textContent || "{}"), about = scene.dedicated;
    if (!about) throw new Error(`DedicatedPage: ${url} is no page that msb web --tier dedicated wrote`);
    const read = async (name) => {
      const { shrunk: from, ...head } = about.arrays[name];
      return from ? shrunk(await read(from.of), from.factor) : storedArray(name, head, page);
    };
    const made = new DedicatedPage(), unit = [...scene.cameras, ...about.tests.map((test) => test.view)][0]?.unit || 1;
    Object.assign(made, { title: about.title, faces: about.faces, background: scene.background, cameras: scene.cameras });
    made.sphere = about.sphere;
    made.canvas = canvas;
    made.look = about.view;
    made.unit = unit;
    made.drawing = await Dedicated.open(about, canvas, read, told);
    return made;
  }

  // Resolves when the view of a camera of three.js is on the canvas, over `background`: sRGB values, 0 to 1.
  draw(camera, background = this.background) {
    const view = viewOf(camera, this.canvas.width, this.canvas.height, this.unit);
    return this.drawing.draw(view, background, this.look.degree, this.look.own);
  }

  dispose() { this.drawing.device.destroy(); }
}

// A perspective camera of three.js as the page has its own: with OpenCV's axes, and lengths in pixels.
export function viewOf(camera, width, height, unit = 1) {
  camera.updateMatrixWorld();
  const p = camera.projectionMatrix.elements, m = camera.matrixWorldInverse.elements;
  const row = (k, sign) => [sign * m[k], sign * m[k + 4], sign * m[k + 8], sign * m[k + 12]];
  return {
    width, height, fx: width * p[0] / 2, fy: height * p[5] / 2, cx: width * (1 - p[8]) / 2, cy: height * (1 + p[9]) / 2,
    world_to_camera: [row(0, 1), row(1, -1), row(2, -1), [0, 0, 0, 1]], unit,
  };
}
