import { BufferGeometry, Loader, LoadingManager, Mesh, MeshBasicMaterial } from "three";

/** The manifest of an asset, described in docs/triasset.md of MeshSplatBench. */
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
  origin?: number[];
  sh_degree: number;
  color_space: "srgb" | "linear";
  coordinate_frame: { handedness: string; up: string; units: string };
  required_passes: Record<string, string[]>;
  settings: Record<string, { value: number | string | boolean | null; source: string }>;
  [key: string]: unknown;
}

/** The values of a buffer (a view into the file); the last index of `shape` varies fastest. */
export interface TriassetBuffer {
  values: Float32Array | Uint32Array | Uint8Array;
  shape: number[];
  domain: "vertex" | "face" | "corner" | "global";
}

/** Reads a packed `.triasset`. Throws an Error whose message starts with `name` if the file is invalid. */
export function readTriasset(data: ArrayBuffer, name?: string): { manifest: Manifest; buffers: Map<string, TriassetBuffer> };

/** The standard-tier mesh of an asset. `position` is its origin, `up` its up axis, `userData.triasset` its `Manifest`. */
export type TriassetMesh = Mesh<BufferGeometry, MeshBasicMaterial | MeshBasicMaterial[]>;

/** Loads packed `.triasset` files, versions 1.0 and 1.1. */
export class TriassetLoader extends Loader<TriassetMesh> {
  constructor(manager?: LoadingManager);
  /** Throws an Error whose message starts with `name` if the file is invalid. */
  parse(data: ArrayBuffer, name?: string): TriassetMesh;
}
