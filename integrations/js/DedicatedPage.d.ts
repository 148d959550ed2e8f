import { PerspectiveCamera } from "three";

/**
 * A camera with OpenCV's axes. Focal lengths and principal point are in pixels, `world_to_camera` has the rows of a
 * 4 x 4 matrix, and `unit` is a length in camera space, for example for near planes.
 */
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
  /** Rejects if the browser has no WebGPU, if the device cannot draw the model, or if `url` is not such a page. */
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
  /** Draws onto the canvas at its current size. Resolves when the frame is complete. */
  draw(camera: PerspectiveCamera, background?: number[]): Promise<void>;
  /** Releases the graphics device. */
  dispose(): void;
}

/** Converts a three.js perspective camera to a view of the page. */
export function viewOf(camera: PerspectiveCamera, width: number, height: number, unit?: number): View;
