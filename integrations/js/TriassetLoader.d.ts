import { BufferGeometry, Loader, LoadingManager, Mesh, MeshBasicMaterial } from "three";

/** The manifest of an asset: docs/triasset.md of MeshSplatBench. */
export interface Manifest {
  format: "triasset";
  version: string;
  generator: string;
  method: string;
  topology: "triangle_soup" | "indexed_mesh";
  face_count: number;
  vertex_count: number;
  bounds: { min: number[]; max: number[] };
  bounding_sphere: { center: number[]; radius: number };
  sh_degree: number;
  color_space: "srgb" | "linear";
  coordinate_frame: { handedness: string; up: string; units: string };
  required_passes: Record<string, string[]>;
  settings: Record<string, { value: number | string | boolean | null; source: string }>;
  [key: string]: unknown;
}

/** Values of a buffer, a view into the file; the last index of `shape` varies fastest. */
export interface TriassetBuffer {
  values: Float32Array | Uint32Array | Uint8Array;
  shape: number[];
  domain: "vertex" | "face" | "corner" | "global";
}

/** What lies in a packed `.triasset`. Throws an Error that says what is wrong with it, after `name`. */
export function readTriasset(data: ArrayBuffer, name?: string): { manifest: Manifest; buffers: Map<string, TriassetBuffer> };

/** The standard look of an asset. `up` is the axis that points up, `userData.triasset` its `Manifest`. */
export type TriassetMesh = Mesh<BufferGeometry, MeshBasicMaterial | MeshBasicMaterial[]>;

/** Loads packed `.triasset` files, versions 1.0 and 1.1. */
export class TriassetLoader extends Loader<TriassetMesh> {
  constructor(manager?: LoadingManager);
  /** Throws an Error that says what is wrong with the file, after `name`. */
  parse(data: ArrayBuffer, name?: string): TriassetMesh;
}
