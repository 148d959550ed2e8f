"use strict";
// A view is { width, height, fx, fy, cx, cy, world_to_camera, unit }, with OpenCV's camera axes and a row-major matrix.
// Returns its matrix in multiples of `unit`, because near planes are given in this unit.
export function matrixOf(view) {
  const m = view.world_to_camera;
  return [...m.slice(0, 3).map((row) => row.map((value) => value / (view.unit || 1))), m[3]];
}
