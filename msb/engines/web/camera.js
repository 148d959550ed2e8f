"use strict";
// A view is { width, height, fx, fy, cx, cy, world_to_camera, unit }, with OpenCV's camera axes and a row-major matrix.
// `matrixOf` returns the matrix of a view.
// The matrix measures lengths in camera space in multiples of `unit`.
export function matrixOf(view) {
  const m = view.world_to_camera;
  return [...m.slice(0, 3).map((row) => row.map((value) => value / (view.unit || 1))), m[3]];
}
