import { PerspectiveCamera } from "three";

/** A camera with OpenCV's axes: focal lengths and principal point in pixels, rows of a 4 x 4 matrix. */
export interface View {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  world_to_camera: number[][];
  unit: number;
}

/** A model with its method's own look, by WebGPU, out of a page that `msb web --tier dedicated` wrote. */
export class DedicatedPage {
  private constructor();
  /** Throws where there is no WebGPU, where it refuses the model, and where `url` is no such page. */
  static open(url: string, canvas: HTMLCanvasElement, told?: (text: string) => void): Promise<DedicatedPage>;
  /** The method's name, and the number of faces. */
  readonly title: string;
  readonly faces: number;
  /** What a free camera looks at. */
  readonly sphere: { center: number[]; radius: number };
  /** The cameras that the page offers. */
  readonly cameras: (View & { name: string | null })[];
  /** sRGB, each 0 to 1. */
  readonly background: number[];
  /** Draws onto the canvas, in its size; resolves when that is done. */
  draw(camera: PerspectiveCamera, background?: number[]): Promise<void>;
  dispose(): void;
}

/** A perspective camera of three.js as the page has its own. */
export function viewOf(camera: PerspectiveCamera, width: number, height: number, unit?: number): View;
