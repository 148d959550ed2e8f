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

/** Native rendering of a model with WebGPU, from a page of `msb web --tier dedicated`. */
export class DedicatedPage {
  private constructor();
  /** Throws if there is no WebGPU, if the device cannot draw the model, or if `url` is not such a page. */
  static open(url: string, canvas: HTMLCanvasElement, onProgress?: (text: string) => void): Promise<DedicatedPage>;
  /** The name of the method, and the number of faces. */
  readonly title: string;
  readonly faces: number;
  /** A sphere around the model, for placing a camera. */
  readonly sphere: { center: number[]; radius: number };
  /** The cameras stored in the page. */
  readonly cameras: (View & { name: string | null })[];
  /** The background of the page: sRGB values, 0 to 1. */
  readonly background: number[];
  /** Draws onto the canvas at its current size; resolves when the frame is complete. */
  draw(camera: PerspectiveCamera, background?: number[]): Promise<void>;
  dispose(): void;
}

/** Converts a three.js perspective camera to a view of the page. */
export function viewOf(camera: PerspectiveCamera, width: number, height: number, unit?: number): View;
