"use strict";
// A view is { width, height, fx, fy, cx, cy, world_to_camera, unit }: ours, OpenCV, row-major. Near planes count
// in its unit, so it is drawn by a matrix that does, too.
export function matrixOf(view) {
  const m = view.world_to_camera;
  return [...m.slice(0, 3).map((row) => row.map((value) => value / (view.unit || 1))), m[3]];
}
